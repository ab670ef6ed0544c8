"""Numbers of buses in formats that have no names for them: BLF, ASC and MF4."""

import itertools

_MOST = 255


class ChannelNumbers:
    """A number for each name that a log gives a bus; no two names have the same one."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def number(self, name: str) -> int:
        """From 1: that of the name (``3`` is 3, ``can0`` is 1), else the first free one.

        Vendors number from 1 what Linux counts from 0.
        """
        known = self._numbers.get(name)
        if known is not None:
            return known
        digits = "".join(itertools.takewhile(str.isdigit, reversed(name)))[::-1]
        wanted = min(int(digits), _MOST - 1) + (not name.isdigit()) if digits else 1
        taken = {0, *self._numbers.values()}
        number = next(k for k in itertools.chain([wanted], itertools.count(1)) if k not in taken)
        self._numbers[name] = number
        return number

    def interface(self, name: str) -> str:
        """The name for a candump log: ``can0`` for a bus that has only the number 1."""
        return f"can{self.number(name) - 1}" if name.isdigit() else name

    def told(self) -> str:
        """Which number is which name."""
        return ", ".join(f"bus channel {k}: {name}" for name, k in self._numbers.items())

    def notes(self) -> tuple[str, ...]:
        """The same as a note, where a number is not what anybody would expect."""
        plain = all(name in (str(k), f"can{k - 1}") for name, k in self._numbers.items())
        return () if plain else (self.told(),)
