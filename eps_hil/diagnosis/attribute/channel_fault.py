"""One signal that is late, adrift or reads too much, where the torque balance names others for it.

A signal that is late against all others looks like all others being early: the torque balance then
names a late motor torque, an early speed sensor, or nothing. A load cell that reads too much looks
like a ratio and a sensor's gain that are both off. One whose clock drifts looks late by the mean
of that. Where such names were taken, or much was left, one number for the one signal is tried in
the place of them all. A clock has a name in the catalogue (`clock_drift`), the others have none.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.attribute.numbers import SCALES, SPANNED
from eps_hil.diagnosis.attribute.scoring import FINAL_SHARE, refitted, threshold
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.baseline import ALL, HOLD
from eps_hil.diagnosis.balance.fit import Fit, fit
from eps_hil.diagnosis.balance.problem import Problem, huber, knee
from eps_hil.diagnosis.balance.reference import gain_is_observable
from eps_hil.diagnosis.balance.spread import half_widths
from eps_hil.diagnosis.data.drift import IN_BALANCE, MOTION, Drift, drift_matters
from eps_hil.diagnosis.data.entry import place, unknown
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.diagnosis.mismatch.leftover import LARGE_EXCESS
from eps_hil.identification.filters import shifted
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

CHANNELS = {"rack_force_n": "rack_force", "torque_sensor_nm": "torque_sensor"}
"""Signals without a delay effect of their own, and their entries in the model's ``delays_s``."""
LOAD_CELL = "rack_force_n"
"""The signal without a gain effect of its own."""
CLOCKS: Mapping[str, tuple[str, ...]] = {
    "motor_torque_nm": ("motor_torque_nm",),
    "torque_sensor_nm": ("torque_sensor_nm",),
    "rack_force_n": ("rack_force_n",),
    MOTION[0]: MOTION,
}
"""Signals whose clock may drift, and those that share it."""
LEAST_S, LEAST_GAIN = 1e-3, 0.005
"""Less is how signals are sampled and filtered, and how load cells are calibrated."""
MOST_S, MOST_GAIN = 0.1, 0.5
_MOST_PPM = 5e3
"""No clock is worse; a step that goes farther has left what is linear."""
_TIMING = (HOLD, "speed_sensor_delay")
_DELAY_PART = 0.3
"""Of what a drift comes to at the end of the recordings that a delay beside it may be."""
_LEAST_PART = 0.5
"""Of what a refit leaves over that the one number has to explain."""
_AS_KEPT = 0.5
"""Of the share that it explains of the fitted recordings, what it has to take off hold-outs."""
_RESOLUTION_S, _RESOLUTION, _RESOLUTION_PPM = 1e-4, 1e-3, 0.5
_STEP_PPM, _STEP_S = 5.0, 1e-4
"""For a difference."""
_ROUNDS = 5
_GRID = 26


@dataclass(frozen=True)
class ChannelFault:
    """A signal, how much later (s), larger (factor) or adrift (ppm) it is, what that explains.

    ``ppm`` is None where its clock is not what is asked for; ``low`` to ``high`` is what
    it goes through, in its unit.
    """

    signal: str
    late_s: float = 0.0
    gain: float = 1.0
    share: float = 1.0
    low: float = 0.0
    high: float = 0.0
    ppm: float | None = None
    half_ppm: float = 0.0

    def matters(self, recordings: Sequence[Prepared]) -> bool:
        """Whether it is more than how signals are sampled, filtered and calibrated."""
        if self.ppm is not None:
            return abs(self.ppm) > 2.0 * self.half_ppm and drift_matters(self.ppm, recordings)
        return abs(self.late_s) > LEAST_S or abs(self.gain - 1.0) > LEAST_GAIN

    def in_model(self, model: Model) -> Model:
        """The model with that signal's true delay."""
        if self.late_s == 0.0:
            return model
        key = CHANNELS[self.signal]
        moved = {key: max(getattr(model.delays_s, key) + self.late_s, 0.0)}
        return replace(model, delays_s=replace(model.delays_s, **moved))

    def put_right(self, one: Prepared) -> Prepared:
        """The recording with that signal as large, or on the clock, as it should be."""
        if self.ppm is not None:
            return self._drift.corrected(one)
        if self.gain == 1.0:
            return one
        return one.changed(raw={**one.raw, self.signal: one.raw[self.signal] / self.gain})

    @property
    def _drift(self) -> Drift:
        ppm = 0.0 if self.ppm is None else self.ppm
        return Drift(ppm, self.half_ppm, np.inf, CLOCKS[self.signal], IN_BALANCE)

    def finding(self, model: Model) -> dict[str, Any]:
        """The JSON entry (CONTRACT 7), beside the model file's ``model``."""
        if self.ppm is not None:
            return self._drift.finding()
        return unknown(
            f"{self._words(model)} explains {100 * self.share:.0f} % of the mismatch. No effect of "
            "the catalogue stands for that.",
            0.95,
            [place(self.signal, self.low, self.high, self.share)],
            kind="instrument",
        )

    def _words(self, model: Model) -> str:
        if self.late_s == 0.0:
            return f"{self.signal} reads {self.gain:.3f} times what it should: dividing it by that"
        key, delay_s = CHANNELS[self.signal], self.in_model(model).delays_s.of(self.signal)
        way = "later" if self.late_s > 0 else "earlier"
        return (
            f"{self.signal} is reported {1e3 * abs(self.late_s):.3g} ms {way} than the model file "
            f"says: delays_s.{key} of {delay_s:.3g} s"
        )


