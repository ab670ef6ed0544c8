"""Columns of pyarrow as arrays of numpy.

Not by pyarrow's own ``to_numpy``: where pandas is installed it loads that, 40 MB and a wait.
"""

from typing import Any

import numpy as np
import numpy.typing as npt


def numbers(column: Any, out: npt.NDArray[Any] | None = None) -> npt.NDArray[Any]:
    """A copy of a column of numbers (n,), into ``out`` if given; a null of floats is NaN."""
    chunks = [one.fill_null(np.nan) if one.null_count else one for one in column.chunks]
    if not chunks:
        return np.zeros(0) if out is None else out
    return np.concatenate([np.from_dlpack(one) for one in chunks], out=out)
