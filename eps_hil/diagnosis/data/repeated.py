"""Whether hold-outs only repeat the programme that was fitted.

Then every place is passed at the same speeds again, and a map over two signals, which learns the
programme, is confirmed by it as well as physics would be.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.prepare import Prepared

Floats = npt.NDArray[np.float64]

ALIKE = 0.99
"""Correlation of a hold-out's speed with a stretch of what was fitted: 2 % of its energy differ."""


def repeated(fitted: Sequence[Prepared], kept: Sequence[Prepared]) -> bool:
    """Whether each of the recordings ``kept`` runs as some stretch of the ``fitted`` ones does."""
    return all(any(_alike(_speed(one), _speed(other)) for other in fitted) for one in kept)


def _speed(one: Prepared) -> Floats:
    return one.thin(one.raw["motor_speed_rad_s"])


def _alike(short: Floats, long: Floats) -> bool:
    """Highest correlation over all shifts that leave no more than a tenth of ``short`` outside."""
    n, spare = len(short), len(short) // 10
    long = np.concatenate([np.zeros(spare), long, np.zeros(spare)])
    if n < 2 or len(long) < n:
        return False
    size = 1 << (len(long) + n).bit_length()
    spectrum = np.fft.rfft(long, size) * np.conj(np.fft.rfft(short, size))
    cross = np.fft.irfft(spectrum, size)[: len(long) - n + 1]
    sums = np.concatenate([[0.0], np.cumsum(long**2)])
    energy = (sums[n:] - sums[:-n]) * float(np.sum(short**2))
    return bool(np.max(cross / np.sqrt(np.maximum(energy, 1e-300))) > ALIKE)
