"""An array of numbers that grows at its end without a second copy of itself."""

from typing import Any

import numpy as np
import numpy.typing as npt

_ROOM = 4096


class Growing:
    """Numbers of one type, (n,); large ones are moved by the system's tables, not copied."""

    def __init__(self, kind: type[np.generic]) -> None:
        self._numbers = np.empty(_ROOM, kind)
        self._used = 0

    def add(self, more: npt.NDArray[Any]) -> None:
        """Put ``more`` (m,) at the end."""
        need = self._used + len(more)
        if need > len(self._numbers):
            self._numbers.resize(need + need // 8, refcheck=False)
        self._numbers[self._used : need] = more
        self._used = need

    def whole(self) -> npt.NDArray[Any]:
        """All of them; nothing can be added then."""
        self._numbers.resize(self._used, refcheck=False)
        return self._numbers
