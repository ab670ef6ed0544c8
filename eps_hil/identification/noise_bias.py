"""What sensor noise does to a fit that is nonlinear in noisy signals, found by adding more of it.

Simulation extrapolation (Cook and Stefanski, 1994): with noise of ``EXTRA`` times the measured
variance on top, estimates move by ``EXTRA`` times their bias; that much is taken back. The small
speeds of a reversal need it most: there the bristle damping is found.
"""

from collections.abc import Sequence

import numpy as np

from eps_hil.identification.balance import cases
from eps_hil.identification.filters import STEP_S
from eps_hil.identification.kinematics import kinematics
from eps_hil.identification.least_squares import Fit
from eps_hil.identification.prepare import Prepared
from eps_hil.identification.stages import Found, estimate
from eps_hil.identification.state import POSITIVE, Parameter, State, get, put

EXTRA = 2.0
_MOST = 0.5
"""A correction beyond this part of a value is no bias, but a fit that went elsewhere."""


def noisier(recording: Prepared, rng: np.random.Generator) -> Prepared:
    """The recording with white noise of EXTRA times each signal's own density on top."""
    raw = {
        name: values
        + np.sqrt(EXTRA * recording.density[name] / (2 * STEP_S)) * rng.normal(size=len(values))
        for name, values in recording.raw.items()
    }
    density = {name: (1 + EXTRA) * value for name, value in recording.density.items()}
    return Prepared(
        recording.name, recording.time_s, raw, density, recording.good, recording.findings
    )


def corrected(
    found: Found,
    recordings: Sequence[Prepared],
    skew_s: float,
    prior: State,
    parameters: Sequence[Parameter],
) -> Found:
    """The fits with the bias of noise taken out; their covariance grows by what that costs."""
    rng = np.random.default_rng(20150802)
    more = [noisier(one, rng) for one in recordings]
    motions = [kinematics(one, skew_s) for one in more]
    moved = estimate(
        cases(more, motions), found.sliding.state, parameters, prior=prior, passes=1,
        bristle_of=found.bristle.parameters if found.bristle else None,
    )  # fmt: skip
    sliding = _taken_back(found.sliding, moved.sliding)
    bristle = found.bristle
    if bristle is not None and moved.bristle is not None:
        bristle = _taken_back(bristle, moved.bristle, sure=False)
        for parameter in bristle.parameters:
            value = get(bristle.state, parameter.name)
            sliding = Fit(
                put(sliding.state, parameter.name, value),
                sliding.parameters,
                sliding.covariance,
                sliding.rows,
                sliding.blocks,
            )
    return Found(sliding, bristle, found.rough, found.weights)


def _extrapolated(name: str, value: float, noisy: float) -> float:
    """The value without noise; of what is only there above zero, along its logarithm."""
    if name in POSITIVE and value > 0.0 and noisy > 0.0:
        return float(value * (value / noisy) ** (1.0 / EXTRA))
    return value - (noisy - value) / EXTRA


def _taken_back(fit: Fit, moved: Fit, sure: bool = True) -> Fit:
    """``sure`` is whether a bias is as small as the straight extrapolation wants it."""
    state, unsure = fit.state, []
    for parameter in fit.parameters:
        value = get(fit.state, parameter.name)
        noisy = get(moved.state, parameter.name)
        bias = (noisy - value) / EXTRA
        if abs(bias) < max(_MOST * abs(value), 3 * fit.sigma(parameter.name)):
            state = put(state, parameter.name, _extrapolated(parameter.name, value, noisy))
        unsure.append(0.0 if sure else bias**2)
    covariance = fit.covariance * (1 + 1 / EXTRA) + np.diag(unsure)
    return Fit(state, fit.parameters, covariance, fit.rows, fit.blocks)
