"""Numbers and payloads of very many frames without an object for each of them."""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from eps_hil.growing import Growing, blocks

Bytes = npt.NDArray[np.uint8]
Integers = npt.NDArray[np.int64]

_CHUNK = 512


class Payloads:
    """Payloads of one message's frames, one behind the other; ``length`` (n,) is at most 64."""

    def __init__(self, content: Bytes, length: Bytes) -> None:
        self._content, self._length = content, length

    @classmethod
    def of(cls, payloads: Sequence[bytes]) -> "Payloads":
        """The same that are held one by one."""
        gathered = GatheredPayloads()
        for one in payloads:
            gathered.add(one)
        return gathered.whole()

    def __len__(self) -> int:
        return len(self._length)

    def rows(self) -> Bytes | None:
        """As (n, length); None where their lengths differ."""
        if not len(self) or int(self._length.min()) != int(self._length.max()):
            return None
        return self._content.reshape(len(self), int(self._length[0]))

    def hashes(self) -> Integers:
        """A hash (n,) of each; the same payload has the same one, of any message."""
        return np.fromiter(map(hash, self._each()), np.int64, len(self))

    def _each(self) -> Iterator[bytes]:
        begin = 0
        for some in blocks(len(self)):
            for length in self._length[some].tolist():
                yield self._content[begin : begin + length].tobytes()
                begin += length


class GatheredPayloads:
    """Payloads as they come."""

    def __init__(self) -> None:
        self._content, self._length = Growing(np.uint8), Growing(np.uint8)
        self._last: list[bytes] = []

    def add(self, payload: bytes) -> None:
        """The next one."""
        self._last.append(payload)
        if len(self._last) == _CHUNK:
            self._put()

    def whole(self) -> Payloads:
        """All of them; nothing can be added then."""
        self._put()
        return Payloads(self._content.whole(), self._length.whole())

    def _put(self) -> None:
        self._content.add(np.frombuffer(b"".join(self._last), np.uint8))
        self._length.add(np.array([len(one) for one in self._last], np.uint8))
        self._last.clear()


class GatheredIntegers:
    """Whole numbers as they come."""

    def __init__(self) -> None:
        self._numbers = Growing(np.int64)
        self._last: list[int] = []

    def __len__(self) -> int:
        return len(self._numbers) + len(self._last)

    def add(self, number: int) -> None:
        """The next one."""
        self._last.append(number)
        if len(self._last) == _CHUNK:
            self._put()

    def whole(self) -> Integers:
        """All of them, (n,); nothing can be added then."""
        self._put()
        return self._numbers.whole()

    def _put(self) -> None:
        self._numbers.add(np.array(self._last, np.int64))
        self._last.clear()
