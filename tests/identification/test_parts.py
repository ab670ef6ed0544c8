"""Filters, kinematics, outliers and sensitivities, each against its closed form."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.errors import InputError
from eps_hil.identification import filters
from eps_hil.identification.balance import Case, cases
from eps_hil.identification.friction_rows import COLUMNS
from eps_hil.identification.kinematics import kinematics, skew
from eps_hil.identification.prepare import noise_of, prepare, without_spikes
from eps_hil.identification.state import Parameter, State, get, put
from eps_hil.physics.model import Model
from eps_hil.series import Series

T = np.arange(8000) * 1e-3


def turned(late_s: float, seed: int = 0, speed_noise: float = 0.2) -> dict[str, Series]:
    """A rotor swinging at two frequencies, its angle reported later than its speed."""
    rng = np.random.default_rng(seed)
    t_ns = np.round(T * 1e9).astype(np.int64)

    def angle(t: Any) -> Any:
        return 6 * np.sin(2 * np.pi * 0.9 * t) + 2 * np.sin(2 * np.pi * 2.3 * t)

    def speed(t: Any) -> Any:
        a, b = 2 * np.pi * 0.9, 2 * np.pi * 2.3
        return 6 * a * np.cos(a * t) + 2 * b * np.cos(b * t)

    noise = rng.normal(size=(2, len(T)))
    return {
        "motor_torque_nm": Series(t_ns, 0.3 * np.sin(T)),
        "motor_speed_rad_s": Series(t_ns, speed(T) + speed_noise * noise[0]),
        "motor_angle_rad": Series(t_ns, angle(T - late_s) + 1e-3 * noise[1]),
    }


def test_derivative_and_shift_of_a_sine() -> None:
    turn = 2 * np.pi * 4.0
    values, slope = np.sin(turn * T), turn * np.cos(turn * T)
    exact = filters.smooth(slope)
    assert np.abs(filters.derivative(values) - exact).max() < 1e-5 * turn
    late = filters.shifted(values, 0.00237)
    assert np.abs(late - np.sin(turn * (T + 0.00237)))[20:-20].max() < 1e-5


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.003, 0.003), st.integers(0, 1000))
def test_skew_between_angle_and_speed_is_found_with_its_error(late_s: float, seed: int) -> None:
    found = skew([prepare("a", turned(late_s, seed))])
    assert found is not None
    assert abs(found.seconds - late_s) < 5 * found.sigma_s + 2e-6
    assert found.sigma_s < 1e-4


def test_speed_from_angle_and_speed_is_quieter_than_either() -> None:
    one = prepare("a", turned(0.0))
    motion = kinematics(one, 0.0)
    a, b = 2 * np.pi * 0.9, 2 * np.pi * 2.3
    true = 6 * a * np.cos(a * T) + 2 * b * np.cos(b * T)
    inner = slice(300, -300)
    error = float(np.std((motion.speed - true)[inner]))
    assert error < 0.1
    assert error == pytest.approx(motion.speed_sigma, rel=0.25)
    bend = filters.smooth(np.gradient(true, 1e-3))
    noise = np.var((motion.acceleration - bend)[60:-60])
    assert noise == pytest.approx(motion.acceleration_variance, rel=0.25)


@pytest.mark.parametrize(
    ("factor", "words"), [(-1.0, "opposite signs"), (9.5493, "rpm"), (7.0, "times the derivative")]
)
def test_speed_against_angle_is_checked(factor: float, words: str) -> None:
    series = turned(0.0)
    speed = series["motor_speed_rad_s"]
    series["motor_speed_rad_s"] = Series(speed.t_ns, factor * speed.value)
    with pytest.raises(InputError, match=words):
        skew([prepare("a", series)])


@pytest.mark.parametrize("dead", ["motor_speed_rad_s", "motor_angle_rad"])
def test_a_dead_reading_of_the_motion_is_named(dead: str) -> None:
    series = turned(0.0)
    series[dead] = Series(series[dead].t_ns, np.full(len(series[dead].t_ns), 1.25))
    with pytest.raises(InputError, match=f"{dead}: is 1.25 all the time while .* moves"):
        skew([prepare("a", series)])


def test_a_rig_at_rest_has_no_skew() -> None:
    still = {name: Series(one.t_ns, np.zeros(len(one.t_ns))) for name, one in turned(0.0).items()}
    assert skew([prepare("still", still)]) is None
    assert skew([prepare("still", still), prepare("a", turned(0.002))]) is not None


def test_single_wild_samples_are_bridged_and_steep_signals_are_not() -> None:
    rng = np.random.default_rng(3)
    signal = 400 * np.sin(2 * np.pi * 4 * T) + 0.3 * rng.normal(size=len(T))
    assert without_spikes(signal, noise_of(signal))[1] == 0
    wild = signal.copy()
    places = np.arange(150, 7800, 500)
    wild[places] += 300.0
    mended, count = without_spikes(wild, noise_of(wild))
    assert count == len(places)
    assert np.abs(mended - signal)[places].max() < 5.0


def test_sensitivities_of_the_bristle_are_its_finite_differences(
    record: Callable[..., Any], reference_model: Model
) -> None:
    one = prepare("slow", record({"slow_reversals": 8.0})["slow_reversals"])
    (case,) = cases([one], [kinematics(one, 0.0)])
    state = State(reference_model)
    parameters = [Parameter(name, "", 1.0, 1.0) for name in COLUMNS]
    residual, columns = case.linearised(state, parameters)
    assert residual == pytest.approx(case.residual(state), abs=1e-12)
    for k, name in enumerate(COLUMNS):
        slope = difference(case, state, name)
        assert columns[:, k] == pytest.approx(slope, abs=1e-4 * np.abs(slope).max())


def difference(case: Case, state: State, name: str) -> Any:
    step = 1e-4 * get(state, name)
    above = case.residual(put(state, name, get(state, name) + step))
    below = case.residual(put(state, name, get(state, name) - step))
    return (above - below) / (2 * step)
