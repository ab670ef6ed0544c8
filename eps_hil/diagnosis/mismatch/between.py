"""What is left differs between recordings by a constant, which no law of the motion can be.

A load, a pose, a temperature or an offset that was another one in each recording leaves its mean
there: a torque (the same in both directions) or a level of friction (against the motion). Less
than the noise in the balance, it is what a free run adds up.
"""

from collections.abc import Mapping, Sequence
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
_ONE_WAY = 0.1
"""Share of the samples that turn the other way, from which a recording shows both."""
LEAST_SHARE, _LEAST_OF_TORQUE = 0.25, 0.05
"""Of the energy that is left, or of the reported torque's rms: a difference worth a sentence."""


@dataclass(frozen=True)
class _Means:
    """Of one recording's residual while sliding, Nm: ``values`` by kind, their error, samples, and
    energies of the residual and of the reported torque.
    """

    name: str
    values: Mapping[str, float]
    error: float
    samples: int
    energy: float
    torque: float


_KINDS = {
    "constant": "a constant torque that differs between recordings",
    "level": "a level of friction that differs between recordings",
    "up": "a constant, or a level of friction, that differs between recordings with speed > 0",
    "down": "a constant, or a level of friction, that differs between recordings with speed < 0",
}
"""Of recordings that turn both ways, and of those that turn one way: there both look the same."""


def between_recordings(recordings: Sequence[Prepared], model: Model) -> list[str]:
    """What is said of constants that differ between recordings; nothing of what hardly does."""
    means = [one for one in (_means(each, model) for each in recordings) if one is not None]
    total = max(sum(one.energy for one in means), 1e-300)
    usual_nm = np.sqrt(sum(one.torque for one in means) / max(sum(one.samples for one in means), 1))
    told = []
    for kind, text in _KINDS.items():
        these = [one for one in means if kind in one.values]
        if len(these) < 2:
            continue
        values = np.array([one.values[kind] for one in these])
        weight = np.array([one.samples for one in these], dtype=np.float64)
        usual = float(np.sum(values * weight) / np.sum(weight))
        share = float(np.sum(weight * (values - usual) ** 2)) / total
        low, high = these[int(np.argmin(values))], these[int(np.argmax(values))]
        apart = float(np.ptp(values))
        if apart <= _CLEAR * float(np.hypot(low.error, high.error)):
            continue
        ends = ", ".join(f"{one.values[kind] - usual:+.2g} Nm in {one.name}" for one in (low, high))
        if share > LEAST_SHARE:
            much = f"{100 * share:.0f} % of the residual's energy"
        elif apart > _LEAST_OF_TORQUE * usual_nm:
            much = "Little of the residual, but adding up in a free run,"
        else:
            continue
        told.append(
            f"{much} is {text} ({ends}, of their mean): no law of the motion is that; a load, a "
            "pose, a temperature or an offset was another one."
        )
    return told


def _means(one: Prepared, model: Model) -> _Means | None:
    """None where hardly anything was recorded."""
    use = sliding(one, model)
    if one.barred is not None:
        use &= ~one.barred
    left = one.left_over(model)[use]
    at = np.searchsorted(one.time_s, one.thin_time_s[use])
    ahead = one.motion(model).speed_rad_s[np.minimum(at, len(one.time_s) - 1)] > 0.0
    block = ((one.thin_time_s[use] - one.thin_time_s[0]) // BLOCK_S).astype(np.int64)
    if len(np.unique(block)) < _LEAST_BLOCKS:
        return None
    share = float(np.mean(ahead))
    if min(share, 1.0 - share) >= _ONE_WAY:
        up, down = float(np.mean(left[ahead])), float(np.mean(left[~ahead]))
        rest = left - np.where(ahead, up, down)
        values = {"constant": 0.5 * (up + down), "level": 0.5 * (up - down)}
    else:
        way = ahead if share > 0.5 else ~ahead
        left, block = left[way], block[way]
        usual = float(np.mean(left))
        rest = left - usual
        values = {"up" if share > 0.5 else "down": usual}
    sums, n = np.bincount(block, rest), np.bincount(block)
    error = float(np.sqrt(np.sum(sums[n > 0] ** 2))) / len(left)
    torque = np.interp(one.thin_time_s, one.time_s, one.raw["motor_torque_nm"])[use]
    energies = (float(np.sum(left**2)), len(left) * float(np.mean(torque**2)))
    return _Means(one.name, values, error, len(left), *energies)
