"""What a recording holds and what it lacks, per channel and message id: figures of its sidecar."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from eps_hil.bus.frame import Frame

Key = tuple[int, bool]


@dataclass(frozen=True, slots=True)
class CounterField:
    """Where a message carries its counter (little-endian): what is missing shows by its gaps.

    ``modulo``: after how many values it begins again; 0: after all that its bits have.
    """

    start: int
    length: int
    modulo: int = 0

    def read(self, data: bytes) -> int | None:
        """The counter; None where the frame is too short for it."""
        if len(data) * 8 < self.start + self.length:
            return None
        return int.from_bytes(data, "little") >> self.start & (1 << self.length) - 1


@dataclass(slots=True)
class IdCounts:
    """One message id on one channel."""

    frames: int = 0
    lost: int = 0
    repeated: int = 0
    counter: int | None = None

    def take(self, value: int | None, modulo: int) -> None:
        """One more frame, with its counter if it has one.

        More than a whole round of the counter missing at once counts short by whole rounds.
        """
        self.frames += 1
        if value is None:
            return
        if self.counter is not None:
            step = (value - self.counter) % modulo
            self.repeated += step == 0
            self.lost += max(step - 1, 0)
        self.counter = value


@dataclass(slots=True)
class ChannelCounts:
    """One channel: frames in the file, by id; error frames; and what never got there."""

    frames: int = 0
    error_frames: int = 0
    lost_on_full_disk: int = 0
    ids: dict[Key, IdCounts] = field(default_factory=dict)


class Counts:
    """Counts of one part of a recording; ``counters`` by (id, extended)."""

    def __init__(self, channels: int, counters: Mapping[Key, CounterField]) -> None:
        self.channels = [ChannelCounts() for _ in range(channels)]
        self._counters = counters

    @property
    def frames(self) -> int:
        """In this part, of all channels."""
        return sum(channel.frames for channel in self.channels)

    def take(self, channel: int, frames: Sequence[Frame]) -> None:
        """Frames that were written."""
        counts = self.channels[channel]
        counts.frames += len(frames)
        for frame in frames:
            if frame.error:
                counts.error_frames += 1
                continue
            key = (frame.can_id, frame.extended)
            one = counts.ids.get(key)
            if one is None:
                one = counts.ids[key] = IdCounts()
            place = self._counters.get(key)
            if place is None:
                one.frames += 1
            else:
                one.take(place.read(frame.data), place.modulo or 1 << place.length)

    def told(self, channel: int) -> dict[str, Any]:
        """As the sidecar says it."""
        counts = self.channels[channel]
        ids = {
            f"0x{can_id:X}{'x' if extended else ''}": {
                "frames": one.frames,
                **(
                    {"lost_by_counter": one.lost, "repeated": one.repeated}
                    if (can_id, extended) in self._counters
                    else {}
                ),
            }
            for (can_id, extended), one in sorted(counts.ids.items())
        }
        return {
            "frames": counts.frames,
            "error_frames": counts.error_frames,
            "lost_on_full_disk": counts.lost_on_full_disk,
            "ids": ids,
        }


def counters_of(database: Any) -> dict[Key, CounterField]:
    """Little-endian counters of a cantools database, by the marks of its signals."""
    from eps_hil.bus.codec import rules_of

    found = {}
    for message in database.messages:
        rules = rules_of(message)
        name = rules.counter
        signal = next((one for one in message.signals if one.name == name), None)
        if signal is not None and signal.byte_order == "little_endian":
            key = (int(message.frame_id), bool(message.is_extended_frame))
            found[key] = CounterField(
                int(signal.start), int(signal.length), rules.counter_values(signal)
            )
    return found
