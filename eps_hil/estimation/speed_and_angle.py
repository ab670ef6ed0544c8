"""Speed against angle: whether both tell of the same motion (docs/theory-estimator.md).

Both are of one sensor, mostly, but travel as two numbers. Their ways, ∫ω dt and Δφ, may differ by
noise, by a wrong gain, and where one is later than the other; by no more.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from eps_hil.compiled import kernel
from eps_hil.estimation.setup import Inputs

if TYPE_CHECKING:
    from eps_hil.estimation.plausibility import Limits, Watch

RING = 256
WRAP = RING - 1
"""``n & WRAP`` is ``n % RING``, of which there are dozens a step."""
LEAK_PER_MS, SLOW_LEAK_PER_MS = 0.95, 0.99
"""What the residuals keep from one millisecond to the next: they cover some 20 and 100 ms."""
_SCALE, SMOOTHED_S = 0.25, 0.005
_MEAN_S = 0.005
"""Time constant of the mean of the fast residual: white noise of the angle is less in it."""
_LOW_SCALE = _SCALE / (1.0 - _SCALE)
"""The same wrong gain, in parts of the angle's way."""
_LEARN_S, _LEARN_MOTION_S, _RELATED_FOR_S = 0.02, 4.0, 2.0
"""How often gain and lag between speed and angle are learnt, in motion; over how much of it; for
how long they may doubt alone: then it is they that have changed."""
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
_MOST = 1.5
"""Tolerances that the slow residual may grow to: it is to be over soon after the fault."""
_PAIR = math.sqrt(2.0)
"""Noise of two angles, whose difference is looked at, in that of one."""
SUDDEN = 2
_SPEED_JUMP, _SPEED_SPIKE = 1.5, 5.0
"""A jump of the speed (rad/s) from one step to the next that is looked at, and one that ends a
spike."""


@kernel
def angle_off(w: "Watch", p: "Limits", u: Inputs, before: float) -> int:
    """Whether the angle's way and the speed's differ by more than noise, gain and lag make.

    ``before``: speed (rad/s) of the step before. ``SUDDEN``: by more than any load turns a rotor
    in two steps from rest to rest (a jump may be read half way), so that the angle is wrong.
    """
    speed = u.motor_speed_rad_s
    way, turned = 0.5 * (speed + before) * p.step_s, u.motor_angle_rad - w.angle
    apart = turned - way
    w.apart[(w.steps - 1) & WRAP] = w.apart[(w.steps - 2) & WRAP] + apart
    w.slip = p.leak * w.slip + apart
    w.path = p.leak * w.path + way
    w.gain = p.leak * w.gain + (speed - before)
    w.angle = u.motor_angle_rad
    lag = SMOOTHED_S * abs(speed - before)
    noise = _PAIR * max(p.angle_tolerance, math.sqrt(p.jump * max(u.angle_noise, 0.0)))
    jumped = abs(apart) > noise + _SCALE * abs(way) + lag
    tolerance = p.angle_tolerance + _SCALE * abs(w.path) + SMOOTHED_S * abs(w.gain)
    on_average = _off_on_average(w, p, u)
    alone = _slides_alone(w, p, u, apart, turned, speed - before)
    if not (abs(w.slip) > tolerance or on_average or alone or jumped):
        _learn_relation(w, p, u)
        return 0
    w.unlike = p.told_steps
    return SUDDEN if abs(apart) > p.sudden_turn else 1


def mean_noise(leak: float, mean: float, step_s: float) -> tuple[float, float]:
    """Variance of the fast residual's mean for white noise of 1 rad², and of 1 rad²/s².

    ``leak``: what the residual keeps from step to step; ``mean``: what its mean takes over.
    """
    steps = np.arange(round(1.0 / step_s))
    answer = np.convolve(leak**steps, mean * (1.0 - mean) ** steps)[: len(steps)]
    by_angle = np.diff(answer, prepend=0.0)
    by_speed = 0.5 * step_s * (answer + np.concatenate([[0.0], answer[:-1]]))
    return float(np.sum(by_angle**2)), float(np.sum(by_speed**2))


def mean_share(step_s: float) -> float:
    """What the mean of the fast residual takes over in a step."""
    return 1.0 - math.exp(-step_s / _MEAN_S)


@kernel
def _off_on_average(w: "Watch", p: "Limits", u: Inputs) -> bool:
    """Whether the mean over some milliseconds of the fast residual is more than its own noise.

    A speed that is off by 1 rad/s turns the rotor by 10 mrad in 10 ms, five deviations of one
    angle, but more than ten of a mean. Gain and lag are allowed for as in single residuals.
    """
    w.mean_slip += p.mean_share * (w.slip - w.mean_slip)
    w.mean_path += p.mean_share * (w.path - w.mean_path)
    w.mean_gain += p.mean_share * (w.gain - w.mean_gain)
    noise = p.mean_angle_noise * max(u.angle_noise, p.angle_noise)
    noise += p.mean_speed_noise * max(u.speed_noise, 0.0)
    tolerance = math.sqrt(p.jump * noise)
    tolerance += _SCALE * abs(w.mean_path) + SMOOTHED_S * abs(w.mean_gain)
    return abs(w.mean_slip) > tolerance


