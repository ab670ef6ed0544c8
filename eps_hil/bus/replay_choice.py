"""Which frames of a log a replay plays, what it leaves out, and whether somebody else is talking.

Two rules that no option turns off: commands stay out (``bus/commands.py``), and an id that a live
sender uses is not talked over. A receiver cannot tell the two apart, and a rig that gets torque and
position from two sources at once moves by neither.
"""

import time
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

from eps_hil.bus.commands import OWN, Commands
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port
from eps_hil.errors import BusError, InputError

SCAN_FRAMES = 100_000
_LISTEN_ON_S = 1.0
_LOOK_NS = 20_000_000

Key = tuple[int, bool]
"""(id, whether it has 29 bits)."""


class Choice:
    """The frames that are played, one after the other; counts the others.

    ``ids``: only these (None: all); ``without``: not these; ``commands``: never these.
    """

    def __init__(
        self,
        ids: Collection[int] | None = None,
        without: Collection[int] = (),
        commands: Commands = OWN,
    ) -> None:
        self._ids = None if ids is None else frozenset(ids)
        self._without, self._commands = frozenset(without), commands
        self.skipped = 0
        """Error frames, and ids that were not asked for."""
        self.commands: Counter[int] = Counter()
        """Frames left out by the id of their command."""

    def __call__(self, frame: Frame) -> bool:
        """Whether this frame is played."""
        if not frame.error and frame.can_id in self._commands:
            self.commands[frame.can_id] += 1
            return False
        asked = self._ids is None or frame.can_id in self._ids
        played = asked and not frame.error and frame.can_id not in self._without
        self.skipped += not played
        return played

    def left_out(self) -> str:
        """``0x80 EPSHIL_TorqueOverride (commands a torque) 14961 x``, or nothing."""
        return ", ".join(f"{self._commands[i]} {n} x" for i, n in sorted(self.commands.items()))


@dataclass(frozen=True, slots=True)
class Scan:
    """The first frames of what will be played: ``keys`` of what goes out, and what stays out."""

    frames: int
    keys: frozenset[Key]
    choice: Choice
    whole: bool


def scan(frames: Iterable[Frame], choice: Choice, limit: int = SCAN_FRAMES) -> Scan:
    """Look through at most ``limit`` frames; a cyclic message shows within the first seconds."""
    keys: set[Key] = set()
    count = 0
    for count, frame in enumerate(frames, 1):
        if choice(frame):
            keys.add((frame.can_id, frame.extended))
        if count == limit:
            break
    return Scan(count, frozenset(keys), choice, count < limit)


class LiveSenders:
    """Hears who else is on the bus and ends a replay that would talk over somebody.

    A port does not deliver what it sends itself, so whatever arrives is somebody else's.
    """

    def __init__(self, port: Port, ours: Collection[Key]) -> None:
        self._port = port
        self._ours = set(ours)
        self._heard: set[Key] = set()
        self._next_ns = 0

    def listen(self, listen_s: float) -> None:
        """Before the first frame, also to what came since the port was opened;
        :class:`BusError` names the ids that are taken."""
        until_s = time.monotonic() + max(listen_s, 0.0)
        while True:
            left_s = until_s - time.monotonic()
            frames = self._port.recv(max(left_s, 0.0))
            self._hear(frames)
            if left_s <= 0.0 and (not frames or left_s < -_LISTEN_ON_S):
                break
        self._refuse(self._heard & self._ours, "are sent by somebody else already")

    def look(self) -> None:
        """While playing: whoever began to send meanwhile; at most every 20 ms a look."""
        now_ns = time.monotonic_ns()
        if now_ns >= self._next_ns:
            self._next_ns = now_ns + _LOOK_NS
            self._hear(self._port.recv(0.0))
            self._refuse(self._heard & self._ours, "are now sent by somebody else too")

    def sending(self, frame: Frame) -> None:
        """Asked before each frame: an id that the first frames of the log did not have."""
        key = (frame.can_id, frame.extended)
        if key not in self._ours:
            self._ours.add(key)
            self._refuse(self._heard & {key}, "are sent by somebody else")

    def _hear(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            if not (frame.own or frame.error or frame.remote):
                self._heard.add((frame.can_id, frame.extended))

    def _refuse(self, taken: Collection[Key], words: str) -> None:
        if taken:
            ids = ",".join(f"0x{can_id:X}" for can_id, _ in sorted(taken))
            raise BusError(
                f"{self._port.name}: the ids {ids} {words}; nothing is talked over: "
                f"end that sender, or leave them out with --without {ids}"
            )


def refuse_asked(ids: Collection[int], commands: Commands) -> None:
    """:class:`InputError` where ``--ids`` asks for a command."""
    for can_id in sorted(set(ids) & set(commands)):
        raise InputError(
            "--ids", f"{commands[can_id]}", "is never replayed as a frame",
            "a torque goes through the guard: --commands with --config; set-points of a rig are "
            "sent by eps-hil programme",
        )  # fmt: skip


def between(
    frames: Iterator[tuple[int, Frame]], from_s: float, to_s: float | None, slack_s: float = 1.0
) -> Iterator[Frame]:
    """Frames whose time in the log (ns since its first) lies in [from, to); channels of one log
    interleave, so the end is looked for ``slack_s`` further on."""
    from_ns = round(from_s * 1e9)
    to_ns = None if to_s is None else round(to_s * 1e9)
    for offset_ns, frame in frames:
        if to_ns is not None and offset_ns >= to_ns + slack_s * 1e9:
            return
        if offset_ns >= from_ns and (to_ns is None or offset_ns < to_ns):
            yield frame
