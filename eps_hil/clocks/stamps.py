"""The receive stamps of a CAN log by channel and message, in the order of the file."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.recordings.can_log import read_unordered_frames

Stamps = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Message:
    """Stamps (n,) in ns of one CAN id on one channel, and its payloads in the same order.

    ``frame`` (n,): which frames of the channel they are, in the order of the file.
    """

    channel: str
    can_id: int
    extended: bool
    t_ns: Stamps
    data: tuple[bytes, ...]
    frame: Stamps

    @property
    def name(self) -> str:
        """``0x101`` as a candump shows it."""
        return f"0x{self.can_id:X}"


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
    stamps: dict[str, list[int]] = {}
    by_id: dict[tuple[str, int, bool], tuple[list[int], list[bytes]]] = {}
    for channel, frame in read_unordered_frames(path, on_progress):
        all_of = stamps.setdefault(channel, [])
        all_of.append(frame.t_ns)
        if frame.error or frame.remote:
            continue
        places, payloads = by_id.setdefault((channel, frame.can_id, frame.extended), ([], []))
        places.append(len(all_of) - 1)
        payloads.append(frame.data)
    if not stamps:
        raise InputError(path, "", "holds no CAN frame", "check that it is a CAN log")
    return tuple(
        _channel(name, np.array(all_ns, dtype=np.int64), by_id) for name, all_ns in stamps.items()
    )


def _channel(
    name: str,
    t_ns: Stamps,
    by_id: dict[tuple[str, int, bool], tuple[list[int], list[bytes]]],
) -> Channel:
    messages = []
    for (on, can_id, extended), (places, payloads) in sorted(by_id.items()):
        if on == name:
            frame = np.array(places, dtype=np.int64)
            messages.append(Message(name, can_id, extended, t_ns[frame], tuple(payloads), frame))
    return Channel(name, t_ns, tuple(messages))
