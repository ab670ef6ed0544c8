"""A rack force that nobody measured, told from a change of friction.

Torque and error injection take the rack force as zero. A constant force F adds F/i_APA to k0+ and
takes it from k0−, and their sum hardly notices. Two things give it away:

* **The last calibration.** Wear, grease and warmth move both levels the same way; levels that
  moved apart while their sum stayed are what a force does (:func:`force_that_explains_n`).
* **The way before sliding.** By eq. 2a, on a ramp from rest, the torque T reaches for
  T_∞ = k0 ± F/i_APA as 1 − exp(−s/λ) over the way s, with λ = k0/σ0: the friction level is in the
  *length*, the force is not. With one σ0 for both directions, λ+/λ− = k0+/k0−, and the force
  follows (:func:`shift_of`). Where friction's presliding is of another form, the σ0 that comes out
  is not the model's, and nothing is said.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eps_hil.estimation.levels import FrictionLevels

_LEAST_SHARE = 0.08
"""Of the mean level: a shift that is worth a word (18 N on the reference rig)."""
_MOST_COMMON = 0.5
"""What both levels moved alike, as a share of what they moved apart; more is wear or warmth."""
_FORM = 0.08
"""How far the σ0 that presliding shows may lie from the model's, as a share."""
_SCATTER = 0.15
"""Of the lengths of one direction, as a share: a bristle repeats itself."""
_SIGMA = 4.0


class Shift(NamedTuple):
    """F/i_APA (Nm at the rotor) that k0+ is too large by, and k0− too small; NaN: not seen."""

    torque_nm: float
    std_nm: float

    @property
    def seen(self) -> bool:
        """Whether presliding told anything."""
        return math.isfinite(self.torque_nm)

    def matters(self, level_nm: float) -> bool:
        """Whether it is there, and large beside the mean level."""
        least = max(_SIGMA * self.std_nm, _LEAST_SHARE * level_nm)
        return self.seen and abs(self.torque_nm) > least


NOT_SEEN = Shift(math.nan, math.nan)


def shift_of(
    levels: FrictionLevels,
    forth_rad: Sequence[float],
    back_rad: Sequence[float],
    sigma0_nm_per_rad: float,
) -> Shift:
    """The shift of levels found under the assumption of no force, from presliding lengths.

    ``forth_rad``, ``back_rad``: λ of each repetition of both directions (rad at the rotor).
    """
    lengths = [np.array([x for x in part if x > 0.0]) for part in (forth_rad, back_rad)]
    if min(map(len, lengths)) < 2:
        return NOT_SEEN
    (forth, error_forth), (back, error_back) = (
        (float(np.mean(x)), float(np.std(x, ddof=1)) / math.sqrt(len(x))) for x in lengths
    )
    scatter = max(float(np.std(x, ddof=1)) / float(np.mean(x)) for x in lengths)
    sigma0 = sum(levels) / (forth + back)
    if scatter > _SCATTER or abs(sigma0 / sigma0_nm_per_rad - 1.0) > _FORM:
        return NOT_SEEN
    share = forth / back
    error = share * math.hypot(error_forth / forth, error_back / back)
    shift = (levels.positive_nm - share * levels.negative_nm) / (1.0 + share)
    return Shift(shift, sum(levels) / (1.0 + share) ** 2 * error)


def force_that_explains_n(before: FrictionLevels, after: FrictionLevels, ratio: float) -> float:
    """Rack force (N) that would make the levels of ``before`` look like ``after``; 0: friction did.

    ``ratio``: i_APA in rad/m.
    """
    forth, back = after.positive_nm - before.positive_nm, after.negative_nm - before.negative_nm
    apart, alike = 0.5 * (forth - back), 0.5 * (forth + back)
    if abs(apart) < _LEAST_SHARE * 0.5 * sum(before) or abs(alike) > _MOST_COMMON * abs(apart):
        return 0.0
    return apart * ratio
