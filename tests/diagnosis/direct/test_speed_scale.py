"""A speed in another scale than the angle: told whatever else is wrong with it, and only then."""

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.direct.speed_scale import SpeedScale, speed_scale
from eps_hil.identification.butterworth import low_pass
from eps_hil.physics.model import Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

SECONDS = 30.0
SAID = "times as fast as motor_speed_rad_s says"


def wandering(rng: np.random.Generator, hz: float) -> Floats:
    """A speed that wanders about nothing below ``hz``, 20 rad/s rms, at 1 kHz."""
    speed = low_pass(rng.standard_normal(round(SECONDS * 1000)), hz)
    return np.asarray(20.0 * speed / np.std(speed))


def turned(
    rng: np.random.Generator,
    scale: float,
    *,
    late: float = 0.0,
    lag: float = 0.0,
    noise: float = 1.0,
    every: int = 1,
    hz: float = 2.0,
    offset: float = 0.0,
) -> Prepared:
    """A rotor whose reported speed times ``scale`` is the angle's rate."""
    speed = wandering(rng, hz)
    n = len(speed)
    angle, t = np.cumsum(speed) * 1e-3, np.arange(n) * 1e-3
    reported = np.interp(t - late, t, speed)
    if lag:
        reported = lfilter([1e-3 / lag], [1.0, 1e-3 / lag - 1.0], reported)
    signals = {
        "motor_speed_rad_s": (reported + offset + 0.3 * noise * rng.standard_normal(n)) / scale,
        "motor_angle_rad": angle + 1e-3 * noise * rng.standard_normal(n),
        "motor_torque_nm": np.cos(t),
    }
    t_ns = np.arange(n, dtype=np.int64)[::every] * 1_000_000
    return prepare("one", {name: Series(t_ns, one[::every]) for name, one in signals.items()})


@settings(max_examples=20, deadline=None)
@given(
    scale=st.sampled_from([0.5, 0.6, 0.95, 1.05, 1.7, 2.0]),
    late=st.floats(0.0, 0.02),
    lag=st.sampled_from([0.0, 0.005, 0.02]),
    noise=st.floats(0.0, 3.0),
    every=st.sampled_from([1, 3, 20]),
    offset=st.floats(-0.5, 0.5),
    seed=st.integers(0, 999),
)
def test_a_scale_is_told_to_its_interval(seed: int, scale: float, **how: Any) -> None:
    found = speed_scale([turned(np.random.default_rng(seed), scale, **how)])
    assert found is not None
    assert 0.994 * found.low < scale < 1.006 * found.high
    assert found.factor == pytest.approx(scale, rel=0.01)


@pytest.mark.parametrize("scale", [0.98, 1.02])
@pytest.mark.parametrize("how", [{}, {"late": 0.005}, {"noise": 3.0}, {"lag": 0.005, "every": 3}])
def test_two_percent_are_told(scale: float, how: Mapping[str, Any]) -> None:
    found = speed_scale([turned(np.random.default_rng(7), scale, **how)])
    assert found is not None
    assert found.factor == pytest.approx(scale, rel=2e-3)


@settings(max_examples=40, deadline=None)
@given(
    late=st.floats(0.0, 0.05),
    lag=st.sampled_from([0.0, 0.005, 0.02, 0.04]),
    noise=st.floats(0.0, 30.0),
    every=st.sampled_from([1, 3, 20]),
    hz=st.sampled_from([0.5, 2.0, 8.0]),
    offset=st.floats(-0.5, 0.5),
    seed=st.integers(0, 999),
)
def test_a_speed_that_is_late_smoothed_noisy_or_off_has_its_scale(seed: int, **how: Any) -> None:
    assert speed_scale([turned(np.random.default_rng(seed), 1.0, **how)]) is None


def test_two_signals_of_two_motions_have_no_scale() -> None:
    """As where a belt or a gap lets them part: no one factor."""
    rng = np.random.default_rng(1)
    one, other = (turned(rng, 1.0) for _ in range(2))
    angle = 0.7 * one.raw["motor_angle_rad"] + 0.5 * other.raw["motor_angle_rad"]
    mixed = one.changed(raw={**one.raw, "motor_angle_rad": angle})
    assert speed_scale([mixed]) is None


def test_what_is_barred_says_nothing() -> None:
    one = turned(np.random.default_rng(3), 1.0)
    stuck = one.raw["motor_speed_rad_s"].copy()
    stuck[12_000:20_000] = 0.0
    at = one.thin_time_s - one.time_s[0]
    barred = (at > 10.0) & (at < 22.0)
    assert (
        speed_scale([one.changed(raw={**one.raw, "motor_speed_rad_s": stuck}, barred=barred)])
        is None
    )


def test_which_of_both_is_believed() -> None:
    found = SpeedScale(2.0, 1.99, 2.01)
    assert found.speed_is_wrong({"ratio_error": 0.004}) is True
    assert found.speed_is_wrong({"ratio_error": 1.01}) is False
    assert found.speed_is_wrong({"ratio_error": 0.4}) is None
    assert found.speed_is_wrong({}) is None


@pytest.mark.slow
def test_a_diagnosis_says_it_and_finds_what_it_would_have_found(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """With the rack's position, which says what is right; without, it is a note."""
    plant = {other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0}
    train, kept = record(plant, ("sweep", "weave"), 1), record(plant, ("weave",), 2)

    def told(share: float, *without: str) -> Mapping[str, Any]:
        fitted, held = (
            {
                name: {
                    key: Series(a.t_ns, share * a.value) if key == "motor_speed_rad_s" else a
                    for key, a in one.items()
                    if key not in without
                }
                for name, one in recordings.items()
            }
            for recordings in (train, kept)
        )
        return diagnose(reference_model, fitted, held).content

    right, wrong, unsure = told(1.0), told(0.6), told(0.6, "rack_position_m")
    assert not any(SAID in one for one in right["limits"])
    (finding,), (same,) = right["findings"], wrong["findings"]
    assert same["effect"] == finding["effect"] == "stribeck"
    for name, number in finding["parameters"].items():
        assert same["parameters"][name]["value"] == pytest.approx(number["value"], rel=0.03)
    (said,) = [one for one in wrong["limits"] if SAID in one]
    assert "1.667" in said
    assert "rack_position_m goes with the angle" in said
    (said,) = [one for one in unsure["limits"] if SAID in one]
    assert "tells which" in said
