"""Adapted friction levels on their way into a running estimator: from when, and how fast.

A change counts from a grid point of *sample* time on, so that a recording replayed with its changes
gives bit for bit what the live loop published; and it is taken over at a set rate, so that nobody
sees a step in the published force.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.estimation import acting
from eps_hil.estimation.setup import Constants, Physics
from eps_hil.estimation.state import INSTANT, Moment, Rig
from eps_hil.physics.effects.effect import Instant
from eps_hil.physics.friction import SMALLEST_LEVEL_NM, static_level_nm

_WAITING = 32
"""Changes that may wait for their grid point."""

Int64 = npt.NDArray[np.int64]
Float64 = npt.NDArray[np.float64]


class FrictionLevels(NamedTuple):
    """k0+ and k0− of eq. 3, in Nm at the rotor."""

    positive_nm: float
    negative_nm: float

    def above(self, x: Physics) -> tuple[float, float]:
        """What is added to the model's own; ``ValueError`` unless finite and not negative."""
        if not all(math.isfinite(level) and level >= 0.0 for level in self):
            raise ValueError(f"friction levels must be finite and not negative, not {tuple(self)}")
        return self.positive_nm - x.law.offset_pos_nm, self.negative_nm - x.law.offset_neg_nm


class LevelChange(NamedTuple):
    """Levels k0± (Nm, rotor) that are gone over to from grid point ``t_ns`` of sample time on."""

    t_ns: int
    positive_nm: float
    negative_nm: float

    @property
    def levels(self) -> FrictionLevels:
        """The levels alone."""
        return FrictionLevels(self.positive_nm, self.negative_nm)


class Queue(NamedTuple):
    """Changes that wait, oldest first: ``due`` (n,) stamps, ``added`` (n, 2) Nm; ``filled`` (1,)
    counts them.
    """

    due: Int64
    added: Float64
    filled: Int64


def new_queue(size: int = _WAITING) -> Queue:
    """An empty one with room for ``size`` changes."""
    return Queue(np.zeros(size, np.int64), np.zeros((size, 2)), np.zeros(1, np.int64))


def queue_of(changes: Sequence[LevelChange], x: Physics) -> Queue:
    """All changes of a recording, which is of one stretch of time."""
    queue = new_queue(len(changes) + _WAITING)
    for change in changes:
        enqueue(queue, change.t_ns, *change.levels.above(x))
    return queue


@kernel
def enqueue(q: Queue, t: int, added_pos: float, added_neg: float) -> bool:
    """Let a change wait for grid point ``t``; False (and nothing changed) where the queue is full.

    Stamps never go back: a change that would overtake the one before waits for it.
    """
    n = q.filled[0]
    if n >= len(q.due):
        return False
    q.due[n] = t if n == 0 else max(t, q.due[n - 1])
    q.added[n, 0], q.added[n, 1] = added_pos, added_neg
    q.filled[0] = n + 1
    return True


@kernel
def hand_over(q: Queue, r: Rig, t: int) -> None:
    """Make everything that is due at grid point ``t`` the goal of the estimator's levels."""
    while q.filled[0] > 0 and q.due[0] <= t:
        r.goal_pos, r.goal_neg = q.added[0, 0], q.added[0, 1]
        n = q.filled[0] - 1
        for k in range(n):
            q.due[k] = q.due[k + 1]
            q.added[k, 0], q.added[k, 1] = q.added[k + 1, 0], q.added[k + 1, 1]
        q.filled[0] = n


@kernel
def approach(c: Constants, r: Rig) -> None:
    """Move the levels in use one step towards their goals."""
    r.added_pos += min(max(r.goal_pos - r.added_pos, -c.level_step), c.level_step)
    r.added_neg += min(max(r.goal_neg - r.added_neg, -c.level_step), c.level_step)


@kernel
def adapted_level_nm(x: Physics, r: Rig, direction: float, load_n: float) -> float:
    """T_fs of eq. 3 with what adaptation has added to k0± so far."""
    added_nm = r.added_pos if direction >= 0.0 else r.added_neg
    return max(static_level_nm(direction, load_n, x.law) + added_nm, SMALLEST_LEVEL_NM)


@kernel
def level_in_use_nm(x: Physics, r: Rig, direction: float, i: Instant) -> float:
    """The same with what the model's added effects make of it at an instant."""
    level = adapted_level_nm(x, r, direction, i.rack_force_n)
    if x.use.level:
        level = max(acting.level_nm(x.effects, i, level), SMALLEST_LEVEL_NM)
    return level


@kernel
def tell(s: Moment, r: Rig, i: Instant) -> None:
    """Remember an instant for what acts while the estimate is held."""
    for k in range(INSTANT):
        s.told[k] = i[k]
    r.most_nm = max(r.most_nm, abs(i.motor_torque_nm))
    r.most_rad_s = max(r.most_rad_s, abs(i.speed_rad_s))


@kernel
def told_last(s: Moment, speed_rad_s: float, rack_force_n: float) -> Instant:
    """The last instant that was estimated at, with another speed and load."""
    t = s.told
    return Instant(t[0], speed_rad_s, t[2], t[3], rack_force_n, t[5], t[6], t[7], t[8])


def levels_in_use(x: Physics, r: Rig) -> FrictionLevels:
    """The model's k0± with what adaptation has added to them."""
    return FrictionLevels(
        x.law.offset_pos_nm + float(r.added_pos), x.law.offset_neg_nm + float(r.added_neg)
    )
