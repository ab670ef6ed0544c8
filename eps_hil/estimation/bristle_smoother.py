"""The bristle filter over a whole recording, forth and back: what an estimate can know afterwards.

Forward the filter of ``bristle_filter.py``, without what it refuses live; backward the modified
Bryson-Frazier recursion, which needs no inverse of a covariance that sliding makes singular. A
stretch that begins with a start (first samples, a gap) is smoothed by itself, and a bristle that
nobody knew there is known as far back as the smoothed covariance says: sliding makes it known by
forgetting what it was. Done in blocks that look ``AHEAD_STEPS`` beyond their end, so memory does
not grow with the recording.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.estimation import stream_steps as steps
from eps_hil.estimation.bristle_filter import (
    PhysicsInside,
    filter_step,
    friction_nm,
    in_mid_travel,
    take_bristle,
    unknown_torque_nm,
)
from eps_hil.estimation.bristle_setup import BRISTLE, FORCE, OMEGA, PHI, SIZE
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Constants, Inputs, Physics
from eps_hil.estimation.state import HELD, NEVER_RAN, Carried, Moment, begin_anew
from eps_hil.estimation.stream import StreamEstimator
from eps_hil.estimation.stream_timing import Timing
from eps_hil.estimation.validity import Reason
from eps_hil.physics.friction import FrictionLaw
from eps_hil.physics.model import Model

BLOCK_STEPS = 60_000
AHEAD_STEPS = 5_000

Floats = npt.NDArray[np.float64]
Int64 = npt.NDArray[np.int64]

_TIME, _NOT_FROM_INPUTS = int(Reason.TIME), int(Reason.NOT_STARTED | Reason.TIME)
_REFUSED = int(Reason.INCONSISTENT | Reason.FROZEN)
"""Doubts in which nothing is taken from the signals."""
_IMPLAUSIBLE = int(Reason.IMPLAUSIBLE)
_SETTLING, _DIVERGED = int(Reason.SETTLING), int(Reason.DIVERGED)
_UNKNOWN = int(Reason.FRICTION_UNKNOWN)
_START, _HELD, _STEP = 0, 1, 2
_ANYTHING_NM = 1e9


class Forward(NamedTuple):
    """What the backward pass needs of each step; ``kind`` says start, held or step.

    ``lost``: 1 where the friction is unknown, and no later motion tells of it: the rotor may have
    crept at rest and no angle shows it, or effects remember what nobody saw.
    """

    kind: npt.NDArray[np.int8]
    lost: npt.NDArray[np.int8]
    reason: Int64
    mean: Floats
    cov: Floats
    jacobian: Floats
    gain: Floats
    innovation: Floats
    spread: Floats
    extra: Floats


def _room(steps: int) -> Forward:
    return Forward(
        np.zeros(steps, np.int8),
        np.zeros(steps, np.int8),
        np.zeros(steps, np.int64),
        np.zeros((steps, SIZE)),
        np.zeros((steps, SIZE, SIZE)),
        np.zeros((steps, SIZE, SIZE)),
        np.zeros((steps, 2, SIZE)),
        np.zeros((steps, 2)),
        np.ones((steps, 2)),
        np.zeros((steps, 3)),
    )


@njit
def _bristle(s: Moment) -> tuple[float, float]:
    """Deflection (rad), and what is unknown of its torque (Nm)."""
    if s.running == NEVER_RAN:
        return 0.0, _ANYTHING_NM
    return s.bristle, s.unknown_nm + s.unseen_nm


@njit
def _gather(
    m: steps.Memory,
    timing: Timing,
    c: Constants,
    x: Physics,
    signal: npt.NDArray[np.int8],
    t_ns: Int64,
    value: Floats,
    out_t: Int64,
    out: Floats,
    out_wrong: Int64,
    out_doubt: Int64,
) -> int:
    """All inputs on the grid of the stream, what is wrong with them, and what the filter, which
    runs beside, has of doubts, and of the bristle; rows written."""
    rows, lag = 0, int(round(c.output_lag_s * 1e9))
    bristle, unknown_nm = 0.0, _ANYTHING_NM
    for k in range(len(signal)):
        if signal[k] >= 0:
            steps.push(m, timing, signal[k], t_ns[k], value[k])
            continue
        due = min(steps.advance(m, timing, c, x, t_ns[k]), len(out_t) - rows)
        for n in range(due):
            if n == due - 1:
                bristle, unknown_nm = _bristle(m.carried.moment[0])
            at = m.t_ns[n] + lag
            inputs, reason, _, _ = steps.gather(m, timing, at)
            out_t[rows], out_doubt[rows] = at, m.doubt[n]
            out_wrong[rows] = reason | m.reason[n] & _NOT_FROM_INPUTS | m.doubt[n] & _REFUSED
            out[rows, 0], out[rows, 1], out[rows, 2] = inputs[0], inputs[1], inputs[2]
            out[rows, 3], out[rows, 4] = inputs[3], inputs.speed_noise
            out[rows, 5], out[rows, 6] = bristle, unknown_nm
            rows += 1
    return rows


@njit
def _forward(
    c: Constants,
    x: PhysicsInside,
    e: Carried,
    inputs: Floats,
    wrong: Int64,
    to: Forward,
    since: int,
    until: int,
) -> None:
    b, s = x.belief, e.moment[0]
    for k in range(since, until):
        if wrong[k] & _TIME:
            begin_anew(e)
        u = Inputs(
            inputs[k, 0], inputs[k, 1], inputs[k, 2], inputs[k, 3], 0.0,
            -1.0, inputs[k, 4], -1.0, 1.0, 1.0,
        )  # fmt: skip
        if s.running == HELD and inputs[k, 5] == inputs[k, 5]:
            take_bristle(c, x.law, s, u, inputs[k, 5], inputs[k, 6])
        why = filter_step(c, x, e, u, wrong[k])
        to.kind[k] = _HELD
        if wrong[k] == 0 and why & _DIVERGED == 0:
            to.kind[k] = _START if b.place[1] == 1 else _STEP
        to.reason[k] = why & ~(_SETTLING | _UNKNOWN)
        at_rack = s.local * c.ratio
        if wrong[k] == 0 and s.unknown_nm * at_rack > c.unknown_limit_n:
            to.reason[k] |= _UNKNOWN
        lost_n = max(s.unseen_nm * at_rack, e.rig[0].memory_n)
        to.lost[k] = 1 if lost_n > c.unknown_limit_n else 0
        to.mean[k], to.cov[k], to.jacobian[k] = b.mean, b.cov, b.jacobian
        to.gain[k], to.innovation[k], to.spread[k], to.extra[k] = (
            b.gain,
            b.innovation,
            b.spread,
            b.extra,
        )


@njit
def _tell(told: Floats, at: int, gain: Floats, spread: float, scratch: Floats) -> None:
    """What a measurement of state ``at`` tells, added to what later ones ``told`` (SIZE, SIZE)."""
    taken = 1.0 / spread
    for i in range(SIZE):
        scratch[i] = 0.0
        for j in range(SIZE):
            scratch[i] += told[i, j] * gain[j]
        taken += gain[i] * scratch[i]
    for i in range(SIZE):
        told[i, at] -= scratch[i]
        told[at, i] -= scratch[i]
    told[at, at] += taken


@njit
def _before(told: Floats, jacobian: Floats, scratch: Floats) -> None:
    """What is ``told`` (SIZE, SIZE) of a state, of the one a step before."""
    for i in range(SIZE):
        for j in range(SIZE):
            scratch[i, j] = 0.0
            for m in range(SIZE):
                scratch[i, j] += told[i, m] * jacobian[m, j]
    for i in range(SIZE):
        for j in range(i, SIZE):
            told[i, j] = 0.0
            for m in range(SIZE):
                told[i, j] += jacobian[m, i] * scratch[m, j]
            told[j, i] = told[i, j]


@njit
def _backward(angle: bool, law: FrictionLaw, of: Forward, n: int, out: Floats) -> None:
    """[rack force (N), friction (Nm), what is unknown of it (Nm)] (n, 3) given all measurements up
    to step ``n``: the adjoint state and its covariance."""
    adjoint, scratch, smooth = np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE)
    told, square = np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
    for k in range(n - 1, -1, -1):
        variance = of.cov[k, BRISTLE, BRISTLE]
        for i in range(SIZE):
            smooth[i] = of.mean[k, i]
            for j in range(SIZE):
                smooth[i] -= of.cov[k, i, j] * adjoint[j]
                variance -= of.cov[k, BRISTLE, i] * told[i, j] * of.cov[k, j, BRISTLE]
        local = of.extra[k, 2]
        out[k, 0] = local * smooth[FORCE]
        out[k, 1] = friction_nm(in_mid_travel(law, local), of.extra[k], smooth)
        out[k, 2] = unknown_torque_nm(law, variance)
        if of.kind[k] == _HELD:
            continue
        for which in range(1, -1, -1):
            if which == 1 and not angle:
                continue
            at, gain = PHI if which == 1 else OMEGA, of.gain[k, which]
            taken, spread = 0.0, of.spread[k, which]
            for j in range(SIZE):
                taken += gain[j] * adjoint[j]
            adjoint[at] -= taken + of.innovation[k, which] / spread
            _tell(told, at, gain, spread, scratch)
        if of.kind[k] != _STEP:
            adjoint[:] = 0.0
            told[:, :] = 0.0
            continue
        for j in range(SIZE):
            scratch[j] = 0.0
            for i in range(SIZE):
                scratch[j] += of.jacobian[k, i, j] * adjoint[i]
        adjoint[:] = scratch
        _before(told, of.jacobian[k], square)


@dataclass(frozen=True, slots=True)
class Smoothed:
    """Estimates at the instants of their inputs, all (n,), and the filter's innovations.

    ``nis`` (n, 2): squared innovation over its variance, [speed, angle]: about 1 on average where
    the assumed noise is that of the recording; NaN where there was no step.
    """

    t_ns: Int64
    rack_force_n: Floats
    friction_torque_nm: Floats
    reason: Int64
    nis: Floats


def smooth(
    model: Model,
    settings: EstimatorSettings,
    periods_s: Mapping[str, float],
    events: tuple[npt.NDArray[np.int8], Int64, Floats],
) -> Smoothed:
    """All events of a recording (``batch.events``) through filter and smoother.

    ``ValueError`` for settings or signals that will not do.
    """
    chosen = replace(settings, kind="bristle_filter")
    beside, like = (StreamEstimator(model, chosen, periods_s) for _ in range(2))
    c, x, e = like.constants, like.physics, like.memory.carried
    assert isinstance(x, PhysicsInside)
    b = x.belief
    rows = _most_rows(*events[:2], settings.step_ns)
    t, inputs, wrong = np.empty(rows, np.int64), np.empty((rows, 7)), np.empty(rows, np.int64)
    doubt = np.empty(rows, np.int64)
    n = int(_gather(beside.memory, beside.timing, c, beside.physics, *events,
                    t, inputs, wrong, doubt))  # fmt: skip
    t, inputs, wrong, doubt = t[:n], inputs[:n], _foreseen(wrong[:n], 2 * c.keep_steps), doubt[:n]
    inputs[~_behind_doubts(wrong), 5:] = np.nan
    lost = np.zeros(n, np.bool_)
    out, reason, nis = np.empty((n, 3)), np.empty(n, np.int64), np.full((n, 2), np.nan)
    room = _room(min(n, BLOCK_STEPS + AHEAD_STEPS))
    for since in range(0, n, BLOCK_STEPS):
        own, whole = min(BLOCK_STEPS, n - since), min(BLOCK_STEPS + AHEAD_STEPS, n - since)
        part = slice(since, since + whole)
        _forward(c, x, e, inputs[part], wrong[part], room, 0, own)
        kept = [array.copy() for array in (*b, *e, x.effects.state)]
        _forward(c, x, e, inputs[part], wrong[part], room, own, whole)
        both = np.empty((whole, 3))
        _backward(x.filter.angle, x.law, room, whole, both)
        for array, before in zip((*b, *e, x.effects.state), kept, strict=True):
            array[...] = before
        out[since : since + own] = both[:own]
        known = both[:own, 2] * room.extra[:own, 2] * c.ratio <= c.unknown_limit_n
        reason[since : since + own] = room.reason[:own] & np.where(known, ~_UNKNOWN, -1)
        lost[since : since + own] = room.lost[:own] != 0
        stepped = room.kind[:own] != _HELD
        nis[since : since + own][stepped] = (room.innovation**2 / room.spread)[:own][stepped]
    reason |= doubt | np.where(lost, _UNKNOWN, 0)
    reason |= np.where(_beside(wrong & _REFUSED != 0, c.keep_steps), _SETTLING, 0)
    if like.timing.limits.on:
        reason |= np.where(np.abs(out[:, 0]) > like.timing.limits.estimate_n, _IMPLAUSIBLE, 0)
    return Smoothed(t, out[:, 0], out[:, 1], reason, nis)


def _most_rows(kind: npt.NDArray[np.int8], t_ns: Int64, step_ns: int) -> int:
    """How many steps there can be: a jump of the clock has none, be it by decades."""
    sync = t_ns[kind < 0]
    seen = np.clip(np.diff(sync), 0, steps.JUMP_NS)
    return int(np.sum(seen) // step_ns) + 2 * len(sync) + 2


def _foreseen(wrong: Int64, before: int) -> Int64:
    """What is refused, from so many steps ``before`` it was: a doubt comes some steps late.

    As far as the live filter goes back at most, to the older of two states.
    """
    told, bits = wrong.copy(), wrong & _REFUSED
    for k in np.flatnonzero((bits[1:] != 0) & (bits[:-1] == 0)) + 1:
        told[max(k - before, 0) : k] |= bits[k]
    return told


def _behind_doubts(wrong: Int64) -> npt.NDArray[np.bool_]:
    """Where estimating goes on after a doubt. There the bristle is that of the filter beside, which
    was told what the doubt was of: an angle that jumped shows no way that a rotor went."""
    k, number = np.arange(len(wrong)), np.cumsum(np.concatenate([[0], wrong & _REFUSED != 0]))
    fine = np.maximum.accumulate(np.where(wrong == 0, k, -1))
    last = np.concatenate([[-1], fine[:-1]])
    return (wrong == 0) & (number[k] > number[last + 1])


def _beside(refused: npt.NDArray[np.bool_], steps: int) -> npt.NDArray[np.bool_]:
    """Rows so near a refused stretch that what is known of them leans on it: there the force is
    the model's alone, and measurements beside it take some steps to bind it."""
    number = np.cumsum(np.concatenate([[0], refused]))
    k = np.arange(len(refused))
    since, until = np.maximum(k - steps, 0), np.minimum(k + steps + 1, len(refused))
    return (number[until] > number[since]) & ~refused
