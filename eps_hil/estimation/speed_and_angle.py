"""Speed against angle: whether both tell of the same motion (docs/theory-estimator.md).

Both are of one sensor, mostly, but travel as two numbers. Their ways, ∫ω dt and Δφ, may differ by
noise, by a wrong gain, and where one is later than the other; by no more.
"""

import math

import numpy as np

from eps_hil.compiled import kernel
from eps_hil.estimation.gain_and_lag import (
    LEAST_LOOKS,
    LOW_SCALE,
    MOST,
    SCALE,
    SMOOTHED_S,
    doubt_lessons,
    learn_relation,
    unlike,
)
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.watch import RING, WRAP, Limits, Watch

LEAK_PER_MS, SLOW_LEAK_PER_MS = 0.95, 0.99
"""What the residuals keep from one millisecond to the next: they cover some 20 and 100 ms."""
_MEAN_S = 0.005
"""Time constant of the mean of the fast residual: white noise of the angle is less in it."""
_PAIR = math.sqrt(2.0)
"""Noise of two angles, whose difference is looked at, in that of one."""
SUDDEN = 2
_SPEED_JUMP, _SPEED_SPIKE = 1.5, 5.0
"""A jump of the speed (rad/s) from one step to the next that is looked at, and one that ends a
spike."""
_ASKED_SIGMA = 3.0
"""Deviations beyond which the way over a long hole has to be confirmed."""
_BENT_LATE = 0.6
"""Share of a hole after which a speed that bends is rare, and its end off the course by little."""


@kernel
def angle_off(w: Watch, p: Limits, u: Inputs, before: float) -> int:
    """Whether the angle's way and the speed's differ by more than noise, gain and lag make.

    ``before``: speed (rad/s) of the step before. ``SUDDEN``: by more than any load turns a rotor
    in two steps from rest to rest (a jump may be read half way), so that the angle is wrong.
    """
    speed = u.motor_speed_rad_s
    way, turned = 0.5 * (speed + before) * p.step_s, u.motor_angle_rad - w.angle
    apart = turned - way
    summed = apart - p.step_s * _drawn_ahead(w, u) * (speed - before)
    if w.looks >= LEAST_LOOKS:
        summed -= w.gain_off * turned + w.lag_s * (speed - before)
    w.apart[(w.steps - 1) & WRAP] = w.apart[(w.steps - 2) & WRAP] + summed
    if w.drawn > 0:
        w.angle_drawn = int(u.angle_periods > 1.0)
    w.slip = p.leak * w.slip + apart
    w.path = p.leak * w.path + way
    w.gain = p.leak * w.gain + (speed - before)
    w.angle = u.motor_angle_rad
    lag = SMOOTHED_S * abs(speed - before)
    noise = _PAIR * max(p.angle_tolerance, math.sqrt(p.jump * max(u.angle_noise, 0.0)))
    jumped = abs(apart) > noise + SCALE * abs(way) + lag
    tolerance = p.angle_tolerance + SCALE * abs(w.path) + SMOOTHED_S * abs(w.gain)
    on_average = _off_on_average(w, p, u)
    alone = _slides_alone(w, p, u, apart, turned, speed - before)
    if abs(w.slip) > tolerance or on_average or jumped:
        doubt_lessons(w, p)
    elif not alone:
        learn_relation(w, p, u)
        return 0
    w.unlike = p.forgotten_steps
    return SUDDEN if abs(apart) > p.sudden_turn else 1


@kernel
def _drawn_ahead(w: Watch, u: Inputs) -> float:
    """By how many steps the middle of a hole is ahead of this step, 0 outside of one.

    In it the angle is drawn straight, which has the speed of its middle, and so is the speed.
    """
    if w.drawn > 1:
        return 0.5 * u.speed_periods + 1.5 - w.drawn if u.angle_periods > 1.0 else 0.0
    after = w.drawn == 0 and w.hole_last == w.steps - 1 and w.hole_first >= 0
    if after and w.angle_drawn:
        return 1.0 - 0.5 * (w.hole_last - w.hole_first)
    return 0.0


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
def _off_on_average(w: Watch, p: Limits, u: Inputs) -> bool:
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
    tolerance += SCALE * abs(w.mean_path) + SMOOTHED_S * abs(w.mean_gain)
    return abs(w.mean_slip) > tolerance


