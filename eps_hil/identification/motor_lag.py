"""Whether the motor's delay is a dead time or a lag, from what is left once the delay is right.

A torque that reaches the shaft through a dead time T and a first-order lag τ is, for slow torques,

    T_em(t − T − τ) + ½ τ² T̈_em + …

so the delay holds the sum, and only the second derivative tells τ from T: 0.05 % of the torque at
5 Hz for a millisecond. A belt that gives, or a scale, does nearly the same. So τ is claimed only
where the term is clear of its own error and of what a millisecond of doubt would look like: a
command that is held over a step h acts as τ² = h²/12, straight lines between commands as h²/6, a
stamp that is read off between two samples as up to h²/4.

A lag leaves less of a fast torque, which passes for inertia: where it is claimed, the other
parameters are told beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from eps_hil.identification import filters
from eps_hil.identification.balance import Case
from eps_hil.identification.extra_regressor import Column, extra_regressor
from eps_hil.identification.kinematics import FREQUENCY
from eps_hil.identification.least_squares import Fit
from eps_hil.identification.result import Estimate
from eps_hil.identification.state import State, get, put

Floats = npt.NDArray[np.float64]

_SURE = 3.0
_SAMPLED = 0.25
"""Deviation of τ² by what happens between two values of torque or speed, of their step squared."""
_NOTE = "first-order part of the motor torque's delay; the rest of it is dead time"
_STEPS = ("motor_torque_nm", "motor_speed_rad_s")
_SIGNAL, _DELAY = "motor_torque_nm", "delays_s.motor_torque"


@dataclass(frozen=True, slots=True)
class MotorLag:
    """τ² (s²) between reported and shaft torque, and its deviation (inf: these do not show it)."""

    square_s2: float
    sigma_s2: float
    moves: Floats | None = None
    """What one s² of it moves each parameter of the fit by."""

    def beside(self, fit: Fit) -> Fit:
        """The fit beside the lag, where there is one; itself where none is claimed."""
        if not self.separable or self.moves is None:
            return fit
        state = fit.state
        for parameter, move in zip(fit.parameters, self.moves.tolist(), strict=True):
            value = get(state, parameter.name) + move * self.square_s2
            state = put(state, parameter.name, value)
        unsure = self.sigma_s2**2 * np.outer(self.moves, self.moves)
        return replace(fit, state=state, covariance=fit.covariance + unsure)

    @property
    def separable(self) -> bool:
        """Whether a lag is clearly there."""
        return self.square_s2 > _SURE * self.sigma_s2

    @property
    def seconds(self) -> float:
        """τ; 0 where the square is not positive."""
        return float(np.sqrt(max(self.square_s2, 0.0)))

    def estimate(self, quantile: float) -> Estimate | None:
        """τ with its 95 % interval, None where it is not separable."""
        if not self.separable:
            return None
        half = quantile * self.sigma_s2
        low, high = (float(np.sqrt(max(self.square_s2 + s * half, 0.0))) for s in (-1, 1))
        return Estimate(self.seconds, "s", (low, high), None, "identified", _NOTE)

    @property
    def most_s(self) -> float:
        """Largest lag (s) that these recordings allow (95 %); inf where they do not show it."""
        return float(np.sqrt(max(self.square_s2, 0.0) + 2.0 * self.sigma_s2))


def motor_lag(cases: Sequence[Case], state: State, fit: Fit) -> MotorLag:
    """τ² with all fitted parameters free; noise of the torque taken out of its column."""
    if _DELAY not in {p.name for p in fit.parameters}:
        return MotorLag(0.0, np.inf)
    found = extra_regressor(
        cases, state, fit, lambda case: Column(_bent(case, state), *_noise(case))
    )
    steps = [case.recording.step_s.get(name, 0.0) for case in cases for name in _STEPS]
    sampled = _SAMPLED * max(steps, default=0.0) ** 2
    return MotorLag(found.value, float(np.hypot(found.sigma, sampled)), found.moves)


def _bent(case: Case, state: State) -> Floats:
    """½ T̈_em, filtered, (m,): what one s² of τ² does to the balance."""
    torque = case.signal(_SIGNAL, get(state, _DELAY))
    return 0.5 * filters.derivative(filters.slope(torque))


def _noise(case: Case) -> tuple[float, float]:
    """(variance of that column's noise, its covariance with the same noise in the balance)."""
    t = np.arange(-filters.HALF, filters.HALF + 1) * filters.STEP_S
    response = np.abs(np.exp(-2j * np.pi * np.outer(FREQUENCY, t)) @ filters.kernel()) ** 2
    turn = 2 * np.pi * FREQUENCY * filters.STEP_S
    once = (8 * np.sin(turn) - np.sin(2 * turn)) / (6 * filters.STEP_S)
    power = case.recording.density.get(_SIGNAL, 0.0) * response * (FREQUENCY[1] - FREQUENCY[0])
    return float(np.sum(0.25 * once**4 * power)), float(np.sum(-0.5 * once**2 * power))
