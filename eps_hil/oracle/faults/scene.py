"""What a fault is given to work on, and how a kind of fault is described."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from eps_hil.oracle.faults.payload import Layout
from eps_hil.oracle.faults.stretch import MS, Item, Stretch
from eps_hil.oracle.faults.traffic import World

STATE, TORQUES, LOAD_CELL = "EPS_MotorState", "EPS_Torques", "RIG_State"
ECU = (STATE, TORQUES)
ALL = (STATE, TORQUES, LOAD_CELL)


class Done(NamedTuple):
    """A fault that was done: its true times (ns) and what it was, for a reader."""

    kind: str
    since: int
    until: int
    words: str


@dataclass(slots=True)
class Scene:
    """One case in the making."""

    world: World
    stretch: Stretch
    random: np.random.Generator
    done: list[Done] = field(default_factory=list)

    def layout(self, name: str) -> Layout:
        """Of a message by name."""
        return self.world.layouts[name]

    def ids(self, names: tuple[str, ...]) -> frozenset[int]:
        """Ids of messages by name."""
        return frozenset(self.world.layouts[name].can_id for name in names)

    def some(self) -> tuple[str, ...]:
        """One message, both of the ECU, or all."""
        choices = ((STATE,), (TORQUES,), ECU, ALL)
        return choices[int(self.random.integers(len(choices)))]

    def pick(self, low: float, high: float) -> float:
        """Log-uniform between two positive bounds."""
        return float(np.exp(self.random.uniform(np.log(low), np.log(high))))

    def sign(self) -> int:
        """-1 or 1."""
        return 1 if self.random.random() < 0.5 else -1

    def change(
        self,
        names: tuple[str, ...],
        since: int,
        until: int,
        what: Callable[[Item], Item | list[Item] | None],
    ) -> None:
        """Do ``what`` to the items of some messages within [since, until)."""
        ids = self.ids(names)
        self.stretch.change(since, until, lambda i: what(i) if i.frame.can_id in ids else i)


Make = Callable[[Scene, int, int], tuple[str, int]]
"""(scene, since, until) -> (words, true end); most end at ``until``."""


class Kind(NamedTuple):
    """A kind of fault and how long it lasts, in ms."""

    make: Make
    least_ms: float
    most_ms: float

    @property
    def name(self) -> str:
        """As the table prints it."""
        return self.make.__name__.replace("_", " ")


def ms(ns: int) -> str:
    """A time for a reader."""
    return f"{ns / MS:.1f} ms"