def channel_fault(
    problem: Problem,
    selection: Selection,
    measured: Collection[str],
    without: Collection[str] = (),
) -> ChannelFault | None:
    """The signal of which one number does as well as all such numbers that were named, or None.

    And it has to explain most of what the model's own numbers, refitted, leave over. ``measured``:
    the signals that were recorded. Effects in ``without`` (ids) are not considered.
    """
    found = selection.searched
    names = [str(entry["effect"]) for entry in found.entries]
    excess = float(np.mean(found.residual[problem.sliding] ** 2)) - 1.0
    tried: list[tuple[ChannelFault, Sequence[str]]] = []
    much = excess > LARGE_EXCESS
    if set(names) & set(_TIMING) or much:
        tried += [(ChannelFault(name), _TIMING) for name in CHANNELS if name in measured]
        if "clock_drift" not in without:
            clocks = [name for name in CLOCKS if name in measured]
            tried += [(ChannelFault(name, ppm=0.0), _TIMING) for name in clocks]
    if LOAD_CELL in measured and (len(set(names) & set(SCALES)) > 1 or much):
        reads_more = ChannelFault(LOAD_CELL, gain=1.0 + LEAST_GAIN)
        if gain_is_observable(problem, _sensitivity(problem, found, reads_more)):
            tried.append((reads_more, SCALES))
    compared = {instead: _Compared(problem, found, instead) for _, instead in tried}
    told = [compared[instead].to(start) for start, instead in tried]
    best = _best([one for one in told if one is not None], problem)
    if best is None:
        return None
    seen = np.concatenate([one.raw[best.signal] for one in problem.recordings])
    low, high = np.percentile(seen, [2, 98])
    return replace(best, low=float(low), high=float(high))


def _best(told: Sequence[tuple[ChannelFault, Fit]], problem: Problem) -> ChannelFault | None:
    """What leaves least; no clock at all where the clock that leaves least is a delay."""
    if not told:
        return None
    one, after = min(told, key=lambda each: each[1].cost)
    if one.ppm is None or not _is_a_delay(problem, after, one):
        return one
    return _best([each for each in told if each[0].ppm is None], problem)


def held_out_energy(problem: Problem, found: Fit, kept: Sequence[Prepared]) -> float:
    """Mean energy (noise variances, outliers cut) that a fit leaves of recordings kept from it."""
    test = problem.over(kept)
    left = test.residual(test.with_entries(found.entries, found.own))[test.sliding]
    return float(np.mean(np.minimum(left**2, (2.0 * knee(found.residual)) ** 2)))


def no_worse(before: float, after: float, spared: int, samples: int, share: float) -> bool:
    """Whether one number for a signal does on hold-outs what ``spared`` numbers more did.

    Mean energies of :func:`held_out_energy`. A wrong ratio and two gains are the very same as a
    load cell's gain, to what noise makes of each; so numbers have Schwarz's price, ln n, as they
    have everywhere. Where none is spared, it has to take off hold-outs half as much of what is
    beyond noise as of the fitted recordings, of which it takes ``share``.
    """
    if spared <= 0:
        return after < before - _AS_KEPT * share * max(before - 1.0, 0.0)
    return after < before + spared * float(np.log(max(samples, 1))) / max(samples, 1)


