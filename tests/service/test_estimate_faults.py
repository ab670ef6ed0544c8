"""A quick selection of ``scripts/estimate_faults``, and its judge judged."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from eps_hil.bus import sample_clock
from eps_hil.bus.protection import CrcRule, Seen
from eps_hil.bus.sample_clock import SampleClock
from eps_hil.estimation.stream import StreamEstimator
from eps_hil.oracle.faults import case, in_nodes
from eps_hil.oracle.faults.drive import drive
from eps_hil.oracle.faults.judge import errors
from eps_hil.oracle.faults.scene import STATE, TORQUES, Kind, Scene
from eps_hil.oracle.faults.stretch import MS, Stretch
from eps_hil.oracle.faults.table import table
from eps_hil.oracle.faults.traffic import T0_NS, VALID, Published, World
from eps_hil.service.core import ServiceCore

pytestmark = pytest.mark.slow

SEED = 20
HOLDS = (
    "ecu silent", "motor state silent", "torques silent", "rig silent", "bus silent",
    "gap of seconds", "frames lost", "frames doubled", "frames swapped", "one message late",
    "torques 20 ms late", "all frames late", "crc wrong", "sync crc wrong", "bits flipped",
    "error frames", "bus off", "flood", "second sender of our id", "signal not available",
    "counter stuck", "counter jumps", "second ecu", "ecu restarted", "rig restarted",
    "rig stopped", "service restarted", "service stopped", "estimates not sent", "clock step",
    "clock step half second back", "clock drift",
)  # fmt: skip


LIES = {
    "motor torque reads 8 nm", "signal off scale", "torques frozen", "signal frozen",
    "motor state frozen", "offset on a signal", "torque values late",
}  # fmt: skip
"""Values that are wrong and not impossible: not always seen. tests/estimation/test_false_*.py, and
docs/theory-estimator.md says what cannot be told."""


def test_every_kind_of_fault_is_tried_or_named() -> None:
    assert {*HOLDS, *LIES} == set(case.KINDS)
    assert not LIES & set(HOLDS)


@pytest.fixture(scope="module")
def world() -> World:
    return World([("demo", 24)])


@pytest.mark.parametrize("name", [case.NO_FAULT, *HOLDS])
def test_never_wrong_and_valid(world: World, name: str) -> None:
    outcome = case.single(world, name, SEED)
    assert outcome.wrong == [], "\n".join(outcome.story)


@pytest.mark.parametrize("every", [2, 10, 15])
def test_torques_that_come_too_seldom(world: World, every: int) -> None:
    """No sample is too old, and each hole is short enough to be bridged, again and again."""

    def torques_seldom(scene: Scene, since: int, until: int) -> tuple[str, int]:
        count = itertools.count(1)
        scene.change((TORQUES,), since, until, lambda item: None if next(count) % every else item)
        return f"one of {every} torques", until

    outcomes = [
        case.run(world, [Kind(torques_seldom, 2000, 4000)], seed, np.random.default_rng(seed))
        for seed in range(3)
    ]
    assert [outcome.wrong for outcome in outcomes] == [[]] * 3
    for outcome in outcomes:
        assert outcome.back_ms is not None
        assert outcome.back_ms > 600.0, "it was valid all the while"


_copy = World.copy


def _that_believes_values(world: World, core: ServiceCore) -> ServiceCore:
    """Nor does it look whether the friction is known, which a false speed leaves unknown."""
    made = _copy(world, core)
    estimator = made.estimator
    assert isinstance(estimator, StreamEstimator)
    limits = estimator.timing.limits._replace(on=False)
    estimator.timing = estimator.timing._replace(limits=limits)
    estimator.constants = estimator.constants._replace(unknown_limit_n=math.inf)
    return made


def test_without_the_crc_check_the_judge_finds_fault(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside it nothing may look at the values, which would notice most of the damage too."""
    monkeypatch.setattr(World, "copy", _that_believes_values)
    sound = [case.single(world, "bits flipped", SEED + k) for k in range(16)]
    assert all(outcome.longest_ms <= 20 for outcome in sound)
    monkeypatch.setattr(CrcRule, "good", lambda self, data: True)
    found = [case.single(world, "bits flipped", SEED + k) for k in range(16)]
    assert any(outcome.longest_ms > 20 for outcome in found)


