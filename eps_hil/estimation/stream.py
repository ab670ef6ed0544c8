"""Stamped samples in, one estimate a step out: what the service, replay and batch share.

The estimator steps on a grid of *sample* time: 1 kHz, or the sync frame's rate where that is
higher. A grid point is due when a sync frame's stamp reaches it; what is read there lies
``lookback_s`` earlier, where every signal, late as it is reported, has arrived. Nothing depends on
wall time or on how frames were bunched, so frames replayed as fast as possible give bit for bit
what the live loop published.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import direct, interpreted
from eps_hil.estimation import levels, setup
from eps_hil.estimation.bristle_filter import PhysicsInside, physics_inside
from eps_hil.estimation.bristle_setup import new_belief
from eps_hil.estimation.lanes import Lanes, run
from eps_hil.estimation.levels import FrictionLevels, LevelChange
from eps_hil.estimation.memory import memory_of_a_start
from eps_hil.estimation.places import effects_of_places
from eps_hil.estimation.plain import plain
from eps_hil.estimation.settings import EstimatorSettings, problem
from eps_hil.estimation.stream_steps import (
    BATCH_ROWS,
    WAITING,
    Waiting,
    new_memory,
    new_waiting,
    take_all,
    take_and_advance,
)
from eps_hil.estimation.stream_timing import SIGNALS, timing_of
from eps_hil.estimation.validity import Reason, reason_of
from eps_hil.growing import Growing
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model

__all__ = ["SIGNALS", "Estimate", "StreamEstimator", "Trace"]

Int64 = npt.NDArray[np.int64]
Float64 = npt.NDArray[np.float64]


class Estimate(NamedTuple):
    """One published estimate; ``t_ns`` is the physical instant that it speaks of."""

    t_ns: int
    rack_force_n: float
    friction_torque_nm: float
    valid: bool
    reason: Reason


@dataclass(frozen=True, slots=True)
class Trace:
    """Estimates of a whole recording: all shape (n,); ``t_ns`` physical instants."""

    t_ns: Int64
    rack_force_n: Float64
    friction_torque_nm: Float64
    reason: Int64

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """Where the estimate may be used."""
        return np.equal(self.reason, 0)


def ends(count: int, stretch: int) -> Iterator[int]:
    """Where stretches of so many syncs end, of ``count``; at least once."""
    yield from range(stretch, count, stretch)
    yield count


class Rows:
    """Estimates of one stretch of a recording after another."""

    def __init__(self) -> None:
        self._only: Trace | None = None
        self._columns: tuple[Growing, ...] = ()
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, part: Trace) -> None:
        """Those that follow; a recording of one stretch is not copied."""
        self._count += len(part.t_ns)
        if not self._columns and self._only is None:
            self._only = part
            return
        parts = [part]
        if self._only is not None:
            kinds = np.int64, np.float64, np.float64, np.int64
            self._columns = tuple(Growing(kind) for kind in kinds)
            parts, self._only = [self._only, part], None
        for each in parts:
            columns = each.t_ns, each.rack_force_n, each.friction_torque_nm, each.reason
            for growing, column in zip(self._columns, columns, strict=True):
                growing.add(column)

    def whole(self) -> Trace:
        """All of them; nothing is added then. There is a stretch at least."""
        return self._only or Trace(*(each.whole() for each in self._columns))


_BLOCK = 2_000_000
"""Rows of one compiled call: half an hour at 1 kHz, 64 MB."""


class StreamEstimator:
    """Rack force from stamped samples, live or recorded.

    ``periods_s`` names the signals that will come, with their sample periods: torque and speed
    (or the angle, from which the speed is then derived) are the least. A torsion bar that is named
    is waited for; one that is not is absent.
    """

    def __init__(
        self, model: Model, settings: EstimatorSettings, periods_s: Mapping[str, float]
    ) -> None:
        if wrong := problem(settings):
            raise ValueError(wrong)
        self.settings = settings
        model = with_model_effects(model)
        angle_seen = "motor_angle_rad" in periods_s
        speed_seen = "motor_speed_rad_s" in periods_s
        self.constants = setup.constants(
            model, settings, angle_seen, speed_seen, periods_s.get("motor_speed_rad_s", 0.0)
        )
        self.effects_without_angle = () if angle_seen else effects_of_places(model)
        """Ids of effects that need the angle, where none will come: nothing is valid then."""
        self.physics = setup.physics_of(model)
        if settings.kind == "bristle_filter":
            self.physics = physics_inside(model, settings, self.physics, angle_seen)
        self.timing = timing_of(model, settings, periods_s)
        self._places = {name: i for i, name in enumerate(SIGNALS) if name in periods_s}
        self.memory = new_memory()
        self._begin_memory(model)
        self._newest = _NOTHING
        self._waiting = new_waiting()
        self._take, self._advance = take_all, take_and_advance

    def _begin_memory(self, model: Model) -> None:
        """What effects may remember at the start that nobody knows."""
        x, limits = self.physics, self.settings.plausibility
        memory_of_a_start(
            self.constants,
            setup.Physics(x.law, x.effects, x.use),
            self.memory.carried.rig[0],
            self.settings.memory_at_start == "unknown",
            limits.largest_torque_nm(model.rack_to_rotor_ratio_rad_per_m),
            limits.motor_speed_rad_s,
        )

    @property
    def latency_s(self) -> float:
        """From a sync frame's stamp back to the instant that its estimate speaks of."""
        return self.timing.lookback * 1e-9 + self.constants.output_lag_s

    @property
    def memory_unknown_s(self) -> float:
        """For how long at most what effects remember now makes the friction unknown."""
        c, unknown_n = self.constants, float(self.memory.carried.rig[0].memory_n)
        if unknown_n <= c.unknown_limit_n:
            return 0.0
        return math.log(c.unknown_limit_n / unknown_n) / math.log(c.memory_keep) * c.step_s

    def force_of_shift_n(self, shift_ns: int) -> float:
        """By how much the force is off (N) at its worst, once instants moved by ``shift_ns``.

        Speed that changed in a step of one length seems to change in one of another.
        """
        c, now = self.constants, self.memory.carried.moment[0]
        kick = abs(float(now.acceleration)) * abs(shift_ns) * 1e-9 * c.ratio / c.inverse_inertia
        return kick / (_SPREAD * max(c.output_lag_s, c.step_s))

    def push(self, signal: str, t_ns: int, value: float) -> None:
        """Take one sample; a signal that the estimator does not use is ignored.

        It waits until :meth:`advance`, so that all of a step's are handed over by one call.
        """
        place = self._places.get(signal)
        if place is None:
            return
        signals, stamps, values, filled = self._waiting
        k = filled[0]
        if k == WAITING:
            self._take(self.memory, self.timing, self._waiting)
            k = 0
        signals[k], stamps[k], values[k], filled[0] = place, t_ns, value, k + 1

    @property
    def places(self) -> Mapping[str, int]:
        """The number of each signal that is used, as it stands in :attr:`waiting`."""
        return self._places

    @property
    def waiting(self) -> Waiting:
        """Samples that wait; who appends some there need not :meth:`push` them."""
        return self._waiting

    def advance(self, t_ns: int) -> int:
        """A sync frame with stamp ``t_ns``: run what is due, return the number of estimates."""
        n, at_ns, force_n, friction_nm, bits = self._advance(
            self.memory, self.timing, self.constants, self.physics, self._waiting, t_ns
        )
        if n:
            self._newest = Estimate(at_ns, force_n, friction_nm, bits == 0, reason_of(bits))
        return n

    def estimates(self, n: int) -> Sequence[Estimate]:
        """The ``n`` estimates of the last :meth:`advance`, oldest first."""
        return [self._estimate(k) for k in range(n)]

    @property
    def friction_levels(self) -> FrictionLevels:
        """The levels in use at this moment, on their way to what was set."""
        return levels.levels_in_use(self.physics, self.memory.carried.rig[0])

    def set_friction_levels(self, to: FrictionLevels, t_ns: int | None = None) -> LevelChange:
        """Go over to adapted levels at the rate of the settings, without a step in the force.

        From grid point ``t_ns`` of sample time on, or from the next one if that is past (or None).
        What is returned says from when, and belongs into the record: given again in a replay, or
        to :func:`~eps_hil.estimation.batch.estimate`, it gives the same estimates bit for bit.
        ``ValueError`` for impossible levels, or where too many changes wait already.
        """
        m = self.memory
        at = int(m.grid[0]) if t_ns is None else max(t_ns, int(m.grid[0]))
        if not levels.enqueue(m.levels, at, *to.above(self.physics)):
            raise ValueError("too many changes of the friction levels wait for their time")
        return LevelChange(int(m.levels.due[m.levels.filled[0] - 1]), *to)

    @property
    def latest(self) -> Estimate:
        """The newest estimate of :meth:`advance`."""
        return self._newest

    def warm_up(self) -> None:
        """Compile (or load) all machine code now, so that no frame waits for it."""
        twin = StreamEstimator.__new__(StreamEstimator)
        twin.constants, twin.timing = self.constants, self.timing
        effects = self.physics.effects._replace(
            state=self.physics.effects.state.copy(), spare=self.physics.effects.spare.copy()
        )
        twin.physics = self.physics._replace(effects=effects)
        if isinstance(twin.physics, PhysicsInside):
            twin.physics = twin.physics._replace(belief=new_belief())
        twin.settings, twin._places, twin._newest = self.settings, self._places, _NOTHING
        twin.memory, twin._waiting = new_memory(), new_waiting()
        twin._take, twin._advance = take_all, take_and_advance
        for k in range(WAITING):  # more than may wait, so that both are called
            for name in self._places:
                twin.push(name, k * self.timing.step_ns, 0.0)
        twin.advance(WAITING * self.timing.step_ns)
        m, waits = self.memory, self._waiting
        self._take = direct(take_all, m, self.timing, waits)
        self._advance = direct(
            take_and_advance, m, self.timing, self.constants, self.physics, waits, 0
        )

    def run(
        self, lanes: Lanes, changes: Sequence[LevelChange] = (), until: int | None = None
    ) -> Trace:
        """The samples of a recording, to its end or up to sync ``until``, which is still to come.

        ``changes``: friction levels set meanwhile, in the order of their stamps; no jump of time
        may lie between them.
        """
        if self._waiting.filled[0]:
            self._take(self.memory, self.timing, self._waiting)
        if changes:
            queue = levels.queue_of(changes, self.physics)
            self.memory = self.memory._replace(levels=queue)
            self._take, self._advance = take_all, take_and_advance  # other types, perhaps
        syncs = lanes.t_ns[-1]
        since, end = int(lanes.at[-1]), len(syncs) if until is None else until
        # about as many rows as are due; where time jumps, another block follows
        due = int(syncs[end - 1] - syncs[since]) // self.timing.step_ns + 1 if since < end else 0
        size = min(max(due, 0), _BLOCK) + 2 * BATCH_ROWS
        if interpreted():
            self.memory, self.timing = plain(self.memory), plain(self.timing)
        blocks: list[tuple[Int64, Float64, Int64]] = []
        while not blocks or lanes.at[-1] < end:
            out_t, out, out_reason = (
                np.empty(size, np.int64), np.empty((size, 2)), np.empty(size, np.int64)
            )  # fmt: skip
            n = run(
                self.memory, self.timing, self.constants, self.physics,
                *lanes, end, out_t, out, out_reason,
            )  # fmt: skip
            blocks.append((out_t[:n], out[:n], out_reason[:n]))
        if len(blocks) == 1:
            times, values, reasons = blocks[0]
        else:
            times, values, reasons = (np.concatenate(part) for part in zip(*blocks, strict=True))
        return Trace(times, values[:, 0], values[:, 1], reasons)

    def _estimate(self, k: int) -> Estimate:
        m = self.memory
        bits = int(m.reason[k])
        force_n, friction_nm = m.estimate[k].tolist()
        return Estimate(int(m.t_ns[k]), force_n, friction_nm, bits == 0, reason_of(bits))


_SPREAD = 1.5
"""Lags of the output over which observer and filter spread what lasts a moment."""
_NOTHING = Estimate(0, 0.0, 0.0, False, Reason.NOT_STARTED)
