"""A bristle of unknown history: told, forgotten by sliding, and bridged over a dropout at rest."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.gap import lose_way
from eps_hil.estimation.rack_force import RackForceEstimator
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs, physics_of
from eps_hil.estimation.state import new_carried
from eps_hil.estimation.stream import Trace
from eps_hil.estimation.validity import Reason
from eps_hil.physics.model import Model
from eps_hil.series import Series

from .prescribed import SPEED_ONLY, Prescribed, at, friction_nm

MS = 1_000_000
NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
UNKNOWN = int(Reason.FRICTION_UNKNOWN)
STRIBECK = ({"effect": "stribeck", "level_nm": 0.3, "speed_rad_s": 2.0},)


def back_and_rest(seconds: float = 3.0) -> dict[str, Series]:
    """Half a second of sine, then rest under 0.5 Nm with the bristle bent (no noise)."""
    t = np.arange(round(seconds * 1000)) * 1e-3
    moving = t < 0.5
    speed = np.where(moving, 20.0 * np.sin(2 * np.pi * t), 0.0)
    angle = np.cumsum(speed) * 1e-3
    t_ns = (t * 1e9).round().astype(np.int64)
    torque = np.where(moving, 0.5 + 0.01 * speed, 0.5)
    columns = (torque, 0.0 * t, speed, angle)
    return {name: Series(t_ns, value) for name, value in zip(NAMES, columns, strict=True)}


def cut(series: dict[str, Series], lost: Any) -> dict[str, Series]:
    return {n: Series(s.t_ns[~lost(s.t_ns)], s.value[~lost(s.t_ns)]) for n, s in series.items()}


def within(trace: Trace, since_s: float, until_s: float) -> Any:
    return trace.reason[(trace.t_ns > since_s * 1e9) & (trace.t_ns < until_s * 1e9)]


@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
def test_begun_at_rest_it_is_not_valid_however_long_that_lasts(
    reference_model: Model, kind: Any
) -> None:
    settings = EstimatorSettings(kind=kind)
    begun = cut(back_and_rest(), lambda t: t < 700 * MS)
    resting = within(estimate(begun, reference_model, settings), 0.9, 3.0)
    assert np.all(resting & UNKNOWN)
    whole = within(estimate(back_and_rest(), reference_model, settings), 0.9, 2.9)
    assert np.all(whole == 0)


@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
@pytest.mark.parametrize("lost_ms", [1, 30, 150])
def test_a_hole_at_rest_keeps_what_added_effects_make_of_the_bristle(
    reference_model: Model, kind: Any, lost_ms: int
) -> None:
    """It was cut down to the level of eq. 3 alone: up to 490 N off, and valid."""
    model, settings = replace(reference_model, effects=STRIBECK), EstimatorSettings(kind=kind)
    t, rng = np.arange(4000) * 1e-3, np.random.default_rng(3)
    speed = np.where(t < 1.0, 5.0 * (1.0 + np.cos(np.pi * t)), 0.0)
    speed += np.where((t > 1.5) & (t < 3.0), 0.02 * (1.0 - np.cos(4.0 * np.pi * t / 3.0)), 0.0)
    angle = np.cumsum(speed) * 1e-3 + 5e-5 * rng.standard_normal(4000)
    noisy = speed + 0.02 * rng.standard_normal(4000)
    columns = (0.5 + 2e-4 * rng.standard_normal(4000), 0.0 * t, noisy, angle)
    t_ns = (t * 1e9).round().astype(np.int64)
    whole = {n: Series(t_ns, np.asarray(v)) for n, v in zip(NAMES, columns, strict=True)}
    right = estimate(whole, model, settings)
    without = estimate(whole, reference_model, settings)
    assert abs(right.rack_force_n[-1] - without.rack_force_n[-1]) > 100.0
    holed = cut(whole, lambda t_ns: (t_ns >= 2200 * MS) & (t_ns < (2200 + lost_ms) * MS))
    trace = estimate(holed, model, settings)
    assert trace.rack_force_n[-1] == pytest.approx(right.rack_force_n[-1], abs=20.0)


def test_a_lost_way_may_have_bent_the_bristle_to_the_level_with_its_effects(
    reference_model: Model,
) -> None:
    found = []
    for model in (reference_model, replace(reference_model, effects=STRIBECK)):
        carried = new_carried()
        lose_way(physics_of(model), carried.moment[0], carried.rig[0], 10.0)
        found.append(float(carried.moment[0].unknown_nm))
    assert found[1] - found[0] == pytest.approx(0.3)


def test_a_rotor_that_slides_has_a_known_bristle() -> None:
    from eps_hil.physics.model import load_model

    model = load_model("configs/reference_rig.yaml")
    estimator = RackForceEstimator(model)
    told = [estimator.step(Inputs(0.5, 0.0, 5.0)).reason for _ in range(200)]
    assert told[50] & Reason.FRICTION_UNKNOWN
    assert told[-1] == Reason.FINE


def test_what_it_calls_valid_is_as_if_it_had_run_all_along(
    reference_model: Model, weave_truth: Any
) -> None:
    """Begun anywhere, also with the bristle bent at rest: never valid and more than 50 N off."""
    t_ns = np.round(weave_truth.columns["time_s"] * 1e9).astype(np.int64)
    series = {name: Series(t_ns, weave_truth.columns[name]) for name in NAMES}
    running = estimate(series, reference_model)
    hidden = 0.0
    for start in range(1000, 9000, 500):
        part = {n: Series(s.t_ns[start : start + 2000], s.value[start : start + 2000])
                for n, s in series.items()}  # fmt: skip
        begun = estimate(part, reference_model)
        _, ours, theirs = np.intersect1d(begun.t_ns, running.t_ns, return_indices=True)
        error = np.abs(begun.rack_force_n[ours] - running.rack_force_n[theirs])
        assert np.max(error[begun.valid[ours]], initial=0.0) < 50.0
        settled = begun.reason[ours] & ~UNKNOWN == 0
        hidden = max(hidden, np.max(error[settled], initial=0.0))
    assert hidden > 100.0, "the rule had something to hide"


@pytest.mark.parametrize(
    ("names", "lost_ms", "again"),
    [(NAMES, 20, True), (NAMES, 800, True), (NAMES[:3], 20, False), (NAMES[:3], 800, False)],
)
def test_a_dropout_at_rest(
    reference_model: Model, names: tuple[str, ...], lost_ms: int, again: bool
) -> None:
    """With an angle the bristle is kept; without, no rest is known for long."""
    series = {n: s for n, s in back_and_rest().items() if n in names}
    holed = cut(series, lambda t: (t > 1000 * MS) & (t < (1000 + lost_ms) * MS))
    # the bus goes on without the torque frame alone
    holed = {**series, "motor_torque_nm": holed["motor_torque_nm"]}
    trace = estimate(holed, reference_model)
    assert np.all(within(trace, 1.02, 1.0 + lost_ms * 1e-3 - 0.02) != 0) or lost_ms == 20
    after = within(trace, 1.0 + lost_ms * 1e-3 + 0.8, 2.9)
    assert np.all((after == 0) == again)
    if again:
        expected = estimate(series, reference_model)
        assert trace.rack_force_n[-1] == pytest.approx(expected.rack_force_n[-1], abs=25.0)


def test_a_rotor_that_moved_in_the_gap_has_another_bristle(reference_model: Model) -> None:
    series = back_and_rest()
    series["motor_angle_rad"].value[1500:] -= 1.0
    holed = cut(series, lambda t: (t > 1400 * MS) & (t < 1600 * MS))
    trace = estimate(holed, reference_model)
    assert np.all(within(trace, 1.8, 2.9) & UNKNOWN)


@pytest.mark.parametrize(
    ("names", "lost_ms", "again"), [(NAMES, 3, True), (NAMES, 60, False), (NAMES[:3], 3, False)]
)
def test_a_dropout_just_before_rest(
    reference_model: Model, names: tuple[str, ...], lost_ms: int, again: bool
) -> None:
    """A brief one in motion leaves the bristle to the measured angle; then it rests as known."""
    series = {n: s for n, s in back_and_rest().items() if n in names}
    holed = cut(series, lambda t: (t > 470 * MS) & (t <= (470 + lost_ms) * MS))
    holed = {**series, "motor_torque_nm": holed["motor_torque_nm"]}
    settings = replace(EstimatorSettings(), stale_after_s=0.002)
    trace = estimate(holed, reference_model, settings)
    expected = estimate(series, reference_model, settings)
    assert np.all((within(trace, 1.3, 2.9) == 0) == again)
    if again:
        assert trace.rack_force_n[-1] == pytest.approx(expected.rack_force_n[-1], abs=25.0)


def test_an_angle_that_jumps_in_a_hole_tells_no_way(reference_model: Model) -> None:
    """No such speeds go 6 rad in 3 ms: where the rotor went is unknown, and so is the bristle."""
    series = back_and_rest()
    series["motor_angle_rad"].value[472:] -= 6.0
    holed = cut(series, lambda t: (t > 470 * MS) & (t <= 473 * MS))
    settings = replace(EstimatorSettings(), stale_after_s=0.002)
    trace = estimate(
        {**series, "motor_torque_nm": holed["motor_torque_nm"]}, reference_model, settings
    )
    assert np.all(within(trace, 1.3, 2.9) & UNKNOWN)


def test_the_limit_is_a_setting(reference_model: Model) -> None:
    begun = cut(back_and_rest(), lambda t: t < 700 * MS)
    settings = replace(EstimatorSettings(), friction_unknown_n=1e9)
    assert np.all(within(estimate(begun, reference_model, settings), 0.9, 2.9) == 0)


@pytest.mark.parametrize("back_ms", [3, 20, 500, 990, 1010, 10_000])
def test_a_clock_set_back_repeats_nothing(reference_model: Model, back_ms: int) -> None:
    from eps_hil.estimation.stream import StreamEstimator

    series = back_and_rest()
    stream = StreamEstimator(reference_model, EstimatorSettings(), dict.fromkeys(NAMES, 1e-3))
    steps = []
    for k in range(2500):
        t = (50_000 + k - (back_ms if k >= 1500 else 0)) * MS
        for name in NAMES:
            stream.push(name, t, float(series[name].value[k]))
        steps.append(stream.advance(t))
        if k in (1499, 1500, 1503):
            assert stream.latest.valid == (k == 1499)
    assert steps == [1] * 2500
    assert stream.latest.valid or back_ms > 1000  # a long step is a new start, here at rest


@pytest.mark.parametrize("lost_ms", [30, 45])
def test_what_crept_in_a_gap_bends_the_bristle(reference_model: Model, lost_ms: int) -> None:
    """A rotor that still creeps at the gap's end is judged as moving there: nothing is lost."""
    series = back_and_rest()
    t = series["motor_speed_rad_s"].t_ns * 1e-9
    speed = np.where((t >= 1.0) & (t < 1.05), -0.4, 0.0)
    series["motor_speed_rad_s"].value[:] += speed
    series["motor_angle_rad"].value[:] += np.cumsum(speed) * 1e-3
    lost = cut(series, lambda t: (t > 1000 * MS) & (t < (1000 + lost_ms) * MS))
    trace = estimate(lost, reference_model)
    assert within(trace, 2.8, 2.9)[-1] == 0
    before = trace.rack_force_n[np.searchsorted(trace.t_ns, 950 * MS)]
    law, ratio = reference_model.friction, reference_model.rack_to_rotor_ratio_rad_per_m
    ends = [(offset + slope * 1100.0) / law.sigma0_nm_per_rad
            for offset, slope in ((law.offset_pos_nm, law.load_pos_nm_per_n),
                                  (law.offset_neg_nm, law.load_neg_nm_per_n))]  # fmt: skip
    back = sum(ends) * (1.0 - np.exp(-0.02 / ends[1]))  # eq. 2a, from one end towards the other
    expected = before + ratio * law.sigma0_nm_per_rad * back
    assert trace.rack_force_n[-1] == pytest.approx(expected, abs=40.0)