def refined(wrong: ChannelFault, problem: Problem, selection: Selection) -> ChannelFault:
    """The same once more, beside what is found now that it is known.

    ``problem`` has it put right. What was found before may have made up for a part of it. The very
    same where it did not.
    """
    others = [e for e in selection.searched.entries if e["effect"] not in SPANNED]
    bare = fit(problem, others, own={**ALL, **problem.tied})
    still = ChannelFault(
        wrong.signal,
        gain=1.0 if wrong.gain == 1.0 else 1.0 + LEAST_GAIN,
        ppm=None if wrong.ppm is None else 0.0,
    )
    more, _ = _followed(problem, bare, others, still)
    if wrong.ppm is not None and more.ppm is not None:
        far = abs(more.ppm) > _RESOLUTION_PPM
        return replace(wrong, ppm=wrong.ppm + more.ppm, half_ppm=more.half_ppm) if far else wrong
    if abs(more.late_s) < _RESOLUTION_S and abs(more.gain - 1.0) < _RESOLUTION:
        return wrong
    return replace(wrong, late_s=wrong.late_s + more.late_s, gain=wrong.gain * more.gain)


class _Compared:
    """Entries of some names, beside which one number of a signal has to do as well."""

    def __init__(self, problem: Problem, found: Fit, names: Sequence[str]) -> None:
        self.problem = problem
        self.others = [e for e in found.entries if e["effect"] not in (*names, *SPANNED)]
        named = [e for e in found.entries if e["effect"] in names]
        self.bare = fit(problem, self.others, own={**ALL, **problem.tied})
        self.named = fit(problem, [*self.others, *named], own=self.bare.own) if named else self.bare

    def to(self, start: ChannelFault) -> tuple[ChannelFault, Fit] | None:
        """The one number and the fit with it; None where it does not do as well."""
        problem, bare = self.problem, self.bare
        one, after = _followed(problem, bare, self.others, start)
        gain, over = bare.cost - after.cost, bare.cost - float(len(bare.residual))
        clear = threshold(problem, bare.residual, FINAL_SHARE)
        if gain < max(_LEAST_PART * over, clear):
            return None
        if not one.matters(problem.recordings):
            return None
        unlike = threshold(problem, self.named.residual, FINAL_SHARE)
        if start.ppm is not None:
            unlike = -unlike  # a drift is mostly its mean: a delay does nearly as well
        if after.cost > self.named.cost + unlike:
            return None
        return replace(one, share=gain / max(over, gain)), after


def _followed(
    problem: Problem, bare: Fit, others: Sequence[Mapping[str, Any]], start: ChannelFault
) -> tuple[ChannelFault, Fit]:
    """What fits best of the signal's one number, and the fit with that.

    The numbers that the wrong signal bent come back while it is found, so it takes a few rounds.
    """
    best = _best_delay if start.gain == 1.0 else _best_gain
    if start.ppm is not None:
        best = _best_ppm
    one, after = ChannelFault(start.signal, ppm=start.ppm), bare
    for _ in range(_ROUNDS):
        before = one
        one = best(problem, after, one)
        after = fit(_right(problem, one), others, own=after.own)
        if _same(one, before) or not one.matters(problem.recordings):
            break
    return one, after


def _same(one: ChannelFault, other: ChannelFault) -> bool:
    late, gain = abs(one.late_s - other.late_s), abs(one.gain - other.gain)
    ppm = abs((one.ppm or 0.0) - (other.ppm or 0.0))
    return late < _RESOLUTION_S and gain < _RESOLUTION and ppm < _RESOLUTION_PPM


def _right(problem: Problem, one: ChannelFault) -> Problem:
    recordings = [one.put_right(each) for each in problem.recordings]
    right = replace(problem, recordings=recordings, model=one.in_model(problem.model))
    right.knee = problem.knee
    return right


