"""The data frames of a whole log as columns, for decoding at once instead of frame by frame."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

EXTENDED = 1 << 32
"""In a key: the id has 29 bits."""


def key_of(can_id: int, extended: bool) -> int:
    """Id and format in one number."""
    return can_id | EXTENDED if extended else can_id


@dataclass(frozen=True, slots=True)
class FrameColumns:
    """Data frames ordered by stamp, of equal stamps as in the file; no error or remote frames.

    ``t_ns`` (n,); ``key`` (n,) as of :func:`key_of`; ``length`` (n,) bytes; ``data`` (n, widest)
    payloads, zeros behind their end.
    """

    t_ns: npt.NDArray[np.int64]
    key: npt.NDArray[np.int64]
    length: npt.NDArray[np.int64]
    data: npt.NDArray[np.uint8]
