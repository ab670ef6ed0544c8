"""What candidates explain on blocks of time that they were not fitted to, and what counts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.attribute.numbers import CONSTANTS
from eps_hil.diagnosis.balance.fit import Fit, deviation
from eps_hil.diagnosis.balance.probes import Candidate
from eps_hil.diagnosis.balance.problem import Problem, clipped, huber, knee
from eps_hil.diagnosis.mismatch.curve import ID as CURVE
from eps_hil.diagnosis.mismatch.curve import has_curve

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

LEAST_SHARE = 0.006
"""Least share of the residual's energy that an accepted effect explains on unfitted blocks."""
LEAST_GAIN = 30.0
"""Least gain in units of the noise's own variance, at as many independent samples in a thinned one
as the filter leaves of signals at 1 kHz…"""
_USUAL = 0.64
"""…which is so many: what is recorded slowly repeats the same noise."""
FORWARD_SHARE, FINAL_SHARE = 0.02, 0.10
"""Least shares of what is still unexplained: on the way, and in the end."""
NEAR = 0.8
"""A candidate that reaches this share of a finding's gain is fitted in its place."""
ONCE_GAIN, _ONCE = 0.5, 0.05
"""What happened in one half of the blocks only (a stop that was touched once) the other half cannot
bear out: half of what it explains counts, and the hold-outs have the last word as always."""
_AT_ONCE = 32
"""Columns that are worked on together, which bounds the memory for an hour of recordings."""
_NOTHING = 1e-6
_ROUNDS = 5
"""Of weighted least squares: what is an outlier is known once the rest is fitted."""
IN_CURVE = ("unmodelled_spring", "end_stop")
"""A static curve over position holds these already; both at once would cancel each other."""


@dataclass(frozen=True)
class Scored:
    """A candidate, its held-out gain (noise variances), and the entry to start a fit from."""

    candidate: Candidate
    gain: float
    entry: dict[str, Any]


def score(problem: Problem, found: Fit, pool: Sequence[Candidate]) -> list[Scored]:
    """Every candidate's gain on held-out blocks, best first."""
    there, taken = {str(entry["effect"]) for entry in found.entries}, set[str]()
    if has_curve(found):
        taken |= {*IN_CURVE, *CONSTANTS}
    elif there & set(IN_CURVE):
        taken |= {CURVE}
    if there & set(CONSTANTS):
        taken |= set(CONSTANTS)  # one constant is all that sliding shows
    open_to = [
        one
        for one in pool
        if one.effect.id not in taken
        and one.beside(found.entries, problem.model, problem.size.angle)
    ]
    left = refitted(found.residual, found.jacobian)
    gains = cross_validated(
        [one.columns for one in open_to],
        clipped(left, knee(left)),
        found.jacobian,
        problem.block % 2 == 0,
    )
    results = []
    for candidate, (gain, coefficients) in zip(open_to, gains, strict=True):
        entry = candidate.entry(coefficients, problem)
        if deviation(entry, problem) > 0.0:  # of the other sign it is not this effect
            results.append(Scored(candidate, gain, entry))
    return sorted(results, key=lambda one: -one.gain)


def threshold(problem: Problem, residual: Floats, of_excess: float) -> float:
    """Gain that counts beside what the residual still holds.

    ``of_excess`` is the share of the energy beyond the sensor noise that it must explain: an
    effect that leaves most of the mismatch standing has the wrong name. What sampling hides is no
    effect.
    """
    energy = clipped(residual, knee(residual)) ** 2
    excess = float(np.sum(energy[problem.sliding] - 1.0))
    share = LEAST_SHARE * float(np.sum(energy))
    repeated = _USUAL * float(np.sum(problem.sliding)) / max(problem.independent, 1.0)
    return max(LEAST_GAIN * max(repeated, 1.0), share, of_excess * excess, problem.hidden)


def penalised(one: Fit) -> float:
    """Cost with Schwarz's price, ln n, for every number fitted, a curve's knots included."""
    knots = sum(len(entry["curve"]) for entry in one.entries if "curve" in entry)
    return one.cost + float(np.log(len(one.residual))) * (len(one.names) + knots)


