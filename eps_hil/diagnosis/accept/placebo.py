"""Placebo terms: what a term of no meaning gains where the finding's gain was measured.

A finding changes the torque balance by some torque over time. A placebo has that torque's size and
shape but not its place: shifted round in time inside each recording, or with its sign drawn anew
every tenth of a second. Its amplitude is fitted to the fitted recordings and judged on the
hold-outs, as the finding is. If placebos gain as much, so could anything, and the finding does not
stand. In a periodic manoeuvre a shift by whole periods is nearly the term again; quantiles bear
that.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.holdout_support import not_shown
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee, term_of
from eps_hil.diagnosis.data.prepare import STEP_S, THIN

Floats = npt.NDArray[np.float64]

DRAWS = 100
"""Of each kind."""
SIGN_S = 0.1
_CONSTANT = 0.5
"""Share of a term's energy in its mean from which it is an offset rather than a shape."""
_LUCK = 2.0
"""Times the placebos' 95 % quantile: the search took the luckiest of many effects, a placebo is one
of one. With a load cell a small number of the model file's that is off may have less and be true:
it is asked only where nobody measured the load, and between states that share an unknown."""
_LEAST_SHIFT = 0.1
"""Of a recording: a shorter shift would leave the term near its place."""


def placebos(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    judged: Sequence[Holdout],
    seed: int = 0,
) -> list[dict[str, Any]]:
    """For each finding, its gain and its placebos' on the hold-outs, JSON-ready.

    Gains are in noise variances; ``left_over_n`` is the torque balance's rms while sliding as
    force at the rack (N): without the term, with it, and with the luckiest placebo in its place.
    A term that is nearly constant is not shifted: an offset has no place in time to be taken from.
    The same ``seed`` gives the same numbers.
    """
    found = selection.found
    test = problem.over([one.prepared for one in judged])
    full = test.residual(test.with_entries(found.entries, found.own))
    at = knee(full)
    told = []
    for k in findings:
        entry = found.entries[k]
        spared = selection.without[term_of(entry)]
        without = test.residual(test.with_entries(spared.entries, spared.own))
        fitted = _Term(problem, spared.residual, found.residual)
        kept = _Term(test, without, full)
        rng = np.random.default_rng([seed, k])
        gains, luckiest = {}, without
        most = -np.inf
        for kind, draw in (("shifted", _shifted), ("random_signs", _resigned)):
            values = []
            for _ in range(DRAWS if kind == "random_signs" or fitted.changes else 0):
                left = without - fitted.amplitude(draw(fitted, rng)) * draw(kept, rng) / kept.scale
                values.append(_energy(without, at) - _energy(left, at))
                if values[-1] > most:
                    most, luckiest = values[-1], left
            quantiles = np.quantile(values, (0.05, 0.5, 0.95)) if values else ()
            gains[kind] = [float(f"{v:.4g}") for v in quantiles]
        gain = _energy(without, at) - _energy(full, at)
        told.append(
            {
                "effect": entry["effect"],
                **({"order": float(f"{entry['order']:.4g}")} if "order" in entry else {}),
                "gain": float(f"{gain:.4g}"),
                "draws": DRAWS,
                "placebo_gain_5_50_95_percent": gains,
                "placebo_gain_most": float(f"{most:.4g}"),
                "left_over_n": {
                    "without": _rms_n(test, without),
                    "with": _rms_n(test, full),
                    "luckiest_placebo": _rms_n(test, luckiest),
                },
            }
        )
    return told


def as_lucky(
    told: Sequence[Mapping[str, Any]],
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    judged: Sequence[Holdout],
) -> list[str]:
    """Effects (ids) among ``findings`` that gain what a placebo may gain, as :func:`placebos` told.

    Not those that act in no hold-out: there is no gain to compare.
    """
    silent = not_shown(selection.found, findings, judged, problem)
    lucky = []
    for k, one in zip(findings, told, strict=True):
        chance = [ends[-1] for ends in one["placebo_gain_5_50_95_percent"].values() if ends]
        if k not in silent and one["gain"] <= _LUCK * max(0.0, *chance):
            lucky.append(str(one["effect"]))
    return lucky


class _Term:
    """A finding's torque (Nm, thinned) in some recordings, and the residual without it."""

    def __init__(self, problem: Problem, without: Floats, full: Floats) -> None:
        self.scale = problem.scale
        self.torque = (without - full) * problem.scale
        self.left = clipped(without, knee(without))
        slid = self.torque[problem.sliding]
        self.changes = bool(np.mean(slid) ** 2 < _CONSTANT * np.mean(slid**2))
        """Whether a shift in time makes another term of it."""
        ends = np.cumsum([0, *(len(one.thin_time_s) for one in problem.recordings)])
        self.parts = [slice(int(a), int(b)) for a, b in pairwise(ends)]

    def amplitude(self, torque: Floats) -> float:
        """By least squares on what is left without the term."""
        column = torque / self.scale
        return float(column @ self.left) / max(float(column @ column), 1e-300)


def _shifted(term: _Term, rng: np.random.Generator) -> Floats:
    moved = np.empty_like(term.torque)
    for part in term.parts:
        n = part.stop - part.start
        by = int(n * rng.uniform(_LEAST_SHIFT, 1.0 - _LEAST_SHIFT))
        moved[part] = np.roll(term.torque[part], by)
    return moved


def _resigned(term: _Term, rng: np.random.Generator) -> Floats:
    per = round(SIGN_S / (THIN * STEP_S))
    signs = rng.choice((-1.0, 1.0), size=len(term.torque) // per + 1)
    return term.torque * np.repeat(signs, per)[: len(term.torque)]


def _energy(residual: Floats, at: float) -> float:
    return float(np.sum(clipped(residual, at) ** 2))


def _rms_n(test: Problem, residual: Floats) -> float:
    """Rms while sliding of a weighted residual (n,) as force at the rack, N."""
    torque = (residual * test.scale)[test.sliding]
    ratio = test.model.rack_to_rotor_ratio_rad_per_m
    rms = float(np.sqrt(np.mean(torque**2))) if len(torque) else 0.0
    return float(f"{ratio * rms:.4g}")
