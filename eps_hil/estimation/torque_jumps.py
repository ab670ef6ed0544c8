"""Jumps of torque that no motion follows: the observer's innovation over a short window.

No torque is wrong for its size; some rack force would explain any. But over a few milliseconds the
load goes on as it did, and a rotor has inertia: where T_1m leaves its course at once, the speed
must show it. The rings of :class:`~eps_hil.estimation.plausibility.Watch` hold T_1m *less what was
found to be unexplained*, so that the end of a wrong torque looks like its beginning.
"""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.estimation.holes import (
    ROLLED_BACK,
    UNEXPLAINED_N,
    guessed,
    in_the_dark,
    learn_swing,
    lose_course,
    undecided,
)
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.state import Records
from eps_hil.estimation.validity import Reason
from eps_hil.estimation.watch import WRAP, Limits, Watch, next_step

_INCONSISTENT = int(Reason.INCONSISTENT)
_FOLLOWS = 0.3
"""Share of what a torque jump should do to the speed, below which it was not there; the more that
is beside noise and load, the nearer is this share to a half, where both are equally near."""
_CLIP, _LEAST_SPREAD = 6.6, 0.02**2
_MOTION = 4.0
"""A jump's own motion must exceed two deviations of what the load makes of the speed: load and
friction change its bend too, but a torque that leaves its own course at once is rare."""
_KEPT = 1.5
"""So much of it is kept as unexplained; less is nothing."""
_BACK, _BACK_SIGMA = 0.4, 4.0
"""Share of an unexplained torque that may be left when it has jumped back, and deviations of the
torque's own course: more may be of another that began meanwhile, and is doubted for a while."""
_OWN_SIGMA = 2.0
"""Deviations of the torque's own course within which what a spike leaves may be that course."""

Floats = npt.NDArray[np.float64]


def hinge(n: int) -> Floats:
    """Weights (2n + 1,) on speeds, the middle one where the torque may have jumped.

    Least squares of a line with a bend there: blind to speed and to steady acceleration. The bend
    is told as the speed that it adds by the end of the window.
    """
    t = np.arange(-n, n + 1, dtype=float)
    columns = np.stack([np.ones_like(t), t, np.maximum(t, 0.0)], axis=1)
    weights: Floats = n * np.linalg.pinv(columns)[2]
    return weights


def swing_hinge(before: int, n: int) -> Floats:
    """Weights (before + n + 1,) on speeds, a bend at ``before``, as :func:`hinge` tells it.

    Least squares of a parabola with that bend: blind to a load that changes steadily, too.
    """
    t = np.arange(-before, n + 1, dtype=float)
    columns = np.stack([np.ones_like(t), t, t * t, np.maximum(t, 0.0)], axis=1)
    weights: Floats = n * np.linalg.pinv(columns)[3]
    return weights


def bend_noise(weights: Floats) -> float:
    """Variance of the bend (2n + 1 weights) less that of n steps before, for white noise of 1."""
    n = len(weights) // 2
    change = np.zeros(3 * n + 1)
    change[n:] += weights
    change[: 2 * n + 1] -= weights
    return float(np.sum(change**2))


def due_noise(n: int, step_s: float, inverse_inertia: float) -> float:
    """Variance of the bend that is due, where T_1m has white noise of variance 1 Nm²."""
    weights, total = hinge(n), 0.0
    for place in range(2 * n + 1):
        torque = np.zeros(2 * n + 1)
        torque[place] = 1.0
        slope = (torque[n] - torque[0]) / n
        off = torque[n:] - torque[n] - slope * np.arange(n + 1)
        speed = np.cumsum(0.5 * (off[1:] + off[:-1])) * step_s * inverse_inertia
        total += float(weights[n + 1 :] @ speed) ** 2
    return total


