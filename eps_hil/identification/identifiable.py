"""What recordings cannot tell keeps the model file's value, and is said to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eps_hil.identification.balance import Case
from eps_hil.identification.least_squares import Fit, fit, linearised
from eps_hil.identification.stages import Sliding
from eps_hil.identification.state import Parameter, State, get, put

LOOSEST = {"inertia_kg_m2": 0.15, "delays_s": 0.06, "friction": 0.3, "spring": 0.2}
"""Largest deviation of what counts as identified, in units of the parameter's prior."""


@dataclass(frozen=True)
class Choice:
    """Parameters that are fitted, those that are kept, and the fit so far."""

    fitted: tuple[Parameter, ...]
    kept: tuple[Parameter, ...]
    fit: Fit


def choose(cases: Sequence[Case], start: State, parameters: Sequence[Parameter]) -> Choice:
    """Fit the sliding stage, and drop the least certain parameter until the rest is certain."""
    fitted, kept = list(parameters), []
    weights = Sliding()
    found = fit(cases, start, fitted, start, weights)
    while fitted:
        worst, doubt = max(((p, _doubt(found, p)) for p in fitted), key=lambda item: item[1])
        if doubt <= 1.0:
            break
        fitted.remove(worst)
        kept.append(worst)
        state = put(found.state, worst.name, get(start, worst.name))
        if not fitted:
            found = replace(found, state=state, parameters=(), covariance=np.zeros((0, 0)))
            break
        found = fit(cases, state, fitted, start, weights, rounds=6)
    return Choice(tuple(fitted), tuple(kept), found)


def widened(fit: Fit, cases: Sequence[Case], kept: Sequence[Parameter], weights: Sliding) -> Fit:
    """The fit with covariance for what the kept values, off by their priors, would change.

    The model file's value of a kept parameter may be wrong by its prior's half.
    """
    if not kept or not fit.parameters:
        return fit
    everything = [*fit.parameters, *kept]
    rows = linearised(cases, fit.state, everything, weights)
    normal = np.zeros((len(everything),) * 2)
    for one in rows:
        normal += one.columns.T @ (one.columns * one.weight[:, None])
    n = len(fit.parameters)
    mine = normal[:n, :n] + np.diag([p.prior**-2.0 for p in fit.parameters])
    change = -np.linalg.solve(mine, normal[:n, n:])
    wrong = np.diag([(0.5 * p.prior) ** 2 for p in kept])
    return replace(fit, covariance=fit.covariance + change @ wrong @ change.T)


def _doubt(found: Fit, parameter: Parameter) -> float:
    group = next(group for group in LOOSEST if parameter.name.startswith(group))
    return found.sigma(parameter.name) / (LOOSEST[group] * parameter.prior)
