"""Stamped samples in, one estimate a millisecond out: what the service, replay and batch share.

The estimator steps on a 1 kHz grid of *sample* time. A grid point is due when a sync frame's
stamp reaches it; what is read there lies ``lookback_s`` earlier, where every signal, late as it
is reported, has arrived. Nothing depends on wall time or on how frames were bunched, so frames
replayed as fast as possible give bit for bit what the live loop published.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.estimation import alignment, levels, setup
from eps_hil.estimation.bristle_filter import PhysicsInside, physics_inside
from eps_hil.estimation.bristle_setup import new_belief
from eps_hil.estimation.levels import FrictionLevels, LevelChange
from eps_hil.estimation.settings import EstimatorSettings, problem
from eps_hil.estimation.setup import STEP_NS, STEP_S, Constants, Inputs, Physics
from eps_hil.estimation.step import step
from eps_hil.estimation.validity import Reason
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.signals import ESTIMATOR_INPUTS

SIGNALS = (*ESTIMATOR_INPUTS, "rack_force_n")
_TORQUE, _SENSOR, _SPEED, _ANGLE, _FORCE = range(5)
_LOST = np.array(
    [
        Reason.MOTOR_TORQUE,
        Reason.TORQUE_SENSOR,
        Reason.MOTOR_SPEED,
        Reason.MOTOR_SPEED,
        Reason.RACK_FORCE,
    ],
    dtype=np.int64,
)
_TIME, _NOT_STARTED = int(Reason.TIME), int(Reason.NOT_STARTED)
_JUMP_NS = 1_000_000_000
_BATCH_ROWS = 1_100
"""Steps that one sync frame can make due: a jump of a second and more starts anew."""

Int64 = npt.NDArray[np.int64]
Float64 = npt.NDArray[np.float64]


class Timing(NamedTuple):
    """Per signal, in ns: delay, age beyond which it is lost, whether it is used; and look-back."""

    delay: Int64
    stale: Int64
    used: npt.NDArray[np.bool_]
    lookback: int
    speed_window: int


class Memory(NamedTuple):
    """Everything that the stream remembers; arrays only, so that compiled code can hold it."""

    stamps: Int64
    values: Float64
    filled: Int64
    grid: Int64
    state: Float64
    t_ns: Int64
    estimate: Float64
    reason: Int64
    levels: levels.Queue


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


@njit
def push(m: Memory, timing: Timing, i: int, t: int, v: float) -> None:
    """One sample of signal ``i`` (place in SIGNALS) with its stamp."""
    if not alignment.push_sample(m.stamps, m.values, m.filled, i, t, v):
        return
    if i == _ANGLE and timing.speed_window > 0:
        there, stamp, speed = alignment.slope(m.stamps, m.values, m.filled, i, timing.speed_window)
        if there:
            alignment.push_sample(m.stamps, m.values, m.filled, _SPEED, stamp, speed)


@njit
def gather(m: Memory, timing: Timing, at: int) -> tuple[Inputs, int]:
    """All inputs at physical instant ``at`` and what is wrong with them."""
    got = (0.0, 0.0, 0.0, 0.0, 0.0)
    torque, sensor, speed, angle, force = got
    reason = 0
    for i in range(len(SIGNALS)):
        if not timing.used[i]:
            continue
        value, why = alignment.read_at(
            m.stamps, m.values, m.filled, i, at + timing.delay[i], timing.stale[i], _LOST[i]
        )
        if i == _SENSOR and m.filled[i] == 0:  # never there: absent, not lost (CONTRACT 2)
            continue
        reason |= why
        if i == _TORQUE:
            torque = value
        elif i == _SENSOR:
            sensor = value
        elif i == _SPEED:
            speed = value
        elif i == _ANGLE:
            angle = value
        else:
            force = value
    return Inputs(torque, sensor, speed, angle, force), reason


@njit
def advance(m: Memory, timing: Timing, c: Constants, x: Physics, t: int) -> int:
    """Step the grid up to sync stamp ``t``; results in m.t_ns, m.estimate, m.reason [0:n]."""
    extra = 0
    if m.grid[1] == 0:
        m.grid[0], m.grid[1] = t, 1
        extra = _NOT_STARTED
    elif t - m.grid[0] > _JUMP_NS or m.grid[0] - t > _JUMP_NS:
        m.grid[0] = t
        m.filled[:] = 0
        levels.forget(m.state)
        x.effects.state[:] = 0.0
        extra = _TIME
    lag = int(round(c.output_lag_s * 1e9))
    n = 0
    # Half a step of grace: a sync frame that is a little early still makes its own step due.
    while m.grid[0] <= t + STEP_NS // 2 and n < _BATCH_ROWS:
        levels.hand_over(m.levels, m.state, m.grid[0])
        at = m.grid[0] - timing.lookback
        inputs, reason = gather(m, timing, at)
        reason |= extra
        m.reason[n] = step(c, x, m.state, inputs, reason)
        m.t_ns[n] = at - lag
        m.estimate[n, 0] = m.state[setup.OUT_FORCE]
        m.estimate[n, 1] = m.state[setup.OUT_FRICTION]
        m.grid[0] += STEP_NS
        n += 1
    return n


@njit
def run(
    m: Memory,
    timing: Timing,
    c: Constants,
    x: Physics,
    signal: npt.NDArray[np.int8],
    t_ns: Int64,
    value: Float64,
    out_t: Int64,
    out: Float64,
    out_reason: Int64,
    since: int,
) -> tuple[int, int]:
    """Events ``since`` onwards (signal −1 is a sync) until done or ``out`` is full.

    Returns (next event, rows written).
    """
    rows = 0
    k = since
    while k < len(signal) and rows + _BATCH_ROWS <= len(out_t):
        if signal[k] >= 0:
            push(m, timing, signal[k], t_ns[k], value[k])
        else:
            n = advance(m, timing, c, x, t_ns[k])
            out_t[rows : rows + n] = m.t_ns[:n]
            out[rows : rows + n] = m.estimate[:n]
            out_reason[rows : rows + n] = m.reason[:n]
            rows += n
        k += 1
    return k, rows


class StreamEstimator:
    """Rack force from stamped samples, live or recorded.

    ``periods_s`` names the signals that will come, with their sample periods: torque and speed
    (or the angle, from which the speed is then derived) are the least.
    """

    def __init__(
        self, model: Model, settings: EstimatorSettings, periods_s: Mapping[str, float]
    ) -> None:
        if wrong := problem(settings):
            raise ValueError(wrong)
        self.settings = settings
        model = with_model_effects(model)
        angle_seen = "motor_angle_rad" in periods_s
        self.constants = setup.constants(model, settings, angle_seen)
        self.physics = setup.physics_of(model)
        if settings.kind == "bristle_filter":
            self.physics = physics_inside(model, settings, self.physics, angle_seen)
        self.timing = timing_of(model, settings, periods_s)
        self._places = {name: i for i, name in enumerate(SIGNALS) if name in periods_s}
        self.memory = new_memory()
        self._latest = 0

    @property
    def latency_s(self) -> float:
        """From a sync frame's stamp back to the instant that its estimate speaks of."""
        return self.timing.lookback * 1e-9 + self.constants.output_lag_s

    def push(self, signal: str, t_ns: int, value: float) -> None:
        """Take one sample; a signal that the estimator does not use is ignored."""
        place = self._places.get(signal)
        if place is not None:
            push(self.memory, self.timing, place, t_ns, value)

    def advance(self, t_ns: int) -> int:
        """A sync frame with stamp ``t_ns``: run what is due, return the number of estimates."""
        n = int(advance(self.memory, self.timing, self.constants, self.physics, t_ns))
        self._latest = n - 1 if n else self._latest
        return n

    def estimates(self, n: int) -> Sequence[Estimate]:
        """The ``n`` estimates of the last :meth:`advance`, oldest first."""
        return [self._estimate(k) for k in range(n)]

    @property
    def friction_levels(self) -> FrictionLevels:
        """The levels in use at this moment, on their way to what was set."""
        return levels.levels_in_use(self.physics, self.memory.state)

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
        """The newest estimate."""
        return self._estimate(self._latest)

    def warm_up(self) -> None:
        """Compile (or load) all machine code now, so that no frame waits for it."""
        twin = StreamEstimator.__new__(StreamEstimator)
        twin.constants, twin.timing = self.constants, self.timing
        effects = self.physics.effects._replace(state=self.physics.effects.state.copy())
        twin.physics = self.physics._replace(effects=effects)
        if isinstance(twin.physics, PhysicsInside):
            twin.physics = twin.physics._replace(belief=new_belief())
        twin.settings, twin._places, twin._latest = self.settings, self._places, 0
        twin.memory = new_memory()
        for name in self._places:
            twin.push(name, 0, 0.0)
        twin.advance(0)
        _ = twin.latest

    def run(
        self,
        signal: npt.NDArray[np.int8],
        t_ns: Int64,
        value: Float64,
        changes: Sequence[LevelChange] = (),
    ) -> Trace:
        """All events of a recording at once: places in SIGNALS, −1 for a sync; all shape (n,).

        ``changes``: friction levels set meanwhile, in the order of their stamps; no jump of time
        may lie between them.
        """
        if changes:
            queue = levels.queue_of(changes, self.physics)
            self.memory = self.memory._replace(levels=queue)
        blocks: list[tuple[Int64, Float64, Int64]] = []
        since, size = 0, 100_000
        out_t, out = np.empty(size, np.int64), np.empty((size, 2))
        out_reason = np.empty(size, np.int64)
        while since < len(signal):
            since, n = run(
                self.memory, self.timing, self.constants, self.physics,
                signal, t_ns, value, out_t, out, out_reason, since,
            )  # fmt: skip
            blocks.append((out_t[:n].copy(), out[:n].copy(), out_reason[:n].copy()))
        if not blocks:
            return Trace(out_t[:0], out[:0, 0], out[:0, 1], out_reason[:0])
        times, values, reasons = (np.concatenate(part) for part in zip(*blocks, strict=True))
        return Trace(times, values[:, 0], values[:, 1], reasons)

    def _estimate(self, k: int) -> Estimate:
        m = self.memory
        reason = Reason(int(m.reason[k]))
        return Estimate(
            int(m.t_ns[k]), float(m.estimate[k, 0]), float(m.estimate[k, 1]), reason == 0, reason
        )


