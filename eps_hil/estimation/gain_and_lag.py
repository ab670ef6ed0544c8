"""Gain and lag between speed and angle, as this rig has them: learnt, and no more is excused.

A speed of another filter is later than the angle, and one of another scale larger. Both are
learnt by least squares on the residual over 100 ms; what they do not explain is a fault.
"""

import math

from eps_hil.compiled import kernel
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.watch import Limits, Watch

SCALE, SMOOTHED_S = 0.25, 0.005
"""Gain, in parts of the speed's way, and lag that are excused before they are known."""
LOW_SCALE = SCALE / (1.0 - SCALE)
"""The same gain, in parts of the angle's way."""
MOST = 1.5
"""Tolerances that the slow residual may grow to: it is to be over soon after the fault."""
_MOST_LEARNT = 1.1
"""The same where gain and lag are known: tolerance and residual decay together after a motion."""
_LEARN_S, _LEARN_MOTION_S, _RELATED_FOR_S = 0.02, 4.0, 1.7
"""How often gain and lag between speed and angle are learnt, in motion; over how much of it; for
how long they may doubt alone: then it is they that have changed."""
LEAST_LOOKS, _FORGOTTEN_S = 25, 0.8
"""Looks after which gain and lag are known; what is left of a doubt in sums over 100 ms after so
long is nothing."""
_LEAST_GAIN, _LEAST_LAG_S = 0.002, 0.0001
"""What is left to gain and lag (rms) however well they are known."""
_LEARNT = 0.5
"""Share of its tolerance beyond which nothing is learnt from a residual: it may be a fault."""
_KNOWN_SIGMA = 4.0
"""Deviations of gain and lag within which they are."""
_TOGETHER = 5.0
"""Neighbouring samples of a residual over 100 ms that count as one."""
_IN_MOTION, _SPEED_TELLS = 5.0, 0.5
"""Tolerances that an angle's way in motion is worth, and the speed's share in that way: an angle
that creeps while the speed says little is no fault."""


@kernel
def _off_relation(w: Watch, p: Limits, noise: float) -> tuple[float, float]:
    """The slow residual less what gain and lag make of it, and how large that may be (rad).

    ``noise``: its variance (rad²) at rest.
    """
    off = w.slow - w.gain_off * w.turned - w.lag_s * w.slow_gain
    spread = w.turned * w.turned * w.gain_variance + w.slow_gain * w.slow_gain * w.lag_variance
    spread += 2.0 * w.turned * w.slow_gain * w.gain_and_lag
    moving = _LEAST_GAIN * abs(w.turned) + _LEAST_LAG_S * abs(w.slow_gain)
    tolerance = math.sqrt(p.jump * noise) + _KNOWN_SIGMA * moving
    tolerance *= math.sqrt(max(w.relation_left, 1.0))
    return off, tolerance + p.slow_rest + _KNOWN_SIGMA * math.sqrt(max(spread, 0.0))


@kernel
def unlike(w: Watch, p: Limits, noise: float) -> bool:
    """Whether the slow residual is more than the gain and lag that this rig was seen to have.

    They excuse a third of the way before they are known. ``noise``: variance of the residual
    (rad²) at rest. A relation that changes for good is learnt anew.
    """
    if w.dark > 0 or w.looks < LEAST_LOOKS:
        return False
    off = w.slow - w.gain_off * w.turned - w.lag_s * w.slow_gain
    if off * off < p.jump * noise:  # mostly: the rest is for what may be a fault
        return False
    off, tolerance = _off_relation(w, p, noise)
    if abs(off) < tolerance:
        return False
    most = math.copysign(min(abs(off), _MOST_LEARNT * tolerance), off)
    w.slow += most - off
    off = most
    said, turned = w.turned - off, w.turned
    told = said * turned > _SPEED_TELLS * turned * turned
    if abs(said) <= abs(turned) and not (told and abs(turned) > _IN_MOTION * tolerance):
        return False
    _doubt_relation(w, p, 1)
    return True


@kernel
def _doubt_relation(w: Watch, p: Limits, steps: int) -> None:
    """Count for how long gain and lag are not what they were: at last that is what has changed."""
    w.unlike_alone += steps
    if w.unlike_alone > p.related_steps:
        _forget_relation(w)


