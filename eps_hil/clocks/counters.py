"""Counters in payloads, found without a database: they tell lost frames from a clock's step."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.clocks.payloads import Payloads

Integers = npt.NDArray[np.int64]

FEWEST = 32
_BY_ONE = 0.8
"""Share of frames that count one more than the one before; the others are losses and restarts."""
_CARRIED = 0.98
_SMALLEST = 4
_MOST_BYTES = 4
_LOOKED_AT = 20_000


@dataclass(frozen=True, slots=True)
class Counter:
    """Values (n,) that count frames, modulo ``modulus``."""

    values: Integers
    modulus: int

    def lost_between(self, before: int, after: int) -> int:
        """Frames that were sent between two of the log, modulo ``modulus``."""
        return int((self.values[after] - self.values[before] - 1) % self.modulus)


def find_counter(data: Payloads) -> Counter | None:
    """The widest counter in a message's payloads; None where there is none."""
    content = data.rows()
    if content is None or len(content) < FEWEST:
        return None
    some = content[:_LOOKED_AT].astype(np.int64)
    for place in range(content.shape[1]):
        for shift, mask in ((0, 255), (0, 15), (4, 15)):
            values = (some[:, place] >> shift) & mask
            modulus = int(np.max(values)) + 1
            if modulus >= _SMALLEST and _counts(values, modulus):
                if modulus == 256:
                    return _widened(content, some, place)
                return Counter(((content[:, place] >> shift) & mask).astype(np.int64), modulus)
    return None


def _counts(values: Integers, modulus: int) -> bool:
    return float(np.mean(np.diff(values) % modulus == 1)) > _BY_ONE


def _widened(content: npt.NDArray[np.uint8], some: Integers, place: int) -> Counter:
    """With the bytes that take the carry, on the side on which there are some."""
    for side in (-1, 1):
        values, modulus, at = some[:, place], 256, place + side
        whole = content[:, place].astype(np.int64)
        while 0 <= at < content.shape[1] and modulus < 256**_MOST_BYTES:
            one_more = np.diff(values) % modulus == 1
            carry = (values[1:] == 0)[one_more]
            moved = (np.diff(some[:, at]) % 256)[one_more]
            if not np.any(carry) or np.mean(moved[carry] == 1) < _CARRIED or np.any(moved[~carry]):
                break
            values = values + modulus * some[:, at]
            whole += modulus * content[:, at].astype(np.int64)
            modulus, at = modulus * 256, at + side
        if modulus > 256:
            return Counter(whole, modulus)
    return Counter(content[:, place].astype(np.int64), 256)
