"""Whether signals can be what they say: range, rate, frozen, angle against speed, torque jumps.

A frame with a right CRC and a running counter may still carry nonsense. What a sample cannot be is
taken out as it arrives; what several signals cannot be together is told beside the estimate
(docs/theory-estimator.md, "Plausibility"). Compiled; all that is remembered is one record.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.estimation.creep import CREPT_RING, follow_creep
from eps_hil.estimation.holes import blind, course, in_the_dark, lose_course, unseen
from eps_hil.estimation.records import copy
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs, smoothing
from eps_hil.estimation.speed_and_angle import (
    LEAK_PER_MS,
    RING,
    SLOW_LEAK_PER_MS,
    SMOOTHED_S,
    SUDDEN,
    WRAP,
    angle_off,
    jumped_alone,
    jumped_in_hole,
    mean_noise,
    mean_share,
    relation_steps,
    spiked_alone,
)
from eps_hil.estimation.state import Records, record_of
from eps_hil.estimation.torque_jumps import (
    add_pace,
    bend_noise,
    bridge,
    due_noise,
    hinge,
    latched,
    swing_hinge,
    watch_jump,
)
from eps_hil.estimation.validity import Reason
from eps_hil.physics.model import Model

COUNT = 5
"""Signals: motor torque, torque sensor, speed, angle, load cell, as in ``stream.SIGNALS``."""
_TORQUE, _SENSOR, _SPEED, _ANGLE = range(4)
_RANGE, _RATE = int(Reason.RANGE), int(Reason.RATE)
_FROZEN, _INCONSISTENT = int(Reason.FROZEN), int(Reason.INCONSISTENT)
_CONTINUOUS_NS = 50_000_000
_MOVING_RAD_S = 1.0
_REPEATS_MEMORY, _LEARNT = 256, 32
_NO_ACCIDENT = math.log(1e-9)
"""A run of equal samples that is less likely than this, by how often neighbours are equal."""
_TURNS = 0.9
"""The most that may be known of how often noise turns back; white noise does at two of three."""
_WHITE_TURNS, _MOSTLY_NOISE = 2.0 / 3.0, 0.4
_EQUAL_NOISE = 0.03
"""The least that is taken for how often two samples of noise are equal."""
_NONE_OF = 3.0
"""What none of n was may be as often as 3 of n (95 %)."""
_SPREAD_MEMORY_MS, _FIRST_SPREAD = 512.0, 1.0
_TOLD_S, _EDGE_S, _WINDOW_S = 0.2, 0.002, 0.010
_BRIDGED_S = 0.018
"""A hole at whose end a jump of the torque is still told from the load's own course."""
_STALLED_S = 1.5
"""How long torque is doubted that stood still, or whose jump back may have been missed."""
_ANGLE_SIGMA = 10.0
_ZERO_S = 0.02
"""Over so long an angle that jumped tells where its zero is now."""

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Watch:
    """What is remembered of signals and of how they fit each other."""

    # Of each signal: the last sample and its stamp, equal ones in a row while the rotor moved,
    # how often neighbours are equal and of how many that was learnt, whether it stands still now,
    # why one was taken out last.
    last: Annotated[Floats, COUNT]
    last_ns: Annotated[Ints, COUNT]
    same: Annotated[Ints, COUNT]
    repeats: Annotated[Floats, COUNT]
    learnt: Annotated[Ints, COUNT]
    # The same at rest: equal ones in a row, the last change, how often it turned back, of how many.
    still: Annotated[Ints, COUNT]
    change: Annotated[Floats, COUNT]
    turns: Annotated[Floats, COUNT]
    equals: Annotated[Floats, COUNT]
    rested: Annotated[Ints, COUNT]
    # How often both torques are equal to those before at once, and of how many that was learnt.
    both: float
    paired: int
    frozen: Annotated[Ints, COUNT]
    refused: Annotated[Ints, COUNT]
    moving: int
    # Aligned T_1m, less what is unexplained of it, and speed of the last steps.
    torque: Annotated[Floats, RING]
    speed: Annotated[Floats, RING]
    # The speed as it would be if the friction stayed the same, and its bend; what is added to the
    # speed for that (rad/s), the friction torque (Nm) that it makes up for, that of the last step,
    # whether that was known, and the bristle (rad) that makes it.
    pace: Annotated[Floats, RING]
    bend: Annotated[Floats, RING]
    lent: float
    changed_nm: float
    friction_nm: float
    friction_known: int
    bristle: float
    steps: int
    # The step at which the torque left its course last, what it was, and its slope (Nm a step).
    edge_at: int
    edge_nm: float
    edge_slope: float
    # Steps without inputs until now, or without a torque that was seen; its slope before them.
    hole: int
    unseen: int
    slope_nm: float
    # How wrong a torque may be that was guessed (Nm², 0: it was seen), and the one before the hole;
    # how many were guessed in a row; how far the torque bends by itself (Nm²; holes.py).
    doubt: Annotated[Floats, RING]
    guess_before: float
    guesses: int
    swing: float
    # For how many steps the speed was drawn straight between samples until now, and for how many
    # more its bend may be that of the drawing; the same count at each of the last steps; the steps
    # at either side of the last hole of the speed (-1: none that counts).
    drawn: int
    dark: int
    drawn_at: Annotated[Ints, RING]
    hole_first: int
    hole_last: int
    # Innovation of the motion after a torque jump: its spread, that of the bend beside a swing, the
    # jumps that nothing followed, whether much was left of the last as it jumped back, and whether
    # one came in a doubt that was estimated on with.
    spread: float
    residual: float
    innovation: float
    unexplained_nm: float
    left: int
    stalled: int
    missed: int
    misled: int
    told: int
    quiet: int
    # For how many steps more the torque may be wrong since nobody looked; whether that is now;
    # whether it is since a start, which a recording is not asked to wait for.
    unsure: int
    missed_now: int
    started: int
    # For how many steps more the motion has to confirm what the torque did in a hole; how far it
    # was read from its course at most within the hole that lasts (Nm).
    awaited: int
    strayed: float
    # Whether speed and angle part at this step; for how many steps in a row (1, or more: 2); and
    # whether the angle jumped at one of the first two, which is one jump that was read half way.
    parted: int
    parting: int
    sudden: int
    # Angle less the speed's path, and what scales its tolerance; the angle of the step before.
    slip: float
    path: float
    gain: float
    angle: float
    # Means of slip, path and gain over some milliseconds.
    mean_slip: float
    mean_path: float
    mean_gain: float
    # The same over a tenth of a second, and the angle's way in it.
    slow: float
    turned: float
    slow_gain: float
    # Gain and lag that this rig was seen to have in them: sums of their least squares, what they
    # are, their covariance (0: unknown), and the mean square of what they leave, in parts of what
    # is expected of it; for how many steps more nothing is learnt, and for how many they doubt.
    turned_square: float
    turned_change: float
    change_square: float
    turned_slow: float
    change_slow: float
    gain_off: float
    lag_s: float
    gain_variance: float
    lag_variance: float
    gain_and_lag: float
    relation_left: float
    unlike: int
    unlike_alone: int
    # The angle's way less the speed's, summed: a speed that leaves its own course bends it.
    apart: Annotated[Floats, RING]
    # The angle without its jumps, smoothed, and followed past its noise, at each of the last steps;
    # its zero, and of how many samples that is the mean; what is drawn of it, and of the speed's
    # way, until a sample comes; steps without missing ones.
    ahead: float
    zero: float
    zeroed: int
    smooth: float
    followed: float
    crept: Annotated[Floats, CREPT_RING]
    pending_turn: float
    pending_way: float
    unbroken: int