@kernel
def watch_jump(w: Watch, p: Limits, u: Inputs) -> None:
    """Look at the torque of ``window`` steps ago: did it jump there, and did the rotor follow?"""
    n, k = p.window, w.steps - 1
    if k < 2 * n:
        return
    torque, speeds, weights = w.torque, w.pace, p.hinge
    done = weights[n] * speeds[(k - n) & WRAP]
    for j in range(n):  # the weights are even
        done += weights[j] * (speeds[(k - 2 * n + j) & WRAP] + speeds[(k - j) & WRAP])
    w.bend[k & WRAP] = done
    if k < 3 * n:
        return
    done -= w.bend[(k - n) & WRAP]  # the load goes on bending the course as it did
    learn_swing(w, p)
    _learn_residual(w, p)
    base, slope, edge = torque[(k - n) & WRAP], *_edge(w, p, u)
    noise = p.bend_noise * u.speed_noise + p.due_noise * u.drive_noise
    limit = max(p.jump * noise, _MOTION * w.spread)
    w.spread += p.spread_memory * (min(done * done, _CLIP * w.spread) - w.spread)
    w.spread = max(w.spread, _LEAST_SPREAD)
    if not _leaves(p, u, edge):
        return
    due, level, most = _due(w, p, weights, base, slope)
    w.innovation = done - due
    if abs(edge) < 0.3 * most or edge * due <= 0.0:
        return
    clear = unclear = False
    if due * due >= limit:
        unclear = w.dark > 0 and _contradict(done, w.bend[k & WRAP], due, limit)
        clear = w.innovation * w.innovation >= limit and not _followed(done, due, limit)
    if not clear and not unclear and not _alone(w, p, u, base, slope, edge):
        return
    if w.stalled > 0 and w.unexplained_nm == 0.0:  # what stood still catches up, or is wrong anew
        w.stalled, w.missed, w.misled = p.stalled_steps, 1, 1
    elif unclear or undecided(w, p, edge):
        lose_course(w)
    else:
        _found(w, p, base, slope, level, most)


@kernel
def _due(
    w: Watch, p: Limits, weights: Floats, base: float, slope: float
) -> tuple[float, float, float]:
    """What a torque that left its course a window ago is to do to the speed's bend (rad/s).

    ``weights`` end with those of the window. And by how much (Nm) it is off the course, which is
    ``base`` and ``slope``, now and at most.
    """
    n, due, speed, before, most = p.window, 0.0, 0.0, 0.0, 0.0
    first, last = w.steps - 1 - n, len(weights) - 1 - n
    for j in range(1, n + 1):
        off = w.torque[(first + j) & WRAP] - base - j * slope
        speed += 0.5 * (before + off) * p.step_s * p.inverse_inertia
        due += weights[last + j] * speed
        most, before = max(most, abs(off)), off
    return due, before, most


@kernel
def _residual(w: Watch, p: Limits) -> float:
    """Bend of the speed a window ago (rad/s) less that which the torques make.

    Over a longer time before it than :func:`watch_jump` looks at: what the torque does to the
    speed is taken out first, so that a rotor that swings makes none, but a load that does.
    """
    length = p.swing_before + p.window
    first = w.steps - 1 - length
    way, before, due, done = 0.0, w.torque[first & WRAP], 0.0, 0.0
    for j in range(1, length + 1):
        torque = w.torque[(first + j) & WRAP]
        way += 0.5 * (before + torque)
        before = torque
        due += p.swing_hinge[j] * way
        done += p.swing_hinge[j] * (w.pace[(first + j) & WRAP] - w.pace[first & WRAP])
    due *= p.step_s * p.inverse_inertia
    return done - due


@kernel
def _seen_for_long(w: Watch, p: Limits) -> bool:
    """Whether all that :func:`_residual` looks at was seen."""
    length = p.swing_before + p.window
    return bool(w.steps > length and w.dark <= 0 and w.guessed_at < w.steps - 1 - length)


@kernel
def _learn_residual(w: Watch, p: Limits) -> None:
    """How large :func:`_residual` is by itself (mean square); looked at every few steps."""
    if w.swing_turn != 0 or not _seen_for_long(w, p):
        return
    off = _residual(w, p)
    share = p.swing_every * p.spread_memory
    w.residual += share * (min(off * off, _CLIP * w.residual) - w.residual)
    w.residual = max(w.residual, _LEAST_SPREAD)


