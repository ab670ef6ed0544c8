"""One signal over time: what readers produce and estimators consume."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class Series:
    """One signal: stamps (int64 nanoseconds, strictly increasing) and values, both shape (n,).

    A NaN value is a sample known to be bad; a missing sample is simply not there.
    """

    t_ns: npt.NDArray[np.int64]
    value: npt.NDArray[np.float64]


class Arrivals(NamedTuple):
    """Of each frame of the sync message, all (n,): its stamp, and the instant of its samples.

    ``moved_ns``: by how much such instants had moved against the sender's counter until then.
    """

    receive_ns: npt.NDArray[np.int64]
    sample_ns: npt.NDArray[np.int64]
    moved_ns: npt.NDArray[np.int64]
