"""Sliding first, bristle second, and again: each stage looks where the other is settled.

While the rotor slides and the bristle has forgotten its last reversal, friction is its static
level, whatever law presliding obeys: levels, inertia and delays are found there. Reversals and
small motion then show the bristle. Where presliding is not LuGre's, the levels stay right.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from eps_hil.identification.balance import Case
from eps_hil.identification.least_squares import Fit, fit
from eps_hil.identification.state import Parameter, State, bristle_parameters

Floats = npt.NDArray[np.float64]

SETTLED_SHARE = 0.01
"""Rows of which no more than this part of the filter's length is unsettled count as sliding."""
_ROBUST = 3.0
_ROUGH = 0.2
"""How wrong friction may be while a bristle is unsettled, of its level, before it was fitted."""
_FEWEST = 50
_CAREFUL = 3.0
"""Presliding misfit repeats itself at every reversal, so it counts this much more than noise."""


@dataclass
class Sliding:
    """Weights of rows for the sliding stage; ``rough`` is the misfit of presliding, of T_fs."""

    rough: float = _ROUGH
    _kept: dict[tuple[int, float], Floats] = field(default_factory=dict)

    def unsettled(self, case: Case, state: State) -> Floats:
        """Kept over the rounds of a fit: the mask hardly moves with the parameters."""
        key = (case.index, state.model.friction.sigma0_nm_per_rad)
        if key not in self._kept:
            self._kept[key] = case.unsettled(state)
        return self._kept[key]

    def __call__(self, case: Case, state: State, residual: Floats) -> Floats:
        """1/Nm², (m,): settled rows by their own spread, unsettled ones by what is unknown."""
        share = self.unsettled(case, state)
        spread = _spread(residual[(share <= SETTLED_SHARE) & case.good])
        level = np.abs(case.thin_level(state))
        variance = spread**2 + (self.rough * level * share) ** 2
        return np.where(share < 0.9, _huber(residual, np.sqrt(variance)) / variance, 0.0)


@dataclass
class Presliding:
    """Weights for the bristle stage: unsettled rows that move, all alike."""

    sliding: Sliding

    def __call__(self, case: Case, state: State, residual: Floats) -> Floats:
        """1/Nm², (m,)."""
        share = self.sliding.unsettled(case, state)
        mine = (share > 0.05) & case.good & ~case.resting
        spread = max(_spread(residual[mine]), 1e-3)
        return np.where(mine, _huber(residual, np.full(len(residual), spread)) / spread**2, 0.0)


@dataclass(frozen=True)
class Found:
    """Fits of both stages; ``bristle`` is None where nothing reverses."""

    sliding: Fit
    bristle: Fit | None
    rough: float
    weights: Sliding


def estimate(
    cases: Sequence[Case],
    start: State,
    parameters: Sequence[Parameter],
    on_progress: Callable[[float], None] | None = None,
    passes: int = 2,
    prior: State | None = None,
    bristle_of: Sequence[Parameter] | None = None,
) -> Found:
    """Alternate the stages from ``start``; at the last one the sliding stage has the last word.

    Priors stand at ``prior`` (``start`` where that is None). ``bristle_of``: the bristle's
    parameters that are fitted; all where that is None.
    """
    prior = prior or start
    looked_for = bristle_parameters(prior) if bristle_of is None else bristle_of
    say = on_progress or (lambda _part: None)
    weights = Sliding()
    sliding = fit(cases, start, parameters, prior, weights)
    bristle: Fit | None = None
    for k in range(passes):
        say((k + 1) / (passes + 1))
        if not looked_for or _unsettled_rows(cases, sliding.state, weights) < _FEWEST:
            break
        bristle = fit(
            cases,
            sliding.state,
            looked_for,
            prior,
            Presliding(weights),
            rounds=10 if k == 0 else 4,
        )
        weights = Sliding(_CAREFUL * max(0.01, _misfit(cases, bristle, weights)))
        sliding = fit(cases, bristle.state, parameters, prior, weights, rounds=6)
    return Found(sliding, bristle, weights.rough / _CAREFUL, weights)


def _unsettled_rows(cases: Sequence[Case], state: State, weights: Sliding) -> int:
    return sum(int((weights.unsettled(case, state) > 0.2).sum()) for case in cases)


def _misfit(cases: Sequence[Case], found: Fit, weights: Sliding) -> float:
    """Rms of what the bristle leaves while unsettled, of T_fs and of the share unsettled."""
    left, level = [], []
    for case, rows in zip(cases, found.rows, strict=True):
        share = weights.unsettled(case, found.state)
        mine = (share > 0.2) & (share < 0.9) & case.good
        left.append(rows.residual[mine] / share[mine])
        level.append(case.thin_level(found.state)[mine])
    residual, size = np.concatenate(left), np.concatenate(level)
    return float(np.sqrt(np.mean((residual / size) ** 2))) if len(size) else _ROUGH


def _spread(residual: Floats) -> float:
    if len(residual) < 10:
        return 5e-3
    return max(1.4826 * float(np.median(np.abs(residual))), 1e-5)


def _huber(residual: Floats, sigma: Floats) -> Floats:
    size = np.abs(residual) / sigma
    return np.where(size < _ROBUST, 1.0, _ROBUST / np.maximum(size, _ROBUST))