def test_without_a_look_at_the_data_a_second_ecu_is_found(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(World, "copy", _that_believes_values)
    monkeypatch.setattr(Seen, "again", lambda self, t_ns, counter, data: None)
    monkeypatch.setattr(
        SampleClock, "_early", lambda self, *frame: self._restart(*frame, frame[1] - frame[0].stamp)
    )
    found = [case.single(world, "second ecu", SEED + k) for k in range(24)]
    assert any(outcome.longest_ms > 20 for outcome in found)


def test_without_the_relation_of_the_counters_late_torques_are_found(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(World, "copy", _that_believes_values)  # else it settles for as long
    monkeypatch.setattr(sample_clock, "_RELATED", 1 << 60)
    found = [case.single(world, "torques 20 ms late", SEED + k) for k in range(4)]
    assert any(outcome.longest_ms > 20 for outcome in found)


def test_a_service_that_never_comes_back_is_found(world: World) -> None:
    found = _judged(world, lambda each: each._replace(status=3, reason=2))
    assert any("not valid" in line for line in found)


def test_a_service_that_goes_quiet_is_found(world: World) -> None:
    found = _judged(world, lambda each: None)
    assert found == ["nothing was published"]


@pytest.mark.parametrize(("spell_ms", "told"), [(19, False), (25, True)])
def test_a_spell_of_wrong_values_is_found_by_its_length(
    world: World, spell_ms: int, told: bool
) -> None:
    count = [0]

    def spoil(each: Published) -> Published:
        count[0] += 1
        wrong = 200 < count[0] <= 200 + spell_ms
        return each._replace(force_n=each.force_n + 101.0) if wrong else each

    found = _judged(world, spoil)
    assert bool(found) == told, found


def test_an_age_that_is_too_small_is_found(world: World) -> None:
    found = _judged(world, lambda each: each._replace(age_ms=0.0), name="no fault", seed=2)
    assert any("off for" in line for line in found)


def test_the_table_has_a_line_for_every_kind(world: World) -> None:
    outcome = case.single(world, case.NO_FAULT, SEED)
    rows = [replace(outcome, kinds=(name,)) for name in case.KINDS]
    rows.append(replace(outcome, kinds=("bus off", "flood"), wrong=["x"]))
    lines = table(rows).splitlines()
    assert len(lines) == 2 + len(case.KINDS) + 1
    assert lines[-1].startswith("| 2 faults in sequence | 1 |")
    assert lines[-1].endswith("| 1 |")


class _Zeros(np.random.Generator):
    """Draws nothing but the least: a restarted ECU is in phase, and its angle is from zero."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))

    def integers(self, *args: object, **kwargs: object) -> int:  # type: ignore[override]
        return 0

    def random(self, *args: object, **kwargs: object) -> float:  # type: ignore[override]
        return 0.0


def test_a_restarted_ecu_has_its_zero_from_an_angle(world: World) -> None:
    """'Not available' is none: the angle would stand at the end of its range from then on."""
    start, demo = T0_NS + 2_000 * MS, world.recordings["demo"]
    stretch = Stretch(start, start + 600 * MS, demo.between(start, start + 600 * MS))
    stretch.world.append((start, "demo", 0))
    scene, layout = Scene(world, stretch, _Zeros()), world.layouts[STATE]
    field = layout.fields["MotorAngle"]
    missing = field.not_available * field.scale
    in_nodes._constant(scene, STATE, "MotorAngle", start, start + 300 * MS, missing)
    in_nodes.ecu_restarted(scene, start + 100 * MS, start + 200 * MS)
    told = [layout.value(i.frame.data, "MotorAngle") for i in stretch.items
            if i.frame.can_id == layout.can_id]  # fmt: skip
    assert told[:200] == [missing] * 200
    assert told[200] == 0.0
    assert max(abs(each) for each in told[200:]) < 20.0


@pytest.mark.parametrize("by_rad", [-4.0, 4.0])
def test_an_angle_that_jumps_at_rest_and_back_costs_the_wait_for_a_hole(
    world: World, by_rad: float
) -> None:
    """The manoeuvre rests from 22.7 to 24 s; the bristle stays known, so nothing has to slide."""
    start, demo = T0_NS + 22_500 * MS, world.recordings["demo"]
    stretch = Stretch(start, start + 1_490 * MS, demo.between(start, start + 1_490 * MS))
    stretch.world.append((start, "demo", 0))
    scene, layout = Scene(world, stretch, np.random.default_rng(0)), world.layouts[STATE]
    by = round(by_rad / layout.fields["MotorAngle"].scale)
    in_nodes._values(
        scene, STATE, start + 300 * MS, start + 400 * MS,
        lambda lay, data: lay.with_raw(data, MotorAngle=lay.raw(data, "MotorAngle") + by),
    )  # fmt: skip
    sent = drive(world, world.copy(demo.cores[22_500]), stretch)
    off = errors(scene, sent)
    valid = {each.at // MS - start // MS: each.status == VALID for each in sent}
    assert not any(valid.get(k, True) for k in range(305, 1_100))
    assert all(valid.get(k, True) for k in range(1_250, 1_490))
    assert np.nanmax(np.abs(off)) < 30.0


def _judged(
    world: World,
    change: Callable[[Published], Published | None],
    name: str = case.NO_FAULT,
    seed: int = SEED,
) -> list[str]:
    """What the judge says of a case whose published frames were tampered with."""

    def tampered(world: World, core: ServiceCore, stretch: Stretch, _: object) -> list[Published]:
        made = [change(each) for each in drive(world, core, stretch)]
        return [each for each in made if each is not None]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(case, "drive", tampered)
        return case.single(world, name, seed).wrong