WATCH = record_of(Watch)


class Limits(NamedTuple):
    """Numbers of :class:`~eps_hil.estimation.settings.PlausibilitySettings` for compiled code."""

    on: bool
    step_s: float
    most: Floats
    rate: Floats
    frozen_samples: int
    window: int
    lag: int
    inverse_inertia: float
    ratio: float
    sensor_to_rotor: float
    jump: float
    consistent_steps: int
    told_steps: int
    stalled_steps: int
    unsure_steps: int
    bridged: int
    edge: int
    hinge: Floats
    hinge_noise: float
    bend_noise: float
    due_noise: float
    spread_memory: float
    swing_before: int
    swing_every: int
    swing_hinge: Floats
    swing_noise: float
    leak: float
    slow_leak: float
    slow_noise: float
    slow_rest: float
    learn_every: int
    relation_memory: float
    related_steps: int
    creep_share: float
    zero_steps: int
    mean_share: float
    mean_angle_noise: float
    mean_speed_noise: float
    angle_seen: bool
    angle_noise: float
    angle_tolerance: float
    sudden_turn: float
    estimate_n: float


def new_watch() -> Records:
    """Nothing seen yet."""
    watch = np.zeros(1, WATCH)
    watch["spread"], watch["residual"], watch["repeats"] = _FIRST_SPREAD, _FIRST_SPREAD, 1.0
    watch["missed_now"], watch["started"], watch["hole_first"] = 1, 1, -1
    return watch