@kernel
def _alone(w: Watch, p: Limits, u: Inputs, base: float, slope: float, edge: float) -> bool:
    """Whether a torque that left its course by ``edge`` (Nm) amid a swing was not followed.

    Only the jump is asked for: the rest of the torque's bend is the swing's, which the rotor makes.
    """
    if not _seen_for_long(w, p):
        return False
    off, (due, _, _) = _residual(w, p), _due(w, p, p.swing_hinge, base, slope)
    noise = p.swing_noise * u.speed_noise + p.due_noise * u.drive_noise
    limit = max(p.jump * noise, _MOTION * w.residual)
    if edge * due <= 0.0 or due * due < limit or off * off < limit:
        return False
    return not _followed(off + due, due, limit)


@kernel
def _share(due: float, limit: float) -> float:
    """Share of the bend that is ``due`` (rad/s; not zero) below which it was not there."""
    return max(_FOLLOWS, 0.5 - _FOLLOWS * math.sqrt(limit / (due * due)))


@kernel
def _followed(done: float, due: float, limit: float) -> bool:
    """Whether the speed's bend ``done`` is that of the torque, ``due`` (rad/s); not zero."""
    return done * due > _share(due, limit) * due * due


@kernel
def _contradict(done: float, bent: float, due: float, limit: float) -> bool:
    """Whether a bend that is ``bent``, and ``done`` less that of before, do not say the same.

    Half a jump is none: it has to be nearer to the whole than to nothing by as much as one that was
    not there is nearer to nothing.
    """
    share, whole = _share(due, limit), due * due
    least, most = min(done * due, bent * due), max(done * due, bent * due)
    if least > share * whole:
        return least < (1.0 - share) * whole
    return most > share * whole or min((done - due) ** 2, (bent - due) ** 2) < limit


@kernel
def add_pace(w: Watch, p: Limits) -> None:
    """The speed of the newest step, with what the friction's changes took from it given back.

    Friction that turns over where the rotor does bends the speed's course as much as a torque that
    jumps, and would hide one that jumps there, or excuse one that did not.
    """
    w.lent += p.step_s * p.inverse_inertia * w.changed_nm
    w.pace[w.steps & WRAP] = w.speed[w.steps & WRAP] + w.lent


@kernel
def take_friction(watch: Records, friction_nm: float, known: bool, bristle: float) -> None:
    """The friction torque (Nm) of the step that was made, if it is ``known``; its bristle (rad)."""
    w = watch[0]
    if known and w.friction_known:
        w.changed_nm += friction_nm - w.friction_nm
    w.friction_nm, w.friction_known, w.bristle = friction_nm, 1 if known else 0, bristle


@kernel
def _leaves(p: Limits, u: Inputs, edge: float) -> bool:
    """Whether a torque that is ``edge`` (Nm) off its course has left it, beyond size and noise."""
    return abs(edge) * p.ratio >= UNEXPLAINED_N and edge * edge >= p.jump * u.drive_noise


@kernel
def _edge(w: Watch, p: Limits, u: Inputs) -> tuple[float, float]:
    """Slope of the torque before ``window`` steps ago (Nm a step), and how far it left it there.

    A spike makes no slope: while its beginning is in the window that the slope is taken from, the
    slope from before it counts.
    """
    n, m, torque = p.window, w.steps - 1 - p.window, w.torque
    slope = (torque[m & WRAP] - torque[(m - n) & WRAP]) / n
    new = not 0 < m - w.edge_at <= n + p.edge
    if not new:
        slope = w.edge_slope
    edge = 0.0
    for j in range(1, p.edge + 1):
        off = torque[(m + j) & WRAP] - torque[m & WRAP] - j * slope
        edge = off if abs(off) > abs(edge) else edge
    if new and _leaves(p, u, edge):
        w.edge_at, w.edge_nm, w.edge_slope = m, torque[m & WRAP], slope
    return slope, edge


