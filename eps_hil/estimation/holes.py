"""Holes of the inputs: how the torque goes on in them, and how much of its end is only that guess.

A short hole is bridged on the torque's own course, so that what it did meanwhile is one jump at the
hole's end, which the motion confirms or not. A load that swings leaves that course by itself; by
how much is learnt while samples come, and a jump that is no larger than that says nothing. Then,
as after a hole that is too long to be bridged, what may have begun unseen is waited for.
"""

from eps_hil.compiled import kernel
from eps_hil.estimation.validity import Reason
from eps_hil.estimation.watch import NO_STEP, WRAP, Limits, Watch

_SETTLING, _GAP = int(Reason.SETTLING), int(Reason.GAP)
_SUDDEN = 0.7
"""Share of a torque's change in a window that a jump makes in two milliseconds."""
_TURNS_IN = 5
"""A fast rotor turns round within a fifth of a window, 2 ms, and its friction with it."""
UNEXPLAINED_N = 50.0
"""A jump of the torque that is worth less at the rack is not looked at."""
ROLLED_BACK = 2
"""Steps for which a doubt of something past is a doubt of now, so that the state is rolled back."""
_SPIKE = 4.0
"""A sample in a hole that strays so many times as far as the hole's end went off the course."""
_SIGMA = 2.0
"""Deviations of the guess within which a jump at a hole's end may be the guess's own error."""


@kernel
def unseen(w: Watch, p: Limits) -> int:
    """Settling while a torque may be wrong since a time at which nobody looked.

    Whatever began to be wrong in a hole of the inputs is not seen; only its end would be, and for
    so long it is waited for. After a start it is only not known which of both a jump is: who
    begins amid traffic waits by himself (service/core.py), a recording begins before its faults.
    So it is while the motion has to confirm what the torque did in a hole (:func:`course`), or the
    angle what the speed did. A gap that does not end, or comes again as soon as it does, is none:
    the torques come more seldom than was said of them. What they do between their samples may be
    over at the next one, and no single hole of 10 or 18 ms is long enough to be waited for.
    """
    if w.scarce > p.scarce_steps:
        w.unsure, w.started, w.missed_now = p.unsure_steps, 0, 0
        return _SETTLING | _GAP
    waits, w.awaited = w.awaited, max(w.awaited - 1, 0)
    if w.missed_now:
        w.unsure, w.missed_now = p.unsure_steps, 0
    if w.unsure == 0:
        w.started = 0
        return _SETTLING if waits else 0
    w.unsure -= 1
    return 0 if w.started and not waits else _SETTLING


@kernel
def lose_course(w: Watch) -> None:
    """Nobody knows how the torque should go on: it is looked at anew from here."""
    w.missed_now, w.started = 1, 0
    w.swing_turn, w.relation_turn, w.guessed_at = 0, 0, NO_STEP
    w.steps, w.missed, w.hole, w.guesses, w.hole_first = 0, 1, 0, 0, -1


@kernel
def blind(w: Watch, p: Limits, speed: float, refused: bool) -> None:
    """Inputs are missing: for longer than a bridge carries, the torque's course is lost.

    A hole goes on where inputs come but no torque is seen between two of them. The course is lost,
    too, where a sample was ``refused``: what is impossible now may have been wrong before.
    """
    w.speed[(w.steps + w.hole) & WRAP] = speed
    w.hole += 1
    w.unseen += 1
    if w.steps > 0 and (refused or w.unseen > p.bridged):
        lose_course(w)


@kernel
def in_the_dark(w: Watch, p: Limits, drawn: bool) -> None:
    """Count the steps of a hole of the speed, ``drawn`` straight from its one end to the other.

    Friction that turns over in it is given back in its own time (``add_pace``), and bends the
    course there as no load does; for as long as the windows reach into the hole.
    """
    if w.drawn > 0 and not drawn:
        w.hole_first, w.hole_last = w.steps - w.drawn - 1, w.steps
    w.drawn = w.drawn + 1 if drawn else 0
    w.drawn_at[w.steps & WRAP] = w.drawn
    w.dark = 3 * p.window if w.drawn > p.window // _TURNS_IN else max(w.dark - 1, 0)


