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
_SCALE, _SMOOTHED_S = 0.25, 0.005
_MEAN_S = 0.005
"""Time constant of the mean of the fast residual: white noise of the angle is less in it."""
_LOW_SCALE = _SCALE / (1.0 - _SCALE)
"""The same wrong gain, in parts of the angle's way."""
_MOST = 1.5
"""Tolerances that the slow residual may grow to: it is to be over soon after the fault."""
_PAIR = math.sqrt(2.0)
"""Noise of two angles, whose difference is looked at, in that of one."""
SUDDEN = 2
_SPEED_JUMP = 1.5
"""A jump of the speed (rad/s) from one step to the next that is looked at."""
_COURSE_STEPS = 3
"""Over so many on either side of a hole the speed's own slope is taken."""


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
    lag = _SMOOTHED_S * abs(speed - before)
    noise = _PAIR * max(p.angle_tolerance, math.sqrt(p.jump * max(u.angle_noise, 0.0)))
    jumped = abs(apart) > noise + _SCALE * abs(way) + lag
    tolerance = p.angle_tolerance + _SCALE * abs(w.path) + _SMOOTHED_S * abs(w.gain)
    on_average = _off_on_average(w, p, u)
    alone = _slides_alone(w, p, u, apart, turned, speed - before)
    if not (abs(w.slip) > tolerance or on_average or alone or jumped):
        return 0
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
    tolerance += _SCALE * abs(w.mean_path) + _SMOOTHED_S * abs(w.mean_gain)
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
    tolerance += _LOW_SCALE * abs(w.turned) + _SMOOTHED_S * abs(w.slow_gain)
    w.slow = min(max(w.slow, -_MOST * tolerance), _MOST * tolerance)
    said = w.turned - w.slow  # the speed's own way
    return abs(w.slow) > tolerance and abs(said) > abs(w.turned)


@kernel
def jumped_alone(w: "Watch", p: "Limits", u: Inputs) -> bool:
    """Whether the speed jumped ``window`` steps ago, and the angle did not go with it.

    No load moves an inertia at once, but an impact nearly does; then the angle's slope changes by
    as much. The sum of (dphi - omega dt) shows by its bend whether it did; a gain that is wrong
    gives it a slope and no bend. A jump in a hole of the speed is drawn over all of it, and looked
    for where the middle of the hole is that long ago.
    """
    n, k = p.window, w.steps - 1
    if k < 2 * n + _COURSE_STEPS or n < 3:
        return False
    v, m = w.speed, k - n
    first, last = m, m + 1
    while w.drawn_at[first & WRAP] > 0 and m - first < n:
        first -= 1
    while w.drawn_at[last & WRAP] > 0 and last < k - 1:
        last += 1
    if m != (first + last) // 2:
        return False
    over = 1 if last == first + 1 else min(_COURSE_STEPS, k - last)
    course = v[first & WRAP] - v[(first - over) & WRAP]
    course += v[(last + over) & WRAP] - v[last & WRAP]
    share = 0.5 * (last - first) / over
    jump = v[last & WRAP] - v[first & WRAP] - share * course
    noise = 2.0 * ((1.0 + share) ** 2 + share * share) if over > 1 else 2.5
    if jump * jump < max(noise * p.jump * u.speed_noise, _SPEED_JUMP**2):
        return False
    bend, begun = 0.0, w.apart[first & WRAP]
    slope = (w.apart[last & WRAP] - begun) / (last - first)
    for j in range(2 * n + 1):
        i = m - n + j  # within a hole the angle is drawn straight, too, and no integral of a speed
        apart = begun + (i - first) * slope if first < i < last else w.apart[i & WRAP]
        bend += p.hinge[j] * apart
    due = jump * n * p.step_s
    noise = p.jump * p.hinge_noise * u.angle_noise
    return bool((bend + due) ** 2 < 0.25 * due * due and bend * bend > noise)