@kernel
def _slides_alone(
    w: Watch, p: Limits, u: Inputs, apart: float, turned: float, change: float
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
    tolerance += LOW_SCALE * abs(w.turned) + SMOOTHED_S * abs(w.slow_gain)
    w.slow = min(max(w.slow, -MOST * tolerance), MOST * tolerance)
    said = w.turned - w.slow  # the speed's own way
    if abs(w.slow) > tolerance and abs(said) > abs(w.turned):
        doubt_lessons(w, p)
        return True
    return unlike(w, p, noise)


@kernel
def jumped_alone(w: Watch, p: Limits, u: Inputs) -> bool:
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
def jumped_in_hole(w: Watch, p: Limits, u: Inputs) -> bool:
    """The same for a speed that jumped where its samples are lost: in the last hole.

    There it is drawn straight from end to end, which is no integral of a speed, so only what is
    beside the hole counts: the slope of the sum after it less that before, against the jump that
    the speed's own slopes leave. It is looked for as soon as two steps are seen, and again with
    each of the next, which see smaller jumps. A jump that is seen less than a window after the
    hole, where no course of the speed is known yet, counts as one in it.
    """
    first, last = w.hole_first, w.hole_last
    after, before = w.steps - 1 - last, min(first, p.window)
    v = w.speed
    if first >= 0 and 0 < after < p.window:
        jump = v[(last + after) & WRAP] - v[(last + after - 1) & WRAP]
        if jump * jump > max(2.5 * p.jump * u.speed_noise, _SPEED_JUMP**2):
            w.hole_last = last + after
            return False
    if first < 0 or after < 2 or after > p.window or before < 3:
        return False
    if w.steps - first + before > RING:  # not remembered any more
        return False
    over = min(after, before)
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
    by_gain = SCALE * abs(went - jump) * p.step_s
    enough = bend * bend > p.jump * rough and abs(bend) > by_gain
    return bool(enough and (bend - due) ** 2 < 0.25 * due * due)


@kernel
def await_angle(w: Watch, p: Limits, u: Inputs) -> None:
    """A hole of over a window begins over which the angle does not go as the speed may have done.

    A speed that bends once within the hole, and ends it ``off`` its course, leaves a way that is
    short by up to ``off`` times half the hole, by a third of that if it bends all the while. One
    that only reads another value since leaves all of it. Until the angle can tell after the hole
    (:func:`jumped_in_hole`), what was drawn over it may be wrong.
    """
    length, k, over = u.speed_periods, w.steps - 1, p.window
    if w.drawn != 2 or length < over or u.angle_periods != length or k < over + 2:
        return
    if w.looks < LEAST_LOOKS:
        return
    v = w.speed
    course = (v[(k - 2) & WRAP] - v[(k - 2 - over) & WRAP]) / over
    off = (v[k & WRAP] - v[(k - 1) & WRAP] - course) * length
    short = -2.0 * (w.apart[k & WRAP] - w.apart[(k - 1) & WRAP]) / p.step_s
    most = _BENT_LATE * off
    beyond = max(short - max(most, 0.0), min(most, 0.0) - short)
    share = length / over
    noise = (2.0 + 2.0 * _BENT_LATE**2 * (1.0 + share + share * share)) * u.speed_noise
    noise += 8.0 * u.angle_noise / (length * p.step_s) ** 2
    if beyond > 0.0 and beyond * beyond > max(_ASKED_SIGMA**2 * noise, _SPEED_JUMP**2):
        w.awaited = max(w.awaited, math.ceil(length) + over)


@kernel
def spiked_alone(w: Watch, p: Limits, u: Inputs) -> bool:
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
def _slope(w: Watch, first: int, steps: int) -> float:
    """Least-squares slope (rad a step) of the sum (dphi - omega dt) over ``steps`` from there."""
    total, mean = 0.0, 0.5 * steps
    for j in range(steps + 1):
        total += (j - mean) * w.apart[(first + j) & WRAP]
    return 12.0 * total / (steps * (steps + 1.0) * (steps + 2.0))


@kernel
def _slope_noise(u: Inputs, p: Limits, steps: int) -> float:
    """Its variance: white noise of the angle, and a random walk, which is the speed's."""
    by_angle = 12.0 * u.angle_noise / (steps * (steps + 1.0) * (steps + 2.0))
    return by_angle + 1.2 * u.speed_noise * p.step_s**2 / (steps + 1.0)
