"""The lines of an ASC log, with a head that python-can's reader cannot misread.

That reader ends the head at the first line that it does not know (a date of another country, a
byte order mark), loses the base of the numbers with it, and the line after the head.
"""

import re
from pathlib import Path

from eps_hil.bus.text_lines import TextLines
from eps_hil.errors import InputError

_BASE = re.compile(r"base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
_EVENT = re.compile(r"\d+[.,]\d+\s")
_TEXT_BASES = {"hex": 16, "dec": 10}
_REQUEST = "TxRq"
_FRAME = re.compile(r"\d+\.\d+\s+(?:CANFD\s+)?\d+\s+(?P<a>\S+)\s+(?P<b>\S+)")


class AscLines(TextLines):
    """The head said anew, then every line but requests to send, which come again as sent.

    :class:`InputError` for stamps relative to the event before, and for no base of the numbers.
    """

    def __init__(self, path: Path) -> None:
        self._base = _base_of(path)
        self._head = [f"base {self._base}  timestamps absolute\n", "no internal events logged\n"]
        self._last = ""
        self.requests = 0
        super().__init__(path)

    def __next__(self) -> str:  # type: ignore[override]  # as typeshed does itself
        if self._head:
            return self._head.pop(0)
        while _is_request(line := super().__next__()):
            self.requests += 1
        self._last = line
        return line

    def has_names(self) -> bool:
        """Whether the last line has a message's name where an id belongs."""
        found = _FRAME.match(self._last.strip())
        if found is None:
            return False
        one = found["b"] if found["a"] in ("Rx", "Tx") else found["a"]
        try:
            int(one.removesuffix("x").removesuffix("X"), _TEXT_BASES[self._base])
        except ValueError:
            return True
        return False


def _is_request(line: str) -> bool:
    if _REQUEST not in line:
        return False
    found = _FRAME.match(line.strip())
    return found is not None and _REQUEST in (found["a"], found["b"])


def _base_of(path: Path) -> str:
    """``hex`` or ``dec``, from the lines above the first event."""
    with TextLines(path) as lines:
        for line in lines:
            text = line.strip()
            if found := _BASE.match(text):
                if (found[2] or "").lower() == "relative":
                    problem = "time stamps are relative to the event before"
                    remedy = "export with absolute time stamps"
                    raise InputError(path, f"line {lines.line}", problem, remedy)
                return found[1].lower()
            if _EVENT.match(text):
                problem = "no line 'base hex' or 'base dec' stands before the first event"
                remedy = "export it again, with its head"
                raise InputError(path, f"line {lines.line}", problem, remedy)
    return "hex"  # there is no frame to read
