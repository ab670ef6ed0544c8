"""What all verbs share about taking recordings."""

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from eps_hil.cli._inputs import (
    Gaps,
    Reading,
    RecordingPaths,
    read_all,
    read_recording,
    reads_recordings,
    told_what_it_holds,
)
from eps_hil.errors import InputError


def _heard(words: list[str], gaps: Gaps = Gaps.REFUSE) -> tuple[list[Path], bool, Reading]:
    heard: list[tuple[list[Path], bool, Reading]] = []

    def verb(paths: RecordingPaths, quick: bool = False, *, reading: Reading) -> None:
        """Read them."""
        heard.append((paths, quick, reading))

    app = typer.Typer()
    app.command()(reads_recordings(verb, gaps))
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    return heard[0]


def test_a_verb_hears_the_reading_options() -> None:
    words = ["a.log", "--dbc", "x.dbc", "--dbc", "y.dbc", "--signals", "s.yaml", "--gaps", "mark"]
    paths, quick, reading = _heard([*words, "--ignore-unknown", "--channel", "can1", "--quick"])
    assert paths == [Path("a.log")]
    assert quick
    dbc = (Path("x.dbc"), Path("y.dbc"))
    assert reading == Reading(dbc, Path("s.yaml"), Gaps.MARK, ignore_unknown=True, channel="can1")


def test_what_is_not_said_has_the_verbs_default() -> None:
    assert _heard(["a.csv"])[2] == Reading()
    assert _heard(["a.csv"], Gaps.MARK)[2] == Reading(gaps=Gaps.MARK)


def test_the_same_recording_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s,motor_torque_nm\n0,1\n0.001,2\n")
    assert list(read_all([path], Reading())) == [str(path)]
    with pytest.raises(InputError, match="given twice"):
        read_all([path, path], Reading())
    (tmp_path / "b.csv").symlink_to(path)
    with pytest.raises(InputError, match="given twice"):
        read_all([path, tmp_path / "b.csv"], Reading())


def test_many_recordings_are_read_in_the_order_they_were_named(tmp_path: Path) -> None:
    paths = [tmp_path / f"{k}.csv" for k in (3, 1, 2, 5, 4)]
    for k, path in enumerate(paths):
        path.write_text(f"time_s,motor_torque_nm\n0,{k}\n0.001,{k}\n")
    read = read_all(paths, Reading())
    assert list(read) == [str(path) for path in paths]
    assert [one["motor_torque_nm"].value[0] for one in read.values()] == [0, 1, 2, 3, 4]


def test_of_several_bad_recordings_the_first_is_named(tmp_path: Path) -> None:
    paths = [tmp_path / f"{k}.csv" for k in range(6)]
    for k, path in enumerate(paths):
        long = "".join(f"{0.001 * row:.3f},1\n" for row in range(2000)) if k == 2 else "0,1\n"
        path.write_text("time_s,motor_torque_nm\n" + long + ("9,x\n" if k in (2, 3) else "9,1\n"))
    with pytest.raises(InputError, match=r"2\.csv.*'x' is not a number"):
        read_all(paths, Reading())


def test_a_refusal_names_the_file_and_what_it_holds(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s,motor_torque_nm,rack_force_n\n0,1,3\n0.001,2,3\n")
    recording = read_recording(path, Reading())
    with (
        pytest.raises(InputError, match=r"a\.csv.*no speed.*motor_torque_nm, rack_force_n"),
        told_what_it_holds(path, recording),
    ):
        raise ValueError("no speed")