def is_curve(candidate: Candidate) -> bool:
    """Whether its shape is a free curve over position, knot by knot."""
    probe = candidate.effect.probe
    return probe is not None and probe.scan == "curve"


def cross_validated(
    regressors: Sequence[Floats], residual: Floats, jacobian: Floats, even: Flags
) -> list[tuple[float, Floats]]:
    """(held-out gain, coefficients from all samples) for each regressor (n, k) by itself.

    Each half of the blocks (``even`` and not) is fitted by least squares and judged on the other.
    What the parameters already in the model could do, the columns of ``jacobian`` (n, p), is
    projected out of both first: half of what such columns do is not orthogonal to half of another.
    Gains are in units of ``residual`` squared.
    """
    basis = _basis(jacobian)
    residual = residual - basis @ (basis.T @ residual)
    found: list[tuple[float, Floats]] = []
    first = 0
    while first < len(regressors):
        last, width = first + 1, regressors[first].shape[1]
        while last < len(regressors) and width + regressors[last].shape[1] <= _AT_ONCE:
            width += regressors[last].shape[1]
            last += 1
        found += _some(regressors[first:last], residual, basis, even)
        first = last
    return found


def refitted(residual: Floats, jacobian: Floats) -> Floats:
    """The residual (n,) without what columns (n, p) can do of it, by Huber's loss.

    Of a fit that is nothing. Of a model that is no fit it is most, beside which what a candidate
    explains would all be cut off as outliers.
    """
    size = np.sqrt(np.sum(jacobian**2, axis=0))
    columns = jacobian[:, size > 0] / size[size > 0]
    left, weight = residual, np.ones(len(residual))
    for _ in range(_ROUNDS if columns.shape[1] else 0):
        moved = np.linalg.lstsq(columns * weight[:, None], residual * weight, rcond=1e-9)[0]
        left = residual - columns @ moved
        weight = np.sqrt(huber(left, knee(left)))
    return left


def _some(
    regressors: Sequence[Floats], residual: Floats, basis: Floats, even: Flags
) -> list[tuple[float, Floats]]:
    columns = np.hstack(regressors)
    columns -= basis @ (basis.T @ columns)
    norm = np.sqrt(np.sum(columns**2, axis=0))
    columns /= norm + 1e-300
    halves = [
        (columns[half].T @ columns[half], columns[half].T @ residual[half])
        for half in (even, ~even)
    ]
    found, first = [], 0
    for one in regressors:
        part = slice(first, first + one.shape[1])
        first = part.stop
        if np.linalg.norm(norm[part]) < _NOTHING:
            found.append((0.0, np.zeros(one.shape[1])))
            continue
        (gram_e, slope_e), (gram_o, slope_o) = ((g[part, part], s[part]) for g, s in halves)
        gain = _judged(gram_e, slope_e, gram_o, slope_o) + _judged(gram_o, slope_o, gram_e, slope_e)
        gram, slope = gram_e + gram_o, slope_e + slope_o
        whole = _solved(gram, slope)
        share = float(np.trace(gram_e)) / one.shape[1]
        if min(share, 1.0 - share) < _ONCE:
            gain = ONCE_GAIN * float(2.0 * slope @ whole - whole @ gram @ whole)
        found.append((gain, whole / (norm[part] + 1e-300)))
    return found


def _judged(gram: Floats, slope: Floats, other_gram: Floats, other_slope: Floats) -> float:
    """Drop of the other half's energy by what this half's fit says."""
    a = _solved(gram, slope)
    return float(2.0 * other_slope @ a - a @ other_gram @ a)


def _solved(gram: Floats, slope: Floats) -> Floats:
    return np.asarray(np.linalg.pinv(gram, rcond=1e-12, hermitian=True) @ slope)


def _basis(jacobian: Floats) -> Floats:
    """Orthonormal columns that span those of the Jacobian, (n, at most p)."""
    if jacobian.shape[1] == 0:
        return jacobian
    size = np.sqrt(np.sum(jacobian**2, axis=0))
    q, r = np.linalg.qr(jacobian[:, size > 0] / size[size > 0])
    return np.asarray(q[:, np.abs(np.diag(r)) > 1e-6])
