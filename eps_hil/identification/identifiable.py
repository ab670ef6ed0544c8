"""What recordings cannot tell keeps the model file's value, and is said to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from eps_hil.identification import filters
from eps_hil.identification.balance import Case
from eps_hil.identification.least_squares import Fit, expected, fit, linearised
from eps_hil.identification.stages import Sliding
from eps_hil.identification.state import Parameter, State, get, put

LOOSEST = {"inertia_kg_m2": 0.15, "delays_s": 0.06, "friction": 0.3, "spring": 0.2}
"""Largest deviation of what counts as identified, in units of the parameter's prior."""
FELT = 0.005
"""How far friction's load may be off the spring's force that stands in for a load cell (rms)."""

Floats = npt.NDArray[np.float64]


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
    found = _settled(cases, found, start, fitted, kept, weights)
    return Choice(tuple(fitted), tuple(kept), found)


def _settled(
    cases: Sequence[Case],
    found: Fit,
    start: State,
    fitted: Sequence[Parameter],
    kept: Sequence[Parameter],
    weights: Sliding,
) -> Fit:
    """The fit again with kept delays at their values, now that the speed's own is known."""
    for _ in range(2):
        held = _held(found, start, kept)
        if fitted and held != found.state:
            found = fit(cases, held, fitted, start, weights, rounds=6)
    return found


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
    """The fit with covariance for what it takes on trust, were that wrong.

    The model file's value of a kept parameter may be wrong by its prior's half; where the load is
    not measured, what friction feels of it by :data:`FELT` of its size.
    """
    springs = [case.index for case in cases if not case.measured_load]
    if not fit.parameters or not (kept or springs):
        return fit
    n = len(fit.parameters)
    rows = linearised(cases, fit.state, [*fit.parameters, *kept], weights)
    trusted = [_felt(case, fit.state, springs) for case in cases]
    mine = np.diag([p.prior**-2.0 for p in fit.parameters])
    others = np.zeros((n, len(kept) + 2 * len(springs)))
    for one, felt in zip(rows, trusted, strict=True):
        weighted = one.columns[:, :n] * one.weight[:, None]
        mine += weighted.T @ one.columns[:, :n]
        others += weighted.T @ np.column_stack([one.columns[:, n:], felt])
    change = -np.linalg.solve(mine, others)
    wrong = np.diag([*((0.5 * p.prior) ** 2 for p in kept), *np.ones(2 * len(springs))])
    return replace(fit, covariance=fit.covariance + change @ wrong @ change.T)


def _felt(case: Case, state: State, springs: Sequence[int]) -> Floats:
    """Residual (Nm) if friction felt an unmeasured load FELT of its size higher, or later.

    (m, 2 a spring). A spring's zero and its damping act on the rotor just as the difference of
    the friction offsets and the viscous friction do; only the friction that the load makes tells
    them apart, so how well that is known is how well they are.
    """
    columns = np.zeros((len(case.time_s), 2 * len(springs)))
    if case.measured_load:
        return columns
    ratio = state.model.rack_to_rotor_ratio_rad_per_m
    size = FELT * float(np.std(case.rack_force_n(state)))
    rate = case.motion.speed / ratio
    rates = float(np.std(rate))
    k, name = 2 * springs.index(case.index), f"spring{case.index}."
    for place, key, direct, step in (
        (k, "force_n", np.ones(len(rate)), size),
        (k + 1, "damping_n_s_per_m", rate, size / rates if rates > 0 else 0.0),
    ):
        moved = put(state, name + key, get(state, name + key) + step)
        whole = case.residual(moved) - case.residual(state)
        columns[:, place] = whole + step * filters.smooth(direct) / ratio
    return columns


def _doubt(found: Fit, parameter: Parameter) -> float:
    group = next(group for group in LOOSEST if parameter.name.startswith(group))
    return found.sigma(parameter.name) / (LOOSEST[group] * parameter.prior)


def beside_sliding(
    cases: Sequence[Case], bristle: Fit, sliding: Fit, own: Mapping[str, float]
) -> Fit:
    """The bristle's fit, wider by what errors of the sliding stage's numbers do to it.

    They are held while the bristle is fitted. In fast motion, where the inertia's torque is many
    times the friction's, a tenth of a per mille of it passes for a bristle. ``own``: deviations by
    the method itself, by parameter.
    """
    if not bristle.parameters or not sliding.parameters:
        return bristle
    mine = np.diag([p.prior**-2.0 for p in bristle.parameters])
    others = np.zeros((len(bristle.parameters), len(sliding.parameters)))
    for case, one in zip(cases, bristle.rows, strict=True):
        _, columns = case.linearised(bristle.state, sliding.parameters)
        weighted = one.columns * one.weight[:, None]
        mine += weighted.T @ one.columns
        others += weighted.T @ columns
    change = -np.linalg.solve(mine, others)
    method = np.array([own.get(p.name, 0.0) for p in sliding.parameters])
    wrong = sliding.covariance + np.diag(method**2)
    return replace(bristle, covariance=bristle.covariance + change @ wrong @ change.T)
