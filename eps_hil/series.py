"""One signal over time: what readers produce and estimators consume."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class Series:
    """One signal: stamps (int64 nanoseconds, strictly increasing) and values, both shape (n,).

    A NaN value is a sample known to be bad; a missing sample is simply not there.
    """

    t_ns: npt.NDArray[np.int64]
    value: npt.NDArray[np.float64]
