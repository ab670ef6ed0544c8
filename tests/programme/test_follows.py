"""A rack position that does not go the rotor's way leads nobody."""

from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.errors import SafetyStop
from eps_hil.programme.conductor import Conductor, Reading
from eps_hil.programme.follows import Follows
from eps_hil.programme.plan import PlannedCell
from eps_hil.rig.command import CommandState
from eps_hil.rig.sensors import REPORTED

from .link_bench import MODEL, LinkBench
from .programme_bench import PLAN

RATIO = MODEL.rack_to_rotor_ratio_rad_per_m
TURN_M = 6.283 / RATIO


def led(speed_rad_s: float, position: float = 1.0, zero: float = 0.0, wrap: float = 1e9) -> None:
    """Twenty seconds there and back; ``position`` and ``zero``: what is wrong with the readings."""
    follows, place = Follows(RATIO), 0.0
    for tick in range(2000):
        speed = speed_rad_s * (1 if tick % 1000 < 500 else -1)
        place += 0.01 * speed / RATIO
        follows.check(Reading(speed + zero, (position * place) % wrap, 0.0), 0.01 * tick)


@pytest.mark.parametrize("speed", [60.0, -60.0, 5.0])
@pytest.mark.parametrize("wrong", [{"position": 0.0}, {"position": -1.0}, {"wrap": TURN_M}])
def test_a_position_that_stands_still_or_goes_back(speed: float, wrong: dict[str, float]) -> None:
    with pytest.raises(SafetyStop, match="the limits of travel cannot be held"):
        led(speed, **wrong)


@pytest.mark.parametrize(
    "wrong", [{}, {"position": 0.8}, {"position": 1.2}, {"zero": 1.0}, {"zero": -1.0}]
)
@pytest.mark.parametrize("speed", [120.0, 60.0, 1.0])
def test_what_is_not_known_well_is_allowed(speed: float, wrong: dict[str, float]) -> None:
    led(speed, **wrong)


def test_a_dead_position_does_not_lead_a_rack_out_of_its_travel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot turned on and on towards the end stop: every limit was kept by the readings."""
    bench = LinkBench(tmp_path, monkeypatch)
    step = bench.rig._sensors.step

    def dead(truth: object, reported: object) -> None:
        step(truth, reported)  # type: ignore[arg-type]
        reported[REPORTED.index("rack_position_m")] = 0.0  # type: ignore[index]

    bench.rig._sensors.step = dead  # type: ignore[method-assign, assignment]
    plan = replace(PLAN, rack_travel_m=0.03)
    conductor = Conductor(PlannedCell(1, 20.0, 0.0, 1), plan, MODEL)
    bench.open()
    try:
        with pytest.raises(SafetyStop, match="stands still"):
            bench.link.lead(conductor, None, lambda: None)
    finally:
        bench.link.let_go()
    assert max(abs(place) for _, _, place in bench.truth) < 0.01
    assert bench.state is CommandState.RELEASED