@kernel
def _slides_alone(
    w: "Watch", p: "Limits", u: Inputs, apart: float, turned: float, change: float
) -> bool:
    """Whether the speed tells of more way than the angle, over a tenth of a second.

    A speed that is off by little slides the bristle of a resting rotor, and so the estimate, by
    hundreds of N; below the dead zone it does nothing. An angle that tells of more way is creep, or
    a speed that is rounded down, and does no harm.
    """
    w.slow = p.slow_leak * w.slow + apart
    w.turned = p.slow_leak * w.turned + turned
    w.slow_gain = p.slow_leak * w.slow_gain + change
    noise = max(u.angle_noise, p.angle_noise) + p.slow_noise * max(u.speed_noise, 0.0)
    tolerance = math.sqrt(p.jump * noise) + p.slow_rest
    tolerance += _LOW_SCALE * abs(w.turned) + SMOOTHED_S * abs(w.slow_gain)
    w.slow = min(max(w.slow, -_MOST * tolerance), _MOST * tolerance)
    said = w.turned - w.slow  # the speed's own way
    if abs(w.slow) > tolerance and abs(said) > abs(w.turned):
        return True
    return _unlike(w, p, noise)


@kernel
def _off_relation(w: "Watch", p: "Limits", noise: float) -> tuple[float, float]:
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
def _unlike(w: "Watch", p: "Limits", noise: float) -> bool:
    """Whether the slow residual is more than the gain and lag that this rig was seen to have.

    They excuse a third of the way before they are known. ``noise``: variance of the residual
    (rad²) at rest. A relation that changes for good is learnt anew.
    """
    if w.dark > 0 or w.gain_variance == 0.0:
        return False
    off, tolerance = _off_relation(w, p, noise)
    if abs(off) < tolerance:
        return False
    most = math.copysign(min(abs(off), _MOST * tolerance), off)
    w.slow += most - off
    off = most
    said, turned = w.turned - off, w.turned
    told = said * turned > _SPEED_TELLS * turned * turned
    if abs(said) <= abs(turned) and not (told and abs(turned) > _IN_MOTION * tolerance):
        return False
    _doubt_relation(w, p, 1)
    return True


@kernel
def _doubt_relation(w: "Watch", p: "Limits", steps: int) -> None:
    """Count for how long gain and lag are not what they were: at last that is what has changed."""
    w.unlike_alone += steps
    if w.unlike_alone > p.related_steps:
        _forget_relation(w)


@kernel
def _forget_relation(w: "Watch") -> None:
    """Gain and lag are as unknown as at the beginning."""
    w.turned_square = w.turned_change = w.change_square = 0.0
    w.turned_slow = w.change_slow = w.relation_left = 0.0
    w.gain_variance, w.unlike_alone = 0.0, 0


@kernel
def _learn_relation(w: "Watch", p: "Limits", u: Inputs) -> None:
    """Gain and lag of the speed against the angle, by least squares on the slow residual.

    With a speed of (1 + g) times the angle's slope that is τ later the residual is
    −g turned + τ change. Looked at now and then, in motion; what is old is forgotten.
    """
    w.unlike = max(w.unlike - 1, 0)
    if w.unlike > 0 or w.dark > 0 or w.stalled > 0 or w.steps % p.learn_every != 0:
        return
    noise = max(u.angle_noise, p.angle_noise) + p.slow_noise * max(u.speed_noise, 0.0)
    if w.turned * w.turned + (SMOOTHED_S * w.slow_gain) ** 2 < p.jump * noise:
        return
    keep, turned, change = p.relation_memory, w.turned, w.slow_gain
    variance = noise + (_LEAST_GAIN * turned) ** 2 + (_LEAST_LAG_S * change) ** 2
    if w.gain_variance > 0.0:
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
    scale = 1.0 / max(w.relation_left, 1.0)
    a = scale * w.turned_square + (_KNOWN_SIGMA / _LOW_SCALE) ** 2
    b = scale * w.turned_change
    c = scale * w.change_square + (_KNOWN_SIGMA / SMOOTHED_S) ** 2
    first, second, whole = scale * w.turned_slow, scale * w.change_slow, a * c - b * b
    w.gain_off = (c * first - b * second) / whole
    w.lag_s = (a * second - b * first) / whole
    w.gain_variance, w.lag_variance, w.gain_and_lag = c / whole, a / whole, -b / whole


def relation_steps(step_s: float) -> tuple[int, float, int]:
    """Steps between two looks at gain and lag, what is kept from one to the next, and for how many
    steps they may doubt alone."""
    every = max(round(_LEARN_S / step_s), 1)
    keep = math.exp(-every * step_s / _LEARN_MOTION_S)
    return every, keep, round(_RELATED_FOR_S / step_s)