def test_the_noise_of_an_angle_after_a_hole_is_no_way(reference_model: Model) -> None:
    """A rotor comes to rest just after a hole of 2 ms: one noisy angle bent its bristle."""
    noise_rad, off = 2e-3, []
    for seed in range(12):
        series = back_and_rest(1.5)
        series["motor_angle_rad"].value[:] += noise_rad * np.random.default_rng(
            seed
        ).standard_normal(1500)
        expected = estimate(series, reference_model)
        for name in NAMES[2:]:
            series[name].value[490:492] = np.nan
        trace = estimate(series, reference_model)
        assert np.any(within(trace, 0.46, 0.52) & int(Reason.BAD_SAMPLE))
        off.append(abs(trace.rack_force_n[-1] - expected.rack_force_n[-1]))
    assert max(off) < 15.0


def test_a_rotor_that_crept_in_a_long_hole_may_have_been_elsewhere(
    reference_model: Model,
) -> None:
    """Nobody saw whether it went further and came back; one whose angle is the same rested."""
    settings = EstimatorSettings()
    for way_rad, known in ((0.02, False), (0.0, True)):
        series = back_and_rest()
        series["motor_angle_rad"].value[1200:] += way_rad
        lost = cut(series, lambda t: (t > 1000 * MS) & (t < 1600 * MS))
        after = within(estimate(lost, reference_model, settings), 2.4, 2.9)
        assert np.all((after == 0) == known)