def with_channel_fault(content: Mapping[str, Any], finding: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON (CONTRACT 7) with this finding beside the others."""
    findings = [*content["findings"], dict(finding)]
    nameless = [one["effect"] == "unknown" for one in findings]
    verdict = "partly_explained" if any(nameless) else "explained"
    verdict = "unknown_effect" if all(nameless) else verdict
    return {**content, "verdict": verdict, "findings": findings}


def _best_delay(problem: Problem, fitted: Fit, one: ChannelFault) -> ChannelFault:
    model = problem.with_entries(fitted.entries, fitted.own)

    def cost(late_s: float) -> float:
        residual = problem.residual(replace(one, late_s=late_s).in_model(model))
        return problem.cost(refitted(residual, fitted.jacobian))

    least = -problem.model.delays_s.of(one.signal)
    return replace(one, late_s=_least(cost, least, MOST_S, _RESOLUTION_S))


def _sensitivity(problem: Problem, fitted: Fit, one: ChannelFault) -> Floats:
    """What a gain does to the weighted residual, (n, 1)."""
    model = problem.with_entries(fitted.entries, fitted.own)
    parts = [one.put_right(each).left_over(model) for each in problem.recordings]
    before = [each.left_over(model) for each in problem.recordings]
    moved = (np.concatenate(parts) - np.concatenate(before)) / problem.scale
    return np.asarray(moved / (one.gain - 1.0))[:, None]


def _best_gain(problem: Problem, fitted: Fit, one: ChannelFault) -> ChannelFault:
    model = problem.with_entries(fitted.entries, fitted.own)

    def cost(gain: float) -> float:
        right = replace(one, gain=gain)
        parts = [right.put_right(each).left_over(model) for each in problem.recordings]
        residual = np.concatenate(parts) / problem.scale
        return problem.cost(refitted(residual, fitted.jacobian))

    low, high = 1.0 / (1.0 + MOST_GAIN), 1.0 + MOST_GAIN
    return replace(one, gain=_least(cost, low, high, _RESOLUTION))


def _best_ppm(problem: Problem, fitted: Fit, one: ChannelFault) -> ChannelFault:
    """One step towards less: what a drift moves is nearly linear in it."""
    step, half = _clock_step(problem, fitted, one, 0.0)
    ppm = float(np.clip((one.ppm or 0.0) + step[0], -_MOST_PPM, _MOST_PPM))
    return replace(one, ppm=ppm, half_ppm=float(half[0]))


def _is_a_delay(problem: Problem, fitted: Fit, one: ChannelFault) -> bool:
    """Whether a drift, once a delay of the same signal is free beside it, becomes that delay."""
    if one.ppm is None:
        return False
    late_s, ppm = 0.0, one.ppm
    for _ in range(_ROUNDS):
        step, half = _clock_step(problem, fitted, replace(one, ppm=ppm), late_s, delay=True)
        ppm = float(np.clip(ppm + step[0], -_MOST_PPM, _MOST_PPM))
        late_s = float(np.clip(late_s + step[1], -MOST_S, MOST_S))
    longest = max(float(each.since_start_s[-1]) for each in problem.recordings)
    unsure = abs(ppm) < 2.0 * float(half[0])
    return unsure or abs(late_s) > _DELAY_PART * abs(ppm) * 1e-6 * longest


def _clock_step(
    problem: Problem, fitted: Fit, one: ChannelFault, late_s: float, *, delay: bool = False
) -> tuple[Floats, Floats]:
    """(step of ppm and, if ``delay``, of late_s; half widths): one of least squares."""
    model = problem.with_entries(fitted.entries, fitted.own)

    def left(ppm: float, late_s: float) -> Floats:
        clock, parts = replace(one, ppm=ppm), []
        for each in problem.recordings:
            late = {n: shifted(each.raw[n], late_s) for n in CLOCKS[one.signal] if n in each.raw}
            moved = each.changed(raw={**each.raw, **late}) if late_s else each
            parts.append(clock.put_right(moved).left_over(model))
        return np.concatenate(parts) / problem.scale

    now = one.ppm or 0.0
    residual = left(now, late_s)
    columns = [(left(now + _STEP_PPM, late_s) - residual) / _STEP_PPM]
    others = fitted.jacobian
    if delay:  # which stands for how the motor's torque is held, too
        columns.append((left(now, late_s + _STEP_S) - residual) / _STEP_S)
        others = np.delete(others, [k for k, name in enumerate(fitted.own) if name == HOLD], axis=1)
    jacobian = np.column_stack([*columns, others])
    weight = np.sqrt(huber(refitted(residual, jacobian), problem.knee))
    size = np.sqrt(np.sum(jacobian**2, axis=0)) + 1e-300
    scaled = jacobian / size * weight[:, None]
    step = np.linalg.lstsq(scaled, residual * weight, rcond=1e-9)[0] / size
    left_over = (residual - jacobian @ step) * weight
    half = half_widths(jacobian * weight[:, None], left_over, (problem.block, problem.stretch))
    return -step, half


def _least(cost: Callable[[float], float], low: float, high: float, resolution: float) -> float:
    """Where the cost is least: on a grid, then between its neighbours."""
    from scipy.optimize import minimize_scalar

    grid = np.linspace(low, high, _GRID)
    k = int(np.argmin([cost(float(one)) for one in grid]))
    ends = float(grid[max(k - 1, 0)]), float(grid[min(k + 1, len(grid) - 1)])
    found = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": resolution / 4})
    return float(found.x)
