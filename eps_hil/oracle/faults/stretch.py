"""A stretch of bus traffic that faults are done to: what arrives when, and what befalls whom.

Times are true times in ns, which no clock of the stretch can move: a frame *arrives* at a true
time and carries a *stamp* of the service's wall clock, which a fault may set or let drift.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from eps_hil.bus.frame import Frame

MS = 1_000_000


class Item(NamedTuple):
    """A frame that reaches the service's socket at true time ``at``."""

    at: int
    frame: Frame


@dataclass(slots=True)
class Stretch:
    """Traffic from ``start`` to ``end`` and the list of what happens beside it."""

    start: int
    end: int
    items: list[Item]
    restarts: list[tuple[int, int]] = field(default_factory=list)
    """When no service ran; at the end of each a new one, which knows nothing, takes over."""
    stops: list[tuple[int, int]] = field(default_factory=list)
    """When the service's process did not run (SIGSTOP)."""
    deaf: list[tuple[int, int]] = field(default_factory=list)
    """When the service's frames did not get out (ENOBUFS)."""
    clock: list[tuple[int, int, float]] = field(default_factory=list)
    """(since, offset ns, drift ppm) of the wall clock against true time, ascending."""
    world: list[tuple[int, str, int]] = field(default_factory=list)
    """(since, recording, shift): from then on true time t is time t - shift of that recording."""
    angle_lost: bool = False
    """Whether nobody on the bus can tell by the angle how far the rotor turned meanwhile."""

    def take(self, since: int, until: int) -> tuple[list[Item], list[Item], list[Item]]:
        """Items before, within and after [since, until)."""
        first = _place(self.items, since)
        last = _place(self.items, until)
        return self.items[:first], self.items[first:last], self.items[last:]

    def change(
        self, since: int, until: int, what: Callable[[Item], Item | Iterable[Item] | None]
    ) -> None:
        """Each item within [since, until) becomes another, several, or none."""
        before, within, after = self.take(since, until)
        made: list[Item] = []
        for item in within:
            out = what(item)
            if isinstance(out, Item):
                made.append(out)
            elif out is not None:
                made.extend(out)
        self.items = sorted(before + made + after, key=lambda item: item.at)

    def wall(self, at: int) -> int:
        """The service's wall clock at true time ``at``, in ns."""
        for since, offset, ppm in reversed(self.clock):
            if at >= since:
                return at + offset + round((at - since) * ppm * 1e-6)
        return at

    def set_clock(self, at: int, step: int = 0, ppm: float = 0.0) -> None:
        """From ``at`` on the wall clock is ``step`` further and runs ``ppm`` too fast."""
        self.clock.append((at, self.wall(at) - at + step, ppm))

    def begin_anew(self, since: int, until: int, name: str, shift: int) -> None:
        """The rig ends at ``since``; from ``until`` on it is that of another recording."""
        self.world = [each for each in self.world if each[0] <= since]
        self.world.append((until, name, shift))

    def pause(self, since: int, wait: int) -> None:
        """What the rig does from ``since`` on it does ``wait`` later, a restart to come too."""
        name, local = self.truth_of(since)
        later = [(at + wait, where, by + wait) for at, where, by in self.world if at > since]
        self.world = [each for each in self.world if each[0] <= since]
        self.world += [(since + wait, name, since - local + wait), *later]

    def truth_of(self, at: int) -> tuple[str, int]:
        """(recording, its time) that was real at true time ``at``."""
        name, shift = "", 0
        for since, where, by in self.world:
            if at < since and name:
                break
            name, shift = where, by
        return name, at - shift


def _place(items: list[Item], at: int) -> int:
    return bisect_left(items, at, key=lambda item: item.at)