@kernel
def jumped_alone(w: "Watch", p: "Limits", u: Inputs) -> bool:
    """Whether the speed jumped ``window`` steps ago, and the angle did not go with it.

    No load moves an inertia at once, but an impact nearly does; then the angle's slope changes by
    as much. The sum of (dphi - omega dt) shows by its bend whether it did; a gain that is wrong
    gives it a slope and no bend.
    """
    n, k = p.window, w.steps - 1
    m = k - n
    if k < 2 * n + 1 or n < 3 or w.drawn_at[m & WRAP] > 0 or w.drawn_at[(m + 1) & WRAP] > 0:
        return False
    v = w.speed
    jump = v[(m + 1) & WRAP] - v[m & WRAP]
    jump -= 0.5 * (v[m & WRAP] - v[(m - 1) & WRAP] + v[(m + 2) & WRAP] - v[(m + 1) & WRAP])
    if jump * jump < max(2.5 * p.jump * u.speed_noise, _SPEED_JUMP**2):
        return False
    bend = 0.0
    for j in range(2 * n + 1):
        bend += p.hinge[j] * w.apart[(m - n + j) & WRAP]
    due = jump * n * p.step_s
    noise = p.jump * p.hinge_noise * u.angle_noise
    return bool((bend + due) ** 2 < 0.25 * due * due and bend * bend > noise)


@kernel
def jumped_in_hole(w: "Watch", p: "Limits", u: Inputs) -> bool:
    """The same for a speed that jumped where its samples are lost: in the last hole.

    There it is drawn straight from end to end, which is no integral of a speed, so only what is
    beside the hole counts: the slope of the sum after it less that before, against the jump that
    the speed's own slopes leave. It is looked for as soon as two steps are seen, and again with
    each of the next, which see smaller jumps.
    """
    first, last = w.hole_first, w.hole_last
    after, before = w.steps - 1 - last, min(first, p.window)
    if first < 0 or after < 2 or after > p.window or before < 3:
        return False
    if w.steps - first + before > RING:  # not remembered any more
        return False
    v, over = w.speed, min(after, before)
    earlier = (v[first & WRAP] - v[(first - over) & WRAP]) / over
    later = (v[(last + over) & WRAP] - v[last & WRAP]) / over
    went = v[last & WRAP] - v[first & WRAP]
    jump = went - 0.5 * (last - first) * (earlier + later)
    share = 0.5 * (last - first) / over
    noise = 2.0 * ((1.0 + share) ** 2 + share * share)
    if jump * jump < max(noise * p.jump * u.speed_noise, _SPEED_JUMP**2):
        return False
    bend = _slope(w, last, after) - _slope(w, first - before, before)
    due = -jump * p.step_s
    rough = _slope_noise(u, p, after) + _slope_noise(u, p, before)
    by_gain = _SCALE * abs(went - jump) * p.step_s
    enough = bend * bend > p.jump * rough and abs(bend) > by_gain
    return bool(enough and (bend - due) ** 2 < 0.25 * due * due)


@kernel
def spiked_alone(w: "Watch", p: "Limits", u: Inputs) -> bool:
    """Whether the speed was away for less than a window, and the angle did not go with it.

    An angle that is later than the speed shows the same way ``lag`` steps after the spike's end:
    only then is it looked for, by the step that it leaves in the sum of (dphi - omega dt).
    """
    n, k, v = p.window, w.steps - 1, w.speed
    end = k - p.lag
    if end < 2 * n + 2:
        return False
    back = v[end & WRAP] - v[(end - 2) & WRAP]
    if back * back < max(2.0 * p.jump * u.speed_noise, _SPEED_SPIKE**2):
        return False
    for steps in range(2, n + 3):
        start = end - steps
        slope = (v[end & WRAP] - v[start & WRAP]) / steps
        course = (v[start & WRAP] - v[(start - n) & WRAP]) / n
        if abs(slope - course) * steps > 0.5 * abs(back):  # it jumped, and did not come back
            continue
        way = 0.0
        for j in range(1, steps):
            way += p.step_s * (v[(start + j) & WRAP] - v[start & WRAP] - j * slope)
        if way * back > 0.0 or abs(way) < 0.3 * p.step_s * (steps - 1) * abs(back):
            continue
        off = w.apart[k & WRAP] - w.apart[start & WRAP] - (k - start) * _slope(w, start - n, n)
        noise = 2.0 * u.angle_noise + (k - start) ** 2 * _slope_noise(u, p, n)
        if off * off > p.jump * noise and (off + way) ** 2 < 0.25 * way * way:
            return True
    return False


@kernel
def _slope(w: "Watch", first: int, steps: int) -> float:
    """Least-squares slope (rad a step) of the sum (dphi - omega dt) over ``steps`` from there."""
    total, mean = 0.0, 0.5 * steps
    for j in range(steps + 1):
        total += (j - mean) * w.apart[(first + j) & WRAP]
    return 12.0 * total / (steps * (steps + 1.0) * (steps + 2.0))


@kernel
def _slope_noise(u: Inputs, p: "Limits", steps: int) -> float:
    """Its variance: white noise of the angle, and a random walk, which is the speed's."""
    by_angle = 12.0 * u.angle_noise / (steps * (steps + 1.0) * (steps + 2.0))
    return by_angle + 1.2 * u.speed_noise * p.step_s**2 / (steps + 1.0)
