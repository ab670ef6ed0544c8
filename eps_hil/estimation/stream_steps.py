"""The stream's compiled part: samples into rings, and the steps that a sync frame makes due.

One machine code for the live loop, a replay and a whole recording.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.estimation import alignment, levels
from eps_hil.estimation.creep import carry, slide_on
from eps_hil.estimation.gap import lose_way, misled
from eps_hil.estimation.memory import end_hold, hold_memory
from eps_hil.estimation.plausibility import judge_sample, judge_step
from eps_hil.estimation.setup import Constants, Inputs, Physics
from eps_hil.estimation.state import (
    HELD,
    NOBODY_KNOWS,
    RUNS,
    Carried,
    Kept,
    Records,
    begin_anew,
    keep,
    move_by_angle,
    new_carried,
    new_kept,
    roll_back,
)
from eps_hil.estimation.step import step
from eps_hil.estimation.stream_timing import (
    ANGLE,
    MISSING_PERIODS,
    SENSOR,
    SIGNALS,
    SPEED,
    TORQUE,
    Timing,
)
from eps_hil.estimation.torque_jumps import take_friction
from eps_hil.estimation.validity import Reason
from eps_hil.estimation.watch import new_watch, watch_anew

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
_INCONSISTENT = int(Reason.INCONSISTENT)
_SOUND = int(Reason.SETTLING | Reason.OUT_OF_RANGE)
"""What leaves the state itself sound, and worth going back to."""
_BAD, _IMPLAUSIBLE = int(Reason.BAD_SAMPLE), int(Reason.IMPLAUSIBLE)
_FAR_LESS = 0.1
"""Share of a known variance of noise below which that of the last samples is believed."""
JUMP_NS = 1_000_000_000
BATCH_ROWS = 11_000
"""Steps that one sync frame can make due: a jump of a second and more starts anew."""
WAITING = 64
"""Samples that may wait for the sync frame."""

Int64 = npt.NDArray[np.int64]
Float64 = npt.NDArray[np.float64]


class Memory(NamedTuple):
    """Everything that the stream remembers; arrays only, so that compiled code can hold it.

    ``t_ns``, ``estimate``, ``reason`` are what :func:`advance` writes, a row a step; ``doubt`` the
    part of ``reason`` that signals which do not fit each other make.
    """

    stamps: Int64
    values: Float64
    filled: Int64
    grid: Int64
    carried: Carried
    t_ns: Int64
    estimate: Float64
    reason: Int64
    doubt: Int64
    levels: levels.Queue
    watch: Records
    kept: Kept
    noise: Float64
    learnt: Int64


def new_memory() -> Memory:
    """Nothing seen yet."""
    n = len(SIGNALS)
    return Memory(
        np.zeros((n, alignment.RING), np.int64),
        np.zeros((n, alignment.RING)),
        np.zeros(n, np.int64),
        np.zeros(3, np.int64),
        new_carried(),
        np.zeros(BATCH_ROWS, np.int64),
        np.zeros((BATCH_ROWS, 2)),
        np.full(BATCH_ROWS, _NOT_STARTED, np.int64),
        np.zeros(BATCH_ROWS, np.int64),
        levels.new_queue(),
        new_watch(),
        new_kept(),
        np.zeros((n, 2)),
        np.zeros(n, np.int64),
    )


class Waiting(NamedTuple):
    """Samples in the order of their arrival, for one call at the sync frame: place in SIGNALS,
    stamp (ns) and value, all (WAITING,), and how many there are, (1,)."""

    signal: Int64
    t_ns: Int64
    value: Float64
    filled: Int64


def new_waiting() -> Waiting:
    """Room for them."""
    places, stamps = np.zeros(WAITING, np.int64), np.zeros(WAITING, np.int64)
    return Waiting(places, stamps, np.zeros(WAITING), np.zeros(1, np.int64))


@kernel(inline="always")
def time_jumped(grid: Int64, step_ns: int, t: int) -> bool:
    """Whether sync stamp ``t`` is of another time than the ones before: back, or far ahead.

    ``grid``: next grid point (ns), 1 once it runs, newest sync stamp (ns). A clock that goes back
    by less than a step makes nothing due until it has caught up; further back, what is in the
    rings is of a future that does not come.
    """
    return t - grid[0] > JUMP_NS or grid[2] - t > step_ns


@kernel
def push(m: Memory, timing: Timing, i: int, t: int, v: float) -> None:
    """One sample of signal ``i`` (place in SIGNALS) with its stamp."""
    v = judge_sample(m.watch, timing.limits, i, t, v)
    if not alignment.push_sample(m.stamps, m.values, m.filled, i, t, v):
        return
    if i == ANGLE and timing.speed_window > 0:
        there, stamp, speed = alignment.slope(m.stamps, m.values, m.filled, i, timing.speed_window)
        if there:
            alignment.push_sample(m.stamps, m.values, m.filled, SPEED, stamp, speed)


@kernel
def _learn(m: Memory, timing: Timing, i: int, t: int) -> None:
    """The noise of ring ``i`` up to stamp ``t``: of what was read, not of what happens to be there.

    How far samples are ahead of the step that is made differs between a live bus and a recording.
    """
    if m.noise[i, 1] == 0.0:
        m.noise[i, 0], m.noise[i, 1] = timing.first_noise[i, 0], timing.first_noise[i, 1]
    n = max(m.learnt[i], m.filled[i] - alignment.RING + 4)
    while n < m.filled[i] and m.stamps[i, n & alignment.WRAP] <= t:
        n += 1
        first = timing.first_noise[i, 0]
        alignment.learn_noise(m.stamps, m.values, n, i, m.noise, first, timing.noise_memory)
    m.learnt[i] = n


@kernel(inline="always")
def _periods(timing: Timing, i: int, apart: int) -> float:
    """How many of its periods samples of signal ``i`` are apart (ns); 1 if none is lost."""
    if apart <= timing.missing[i]:
        return 1.0
    return MISSING_PERIODS * apart / timing.missing[i]


@kernel
def gather(m: Memory, timing: Timing, at: int) -> tuple[Inputs, int, bool, bool]:
    """All inputs at physical instant ``at``, what is wrong with them, and what was seen: T_1m, and
    the rotor's motion.

    Where samples are missing the inputs go straight from neighbour to neighbour, and what a torque
    did meanwhile was not seen.
    """
    got = (0.0, 0.0, 0.0, 0.0, 0.0)
    torque, sensor, speed, angle, force = got
    reason, share, seen, turns = 0, timing.limits.sensor_to_rotor, True, True
    speed_periods = angle_periods = 1.0
    for i in range(len(SIGNALS)):
        if not timing.used[i]:
            continue
        _learn(m, timing, i, at + timing.delay[i])
        value, why, apart = alignment.read_between(
            m.stamps, m.values, m.filled, i, at + timing.delay[i], timing.stale[i], _LOST[i],
            m.learnt[i],
        )  # fmt: skip
        if i <= SENSOR and apart > timing.missing[i]:
            seen = False
        if why & _BAD:
            why |= m.watch[0].refused[i]
        reason |= why
        if why != 0 and i in (SPEED, ANGLE):
            turns = False
        if i == TORQUE:
            torque = value
        elif i == SENSOR:
            sensor = value
        elif i == SPEED:
            speed, speed_periods = value, _periods(timing, i, apart)
        elif i == ANGLE:
            angle, angle_periods = value, _periods(timing, i, apart)
        else:
            force = value
    drive_noise = m.noise[TORQUE, 0] + share * share * m.noise[SENSOR, 0]
    noise = (drive_noise, m.noise[SPEED, 0], m.noise[ANGLE, 0])
    inputs = Inputs(
        torque,
        sensor,
        speed,
        angle,
        force,
        noise[0],
        noise[1],
        noise[2],
        speed_periods,
        angle_periods,
    )
    return inputs, reason, seen, turns


@kernel
def _go_back(m: Memory, c: Constants, x: Physics, u: Inputs, doubted: bool) -> None:
    """The state from before what is ``doubted`` now, carried along the angle's way since.

    Where that way is not known, since the state is from before a hole, what is unknown of the
    friction now stays so, and out and back again over holes is a way of which only the net is left.
    Where speed and angle part, it is moved by the angle; not where the angle jumped and the rotor
    rested by its speed: then the angle is wrong. A jump that is read half way may show as one only
    a step later.
    """
    w, s = m.watch[0], m.carried.moment[0]
    rolled, turned = doubted and s.running == RUNS, s.turned
    unknown_nm, leapt = s.unknown_nm, s.leapt
    if rolled:
        roll_back(m.carried, m.kept)
    steps = 2 if s.held_steps == 1 else 1  # it is held since the step before
    carry(w, c, x, s, m.carried.rig[0], s.held_steps + 1 if rolled else steps)
    if rolled and not s.carried:
        lost = leapt - s.leapt - abs(u.motor_angle_rad - s.last_angle)
        s.unknown_nm = max(s.unknown_nm, unknown_nm)
        lose_way(x, s, m.carried.rig[0], lost)
    if not doubted or not w.parted or s.running != HELD:
        return
    if rolled or s.parted == 0:
        s.parted, s.went = 1, turned - s.turned
    before = m.kept.moments[0]
    if w.sudden and abs(before.speed) < c.limiter_speed:
        s.speed, s.acceleration = before.speed, before.acceleration
    elif rolled:
        move_by_angle(m.carried, u.motor_angle_rad, c.step_s)


@kernel
def _be_wary(m: Memory, x: Physics, doubted: bool) -> None:
    """Tell the estimator whether its torque is doubted, and what a wrong one has made of it.

    What was learnt as noise in a doubt may have been what was doubted. Noise that is over is
    forgotten, too: a torque's jump is not seen in the noise that is thought to be there.
    """
    w, s = m.watch[0], m.carried.moment[0]
    if not doubted:
        s.wary, s.wary_way = 0, 0.0
        w.noisy -= 1 if w.noisy > 0 else 0
        below = 1.0 if w.noisy > 0 else _FAR_LESS
        turn = w.noisy if w.noisy > 0 else w.steps
        if turn % alignment.LATELY == 0:
            for i in range(len(SIGNALS)):
                alignment.forget_noise(m.stamps, m.values, m.learnt[i], i, m.noise, below)
        return
    s.wary, w.noisy = 1, 2 * alignment.LATELY
    if w.misled:
        w.misled = 0
        misled(x, s, m.carried.rig[0])


@kernel
def _slid(m: Memory, c: Constants, x: Physics, u: Inputs, missing: bool) -> None:
    """Take the way of a step, and the friction that it made."""
    now = m.carried.moment[0]
    if now.running == RUNS:
        now.turned += u.motor_speed_rad_s * c.step_s
        now.zero = m.watch[0].zero
        known = now.unknown_n <= c.unknown_limit_n
        take_friction(m.watch, now.unlimited, known, now.bristle)
    elif missing:
        take_friction(m.watch, 0.0, False, m.watch[0].bristle)
    else:
        slide_on(m.watch, c, x, now, m.carried.rig[0], u)


@kernel
def _remember(e: Carried, c: Constants, x: Physics, gap_s: float) -> None:
    """What effects remember, over ``gap_s`` without any step."""
    s = e.moment[0]
    hold_memory(x, s, gap_s)
    end_hold(c, x, s, e.rig[0], gap_s + s.held_steps * c.step_s)


@kernel(inline="always")
def advance(m: Memory, timing: Timing, c: Constants, x: Physics, t: int) -> int:
    """Step the grid up to sync stamp ``t``; results in m.t_ns, m.estimate, m.reason [0:n]."""
    extra = 0
    if m.grid[1] == 0:
        m.grid[0], m.grid[1] = t, 1
        extra = _NOT_STARTED
    elif time_jumped(m.grid, timing.step_ns, t):
        levels.hand_over(m.levels, m.carried.rig[0], m.grid[0])
        m.carried.rig[0].clock_s += max(t - m.grid[0], 0) * 1e-9
        if t - m.grid[0] > JUMP_NS:
            _remember(m.carried, c, x, (t - m.grid[0]) * 1e-9)
            begin_anew(m.carried)
            m.kept.steps[2] = 0
        else:  # the clock was set back: for how long nothing was seen, nobody knows
            unseen = JUMP_NS // timing.step_ns
            if m.grid[0] - t > JUMP_NS:
                unseen = NOBODY_KNOWS
            m.carried.moment[0].held_steps += unseen
            m.kept.steps[0] += unseen
            m.kept.steps[1] += unseen
        m.grid[0] = t
        for i in range(len(SIGNALS)):
            m.filled[i] = m.learnt[i] = 0
        watch_anew(m.watch)
        extra = _TIME
    m.grid[2] = t
    lag = int(round(c.output_lag_s * 1e9))
    n = 0
    # Half a step of grace: a sync frame that is a little early still makes its own step due.
    while m.grid[0] <= t + timing.step_ns // 2 and n < BATCH_ROWS:
        levels.hand_over(m.levels, m.carried.rig[0], m.grid[0])
        at = m.grid[0] - timing.lookback
        inputs, reason, seen, turns = gather(m, timing, at)
        reason |= extra
        turns = turns and extra == 0
        doubt, now_seen = judge_step(m.watch, timing.limits, inputs, seen, reason, turns)
        m.t_ns[n], m.doubt[n] = at - lag, doubt
        _go_back(m, c, x, inputs, now_seen)
        missing = reason != 0
        _be_wary(m, x, doubt & _INCONSISTENT != 0)
        reason = step(c, x, m.carried, inputs, reason | (doubt if now_seen else 0))
        seen_since = m.watch[0].unsure == 0 or m.watch[0].started != 0
        sound = (reason | doubt) & ~_SOUND == 0 and seen_since
        keep(m.carried, m.kept, sound, c.keep_steps)
        now = m.carried.moment[0]
        _slid(m, c, x, inputs, missing)
        if timing.limits.on and abs(now.out_force) > timing.limits.estimate_n:
            doubt |= _IMPLAUSIBLE
            now.settle_steps = max(now.settle_steps, c.settle_steps)
        m.reason[n] = reason | doubt
        m.estimate[n, 0], m.estimate[n, 1] = now.out_force, now.out_friction
        m.grid[0] += timing.step_ns
        n += 1
    return n


@kernel
def take_all(m: Memory, timing: Timing, waiting: Waiting) -> None:
    """The samples that wait; none does then."""
    for k in range(waiting.filled[0]):
        push(m, timing, waiting.signal[k], waiting.t_ns[k], waiting.value[k])
    waiting.filled[0] = 0


@kernel
def take_and_advance(
    m: Memory, timing: Timing, c: Constants, x: Physics, waiting: Waiting, t: int
) -> tuple[int, int, float, float, int]:
    """The samples that wait, then a sync frame of stamp ``t``, in one call.

    (estimates that are new; of the newest: instant, force, friction, reason).
    """
    take_all(m, timing, waiting)
    rows = advance(m, timing, c, x, t)
    k = max(rows - 1, 0)
    return rows, m.t_ns[k], m.estimate[k, 0], m.estimate[k, 1], m.reason[k]
