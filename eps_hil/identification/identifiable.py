"""What recordings cannot tell keeps the model file's value, and is said to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eps_hil.identification.balance import Case
from eps_hil.identification.least_squares import Fit, expected, fit, linearised
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
    fitted, kept = _informed(cases, start, parameters)
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
    for _ in range(2):
        held = _held(found, start, kept)
        if fitted and held != found.state:
            found = fit(cases, held, fitted, start, weights, rounds=6)
    return Choice(tuple(fitted), tuple(kept), found)


def _held(found: Fit, start: State, kept: Sequence[Parameter]) -> State:
    """Kept delays put back to the model file's value, now that the speed's own is known."""
    before = start.model.delays_s
    sure = {key: found.sigma(f"delays_s.{key}") for key in ("torque_sensor", "rack_force")}
    sure = {key: sigma for key, sigma in sure.items() if np.isfinite(sigma)}
    if not sure:
        return found.state
    best = min(sure, key=lambda key: sure[key])
    speed = getattr(before, best) - get(found.state, f"delays_s.{best}")
    state = found.state
    for parameter in kept:
        if parameter.name.startswith("delays_s."):
            late = getattr(before, parameter.name.removeprefix("delays_s."))
            state = put(state, parameter.name, late - speed)
    return state


def _informed(
    cases: Sequence[Case], start: State, parameters: Sequence[Parameter]
) -> tuple[list[Parameter], list[Parameter]]:
    """(parameters, delays left out) by what could be known if the model were right.

    Asked before the fit: a motor torque that is a spring of the same motion can be early or late
    together with the viscous friction and the inertia, and a fit would slide along that valley.
    """
    fitted = list(parameters)
    out: list[Parameter] = []
    while True:
        covariance = expected(cases, start, fitted, Sliding())
        doubts = {
            k: float(np.sqrt(covariance[k, k])) / (LOOSEST["delays_s"] * p.prior)
            for k, p in enumerate(fitted)
            if p.name.startswith("delays_s")
        }
        worst = max(doubts, key=lambda k: doubts[k], default=None)
        if worst is None or doubts[worst] <= 1.0:
            return fitted, out
        out.append(fitted.pop(worst))


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
