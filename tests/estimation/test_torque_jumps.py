"""Torque jumps amid a swing of the load: the speed's bend less that which the torques make."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.plausibility import limits_of
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.torque_jumps import _alone, _found, latched, swing_hinge
from eps_hil.estimation.watch import new_watch
from eps_hil.physics.model import Model
from eps_hil.series import Series

NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
OF_THREE = st.lists(st.floats(-100.0, 100.0), min_size=3, max_size=3)


@given(OF_THREE, st.floats(-50.0, 50.0), st.integers(4, 40))
def test_the_bend_is_that_beside_any_parabola(
    parabola: list[float], bend: float, window: int
) -> None:
    t = np.arange(-3 * window, window + 1) / window
    speed = np.polyval(parabola, t) + bend * np.maximum(t, 0.0)
    assert swing_hinge(3 * window, window) @ speed == pytest.approx(bend, abs=1e-6)


@pytest.mark.parametrize("jump_nm", [-0.15, 0.15])
def test_a_bend_of_the_torque_that_was_followed_excuses_no_jump(
    reference_model: Model, jump_nm: float
) -> None:
    """The torque bends as a swing has it, and the rotor with it; then it jumps, and the rotor not.

    Of all that the torque bends nearly half was seen, which was taken for a jump that was followed.
    """
    p, watch = limits_of(reference_model, EstimatorSettings(), True), new_watch()
    w, before, n = watch[0], 30, 10
    t = np.arange(-before, n + 1, dtype=float)
    swing = jump_nm * 0.12 * np.maximum(t + 15.0, 0.0)
    way = p.step_s * p.inverse_inertia * np.r_[0.0, np.cumsum(0.5 * (swing[1:] + swing[:-1]))]
    jump = np.where(t > 0.0, jump_nm, 0.0)
    w.steps = len(t)
    w.torque[: len(t)], w.pace[: len(t)] = swing + jump, way
    quiet = Inputs(0.0, 0.0, 0.0, drive_noise=2.5e-5, speed_noise=0.09)
    slope = swing[before] - swing[before - 1]
    followed = way + p.step_s * p.inverse_inertia * np.cumsum(jump)
    assert p.swing_hinge @ way / (p.swing_hinge @ followed) > 0.45, "nothing to tell"
    assert _alone(w, p, quiet, swing[before], slope, jump_nm)
    w.pace[: len(t)] = followed
    assert not _alone(w, p, quiet, swing[before], slope, jump_nm)


def _wrong_ms(model: Model, columns: dict[str, Any], since: int, offset_nm: float) -> int:
    """Longest spell in which a torque off by ``offset_nm`` from ``since`` on is valid and wrong."""
    part, begins = slice(since - 2000, since + 300), 2000
    t_ns = np.round(columns["time_s"][part] * 1e9).astype(np.int64)
    right = {name: Series(t_ns, columns[name][part]) for name in NAMES}
    torque = right[NAMES[0]].value.copy()
    torque[begins:] += offset_nm
    wrong, of = estimate({**right, NAMES[0]: Series(t_ns, torque)}, model), estimate(right, model)
    assert np.array_equal(wrong.t_ns, of.t_ns)
    apart = wrong.valid & of.valid & (abs(wrong.rack_force_n - of.rack_force_n) > 100.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], apart.astype(int), [0]])))
    return int(max(np.diff(edges)[::2], default=0))


@pytest.mark.parametrize("offset_nm", [-0.12, 0.12])
def test_an_offset_amid_a_fast_swing_is_told(
    reference_model: Model, sweep_truth: Any, offset_nm: float
) -> None:
    """Of 300 N, over one and a half periods of 3.6 Hz; the torque bends as fast as it jumps."""
    for since in range(36_000, 36_420, 19):
        assert _wrong_ms(reference_model, sweep_truth.columns, since, offset_nm) <= 20


def _back_ms(model: Model, columns: dict[str, Any], since: int, off_nm: dict[int, float]) -> int:
    """When the estimate is valid for good, after torques that are off for so many ms by so much."""
    part, begins = slice(since - 2000, since + 2600), 2000
    t_ns = np.round(columns["time_s"][part] * 1e9).astype(np.int64)
    series = {name: Series(t_ns, columns[name][part].copy()) for name in NAMES}
    for length, offset_nm in off_nm.items():
        first = begins + (75 - length) // 2
        series[NAMES[0]].value[first : first + length] += offset_nm
    bad = np.flatnonzero(~estimate(series, model).valid[begins:])
    return int(max(bad, default=0))


@pytest.mark.parametrize("offset_nm", [-0.2, 0.2])
def test_the_end_of_an_offset_is_seen_where_the_friction_turns_over(
    reference_model: Model, sweep_truth: Any, offset_nm: float
) -> None:
    """No estimate is made then; it took 10 s where the rotor turned round meanwhile."""
    for since in range(34_000, 34_300, 10):
        assert _back_ms(reference_model, sweep_truth.columns, since, {65: offset_nm}) < 600


def test_an_offset_within_an_offset_is_not_doubted_for_long(
    reference_model: Model, sweep_truth: Any
) -> None:
    """What is left of the first as the second ends is some 0.2 Nm: the first itself."""
    for since in range(34_000, 34_300, 20):
        two = {75: 0.2, 33: -0.7}
        assert _back_ms(reference_model, sweep_truth.columns, since, two) < 1700


def test_an_offset_right_after_another_is_not_doubted_for_long(
    reference_model: Model, sweep_truth: Any
) -> None:
    """Where the friction turns over, its beginning is not told from the end of the first."""
    for since in (29_266, 32_220, 32_642, 32_853, 33_697, 34_330):
        part = slice(since - 2500, since + 2600)
        t_ns = np.round(sweep_truth.columns["time_s"][part] * 1e9).astype(np.int64)
        for sign in (-1.0, 1.0):
            series = {n: Series(t_ns, sweep_truth.columns[n][part].copy()) for n in NAMES}
            torque = series[NAMES[0]].value
            torque[2000:2471] += 0.161 * sign
            torque[2480:2500] += 0.166 * sign
            bad = np.flatnonzero(~estimate(series, reference_model).valid[2500:])
            assert max(bad, default=0) < 1700


def test_a_jump_beside_a_hole_is_not_doubted_for_long(
    reference_model: Model, steps_truth: Any
) -> None:
    """Two holes of the torques and a false sample between; the rotor comes to rest meanwhile."""
    t_ns = np.round(steps_truth.columns["time_s"] * 1e9).astype(np.int64)
    for since in (4522, 7529, 12_379, 15_580):
        part = slice(since - 1900, since + 2600)
        series = {n: Series(t_ns[part], steps_truth.columns[n][part].copy()) for n in NAMES}
        series[NAMES[0]].value[1907] += 0.12
        kept = np.ones(4500, bool)
        kept[1900:1907] = kept[1908:1922] = False
        for name in NAMES[:2]:
            series[name] = Series(series[name].t_ns[kept], series[name].value[kept])
        bad = np.flatnonzero(~estimate(series, reference_model).valid[1900:])
        assert max(bad, default=0) < 1700


@pytest.mark.parametrize(
    ("most_nm", "swing", "missed"), [(0.44, 0.004, 1), (0.05, 0.004, 0), (0.44, 1e-4, 0)]
)
def test_what_noise_leaves_of_a_spike_within_the_window_is_not_doubted_for_long(
    reference_model: Model, most_nm: float, swing: float, missed: int
) -> None:
    """What noise left of a spike of 3 ms was doubted for 10 s."""
    p, watch = limits_of(reference_model, EstimatorSettings(), True), new_watch()
    w = watch[0]
    w.steps, w.quiet, w.swing = 1000, 100_000, swing
    w.edge_at = w.steps - 1 - p.window
    _found(w, p, 0.0, 0.0, -0.049, most_nm)
    assert w.unexplained_nm == -0.049
    assert w.missed == missed


@pytest.mark.parametrize(("level_nm", "left_nm"), [(1.5, 0.346), (1.2, 0.0), (1.1, 0.0)])
def test_what_another_offset_adds_is_left_as_the_first_ends(
    reference_model: Model, level_nm: float, left_nm: float
) -> None:
    """0.35 Nm of a sensor, which began within 1.15 Nm of another, were forgotten with these."""
    p, watch = limits_of(reference_model, EstimatorSettings(), True), new_watch()
    w = watch[0]
    w.steps, w.quiet, w.swing, w.unexplained_nm = 1000, 1000, 0.0007, -1.154
    _found(w, p, 0.0, 0.0, level_nm, level_nm)
    assert w.unexplained_nm == pytest.approx(left_nm)
    doubted = [latched(w, p) != 0 for _ in range(p.consistent_steps)]
    assert all(doubted[: p.stalled_steps]) == (left_nm > 0.0)
    assert not any(doubted[p.stalled_steps + 1 :])