@kernel
def _found(w: Watch, p: Limits, base: float, slope: float, level: float, most: float) -> None:
    """Take a jump that nothing followed out of the ring; ``level`` (Nm) is what is left of it.

    It was up to ``most``.

    What is left of a jump that went back, or of a spike, may be what the course did meanwhile: it
    is not doubted for long. Nor is a jump after one of which much was left: it may be its end. Nor
    one beside a hole: how large it was is a guess, as the course through the hole is. Nor one of a
    torque that stood still or was late of late: it may be what that leaves. Nor one right after
    another: it may be the end of a third one between them, which was not told from the other.
    """
    n, k = p.window, w.steps - 1
    first, since = k - n, k - n - w.edge_at
    vague = w.stalled > 0 or w.quiet <= p.told_steps
    for j in range(2 * n + 1):
        vague = vague or w.doubt[(k - j) & WRAP] > 0.0
    if 0 < since <= n + p.edge:  # perhaps the end of a spike: what is left is of before it
        level += base - w.edge_nm - since * slope
        first, base = w.edge_at, w.edge_nm
        vague = vague or level * level <= _OWN_SIGMA**2 * w.swing
        if abs(level) * p.ratio < _KEPT * UNEXPLAINED_N:
            level = 0.0
    elif abs(level) < _BACK * most:  # a spike that is over already
        vague = vague or level * level <= _OWN_SIGMA**2 * w.swing
    for j in range(1, k - first + 1):
        w.torque[(first + j) & WRAP] = base + j * slope
    old = w.unexplained_nm
    w.unexplained_nm += level if abs(level) * p.ratio > UNEXPLAINED_N else 0.0
    vague = vague or (w.left > 0 and w.quiet <= p.consistent_steps)
    w.left = 0
    if abs(w.unexplained_nm) * p.ratio < _KEPT * UNEXPLAINED_N:
        forget_unexplained(w)
    elif level * old < 0.0 and abs(w.unexplained_nm) < _back_nm(w, old):
        forget_unexplained(w)
        w.left = 1
    vague = vague or (level * old < 0.0 and abs(w.unexplained_nm) < abs(old))
    w.slope_nm = slope
    w.quiet, w.missed = 0, 1 if vague else 0
    if w.unsure > 0:  # it may as well be the end of what was wrong since nobody looked
        w.missed, w.stalled, w.told = 1, p.stalled_steps, ROLLED_BACK
    else:
        w.told = p.told_steps


@kernel
def _back_nm(w: Watch, old: float) -> float:
    """What may be left (Nm) of an unexplained torque ``old`` that has jumped back."""
    return min(_BACK * abs(old), _BACK_SIGMA * math.sqrt(w.swing))


@kernel
def forget_unexplained(w: Watch) -> None:
    """Believe the torque again as it is."""
    w.torque += w.unexplained_nm
    w.unexplained_nm = 0.0


@kernel
def latched(w: Watch, p: Limits) -> int:
    """Inconsistent while a jump that nothing followed stays, or is too near in the past.

    So is a signal that stood still: it may be late since. Where inputs were missing the torque may
    have jumped back unseen, or its jump back was not seen well: then it is not doubted for long.
    """
    w.quiet += 1
    if w.stalled > 0:
        w.stalled -= 1
    if w.quiet > (p.stalled_steps if w.missed else p.consistent_steps) and w.unexplained_nm != 0.0:
        forget_unexplained(w)
    if w.told > 0:
        w.told -= 1
        return _INCONSISTENT
    if w.stalled > 0 or w.unexplained_nm != 0.0:
        return _INCONSISTENT
    return 0


@kernel
def bridge(w: Watch, p: Limits, u: Inputs) -> None:
    """Fill a hole of some steps: the torque as in :func:`course`, the speed as measured.

    Where the speed is missing too, it is interpolated.
    """
    missing, w.hole, w.missed = w.hole, 0, 1
    if w.steps == 0:
        return
    speed = w.speed[(w.steps - 1) & WRAP]
    slope = (u.motor_speed_rad_s - speed) / (missing + 1)
    for j in range(1, missing + 1):
        at = w.steps & WRAP
        w.apart[at] = w.apart[(w.steps - 1) & WRAP]
        w.torque[at] = guessed(w, p, u.drive_noise)
        w.drawn_at[at] = 0
        if not math.isfinite(w.speed[at]):
            w.speed[at] = speed + j * slope
            in_the_dark(w, p, True)
        add_pace(w, p)
        next_step(w, p)
        watch_jump(w, p, u)
        if w.steps == 0:
            return