@kernel
def doubt_lessons(w: Watch, p: Limits) -> None:
    """Something else tells that speed and angle part: what was learnt lately may be of the fault.

    A relation that is younger than the longest doubt of it is forgotten: a service that is started
    within a fault takes its offset for gain and lag, and would doubt what is right afterwards.
    """
    if w.looks * p.learn_every < p.related_steps:
        _forget_relation(w)


@kernel
def _forget_relation(w: Watch) -> None:
    """Gain and lag are as unknown as at the beginning."""
    w.turned_square = w.turned_change = w.change_square = 0.0
    w.turned_slow = w.change_slow = w.slow_square = w.relation_left = 0.0
    w.gain_variance, w.looks, w.unlike_alone = 0.0, 0, 0


@kernel
def learn_relation(w: Watch, p: Limits, u: Inputs) -> None:
    """Gain and lag of the speed against the angle, by least squares on the slow residual.

    With a speed of (1 + g) times the angle's slope that is τ later the residual is
    −g turned + τ change. Looked at now and then, in motion; what is old is forgotten.
    """
    w.unlike = max(w.unlike - 1, 0)
    if w.unlike > 0 or w.dark > 0 or w.stalled > 0 or w.relation_turn != 0:
        return
    noise = max(u.angle_noise, p.angle_noise) + p.slow_noise * max(u.speed_noise, 0.0)
    if w.turned * w.turned + (SMOOTHED_S * w.slow_gain) ** 2 < p.jump * noise:
        return
    keep, turned, change = p.relation_memory, w.turned, w.slow_gain
    variance = noise + (_LEAST_GAIN * turned) ** 2 + (_LEAST_LAG_S * change) ** 2
    w.looks += 1
    if w.looks > LEAST_LOOKS:
        off, tolerance = _off_relation(w, p, noise)
        if abs(off) > _LEARNT * tolerance:
            _doubt_relation(w, p, p.learn_every)
            return
        w.relation_left += (1.0 - keep) * (off * off / variance - w.relation_left)
        w.unlike_alone = max(w.unlike_alone - p.learn_every, 0)
    weight = 1.0 / (variance * _TOGETHER)
    w.turned_square = keep * w.turned_square + weight * turned * turned
    w.turned_change = keep * w.turned_change + weight * turned * change
    w.change_square = keep * w.change_square + weight * change * change
    w.turned_slow = keep * w.turned_slow + weight * turned * w.slow
    w.change_slow = keep * w.change_slow + weight * change * w.slow
    w.slow_square = keep * w.slow_square + weight * w.slow * w.slow
    scale = 1.0 / max(w.relation_left, 1.0)
    a = scale * w.turned_square + (_KNOWN_SIGMA / LOW_SCALE) ** 2
    b = scale * w.turned_change
    c = scale * w.change_square + (_KNOWN_SIGMA / SMOOTHED_S) ** 2
    first, second, whole = scale * w.turned_slow, scale * w.change_slow, a * c - b * b
    w.gain_off = (c * first - b * second) / whole
    w.lag_s = (a * second - b * first) / whole
    w.gain_variance, w.lag_variance, w.gain_and_lag = c / whole, a / whole, -b / whole
    if w.looks == LEAST_LOOKS:
        w.relation_left = _left_by_relation(w)


@kernel
def _left_by_relation(w: Watch) -> float:
    """The mean square that gain and lag leave of the first looks, in parts of its variance.

    It is large where some of them were of a fault that is over: such a relation tells little.
    """
    gain, lag = w.gain_off, w.lag_s
    left = w.slow_square - 2.0 * (gain * w.turned_slow + lag * w.change_slow)
    left += gain * gain * w.turned_square + lag * lag * w.change_square
    left += 2.0 * gain * lag * w.turned_change
    return _TOGETHER * left / (LEAST_LOOKS - 2)


def relation_steps(step_s: float) -> tuple[int, float, int, int]:
    """Steps between two looks at gain and lag, what is kept from one to the next, for how many
    steps they may doubt alone, and for how many a doubt is not forgotten."""
    every = max(round(_LEARN_S / step_s), 1)
    keep = math.exp(-every * step_s / _LEARN_MOTION_S)
    return every, keep, round(_RELATED_FOR_S / step_s), round(_FORGOTTEN_S / step_s)
