"""The receive stamps of a CAN log by channel and message, in the order of the file."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.clocks.payloads import GatheredIntegers, GatheredPayloads, Payloads
from eps_hil.errors import InputError
from eps_hil.recordings.can_log import read_unordered_frames

Stamps = npt.NDArray[np.int64]
_Key = tuple[str, int, bool]


@dataclass(frozen=True, slots=True)
class Message:
    """Stamps (n,) in ns of one CAN id on one channel, and its payloads in the same order.

    ``frame`` (n,): which frames of the channel they are, in the order of the file.
    """

    channel: str
    can_id: int
    extended: bool
    t_ns: Stamps
    data: Payloads
    frame: Stamps

    @property
    def name(self) -> str:
        """``0x101``, or ``0x00000101`` of 29 bits, as a candump shows them."""
        return f"0x{self.can_id:08X}" if self.extended else f"0x{self.can_id:X}"


@dataclass(frozen=True, slots=True)
class Channel:
    """All frames of one channel: stamps (n,) in the order of the file."""

    name: str
    t_ns: Stamps
    messages: tuple[Message, ...]

    def with_stamps(self, t_ns: Stamps) -> "Channel":
        """The same frames with other stamps (n,), in the order of the file."""
        messages = tuple(replace(one, t_ns=t_ns[one.frame]) for one in self.messages)
        return replace(self, t_ns=t_ns, messages=messages)


def read_channels(
    path: str | Path, on_progress: Callable[[float], None] | None = None
) -> tuple[Channel, ...]:
    """The channels of a CAN log (LOG, BLF, ASC, TRC, MF4); :class:`InputError` for no frame."""
    stamps: dict[str, GatheredIntegers] = {}
    by_id: dict[_Key, tuple[GatheredIntegers, GatheredPayloads]] = {}
    for channel, frame in read_unordered_frames(path, on_progress):
        if channel not in stamps:
            stamps[channel] = GatheredIntegers()
        all_of = stamps[channel]
        all_of.add(frame.t_ns)
        if frame.error or frame.remote:
            continue
        key = (channel, frame.can_id, frame.extended)
        if key not in by_id:
            by_id[key] = GatheredIntegers(), GatheredPayloads()
        places, payloads = by_id[key]
        places.add(len(all_of) - 1)
        payloads.add(frame.data)
    if not stamps:
        raise InputError(path, "", "holds no CAN frame", "check that it is a CAN log")
    return tuple(_channel(name, all_ns.whole(), by_id) for name, all_ns in stamps.items())


def _channel(
    name: str, t_ns: Stamps, by_id: dict[_Key, tuple[GatheredIntegers, GatheredPayloads]]
) -> Channel:
    messages = []
    for key in sorted(by_id):
        if key[0] == name:
            places, payloads = by_id[key]
            frame = places.whole()
            messages.append(Message(*key, t_ns[frame], payloads.whole(), frame))
    return Channel(name, t_ns, tuple(messages))
