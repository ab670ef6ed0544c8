"""Moving, turning, resting: three parts of a manoeuvre in which an estimate errs differently."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.estimation.score import MOVING_RAD_S

Bools = npt.NDArray[np.bool_]

TURN_WITHIN_S = 0.25
"""Two motions in opposite directions with no longer a pause than this are one reversal."""
_BEFORE_S, _AFTER_S = 0.02, 0.06


class Phases(NamedTuple):
    """Which samples belong where; all shape (n,), each sample in exactly one."""

    moving: Bools
    reversal: Bools
    rest: Bools


def phases(speed_rad_s: npt.NDArray[np.float64], step_s: float = 1e-3) -> Phases:
    """Split by rotor speed (n,), without its sensor's noise.

    Reversal: from 20 ms before the rotor is slower than :data:`MOVING_RAD_S` to 60 ms after it is
    faster the other way, where that takes at most :data:`TURN_WITHIN_S`. Rest: all else that is
    slow.
    """
    fast = np.abs(speed_rad_s) > MOVING_RAD_S
    places = np.flatnonzero(fast)
    turning = np.zeros(len(speed_rad_s), dtype=np.bool_)
    signs = np.sign(speed_rad_s[places])
    near = np.diff(places) <= TURN_WITHIN_S / step_s
    for k in np.flatnonzero((signs[1:] != signs[:-1]) & near):
        since = max(0, places[k] - round(_BEFORE_S / step_s))
        turning[since : places[k + 1] + round(_AFTER_S / step_s)] = True
    return Phases(fast & ~turning, turning, ~fast & ~turning)
