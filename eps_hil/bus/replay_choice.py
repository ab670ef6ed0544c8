"""Which frames of a log a replay plays, and what it leaves out.

No option plays commands (``bus/commands.py``) or talks over a live sender (``live_senders.py``).
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

from eps_hil.bus.commands import OWN, Commands
from eps_hil.bus.frame import Frame
from eps_hil.bus.live_senders import Key
from eps_hil.errors import InputError

SCAN_FRAMES = 100_000


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
