"""Samples and estimates as a monitor hears them -> traces, all at their physical instants.

A signal's stamp less the delay that the model file gives it is the instant that it speaks of; an
estimate says its age itself.
"""

from array import array

import numpy as np

from eps_hil.dashboard.decimate import Float64, Int64, at_instants
from eps_hil.dashboard.store import Block
from eps_hil.dashboard.traces import (
    ANGLE,
    CELL,
    ERROR,
    ESTIMATE,
    FRICTION,
    MEASURED,
    POSITION,
)
from eps_hil.physics.model import Model

_KEPT = 2000
"""Load-cell samples that estimates still to come are compared with."""


def late_ns(model: Model, name: str) -> int:
    """What lies between the instant that a sample of a signal speaks of and its stamp."""
    return round(model.delays_s.of(name) * 1e9)


class Collector:
    """An :class:`~eps_hil.monitor.view_model.Ear`. ``mapped``: the signals that can come."""

    def __init__(self, model: Model, mapped: frozenset[str]) -> None:
        self._late_ns = {name: late_ns(model, name) for name in MEASURED}
        self._ratio = model.rack_to_rotor_ratio_rad_per_m
        self._from_angle = POSITION not in mapped and ANGLE in mapped
        self._new: dict[str, tuple[array[int], array[float]]] = {}
        self._cell: Block = (np.empty(0, np.int64), np.empty(0))
        self._waiting: Block = self._cell
        self._age_ns = 0

    def sample(self, name: str, t_ns: int, value: float) -> None:
        """One sample of a mapped signal; NaN is one that the frame's checks refused."""
        late = self._late_ns.get(name)
        if late is not None:
            self._put(name, t_ns - late, value)

    def estimate(self, t_ns: int, age_ns: int | None, force_n: float, friction_nm: float) -> None:
        """A published estimate by its frame's stamp; NaN where it is not valid."""
        if age_ns is not None:
            self._age_ns = age_ns
        self._put(ESTIMATE, t_ns - self._age_ns, force_n)
        self._put(FRICTION, t_ns - self._age_ns, friction_nm)

    def _put(self, name: str, t_ns: int, value: float) -> None:
        found = self._new.get(name)
        if found is None:
            found = self._new[name] = array("q"), array("d")
        found[0].append(t_ns)
        found[1].append(value)

    def drain(self) -> dict[str, Block]:
        """What came since the last call."""
        new, self._new = self._new, {}
        blocks = {
            name: (np.array(t_ns, np.int64), np.array(value, np.float64))
            for name, (t_ns, value) in new.items()
        }
        if self._from_angle and ANGLE in blocks:
            t_ns, angle = blocks[ANGLE]
            blocks[POSITION] = t_ns, angle / self._ratio
        if error := self._error(blocks.get(ESTIMATE), blocks.get(CELL)):
            blocks[ERROR] = error
        return blocks

    def _error(self, estimate: Block | None, cell: Block | None) -> Block | None:
        """Of the estimates for whose instant the load cell has spoken."""
        if cell is not None:
            t_ns, value = _joined(self._cell, cell)
            self._cell = t_ns[-_KEPT:], value[-_KEPT:]
        if estimate is not None:
            self._waiting = _joined(self._waiting, estimate)
        t_ns, force = self._waiting
        if not len(t_ns) or len(self._cell[0]) < 2:
            self._waiting = t_ns[-_KEPT:], force[-_KEPT:]
            return None
        known = cell if cell is not None and len(cell[0]) > _KEPT else self._cell
        ready = t_ns <= known[0][-1]
        self._waiting = t_ns[~ready][-_KEPT:], force[~ready][-_KEPT:]
        if not ready.any():
            return None
        return t_ns[ready], force[ready] - at_instants(*known, t_ns[ready])


def _joined(one: Block, other: Block) -> tuple[Int64, Float64]:
    """One after the other, with what does not rise left out; a jump back forgets the first."""
    if len(one[0]) and len(other[0]) and other[0][0] < one[0][-1] - 1_000_000_000:
        one = one[0][:0], one[1][:0]
    t_ns, value = np.concatenate((one[0], other[0])), np.concatenate((one[1], other[1]))
    if not len(t_ns):
        return t_ns, value
    highest = np.maximum.accumulate(t_ns)
    rising = np.concatenate(([True], t_ns[1:] > highest[:-1]))
    return t_ns[rising], value[rising]
