"""Torques whose scale disagrees with the load cell's."""

from collections.abc import Sequence

import numpy as np

from eps_hil.identification import filters
from eps_hil.identification.balance import Case
from eps_hil.identification.extra_regressor import Column, Found, extra_regressor
from eps_hil.identification.finding import Finding
from eps_hil.identification.least_squares import Fit
from eps_hil.identification.state import State, get

SMALLEST = 0.02
_SURE = 5.0
_LOOSEST = 0.1
_ABOVE_NOISE = 3.0


def gain_findings(cases: Sequence[Case], state: State, fit: Fit) -> list[Finding]:
    """Torques that would fit the load cell clearly better with another scale."""
    if not any(case.measured_load for case in cases) or not fit.parameters:
        return []
    told = []
    for signal in ("motor_torque_nm", "torque_sensor_nm"):
        one = gain(cases, state, fit, signal)
        if abs(one.value) > max(SMALLEST, _SURE * one.sigma) and one.sigma < _LOOSEST:
            words = (
                f"would fit the load cell better times {1 + one.value:.3f}: check its scale, "
                "the load cell and the ratios"
            )
            told.append(Finding("scale", "", signal, words))
    return told


def gain(cases: Sequence[Case], state: State, fit: Fit, signal: str) -> Found:
    """Relative change of one torque's scale that fits better."""
    motor = signal == "motor_torque_nm"
    factor = 1.0 if motor else state.model.sensor_to_rotor
    late = get(state, "delays_s.motor_torque" if motor else "delays_s.torque_sensor")
    share = float(np.sum(filters.kernel() ** 2)) / (2 * filters.STEP_S)

    def column(case: Case) -> Column:
        variance = factor**2 * case.recording.density.get(signal, 0.0) * share
        return Column(factor * filters.smooth(case.signal(signal, late)), variance, variance)

    return extra_regressor(cases, state, fit, column, 1.0 + _ABOVE_NOISE)
