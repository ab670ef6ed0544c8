"""AUTOSAR E2E protection of a frame that we send, by the package ``autosar-e2e``.

Only for ECUs that check a whole profile (header layout, counter that skips a value, data id
lists); messages whose database names counter and CRC signals are served by
:mod:`eps_hil.bus.protection`. The package is compiled from the AUTOSAR specification's profiles and
counts on from the counter that it finds in the payload, so the last one is put there.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, with_config

from eps_hil.errors import EpsHilError, InputError

_COUNTER = {"p01": (1, 0x0F), "p02": (1, 0x0F), "p05": (2, 0xFF), "p11": (1, 0x0F)}
"""Byte of the header that holds the counter, and the counter's bits in it."""
_DATA_ID_LIST = 16


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class E2eProfile:
    """Profile 1, 2, 5 or 11, as fits a frame of 8 bytes.

    ``data_id``: 16 bits (for p02 the list of 16 bytes goes into ``data_id_list``); ``offset``:
    byte at which the header stands (p01, p05, p11).
    """

    profile: Literal["p01", "p02", "p05", "p11"]
    data_id: Annotated[int, Field(ge=0, le=0xFFFF)] = 0
    data_id_list: tuple[Annotated[int, Field(ge=0, le=0xFF)], ...] | None = None
    offset: Annotated[int, Field(ge=0, le=62)] = 0

    def __post_init__(self) -> None:
        if (self.profile == "p02") != (self.data_id_list is not None):
            raise ValueError("data_id_list belongs to profile p02, which needs it")
        if self.data_id_list is not None and len(self.data_id_list) != _DATA_ID_LIST:
            raise ValueError("data_id_list needs 16 numbers")
        if self.profile == "p02" and self.offset:
            raise ValueError("profile p02 stands at the beginning of the frame")


def check(file: object) -> None:
    """Refuse, before any work, the configuration ``file`` with a profile that nothing computes."""
    if importlib.util.find_spec("e2e") is None:
        problem = "an AUTOSAR profile needs the 'e2e' extra"
        raise InputError(file, "override.e2e", problem, 'pip install "eps_hil[e2e]"')


class E2eProtector:
    """Protects one message of ``length`` bytes.

    :class:`EpsHilError` if the header does not fit; :func:`check` asks for the package.
    """

    def __init__(self, rule: E2eProfile, length: int) -> None:
        self._rule = rule
        self._protect = _function(rule, "protect")
        self._check = _function(rule, "check")
        place, self._mask = _COUNTER[rule.profile]
        self._place = rule.offset + place
        if self._place >= length:
            raise EpsHilError(f"override.e2e: the header does not fit into {length} bytes")
        self._counter = 0

    def protect(self, data: bytes) -> bytes:
        """The payload with CRC and the next counter, whatever ``data`` has in their place."""
        fresh = bytearray(data)
        fresh[self._place] = fresh[self._place] & ~self._mask & 0xFF | self._counter
        self._protect(fresh, self._identity(), **self._where())
        self._counter = fresh[self._place] & self._mask
        return bytes(fresh)

    def good(self, data: bytes) -> bool:
        """Whether a payload carries a header that fits (the counter's step is not judged)."""
        return bool(self._check(bytearray(data), self._identity(), **self._where()))

    def _identity(self) -> int | bytes:
        listed = self._rule.data_id_list
        return self._rule.data_id if listed is None else bytes(listed)

    def _where(self) -> dict[str, int]:
        return {} if self._rule.profile == "p02" else {"offset": self._rule.offset}


def _function(rule: E2eProfile, what: str) -> Callable[..., Any]:
    module = importlib.import_module(f"e2e.{rule.profile}")
    found: Callable[..., Any] = getattr(module, f"e2e_{rule.profile}_{what}")
    return found