@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
@pytest.mark.parametrize(
    ("jump_rad", "lost_ms", "known"),
    [(-4.0, 0, True), (4.0, 0, True), (-4.0, 3, True), (-2.9, 3, False), (-6.0, 12, False)],
)
def test_an_angle_that_jumps_at_rest_bends_no_bristle(
    reference_model: Model, kind: Any, jump_rad: float, lost_ms: int, known: bool
) -> None:
    """From rest to rest no load turns a rotor 4 rad in some ms; 6 rad in 12 ms one could."""
    series, settings = back_and_rest(3.5), EstimatorSettings(kind=kind, stale_after_s=0.002)
    expected = estimate(series, reference_model, settings)
    series["motor_angle_rad"].value[1000:1400] += jump_rad
    away = (1000 * MS, 1400 * MS)
    for name in NAMES[2:]:
        s = series[name]
        lost = sum((s.t_ns > t - 2 * MS) & (s.t_ns < t - 2 * MS + lost_ms * MS) for t in away) > 0
        s.value[lost] = np.nan
    trace = estimate(series, reference_model, settings)
    assert np.all(within(trace, 1.003, 1.1) != 0)
    amid = within(trace, 1.2, 1.38) & UNKNOWN
    assert np.all(amid == 0) == known
    after = within(trace, 2.4, 3.4)
    assert np.all((after == 0) == known)
    if known:
        assert trace.rack_force_n[-1] == pytest.approx(expected.rack_force_n[-1], abs=1.0)