@kernel
def course(w: Watch, p: Limits, torque: float, noise: float, seen: bool) -> float:
    """``torque`` (Nm) of this step, or how it would have gone on where it was not seen.

    What it did in a short hole is one jump at its end then, which the motion confirms or not; after
    a hole longer than a window the estimate waits for that. A single sample within the hole that is
    far from the course before and after it was estimated with: that is taken back.
    ``noise``: variance of the torque's samples.
    """
    k, n = w.steps, p.window
    w.unseen = 0 if seen else w.unseen + 1
    w.scarce = max(w.scarce - 1, 0) if seen else min(w.scarce + 1, p.scarce_steps + 1)
    if 0 < w.unseen <= p.bridged and k > 0:
        guess = guessed(w, p, noise)
        w.strayed = max(w.strayed, abs(torque - guess))
        return guess
    if w.guesses > 0 and k > 0:
        off = torque - w.torque[(k - 1) & WRAP] - w.slope_nm
        if w.guesses > n and _strays(w, p, off, noise, k - 1):
            w.awaited = n + 1
        if w.strayed > _SPIKE * abs(off) and _strays(w, p, w.strayed, noise, k - 1):
            w.told = max(w.told, ROLLED_BACK)
    w.strayed = 0.0
    w.guesses, w.doubt[k & WRAP] = 0, 0.0
    w.slope_nm = (torque - w.torque[(k - n) & WRAP]) / n if k >= n else 0.0
    return torque


@kernel
def _strays(w: Watch, p: Limits, off: float, noise: float, k: int) -> bool:
    """Whether a torque ``off`` (Nm) the guess of step ``k`` is more than noise and guessing."""
    least = max(p.jump * noise, _SIGMA**2 * w.doubt[k & WRAP])
    return off * off > least and abs(off) * p.ratio > UNEXPLAINED_N


@kernel
def guessed(w: Watch, p: Limits, noise: float) -> float:
    """The torque (Nm) of the next step in a hole, as its course was, and how wrong that may be.

    The course may bend meanwhile, and its slope is that of noisy torques, or of a guess where the
    hole before ended less than a window ago.
    """
    k, n = w.steps, p.window
    if w.guesses == 0:
        w.guess_before = w.doubt[(k - 1 - n) & WRAP] if k > n else 0.0
        if _jumps(w, p, noise):
            w.slope_nm = (w.torque[(k - 1 - n) & WRAP] - w.torque[(k - 1 - 2 * n) & WRAP]) / n
    w.guesses += 1
    far = w.guesses / n
    bent = 0.5 * far * (far + 1.0)
    doubt = bent * bent * w.swing + far * far * (2.0 * noise + w.guess_before)
    w.doubt[k & WRAP] = doubt
    if doubt > 0.0:
        w.guessed_at = k
    return float(w.torque[(k - 1) & WRAP] + w.slope_nm)


@kernel
def _jumps(w: Watch, p: Limits, noise: float) -> bool:
    """Whether the torque of the last window is no slope but a jump, which is not judged yet."""
    n, k, t, most = p.window, w.steps - 1, w.torque, 0.0
    if k < 2 * n:
        return False
    bend = t[k & WRAP] - 2.0 * t[(k - n) & WRAP] + t[(k - 2 * n) & WRAP]
    for j in range(n - p.edge + 1):
        most = max(most, abs(t[(k - j) & WRAP] - t[(k - j - p.edge) & WRAP]))
    return bool(bend * bend > max(p.jump * noise, w.swing) and most > _SUDDEN * abs(bend))


@kernel
def learn_swing(w: Watch, p: Limits) -> None:
    """How far the torque leaves its course by itself within a window: the largest square (Nm²) of
    its second difference in the last half second or so, of torques that were seen."""
    n, m, t, doubt = p.window, w.steps - 1 - p.window, w.torque, w.doubt
    if max(doubt[m & WRAP], doubt[(m - n) & WRAP], doubt[(m - 2 * n) & WRAP]) > 0.0:
        return
    bend = t[m & WRAP] - 2.0 * t[(m - n) & WRAP] + t[(m - 2 * n) & WRAP]
    w.swing = max(bend * bend, w.swing * (1.0 - p.spread_memory))


@kernel
def undecided(w: Watch, p: Limits, edge: float) -> bool:
    """Whether a jump of ``edge`` (Nm), a window ago, may be no more than where a guess ended."""
    m, most = w.steps - 1 - p.window, 0.0
    for j in range(p.edge):
        most = max(most, w.doubt[(m + j) & WRAP])
    return bool(edge * edge <= _SIGMA**2 * most)
