"""What the plausibility tests remember of signals, and how they fit each other: one record.

The tests that fill it are in plausibility.py, frozen.py, speed_and_angle.py, gain_and_lag.py,
creep.py, torque_jumps.py and holes.py. Compiled code reads and writes its fields by name.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.estimation.records import copy
from eps_hil.estimation.state import Records, record_of

COUNT = 5
"""Signals: motor torque, torque sensor, speed, angle, load cell, as in ``stream.SIGNALS``."""
RING = 256
WRAP = RING - 1
"""``n & WRAP`` is ``n % RING``, of which there are dozens a step."""
CREPT_RING = 1024
_FIRST_SPREAD = 1.0
NO_STEP = -(1 << 40)
"""Before any step that is looked at."""

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
    # Its smallest change, and whether (0 or 1) it was seen to stand still with less noise than
    # that.
    step: Annotated[Floats, COUNT]
    coarse: Annotated[Ints, COUNT]
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
    # Steps that the torque's course is known for; the same, by which the bend beside a swing and
    # the relation of speed and angle are due: a division takes longer than to count.
    steps: int
    swing_turn: int
    relation_turn: int
    # The step at which the torque left its course last, what it was, and its slope (Nm a step).
    edge_at: int
    edge_nm: float
    edge_slope: float
    # Steps without inputs until now, or without a torque that was seen; of late, by how many more
    # it was not seen than it was; its slope before them.
    hole: int
    unseen: int
    scarce: int
    slope_nm: float
    # How wrong a torque may be that was guessed (Nm², 0: it was seen), and the one before the hole;
    # how many were guessed in a row; how far the torque bends by itself (Nm²; holes.py).
    doubt: Annotated[Floats, RING]
    # The newest step whose torque was guessed.
    guessed_at: int
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
    # For how many steps more what was learnt as noise in a doubt may be what was doubted.
    noisy: int
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
    # are, their covariance, and the mean square of what they leave, in parts of what
    # is expected of it; how often they were looked at; for how many steps more nothing is
    # learnt, and for how many they doubt.
    turned_square: float
    turned_change: float
    change_square: float
    turned_slow: float
    change_slow: float
    slow_square: float
    gain_off: float
    lag_s: float
    gain_variance: float
    lag_variance: float
    gain_and_lag: float
    relation_left: float
    looks: int
    unlike: int
    unlike_alone: int
    # The angle's way less the speed's, summed: a speed that leaves its own course bends it;
    # whether (0 or 1) the angle of the last step was drawn over a hole.
    apart: Annotated[Floats, RING]
    angle_drawn: int
    # The angle without its jumps and its newest sample (which may be half a jump); smoothed, and
    # followed past its noise, at each of the last steps; its zero, and of how many samples that
    # is the mean; what is drawn of it, and of the speed's way, until a sample comes; steps without
    # missing ones, and how many of the last had no angle.
    ahead: float
    next_ahead: float
    zero: float
    zeroed: int
    smooth: float
    followed: float
    crept: Annotated[Floats, CREPT_RING]
    pending_turn: float
    pending_way: float
    unbroken: int
    sightless: int


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
    scarce_steps: int
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
    forgotten_steps: int
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
    watch["guessed_at"] = NO_STEP
    return watch


_NEW = new_watch()


@kernel
def next_step(w: Watch, p: Limits) -> None:
    """Another step of which torque and speed are known."""
    w.steps += 1
    w.swing_turn = w.swing_turn + 1 if w.swing_turn + 1 < p.swing_every else 0
    w.relation_turn = w.relation_turn + 1 if w.relation_turn + 1 < p.learn_every else 0


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
    step, coarse = _each(w.step), _each(w.coarse)
    both, paired = w.both, w.paired
    sums = w.turned_square, w.turned_change, w.change_square, w.turned_slow, w.change_slow
    known = w.gain_off, w.lag_s, w.gain_variance, w.lag_variance, w.gain_and_lag, w.relation_left
    looks, square = w.looks, w.slow_square
    copy(watch, 0, _NEW, 0)
    w.turned_square, w.turned_change, w.change_square, w.turned_slow, w.change_slow = sums
    w.gain_off, w.lag_s, w.gain_variance, w.lag_variance, w.gain_and_lag, w.relation_left = known
    w.looks, w.slow_square = looks, square
    w.spread, w.residual, w.started = spread, residual, 0
    w.both, w.paired = both, paired
    for i in range(COUNT):
        w.repeats[i], w.learnt[i] = repeats[i], learnt[i]
        w.turns[i], w.equals[i], w.rested[i] = turns[i], equals[i], rested[i]
        w.step[i], w.coarse[i] = step[i], coarse[i]