_NEW = new_watch()


@kernel
def _each(of: npt.NDArray[Any]) -> tuple[Any, Any, Any, Any, Any]:
    """A number of every signal, COUNT of them, by value."""
    return of[0], of[1], of[2], of[3], of[4]


@kernel
def watch_anew(watch: Records) -> None:
    """Nothing seen yet, after a jump of time; what is of the rig's signals stays known."""
    w = watch[0]
    spread, residual, repeats, learnt = w.spread, w.residual, _each(w.repeats), _each(w.learnt)
    turns, equals, rested = _each(w.turns), _each(w.equals), _each(w.rested)
    both, paired = w.both, w.paired
    sums = w.turned_square, w.turned_change, w.change_square, w.turned_slow, w.change_slow
    known = w.gain_off, w.lag_s, w.gain_variance, w.lag_variance, w.gain_and_lag, w.relation_left
    copy(watch, 0, _NEW, 0)
    w.turned_square, w.turned_change, w.change_square, w.turned_slow, w.change_slow = sums
    w.gain_off, w.lag_s, w.gain_variance, w.lag_variance, w.gain_and_lag, w.relation_left = known
    w.spread, w.residual, w.started = spread, residual, 0
    w.both, w.paired = both, paired
    for i in range(COUNT):
        w.repeats[i], w.learnt[i] = repeats[i], learnt[i]
        w.turns[i], w.equals[i], w.rested[i] = turns[i], equals[i], rested[i]