@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
@pytest.mark.parametrize("away_ms", [30, 100, 400])
@pytest.mark.parametrize(("jump_rad", "late_us"), [(-2.0, 0), (0.2, 0), (-2.0, 32), (2.0, 968)])
def test_an_angle_that_was_away_for_a_moment_bends_no_bristle(
    reference_model: Model, kind: Any, away_ms: int, jump_rad: float, late_us: int
) -> None:
    """It tells of no way at rest, read half way or whole: neither going nor once it is back."""
    series, settings = back_and_rest(3.5), EstimatorSettings(kind=kind)
    s = series["motor_angle_rad"]
    series["motor_angle_rad"] = Series(s.t_ns + 1000 * late_us, s.value)
    expected = estimate(series, reference_model, settings)
    series["motor_angle_rad"].value[1000 : 1000 + away_ms] += jump_rad
    trace = estimate(series, reference_model, settings)
    assert np.all(within(trace, 1.003, 1.1) != 0)
    assert np.all(within(trace, 2.4, 3.4) == 0)
    assert trace.rack_force_n[-1] == pytest.approx(expected.rack_force_n[-1], abs=1.0)


def test_a_rotor_that_stays_where_its_angle_jumped_to_has_another_bristle(
    reference_model: Model,
) -> None:
    """Up to 3 rad a rotor may have turned meanwhile: nobody looks until speed and angle agree."""
    series = back_and_rest(3.5)
    series["motor_angle_rad"].value[1000:] += 2.0
    assert np.all(within(estimate(series, reference_model), 1.5, 3.4) & UNKNOWN)


@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
def test_an_angle_that_jumps_against_a_creep_tells_no_way(
    reference_model: Model, kind: Any
) -> None:
    """The rotor crept back by 0.07 rad as its angle jumped by 0.1 rad, and then inputs were lost.

    Their sum is less than the bristle can bend, but neither the way of the speed nor none.
    """
    series = back_and_rest()
    t = series["motor_speed_rad_s"].t_ns
    speed = np.where((t >= 950 * MS) & (t < 1000 * MS), -1.4, 0.0)
    series["motor_speed_rad_s"].value[:] += speed
    series["motor_angle_rad"].value[:] += np.cumsum(speed) * 1e-3 + 0.0985 * (t >= 1001 * MS)
    holed = cut(series, lambda t: (t > 1002 * MS) & (t < 1118 * MS))
    trace = estimate(holed, reference_model, EstimatorSettings(kind=kind))
    assert np.all(within(trace, 1.3, 2.9) & UNKNOWN)


