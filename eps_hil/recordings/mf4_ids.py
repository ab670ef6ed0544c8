"""Whether a frame of MF4 bus logging is extended, where its group has no IDE channel.

Then bit 31 of the id says so, as in asammdf; an id beyond 11 bits is extended whatever that bit
says. python-can by itself takes every frame of such a group as extended.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.bus.frame import STANDARD_ID_MAX
from eps_hil.recordings.candump import ID_MASK

_BIT = 0x8000_0000
_KINDS = ("CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame")


def extended(samples: npt.NDArray[Any], kind: str) -> npt.NDArray[np.bool_]:
    """Of the records of one group of ``kind`` (``CAN_DataFrame``)."""
    if f"{kind}.IDE" in (samples.dtype.names or ()):
        return np.asarray(samples[f"{kind}.IDE"], dtype=np.bool_)
    ids = np.asarray(samples[f"{kind}.ID"], dtype=np.int64)
    return (ids & _BIT != 0) | (ids & ID_MASK > STANDARD_ID_MAX)


def tell_format(reader: Any) -> Any:
    """python-can's ``MF4Reader``, which now reads :func:`extended` where IDE is missing."""
    for kind in _KINDS:
        name = f"_{kind.replace('_', '')}Iterator"
        usual = getattr(reader, name)

        def get(self: Any, offset: int, usual: Any = usual, kind: str = kind) -> Any:
            found = usual._get_data(self, offset)
            found.samples = _with_ide(found.samples, kind)
            return found

        setattr(reader, name, type(name, (usual,), {"_get_data": get}))
    return reader


def _with_ide(samples: npt.NDArray[Any], kind: str) -> npt.NDArray[Any]:
    names = samples.dtype.names or ()
    if f"{kind}.IDE" in names or f"{kind}.ID" not in names:
        return samples
    kinds = [(name, samples.dtype[name]) for name in names]
    more = np.empty(len(samples), np.dtype([*kinds, (f"{kind}.IDE", np.uint8)]))
    for name in names:
        more[name] = samples[name]
    more[f"{kind}.IDE"] = extended(samples, kind)
    return more