def limits_of(model: Model, settings: EstimatorSettings, angle_seen: bool) -> Limits:
    """Limits of a model and its settings; what is not set follows from the model."""
    chosen, ratio = settings.plausibility, model.rack_to_rotor_ratio_rad_per_m
    torque = chosen.largest_torque_nm(ratio)
    most = (torque, chosen.torque_sensor_nm, chosen.motor_speed_rad_s, math.inf, math.inf)
    fastest = chosen.largest_acceleration_rad_s2(ratio, model.inertia_kg_m2)
    rate = (math.inf, math.inf, fastest, chosen.largest_turning_rad_s, math.inf)
    step_s, step_ms = settings.step_s, settings.step_s * 1e3
    stiff = math.sqrt(model.friction.sigma0_nm_per_rad / model.inertia_kg_m2)
    window = min(max(round(1.5 / stiff / step_s), 4), round(_WINDOW_S / step_s))
    slow, leak, share = SLOW_LEAK_PER_MS**step_ms, LEAK_PER_MS**step_ms, mean_share(step_s)
    by_angle, by_speed = mean_noise(leak, share, step_s)
    before = min(3 * window, WRAP - 1 - window)
    learn_every, relation_memory, related_steps = relation_steps(step_s)
    return Limits(
        on=chosen.enabled,
        step_s=step_s,
        most=np.array(most),
        rate=np.array(rate),
        frozen_samples=chosen.frozen_samples,
        window=window,
        lag=math.ceil(SMOOTHED_S / step_s) + 1,
        inverse_inertia=1.0 / model.inertia_kg_m2,
        ratio=ratio,
        sensor_to_rotor=model.sensor_to_rotor,
        jump=chosen.jump_chi_square,
        consistent_steps=round(chosen.consistent_s / step_s),
        told_steps=round(_TOLD_S / step_s),
        stalled_steps=round(_STALLED_S / step_s),
        unsure_steps=round(chosen.unseen_s / step_s),
        bridged=round(_BRIDGED_S / step_s),
        edge=max(round(_EDGE_S / step_s), 1),
        hinge=hinge(window),
        hinge_noise=float(np.sum(hinge(window) ** 2)),
        bend_noise=bend_noise(hinge(window)),
        due_noise=due_noise(window, step_s, 1.0 / model.inertia_kg_m2),
        spread_memory=step_ms / _SPREAD_MEMORY_MS,
        swing_before=before,
        swing_every=max(window // 2, 1),
        swing_hinge=swing_hinge(before, window),
        swing_noise=float(np.sum(swing_hinge(before, window) ** 2)),
        leak=leak,
        slow_leak=slow,
        slow_noise=step_s**2 / (1.0 - slow**2),
        slow_rest=settings.dead_zone_rad_s * step_s / (1.0 - slow),
        learn_every=learn_every,
        relation_memory=relation_memory,
        related_steps=related_steps,
        creep_share=smoothing(settings.creep_low_pass_hz, step_s),
        zero_steps=max(round(_ZERO_S / step_s), 1),
        mean_share=share,
        mean_angle_noise=by_angle,
        mean_speed_noise=by_speed,
        angle_seen=angle_seen,
        angle_noise=settings.angle_noise_rad**2,
        angle_tolerance=_ANGLE_SIGMA * settings.angle_noise_rad,
        sudden_turn=max(fastest * step_s**2, 3.0 * _ANGLE_SIGMA * settings.angle_noise_rad),
        estimate_n=chosen.estimate_n,
    )


@kernel
def judge_sample(watch: Records, p: Limits, i: int, t: int, v: float) -> float:
    """The sample of signal ``i``, or NaN where it cannot be what it says."""
    if not p.on or not math.isfinite(v):
        return v
    w = watch[0]
    before, since = w.last[i], t - w.last_ns[i]
    w.last[i], w.last_ns[i] = v, t
    if abs(v) > p.most[i]:
        w.refused[i] = _RANGE
        return math.nan
    if not 0 < since < _CONTINUOUS_NS:
        w.same[i] = w.still[i] = w.frozen[i] = 0
        w.change[i] = 0.0
        return v
    if abs(v - before) > p.rate[i] * max(since * 1e-9, p.step_s):
        w.refused[i] = _RATE
        return math.nan
    if v != before:
        _learn_rest(w, i, v - before)
        w.same[i] = 0
    elif w.moving:
        w.same[i] += 1
    else:
        w.still[i] += 1
    if w.moving and w.same[i] < p.frozen_samples:
        w.learnt[i] = min(w.learnt[i] + 1, _REPEATS_MEMORY)
        w.repeats[i] += ((1.0 if v == before else 0.0) - w.repeats[i]) / w.learnt[i]
    _judge_frozen(w, p, i, v != 0.0)
    return v


@kernel
def _judge_frozen(w: Watch, p: Limits, i: int, on: bool) -> None:
    """Whether signal ``i`` stands still, by how likely its run of equal samples is an accident."""
    moved, rested = 0.0, 0.0
    if on and w.learnt[i] >= _LEARNT and w.same[i] >= p.frozen_samples:
        moved = w.same[i] * math.log(max(w.repeats[i], 1e-3))
    if on and w.rested[i] >= _LEARNT:
        noise = _is_noise(w, i)  # it does not end because the rotor moves
        if w.still[i] + (w.same[i] if noise else 0) >= p.frozen_samples:
            equal = _equal_at_rest(w, i)
            rested = w.still[i] * math.log(equal)
            if noise:
                learnt = w.repeats[i] if w.learnt[i] >= _LEARNT else 0.0
                rested += w.same[i] * math.log(max(equal, learnt))
    w.frozen[i] = 1 if min(moved, rested) < _NO_ACCIDENT else 0
    if i <= _SENSOR and w.last_ns[_TORQUE] == w.last_ns[_SENSOR]:
        _judge_both(w, p)


@kernel
def _is_noise(w: Watch, i: int) -> bool:
    """Whether torque ``i`` turns back at rest as noise does."""
    return i <= _SENSOR and min(w.turns[i], _TURNS) > _MOSTLY_NOISE


@kernel
def _equal_at_rest(w: Watch, i: int) -> float:
    """The most by which two neighbours of signal ``i`` may be equal at rest, by accident."""
    turns = min(w.turns[i], _TURNS)
    equal = 1.0 - turns
    if _is_noise(w, i):  # what is equal there is so for all its noise
        least = max(_EQUAL_NOISE, _NONE_OF / w.rested[i])
        equal = min(equal, max(w.equals[i] * _WHITE_TURNS / turns, least))
    return equal


@kernel
def _equal_by_accident(w: Watch, i: int) -> float:
    """How often neighbours of torque ``i`` are equal as the rotor moves or rests; 1: unknown."""
    if w.last[i] == 0.0:
        return 1.0
    if w.moving:
        return max(w.repeats[i], 1e-3) if w.learnt[i] >= _LEARNT else 1.0
    return _equal_at_rest(w, i) if w.rested[i] >= _LEARNT else 1.0


@kernel
def _judge_both(w: Watch, p: Limits) -> None:
    """Whether both torques stand still: noises of two sensors are seldom equal at once.

    How often they are is also learnt, for a sender that now and then sends both once more.
    """
    run = min(w.same[_TORQUE] + w.still[_TORQUE], w.same[_SENSOR] + w.still[_SENSOR])
    if run < p.frozen_samples:
        w.paired = min(w.paired + 1, _REPEATS_MEMORY)
        w.both += ((1.0 if run > 0 else 0.0) - w.both) / w.paired
        return
    rate = _equal_by_accident(w, _TORQUE) * _equal_by_accident(w, _SENSOR)
    rate = max(rate, w.both)
    if w.paired >= _LEARNT and run * math.log(rate) < _NO_ACCIDENT:
        w.frozen[_TORQUE] = w.frozen[_SENSOR] = 1


@kernel
def _learn_rest(w: Watch, i: int, change: float) -> None:
    """How often signal ``i`` turns back at rest, and how often it repeats itself there.

    Noise turns back at two of three samples. A quantised signal without noise stands still with the
    rotor, and a creeping one goes one way: of these nothing is learnt that could be missed.
    """
    if not w.moving and not w.frozen[i]:
        n = min(w.still[i] + 1, _REPEATS_MEMORY)
        w.rested[i] = min(w.rested[i] + n, _REPEATS_MEMORY)
        turned = 1.0 if change * w.change[i] < 0.0 else 0.0
        w.turns[i] += (turned / n - w.turns[i]) * n / w.rested[i]
        w.equals[i] += ((n - 1.0) / n - w.equals[i]) * n / w.rested[i]
    w.still[i], w.change[i] = 0, change


@kernel
def _miss(w: Watch, p: Limits, u: Inputs, turns: bool) -> None:
    """A step with missing inputs; where the rotor still ``turns`` in sight, its way is followed."""
    w.slip, w.path, w.gain = 0.0, 0.0, 0.0
    w.mean_slip, w.mean_path, w.mean_gain = 0.0, 0.0, 0.0
    w.slow, w.turned, w.slow_gain = 0.0, 0.0, 0.0
    if turns and p.angle_seen and w.unbroken > 0:
        follow_creep(w, p, u)
        w.angle = u.motor_angle_rad
    else:
        w.pending_turn, w.pending_way, w.unbroken = 0.0, 0.0, 0


@kernel
def _speed_before(w: Watch, p: Limits, u: Inputs) -> float:
    """The speed (rad/s) of the step before; where nothing was seen then, as it is now."""
    if w.steps > 0 and w.hole == 0:
        return float(w.speed[(w.steps - 1) & WRAP])
    if w.unbroken == 0:
        w.angle = u.motor_angle_rad - u.motor_speed_rad_s * p.step_s
    return u.motor_speed_rad_s


@kernel
def judge_step(
    watch: Records, p: Limits, u: Inputs, seen: bool, missing: int, turns: bool
) -> tuple[int, bool]:
    """Reason bits of signals that do not fit each other, and whether that is seen at this moment.

    ``seen``: T_1m is read where no samples are lost. ``missing``: why inputs are missing, or 0;
    ``turns``: speed and angle are not. What is doubted for something past is estimated on.
    """
    if not p.on:
        return 0, False
    w = watch[0]
    parting, w.parted, w.parting = w.parting, 0, 0
    if missing != 0:
        _miss(w, p, u, turns)
        blind(w, p, u.motor_speed_rad_s, missing & (_RANGE | _RATE) != 0)
        return latched(w, p), w.told > 0
    if not seen and w.unseen > p.bridged and w.steps > 0:  # drawn straight: nobody saw it
        lose_course(w)
    before = _speed_before(w, p, u)
    if w.hole > 0:
        bridge(w, p, u)
    in_the_dark(w, p, u.speed_periods > 1.0)
    at = w.steps & WRAP
    reason = unseen(w, p)
    torque = u.motor_torque_nm + p.sensor_to_rotor * u.torque_sensor_nm
    w.torque[at] = course(w, p, torque - w.unexplained_nm, u.drive_noise, seen)
    w.speed[at] = u.motor_speed_rad_s
    add_pace(w, p)
    w.steps += 1
    w.moving = 1 if abs(u.motor_speed_rad_s) > _MOVING_RAD_S else 0
    watch_jump(w, p, u)
    reason |= latched(w, p)
    now = w.told > 0
    if p.angle_seen:
        follow_creep(w, p, u)
    off = angle_off(w, p, u, before) if p.angle_seen else 0
    if p.angle_seen and (jumped_alone(w, p, u) or jumped_in_hole(w, p, u)):
        w.stalled, w.missed, off = p.stalled_steps, 1, 1
    elif p.angle_seen and spiked_alone(w, p, u):
        off = 1
    if off:
        w.parted, w.parting = 1, min(parting + 1, 2)
        if parting < 2:
            w.sudden = 1 if off == SUDDEN else 0
        reason |= _INCONSISTENT
        now = True
    for i in range(COUNT):
        if w.frozen[i]:
            reason |= _FROZEN | _INCONSISTENT
            w.stalled, w.missed = p.stalled_steps, 1
            now = True
    return reason, now