@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
@pytest.mark.parametrize(("more_nm", "known"), [(0.3, False), (0.02, True)])
def test_an_angle_that_stood_while_the_load_changed_tells_no_way(
    reference_model: Model, kind: Any, more_nm: float, known: bool
) -> None:
    """An ECU that began again with its angle from zero, where the rotor stood at zero before."""
    series = back_and_rest()
    series["motor_torque_nm"].value[1200:] += more_nm
    holed = cut(series, lambda t: (t > 1000 * MS) & (t < 1500 * MS))
    trace = estimate(holed, reference_model, EstimatorSettings(kind=kind))
    assert np.all(within(trace, 2.4, 2.9) & UNKNOWN == 0) == known


def resting(model: Model) -> Prescribed:
    """A rotor that slides, rests from 1.5 s on, and slides again from 4 s to 5 s.

    Meanwhile the load grows by 390 N, the motor torque is held, and the rotor creeps back by
    0.04 rad, from 2 s to 3 s: less than any noise of its speed.
    """
    t, force, ratio = np.arange(6000) * 1e-3, np.full(6000, 300.0), 2513.0
    speed = np.where(t < 1.5, 8.0 * np.sin(np.pi * t / 1.5) ** 2, 0.0)
    speed[2000:3000] = -0.04
    speed[4000:5000] = 8.0 * np.sin(np.pi * (t[4000:5000] - 4.0)) ** 2
    for _ in range(6):
        friction = friction_nm(model, speed, force)
        held = force[1500] / ratio + friction[1500]
        force = np.where((t > 1.5) & (t < 4.0), ratio * (held - friction), 300.0)
        force[4000:4500] = np.linspace(force[3999], 300.0, 500)
    return Prescribed(model, speed, force, friction)


@pytest.mark.parametrize("kind", ["observer", "bristle_filter"])
def test_a_rest_that_no_angle_shows_ends_as_friction_unknown(
    reference_model: Model, kind: str
) -> None:
    """It stayed valid, 390 N off, for as long as the rotor rested."""
    rig = resting(reference_model)
    trace = rig.estimate(SPEED_ONLY, kind=kind)
    rest, again = at(trace, 1.6, 4.0), at(trace, 4.6, 4.9)
    assert np.mean(trace.valid[rest]) < 0.1
    assert not np.any(trace.valid[at(trace, 2.5, 4.0)])
    assert set(trace.reason[rest].tolist()) <= {0, int(Reason.FRICTION_UNKNOWN)}
    assert np.all(trace.valid[again])
    assert np.max(np.abs(rig.error_n(trace)[trace.valid & at(trace, 1.0, 5.0)])) < 60.0
    assert np.sqrt(np.mean(rig.error_n(trace)[again] ** 2)) < 10.0


def test_a_rest_that_an_angle_shows_is_known(reference_model: Model) -> None:
    rig = resting(reference_model)
    trace = rig.estimate((*SPEED_ONLY, "motor_angle_rad"))
    assert np.all(trace.valid[at(trace, 1.0, 4.9)])
    assert np.max(np.abs(rig.error_n(trace)[at(trace, 1.6, 3.9)])) < 60.0


@pytest.mark.parametrize(("noise", "seconds"), [(0.25, 0.15), (0.02, 0.6)])
def test_how_long_a_rest_without_an_angle_is_known(
    reference_model: Model, noise: float, seconds: float
) -> None:
    """25 N are as much as the mean of the speeds leaves after that time."""
    estimator = RackForceEstimator(reference_model)
    for _ in range(1000):
        estimator.step(Inputs(0.3, 0.0, 20.0, speed_noise=noise**2))
    rested = [
        estimator.step(Inputs(0.3, 0.0, 0.0, speed_noise=noise**2)).reason for _ in range(1000)
    ]
    known = rested.index(Reason.FRICTION_UNKNOWN)
    assert 0.5 * seconds < known * 1e-3 < seconds


def test_turning_round_is_no_rest(reference_model: Model) -> None:
    t = np.arange(4000) * 1e-3
    speed, force = 10.0 * np.sin(2.0 * np.pi * t), np.full(4000, 300.0)
    rig = Prescribed(reference_model, speed, force, friction_nm(reference_model, speed, force))
    trace = rig.estimate(SPEED_ONLY)
    assert np.all(trace.valid[at(trace, 1.0, 3.9)])
