"""Signals that stand still: a run of equal samples that is too long to be an accident.

How often neighbours are equal is learnt of every signal, while the rotor moves and while it rests.
"""

import math

from eps_hil.compiled import kernel
from eps_hil.estimation.watch import Limits, Watch

_TORQUE, _SENSOR = range(2)
_REPEATS_MEMORY, _LEARNT = 256, 32
_NO_ACCIDENT = math.log(1e-9)
"""A run of equal samples that is less likely than this, by how often neighbours are equal."""
_TURNS = 0.9
"""The most that may be known of how often noise turns back; white noise does at two of three."""
_WHITE_TURNS, _MOSTLY_NOISE = 2.0 / 3.0, 0.4
_EQUAL_NOISE = 0.03
"""The least that is taken for how often two samples of noise are equal."""
_DOUBTED, _UNLIKELY = 16, 100
"""So many equal samples of a torque of which nothing was learnt, while the rotor moves, are waited
for; so many are no accident, whatever it is. A coarse, slow torque has runs of less."""
_NONE_OF = 3.0
"""What none of n was may be as often as 3 of n (95 %)."""
_NEAR_ZERO, _ONE_STEP = 2.5, 1.5
"""Steps of a coarse torque within which it may be zero; within which a change is one of them."""
_QUIET = 0.5
"""Share of equal neighbours from which on steps hide a torque's noise."""


@kernel
def take_equal(w: Watch, p: Limits, i: int, before: float, v: float) -> None:
    """Count a sample of signal ``i`` that is equal to the one before, or is not, and judge it."""
    if v != before:
        _learn_step(w, i, abs(v - before))
        _learn_rest(w, i, v - before)
        w.same[i] = 0
    elif w.moving:
        w.same[i] += 1
    else:
        w.still[i] += 1
    if w.moving and w.same[i] < p.frozen_samples:
        w.learnt[i] = min(w.learnt[i] + 1, _REPEATS_MEMORY)
        w.repeats[i] += _share(w.learnt[i]) * ((1.0 if v == before else 0.0) - w.repeats[i])
    _judge_frozen(w, p, i, not _is_off(w, i))


@kernel
def _learn_step(w: Watch, i: int, change: float) -> None:
    """The step of signal ``i``, and whether its noise is less: it then stands still by itself, and
    a run that would be long for others ends by a change of one step."""
    if w.step[i] == 0.0 or change < w.step[i]:
        w.step[i] = change
    if w.same[i] >= _UNLIKELY and change <= _ONE_STEP * w.step[i]:
        w.coarse[i] = 1


@kernel
def _is_off(w: Watch, i: int) -> bool:
    """Whether signal ``i`` reads what one without a load does, for as long as it likes.

    Exactly 0 is a motor that is off, or no sensor. A coarse torque whose steps hide its noise may
    have its zero some steps off.
    """
    if w.last[i] == 0.0:
        return True
    noisy = w.learnt[i] >= _LEARNT and w.repeats[i] < _QUIET
    near = abs(w.last[i]) <= _NEAR_ZERO * w.step[i]
    return i <= _SENSOR and w.coarse[i] != 0 and near and not noisy


@kernel
def _share(learnt: int) -> float:
    """What the newest of so many counts; mostly of as many as are remembered."""
    return 1.0 / _REPEATS_MEMORY if learnt == _REPEATS_MEMORY else 1.0 / learnt


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
    long = w.same[i] >= _UNLIKELY and _untold(w, i)
    w.frozen[i] = 1 if long or min(moved, rested) < _NO_ACCIDENT else 0
    if i <= _SENSOR and w.last_ns[_TORQUE] == w.last_ns[_SENSOR]:
        _judge_both(w, p)


@kernel
def torques_untold(w: Watch) -> bool:
    """Whether the rotor moves and a torque stands still of which nothing is known."""
    return w.moving != 0 and (_untold(w, _TORQUE) or _untold(w, _SENSOR))


@kernel
def _untold(w: Watch, i: int) -> bool:
    """Whether torque ``i`` stands still as the rotor moves, and nothing tells if it may: who began
    to look while it stood still has not learnt how often its neighbours are equal."""
    new = i <= _SENSOR and w.learnt[i] < _LEARNT
    return new and w.same[i] >= _DOUBTED and not _is_off(w, i)


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
    if _is_off(w, i):
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
        w.both += _share(w.paired) * ((1.0 if run > 0 else 0.0) - w.both)
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
        turned, share = 1.0 if change * w.change[i] < 0.0 else 0.0, _share(w.rested[i])
        w.turns[i] += share * (turned - n * w.turns[i])
        w.equals[i] += share * (n - 1.0 - n * w.equals[i])
    w.still[i], w.change[i] = 0, change
