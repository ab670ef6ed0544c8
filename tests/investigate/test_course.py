"""One experiment tick by tick: it goes its course, and it ends at once beyond a limit."""

import math
from pathlib import Path

import pytest

from eps_hil.bus.frame import Frame
from eps_hil.errors import SafetyStop
from eps_hil.investigate.course import Course, Phase
from eps_hil.investigate.experiment import TICK_S, Experiment, Kind
from eps_hil.investigate.lockstep import LockstepRig
from eps_hil.physics.model import load_model
from eps_hil.programme.conductor import Reading, Wanted
from eps_hil.programme.limits import Limits

from .bench import written

MODEL = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")
LIMITS = Limits()
PASSES = Experiment(Kind.PASSES, 20.0, 1000.0)


def follow(course: Course, position_m: float = 0.0) -> list[Wanted]:
    """A rig that does what it is told, at once."""
    wanted, said = Wanted(0.0, 0.0), []
    while not course.over:
        position_m += wanted.speed_rad_s * TICK_S / MODEL.rack_to_rotor_ratio_rad_per_m
        wanted = course.step(Reading(wanted.speed_rad_s, position_m, wanted.force_n))
        said.append(wanted)
        assert len(said) < 4000
    return said


def test_it_goes_its_course_and_ends_at_rest_without_load() -> None:
    course = Course(PASSES, LIMITS, MODEL)
    said = follow(course, position_m=0.03)
    assert course.phase is Phase.DONE
    assert said[-1] == Wanted(0.0, 0.0)
    assert max(one.speed_rad_s for one in said) == pytest.approx(20.0, abs=2.0)
    assert max(one.force_n for one in said) == 1000.0
    loaded = [one.speed_rad_s for one in said if one.force_n == 1000.0]
    assert min(loaded) < -18.0, "both ways under load"


@pytest.mark.parametrize(
    ("reading", "what"),
    [
        (Reading(0.0, 0.051, 0.0), "rack position"),
        (Reading(-60.0, 0.0, 0.0), "rotor speed"),
        (Reading(0.0, 0.0, 0.0, 10.5), "torsion-bar torque"),
        (Reading(0.0, 0.0, 0.0, 0.0, -3.1), "motor torque"),
        (Reading(0.0, 0.0, 5000.0), "load"),
        (Reading(0.0, math.nan, 0.0), "rack position"),
    ],
)
def test_beyond_a_limit_it_ends_at_once_with_zero_set_points(reading: Reading, what: str) -> None:
    course = Course(PASSES, LIMITS, MODEL)
    for _ in range(100):
        course.step(Reading(0.0, course._way_m[0], 0.0))
    assert course.phase is Phase.COURSE
    assert course.step(reading) == Wanted(0.0, 0.0)
    assert course.over
    assert str(course.phase) == Phase.TRIPPED.value
    assert course.reason.startswith(what)


def test_a_rig_that_does_not_come_to_the_start_is_given_up() -> None:
    course = Course(PASSES, LIMITS, MODEL)
    for _ in range(1600):
        if not course.over:
            course.step(Reading(0.0, 0.02, 0.0))
    assert course.phase is Phase.FAILED
    assert "does not come to its start" in course.reason


def test_a_rest_is_a_rest_wherever_the_rack_is() -> None:
    """Nothing leads the rack back to its course while the experiment wants it to stand."""
    course = Course(Experiment(Kind.RESTS, 4.0, rest_s=1.0), LIMITS, MODEL)
    for _ in range(16):
        course.step(Reading(0.0, course._way_m[0], 0.0))
    assert course.phase is Phase.COURSE
    for _ in range(50):
        assert course.step(Reading(0.0, course._way_m[0] + 5e-4, 0.0)).speed_rad_s == 0.0


def test_a_limit_whose_signal_is_gone_ends_it(tmp_path: Path) -> None:
    """The rack's position is lost while the rack travels: no limit on it would be seen."""
    rig = LockstepRig(written(tmp_path), MODEL)
    course = Course(Experiment(Kind.PASSES, 40.0), LIMITS, MODEL)
    step, lost_s = rig._rig.step, [math.inf]

    def without(now_ns: int, *, stopping: bool = False) -> list[Frame]:
        if course.phase is Phase.COURSE and course._in_phase > 80:
            lost_s[0] = min(lost_s[0], rig.simulated_s)
        frames = step(now_ns, stopping=stopping)
        return [one for one in frames if one.can_id != 0x110 or math.isinf(lost_s[0])]

    rig._rig.step = without  # type: ignore[method-assign]
    with pytest.raises(SafetyStop, match="no good value of rack_force_n, rack_position_m"):
        rig.lead(course, None, lambda: None)
    assert rig.simulated_s - lost_s[0] < 0.08
    rig.let_go()
    assert abs(rig._readings.now().speed_rad_s) < 1.0
