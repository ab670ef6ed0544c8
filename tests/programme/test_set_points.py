"""Set-points that the rig's database would read otherwise are refused before a bus is opened."""

from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.errors import InputError
from eps_hil.programme.conductor import Wanted
from eps_hil.programme.link import RigLink

from .link_bench import DBC, MODEL, written

SPEED = ' SG_ WheelSpeedSetPoint : 16|16@1- (0.001,0) [-32.767|32.767] "rad/s" RIG'
FORCE = ' SG_ RackForceSetPoint : 32|16@1- (0.5,0) [-16383.5|16383.5] "N" RIG'
MOST = Wanted(60.0, 3000.0)


def made(folder: Path, line: str, other: str, most: Wanted = MOST) -> RigLink:
    """A link by a database with another line."""
    text = DBC.read_text()
    assert text.count(line) == 1
    (folder / "rig.dbc").write_text(text.replace(line, other))
    return RigLink(replace(written(folder), dbc=(folder / "rig.dbc",)), MODEL, most)


@pytest.mark.parametrize(
    ("line", "other", "said"),
    [
        (FORCE, FORCE.replace('"N"', '"kN"'), "RackForceSetPoint: is in 'kN', and set-points are"),
        (FORCE, FORCE.replace('"N"', '""'), "RackForceSetPoint: is in '', and set-points are"),
        (SPEED, SPEED.replace("rad/s", "rpm"), "WheelSpeedSetPoint: is in 'rpm'"),
        (SPEED, SPEED.replace("rad/s", "deg/s"), "let the rig take rad/s"),
        (FORCE, FORCE.replace("16383.5", "2000"), "3000 N would be sent as 2000 N"),
        (FORCE, FORCE.replace("@1-", "@1+"), "would be sent as"),
        (SPEED, SPEED.replace("32.767", "2"), "rad/s would be sent as 2 rad/s"),
    ],
)
def test_what_the_database_reads_otherwise_is_refused(
    line: str, other: str, said: str, tmp_path: Path
) -> None:
    """500 N were sent as 12 kN, the end of the range of a set-point in kN."""
    with pytest.raises(InputError) as caught:
        made(tmp_path, line, other)
    assert said in str(caught.value)


def test_a_set_point_that_the_rig_does_not_have(tmp_path: Path) -> None:
    text = DBC.read_text().replace("WheelSpeedSetPoint", "Speed")
    (tmp_path / "rig.dbc").write_text(text)
    with pytest.raises(InputError, match="RIG_Command: has no signal WheelSpeedSetPoint"):
        RigLink(replace(written(tmp_path), dbc=(tmp_path / "rig.dbc",)), MODEL, MOST)


def test_what_it_reads_so_is_taken(tmp_path: Path) -> None:
    finer = FORCE.replace("(0.5,0) [-16383.5|16383.5]", "(0.1,0) [-3200|3200]")
    assert made(tmp_path, FORCE, finer).refused == 0
    assert made(tmp_path, FORCE, FORCE, Wanted(120.0, 10_000.0)).refused == 0