def new_memory() -> Memory:
    """Nothing seen yet."""
    n = len(SIGNALS)
    return Memory(
        np.zeros((n, alignment.RING), np.int64),
        np.zeros((n, alignment.RING)),
        np.zeros(n, np.int64),
        np.zeros(2, np.int64),
        setup.new_state(),
        np.zeros(_BATCH_ROWS, np.int64),
        np.zeros((_BATCH_ROWS, 2)),
        np.full(_BATCH_ROWS, _NOT_STARTED, np.int64),
        levels.new_queue(),
    )


def timing_of(
    model: Model,
    settings: EstimatorSettings,
    periods_s: Mapping[str, float],
    also: Collection[str] = (),
) -> Timing:
    """Which signals are read, how late each is, and how far back everything has arrived.

    ``also``: signals beside the estimator's own, where they come. ``ValueError`` for what it lacks.
    """
    derive = "motor_speed_rad_s" not in periods_s
    needed = {"motor_torque_nm", "motor_angle_rad" if derive else "motor_speed_rad_s"}
    if settings.quantity == "friction":
        needed.add("rack_force_n")
    if settings.position == "measured":
        needed.add("motor_angle_rad")
    missing = sorted(needed - set(periods_s))
    if missing:
        if derive and "motor_angle_rad" in missing:
            missing[missing.index("motor_angle_rad")] = "motor_speed_rad_s or motor_angle_rad"
        raise ValueError(f"the estimator needs {', '.join(missing)}")
    used = np.array([name in {*needed, *also, "torque_sensor_nm"} for name in SIGNALS])
    used &= np.array([name in periods_s for name in SIGNALS])
    used[_SPEED] = True
    used[_ANGLE] = "motor_angle_rad" in periods_s
    window = 0.0
    periods = [periods_s.get(name, 0.0) for name in SIGNALS]
    delays = [model.delays_s.of(name) for name in SIGNALS]
    if derive:
        periods[_SPEED], delays[_SPEED] = periods[_ANGLE], delays[_ANGLE]
        window = max(settings.speed_window_s, 2.5 * periods[_ANGLE])  # three samples, surely
    ahead = [d + p + _margin_s(p) for d, p in zip(delays, periods, strict=True)]
    ahead[_SPEED] += window / 2
    lookback = max(a for a, use in zip(ahead, used, strict=True) if use)
    stale = [max(settings.stale_after_s, 3 * p) + window * (i == _SPEED)
             for i, p in enumerate(periods)]  # fmt: skip
    return Timing(
        np.array([round(d * 1e9) for d in delays], np.int64),
        np.array([round(s * 1e9) for s in stale], np.int64),
        used,
        round(lookback * 1e9),
        round(window * 1e9) if derive else 0,
    )


def _margin_s(period_s: float) -> float:
    """How much later than its period a sample may arrive without being missed; whole steps.

    Signals at the estimator's own rate come in the sender's cycle and need none; slower ones are
    stamped on arrival, behind whatever else the bus carried.
    """
    return math.ceil(period_s / 4 / STEP_S) * STEP_S if period_s > 2 * STEP_S else 0.0
