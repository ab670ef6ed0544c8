"""What is left differs between recordings by a constant, which no law of the motion can be.

A load, a pose, a temperature or an offset that was another one in each recording leaves its mean
there: a torque (the same in both directions) or a level of friction (against the motion).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.problem import BLOCK_S, sliding
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

_LEAST_BLOCKS = 4
_CLEAR = 4.0
"""Standard errors, over blocks in time, by which two recordings have to differ."""
LEAST_SHARE = 0.25
"""Of the energy that is left: a difference that is worth a sentence."""


@dataclass(frozen=True)
class _Means:
    """Of one recording's residual while sliding: constant and level (Nm), errors, samples."""

    name: str
    constant: float
    level: float
    error: float
    samples: int
    energy: float


def between_recordings(recordings: Sequence[Prepared], model: Model) -> list[str]:
    """What is said of constants that differ between recordings; nothing of what hardly does."""
    means = [one for one in (_means(each, model) for each in recordings) if one is not None]
    if len(means) < 2:
        return []
    total = sum(one.energy for one in means)
    told = []
    for name, text in (
        ("constant", "a constant torque that differs between recordings"),
        ("level", "a level of friction that differs between recordings"),
    ):
        values = np.array([getattr(one, name) for one in means])
        weight = np.array([one.samples for one in means], dtype=np.float64)
        usual = float(np.sum(values * weight) / np.sum(weight))
        share = float(np.sum(weight * (values - usual) ** 2)) / max(total, 1e-300)
        low, high = means[int(np.argmin(values))], means[int(np.argmax(values))]
        clear = float(np.ptp(values)) > _CLEAR * float(np.hypot(low.error, high.error))
        if clear and share > LEAST_SHARE:
            ends = ", ".join(f"{getattr(one, name):+.3g} Nm in {one.name}" for one in (low, high))
            told.append(
                f"{100 * share:.0f} % of what is left is {text} ({ends}): no law of the motion is "
                "that; a load, a pose, a temperature or an offset was another one."
            )
    return told


def _means(one: Prepared, model: Model) -> _Means | None:
    """None where one direction, or hardly anything, was recorded."""
    use = sliding(one, model)
    if one.barred is not None:
        use &= ~one.barred
    left = one.left_over(model)[use]
    at = np.searchsorted(one.time_s, one.thin_time_s[use])
    way = np.sign(one.motion(model).speed_rad_s[np.minimum(at, len(one.time_s) - 1)])
    block = ((one.thin_time_s[use] - one.thin_time_s[0]) // BLOCK_S).astype(np.int64)
    if len(np.unique(block)) < _LEAST_BLOCKS or min(np.sum(way > 0), np.sum(way < 0)) < 0.1 * len(
        way
    ):
        return None
    up, down = float(np.mean(left[way > 0])), float(np.mean(left[way < 0]))
    rest = left - np.where(way > 0, up, down)
    sums, n = np.bincount(block, rest), np.bincount(block)
    error = float(np.sqrt(np.sum(sums[n > 0] ** 2))) / len(left)
    return _Means(
        one.name, 0.5 * (up + down), 0.5 * (up - down), error, len(left), float(np.sum(left**2))
    )
