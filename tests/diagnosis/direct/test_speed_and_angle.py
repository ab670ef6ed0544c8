"""Speed against angle: a motion that is known in closed form, reported late, adrift or smoothed."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.direct.speed_and_angle import LEAST_S, OutOfStep, speed_and_angle
from eps_hil.identification.butterworth import low_pass
from eps_hil.physics.model import Model
from eps_hil.series import Series

SECONDS = 20.0
TONES = ((0.3, 40.0, 0.3), (1.1, 25.0, 1.9), (3.7, 20.0, 4.0))
"""Hz, amplitude in rad/s, phase."""
FILE_S = 0.004
"""Delay of speed and angle in the model file."""


def moved(
    rng: np.random.Generator,
    *,
    speed_late: float = 0.0,
    angle_late: float = 0.0,
    lag: float = 0.0,
    ppm: float = 0.0,
    noise: float = 1.0,
    tones: tuple[tuple[float, float, float], ...] = TONES,
) -> Prepared:
    """Speed and angle of tones; a first-order lag by its own amplitude and phase."""
    t = np.arange(round(SECONDS * 1000)) * 1e-3
    speed, angle = np.zeros(len(t)), np.zeros(len(t))
    for hz, size, phase in tones:
        w = 2 * np.pi * hz
        when = t - FILE_S - speed_late - 1e-6 * ppm * t
        less, later = 1.0 / np.hypot(1.0, w * lag), np.arctan(w * lag)
        speed += size * less * np.cos(w * when + phase - later)
        angle += size / w * np.sin(w * (t - FILE_S - angle_late) + phase)
    signals = {
        "motor_speed_rad_s": speed + 0.2 * noise * rng.standard_normal(len(t)),
        "motor_angle_rad": angle + 1e-3 * noise * rng.standard_normal(len(t)),
        "motor_torque_nm": np.cos(t),
    }
    t_ns = np.round(t * 1e9).astype(np.int64)
    return prepare("one", {name: Series(t_ns, values) for name, values in signals.items()})


def looked(one: Prepared, model: Model) -> OutOfStep:
    found = speed_and_angle([one], model)
    assert found is not None
    return found


@settings(max_examples=25, deadline=None)
@given(
    speed_late=st.floats(-0.003, 0.02),
    angle_late=st.floats(-0.003, 0.02),
    seed=st.integers(0, 999),
)
def test_what_is_late_is_found_to_its_interval(
    reference_model: Model, speed_late: float, angle_late: float, seed: int
) -> None:
    one = moved(np.random.default_rng(seed), speed_late=speed_late, angle_late=angle_late)
    true = speed_late - angle_late
    found = speed_and_angle([one], reference_model)
    if abs(true) < LEAST_S - 2e-4:
        assert found is None
    elif abs(true) > LEAST_S + 2e-4:
        assert found is not None
        assert not found.smoothed
        assert not found.drifts
        assert found.late_s.half < 2e-4
        assert found.late_s.value == pytest.approx(true, abs=2.0 * found.late_s.half)
        right = found.in_model(reference_model).delays_s
        between = right.of("motor_speed_rad_s") - right.of("motor_angle_rad")
        assert between == pytest.approx(true, abs=2.0 * found.late_s.half)
        assert right.of("motor_angle_rad") >= 0.0


@pytest.mark.parametrize("lag", [0.0053, 0.0106])
def test_a_low_pass_is_told_from_a_dead_time(reference_model: Model, lag: float) -> None:
    rng = np.random.default_rng(1)
    smooth = looked(moved(rng, lag=lag), reference_model)
    assert smooth.smoothed
    assert smooth.lag_s == pytest.approx(lag, rel=0.1)
    assert smooth.late_s.value == pytest.approx(lag, rel=0.03)
    assert smooth.speed_is_late
    assert not looked(moved(rng, speed_late=lag), reference_model).smoothed


def test_a_low_pass_as_late_as_the_file_says_is_no_finding(reference_model: Model) -> None:
    """Its delay is known to the model file; its shape is not."""
    one = moved(np.random.default_rng(1), speed_late=-FILE_S, lag=FILE_S)
    found = looked(one, reference_model)
    assert found.smoothed
    assert not found.is_late
    assert not found.findings()
    assert found.in_model(reference_model) is reference_model
    (remark,) = found.remarks()
    assert "smoothed" in remark
    right = found.put_right(one)
    clean = moved(np.random.default_rng(2), noise=0.0)

    def off(other: Prepared) -> float:
        speeds = (each.raw["motor_speed_rad_s"] for each in (other, clean))
        return float(np.std(low_pass(np.subtract(*speeds), 10.0)[500:-500]))

    assert off(right) < 0.5 * off(one)
    assert right.speed_is_derived


def test_a_clock_adrift_is_a_number_of_its_own(reference_model: Model) -> None:
    one = moved(np.random.default_rng(1), ppm=80.0)
    found = looked(one, reference_model)
    assert found.drifts
    assert not found.is_late
    assert not found.smoothed
    assert found.ppm.value == pytest.approx(80.0, abs=2.0 * found.ppm.half)
    (drift,) = found.findings()
    assert drift["effect"] == "clock_drift"
    assert drift["signal"] == "motor_speed_rad_s"
    assert speed_and_angle([found.put_right(one)], reference_model) is None


def test_an_angle_that_is_late_alone_is_no_finding(reference_model: Model) -> None:
    found = looked(moved(np.random.default_rng(1), angle_late=0.003), reference_model)
    assert not found.findings()
    assert found.in_model(reference_model).delays_s.of("motor_angle_rad") == pytest.approx(
        0.007, abs=1e-4
    )
    (remark,) = found.remarks()
    assert "3 ms later" in remark or "2.99" in remark or "3.01" in remark


def test_a_low_pass_of_second_order_is_told_by_its_noise(reference_model: Model) -> None:
    """It is late like a dead time, but its noise above 40 Hz says nothing of that below."""
    from scipy.signal import butter, lfilter

    one = moved(np.random.default_rng(1))
    speed = lfilter(*butter(2, 40.0 / 500.0), one.raw["motor_speed_rad_s"])
    t_ns = np.round(one.time_s * 1e9).astype(np.int64)
    columns = {**one.raw, "motor_speed_rad_s": np.round(speed / 0.02) * 0.02}
    again = prepare("one", {name: Series(t_ns, values) for name, values in columns.items()})
    found = looked(again, reference_model)
    assert found.lag_s == 0.0
    assert found.smoothed
    (told,) = found.findings()
    assert "noise" in told["summary"]
    late = looked(moved(np.random.default_rng(1), speed_late=0.0056), reference_model)
    assert not late.smoothed


@settings(max_examples=20, deadline=None)
@given(noise=st.floats(0.0, 20.0), hz=st.floats(0.05, 1.0), seed=st.integers(0, 999))
def test_noise_alone_is_neither_late_nor_smoothed(
    reference_model: Model, noise: float, hz: float, seed: int
) -> None:
    """Slow motion under much noise: what noise in both sides makes of a lag is not told."""
    one = moved(np.random.default_rng(seed), noise=noise, tones=((hz, 10.0, 0.0),))
    assert speed_and_angle([one], reference_model) is None


def test_nothing_to_compare(reference_model: Model) -> None:
    one = moved(np.random.default_rng(1), speed_late=0.01)
    assert speed_and_angle([one], reference_model, {"speed_sensor_delay"}) is None
    assert speed_and_angle([one.by_angle()], reference_model) is None
    still = moved(np.random.default_rng(1), noise=0.0, tones=((0.0001, 0.0, 0.0),))
    assert speed_and_angle([still], reference_model) is None
    barred = one.changed(barred=np.ones(len(one.thin_time_s), bool))
    assert speed_and_angle([barred], reference_model) is None


@pytest.mark.slow
def test_an_ecu_that_smooths_its_speed(
    record: Callable[..., Mapping[str, Any]], reference_model: Model
) -> None:
    """The finding has the lag, nothing is named beside it, and the estimate gains."""
    from scipy.signal import lfilter

    lag = 0.0053
    share = 1.0 - np.exp(-1e-3 / lag)

    def smoothed(recordings: Mapping[str, Any]) -> dict[str, Any]:
        out = {}
        for name, signals in recordings.items():
            speed = signals["motor_speed_rad_s"]
            value = np.round(lfilter([share], [1.0, share - 1.0], speed.value) / 0.02) * 0.02
            out[name] = {**signals, "motor_speed_rad_s": replace(speed, value=value)}
        return out

    result = diagnose(reference_model, smoothed(record({})), smoothed(record({}, ("steps",), 9)))
    content = result.content
    assert [one["effect"] for one in content["findings"]] == ["speed_sensor_delay"]
    told = content["findings"][0]["parameters"]["delay_s"]
    # the filter's own samples are half a step each way of its lag
    assert told["value"] == pytest.approx(lag, abs=6e-4)
    assert "smoothed" in content["findings"][0]["summary"]
    assert any("smoothed" in one for one in content["limits"])
    assert result.model.delays_s.motor_speed == pytest.approx(FILE_S + lag, abs=6e-4)
    assert result.model.delays_s.of("motor_angle_rad") == pytest.approx(FILE_S)
    holdout = content["fit"]["holdout"]
    assert holdout["augmented"]["rack_force_rmse_n"] < holdout["baseline"]["rack_force_rmse_n"]
    assert holdout["augmented"]["torque_nrmse"] < 1.2 * holdout["noise_floor"]["torque_nrmse"]
