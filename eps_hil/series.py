"""One signal over time: what readers produce and estimators consume."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

_STEPS = 1 << 22
"""Steps whose median is taken: all of an hour at 1 kHz, and no copy of a night's stamps."""


@dataclass(frozen=True, slots=True)
class Series:
    """One signal: stamps (int64 nanoseconds, strictly increasing) and values, both shape (n,).

    A NaN value is a sample known to be bad; a missing sample is simply not there.
    """

    t_ns: npt.NDArray[np.int64]
    value: npt.NDArray[np.float64]

    def __post_init__(self) -> None:
        """``ValueError`` for shapes that compiled code would read past the end of."""
        if self.t_ns.ndim != 1 or self.t_ns.shape != self.value.shape:
            shapes = f"{self.t_ns.shape} stamps and {self.value.shape} values"
            raise ValueError(f"a signal needs as many values as stamps, (n,), not {shapes}")


def usual_step_ns(t_ns: npt.NDArray[np.int64]) -> float:
    """Median step between two stamps or more; of a very long signal, of steps spread over it."""
    steps = len(t_ns) - 1
    if steps <= _STEPS:
        return float(np.median(np.diff(t_ns)))
    at = np.arange(_STEPS) * steps // _STEPS
    return float(np.median(t_ns[at + 1] - t_ns[at]))


class Arrivals(NamedTuple):
    """Of each frame of the sync message, all (n,): its stamp, and the instant of its samples.

    ``moved_ns``: by how much such instants had moved against the sender's counter until then.
    """

    receive_ns: npt.NDArray[np.int64]
    sample_ns: npt.NDArray[np.int64]
    moved_ns: npt.NDArray[np.int64]


class Pace(NamedTuple):
    """What a log's mapping says of the estimator's timing, where it says something; seconds.

    ``speed_window_s``: over which a speed is derived from the angle; ``cycle_s``: of the message
    that the estimator steps on.
    """

    speed_window_s: float | None = None
    cycle_s: float | None = None
