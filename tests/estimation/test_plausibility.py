"""Signals that cannot be what they say: taken out or told, and believed again afterwards."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.settings import EstimatorSettings, PlausibilitySettings
from eps_hil.estimation.validity import Reason
from eps_hil.physics.model import Model
from eps_hil.series import Series

from .false_signals import NAMES, OFF, SINCE, UNTIL, series_of, told, wrong_and_valid_ms, wrong_ms


def spoilt(series: dict[str, Series], fault: str) -> dict[str, Series]:
    torque, speed, angle = (series[n].value for n in (NAMES[0], NAMES[2], NAMES[3]))
    part = slice(SINCE, UNTIL)
    if fault == "8 Nm":
        torque[part] = 8.0
    elif fault == "offset":
        torque[part] += 0.5
    elif fault == "torque frozen":
        torque[part] = torque[SINCE]
    elif fault == "motion frozen":
        speed[part], angle[part] = speed[SINCE], angle[SINCE]
    elif fault == "speed offset":
        speed[part] += 20.0
    else:
        torque[SINCE:UNTIL:2] += 0.6
    return series


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("8 Nm", Reason.RANGE),
        ("offset", Reason.INCONSISTENT),
        ("torque frozen", Reason.FROZEN | Reason.INCONSISTENT),
        ("motion frozen", Reason.INCONSISTENT),
        ("speed offset", Reason.INCONSISTENT),
        ("two torques in turn", Reason.INCONSISTENT),
    ],
)
def test_a_lie_under_a_right_crc_is_told(
    reference_model: Model, sweep_truth: Any, fault: str, reason: Reason
) -> None:
    right = estimate(series_of(sweep_truth), reference_model)
    lied = spoilt(series_of(sweep_truth), fault)
    trace, believed = (estimate(lied, reference_model, s) for s in (EstimatorSettings(), OFF))
    assert told(trace, SINCE, UNTIL) & reason
    assert wrong_and_valid_ms(trace, right) <= 20
    assert wrong_ms(believed, right) > 20, "nothing to tell"
    # Which of two torques in turn was the right one is not known: doubted for ``consistent_s``.
    again = UNTIL + (11_000 if fault == "two torques in turn" else 2000)
    assert told(trace, again, again + 1000) == Reason.FINE


@pytest.mark.parametrize("truth", ["sweep_truth", "weave_truth", "steps_truth"])
@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_healthy_rig_with_a_wrong_model_is_believed(
    reference_model: Model, request: pytest.FixtureRequest, truth: str, factor: float
) -> None:
    f, m = reference_model.friction, reference_model
    friction = replace(f, offset_pos_nm=f.offset_pos_nm * factor, sigma0_nm_per_rad=4.5 / factor)
    model = replace(m, inertia_kg_m2=m.inertia_kg_m2 * factor, friction=friction)
    trace = estimate(series_of(request.getfixturevalue(truth)), model)
    doubts = Reason.RANGE | Reason.RATE | Reason.FROZEN | Reason.INCONSISTENT | Reason.IMPLAUSIBLE
    assert told(trace, 0, 10**6) & doubts == Reason.FINE


def test_an_impossible_force_is_not_valid(reference_model: Model) -> None:
    t_ns = np.arange(2000, dtype=np.int64) * 10**6
    rng = np.random.default_rng(1)
    columns = (3.0, 0.0, 20.0, 0.0)
    series = {n: Series(t_ns, v + 1e-3 * rng.standard_normal(2000))
              for n, v in zip(NAMES[:3], columns, strict=False)}  # fmt: skip
    believed = estimate(series, reference_model)
    assert believed.valid[-1]
    low = replace(
        EstimatorSettings(),
        plausibility=PlausibilitySettings(estimate_n=6000.0, motor_torque_nm=9.0),
    )
    assert Reason(int(estimate(series, reference_model, low).reason[-1])) & Reason.IMPLAUSIBLE


def test_what_a_lie_did_before_it_was_told_is_rolled_back(
    reference_model: Model, steps_truth: Any
) -> None:
    """The angle of a resting rotor is off for a while: the bristle stays what it was."""
    right = estimate(series_of(steps_truth), reference_model)
    lied = series_of(steps_truth)
    lied[NAMES[3]].value[11_700:12_050] += 0.0934
    trace = estimate(lied, reference_model)
    assert told(trace, 11_700, 11_750) & Reason.INCONSISTENT
    assert wrong_and_valid_ms(trace, right) <= 20
    resting = (trace.t_ns > 12_300 * 10**6) & (trace.t_ns < 12_450 * 10**6)
    assert np.all(trace.valid[resting])
    assert np.max(np.abs(trace.rack_force_n - right.rack_force_n)[resting]) < 10.0


@pytest.mark.parametrize("stuck", [NAMES[2:], NAMES[2:3], NAMES[3:]])
@pytest.mark.parametrize("about", [11_700, 12_300])
def test_a_motion_that_stops_at_rest_is_told(
    reference_model: Model, steps_truth: Any, stuck: tuple[str, ...], about: int
) -> None:
    """The speed stays at what its noise read last: an observer that believes it slides away."""
    right = estimate(series_of(steps_truth), reference_model)
    lied = series_of(steps_truth)
    since = about + int(np.argmax(np.abs(lied[NAMES[2]].value[about : about + 30])))
    for name in stuck:
        lied[name].value[since : since + 300] = lied[name].value[since]
    trace, believed = (estimate(lied, reference_model, s) for s in (EstimatorSettings(), OFF))
    assert told(trace, since, since + 40) & Reason.FROZEN
    assert wrong_and_valid_ms(trace, right) <= 20
    if NAMES[2] in stuck:
        assert wrong_ms(believed, right) > 100, "nothing to tell"
    assert told(trace, since + 2300, since + 3000) == Reason.FINE


@pytest.mark.parametrize("step_rad", [0.01, 0.02])
def test_a_coarse_signal_that_rests_with_the_rotor_is_believed(
    reference_model: Model, steps_truth: Any, step_rad: float
) -> None:
    """A car's angle: it changes at each sample while the rotor creeps, and never at rest."""
    series = series_of(steps_truth)
    angle = np.convolve(np.pad(series[NAMES[3]].value, (100, 100), "edge"), np.full(201, 1 / 201))
    series[NAMES[3]].value[:] = step_rad * np.round(angle[200:-200] / step_rad) + 1e-3
    assert np.mean(np.diff(series[NAMES[3]].value[11_500:12_300]) == 0.0) > 0.95
    trace = estimate(series, reference_model, EstimatorSettings(angle_noise_rad=step_rad))
    assert told(trace, 0, 10**6) & Reason.FROZEN == Reason.FINE
