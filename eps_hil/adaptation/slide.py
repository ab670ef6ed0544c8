"""The friction level of one slide, from its momentum balance (eq. 1d, 2, 3).

A slide is a stretch of motion in one direction, from rest. Integrated over time, eq. 1d reads

    J ω(t) − ∫ (T_1m − F/i_APA − T_v) dt  =  c − k0 ∫ g dt

with the bristle's share g = 1 − (1 − g0) exp(−σ0 s/T_fs) over the travel s (the exact solution of
eq. 2a for a constant level), T_v = g (kω|ω| + kr|F|) + σ1(ω) ω (1 − g) of eq. 2c, 2d and 3. That is
a straight line in ∫ g dt whose slope is k0: nothing is differentiated, and ramp rate, inertia,
viscous term and presliding are in the equation instead of being corrected for afterwards. As g
depends on k0, a few rounds are made. docs/theory-adaptation.md derives it.
"""

import math
from collections.abc import Generator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

FULL_SHARES = (0.995, 0.95)
"""Shares of the level from which on a bristle counts as sliding, the best first: the later, the
less the form of presliding matters."""
_LEAST_PART = 1.0 / 3.0
"""Of the way that must lie beyond, or the next share is taken."""
_ROUNDS = 6
_LEAST_ROWS = 20
_SMOOTHED = 41
"""Samples of the moving mean over the torque of a ramp."""
_BENT = 0.85
"""Share of the break-away torque up to which a ramp is read for its presliding length."""
_LEAST_NM, _MOST_NM = 1e-4, 10.0


class Slide(NamedTuple):
    """One slide at equal steps, signals put to their physical instants, all shape (n,).

    Positive along the slide: a slide in negative direction comes mirrored. ``torque_nm`` is T_1m
    (rotor), ``travel_rad`` counts from rest; ``preload_nm`` is the bristle's torque at the start.
    """

    step_s: float
    torque_nm: Floats
    speed_rad_s: Floats
    travel_rad: Floats
    force_n: Floats
    preload_nm: float = 0.0


class SlideLevel(NamedTuple):
    """k0 (Nm, rotor) of one slide.

    ``standard_error_nm`` is the line's own; ``lengths`` is ``travel_rad`` in presliding
    lengths T_fs/σ0; ``rows`` is how many samples of full sliding were used; ``drift_nm_per_rad``
    is how the level rose along the way (a spring at the rack does that), with its error.
    ``form_nm``: how much larger or smaller k0 would be if the rotor slid fully from the first
    sample used: by eq. 2a the bristle never quite gets there, other friction does. ``bent_rad``:
    the presliding length λ that the ramp itself shows (NaN: it does not).
    """

    offset_nm: float
    standard_error_nm: float
    lengths: float
    travel_rad: float
    rows: int
    drift_nm_per_rad: float
    drift_error_nm_per_rad: float
    form_nm: float
    bent_rad: float


def slide_level(
    slide: Slide, model: Model, *, positive: bool, guess_nm: float
) -> Generator[None, None, SlideLevel | None]:
    """k0 of this direction, a piece at each ``next``; None where the rotor never really slid.

    ``guess_nm`` starts the rounds (the torque at break-away). Where the travel does not bring the
    bristle to one of :data:`FULL_SHARES`, the second half of the way is used, and the result leans
    on the bristle's form (few ``lengths``, and ``form_nm``, say so).
    """
    f = model.friction
    viscous = f.viscous_pos_nm_s_per_rad if positive else f.viscous_neg_nm_s_per_rad
    load = f.load_pos_nm_per_n if positive else f.load_neg_nm_per_n
    beside = viscous * np.abs(slide.speed_rad_s) + load * np.abs(slide.force_n)
    ratio = np.minimum(np.abs(slide.speed_rad_s) / f.sigma1_speed_rad_s, 20.0)
    damping = f.sigma1_nm_s_per_rad * np.exp(-ratio * ratio) * slide.speed_rad_s
    drive = slide.torque_nm - slide.force_n / model.rack_to_rotor_ratio_rad_per_m
    momentum = model.inertia_kg_m2 * slide.speed_rad_s
    way = np.maximum(np.maximum.accumulate(slide.travel_rad), 0.0)
    offset = max(guess_nm, _LEAST_NM)
    for _ in range(_ROUNDS):
        level = offset + float(np.mean(beside))
        start = min(max(slide.preload_nm / level, -1.0), 1.0)
        share = 1.0 - (1.0 - start) * np.exp(-way * f.sigma0_nm_per_rad / level)
        begin = _begin(share, way)
        if len(way) - begin < _LEAST_ROWS:
            return None
        taken = drive - share * beside - damping * (1.0 - share)
        line = momentum - _integral(taken, slide.step_s)
        part = slice(begin, None)
        before, offset = offset, _slope(line[part], share[part], slide.step_s)
        if not _LEAST_NM < offset < _MOST_NM:
            return None
        yield
        if abs(offset - before) < 1e-7:
            break
    noise = _noise(slide.torque_nm[part])
    found = _fit(line[part], share[part], way[part], slide.step_s, noise)
    yield
    at_once = momentum - _integral(drive - beside, slide.step_s)
    other = _slope(at_once[part], np.ones_like(share[part]), slide.step_s)
    yield
    return found._replace(
        form_nm=abs(other - found.offset_nm),
        lengths=float(way[-1]) * f.sigma0_nm_per_rad / level,
        travel_rad=float(way[-1]),
        bent_rad=_bent_rad(slide, model, found.offset_nm),
    )


def _bent_rad(slide: Slide, model: Model, torque_nm: float) -> float:
    """λ of T = ``torque_nm`` · (1 − exp(−s/λ)) along the ramp: the slope of s over −ln(1 − T/T_∞).

    What the bristle's damping adds on a ramp of rate r is σ1/σ0 · r, and comes off first.
    """
    torque = _moving_mean(slide.torque_nm)
    stop = int(np.argmax(torque > _BENT * torque_nm))
    if stop < 4 * _SMOOTHED:
        return math.nan
    part, time = slice(_SMOOTHED // 2, stop), slide.step_s * np.arange(stop)
    rate = float(np.polyfit(time[part], torque[part], 1)[0])
    f = model.friction
    bent = torque[part] - f.sigma1_nm_s_per_rad / f.sigma0_nm_per_rad * rate
    share = np.clip(bent / torque_nm, -1.0, _BENT)
    return float(np.polyfit(-np.log1p(-share), slide.travel_rad[part], 1)[0])


def _moving_mean(values: Floats) -> Floats:
    padded = np.pad(values, _SMOOTHED // 2, mode="edge")
    return np.convolve(padded, np.ones(_SMOOTHED) / _SMOOTHED, mode="valid")


def _begin(share: Floats, way: Floats) -> int:
    """From which sample on it counts as sliding."""
    for full in FULL_SHARES:
        begin = int(np.searchsorted(share, full))
        if begin < len(way) and way[begin] <= (1.0 - _LEAST_PART) * way[-1]:
            return begin
    return int(np.searchsorted(way, 0.5 * way[-1]))


def _integral(values: Floats, step_s: float) -> Floats:
    """Trapezoids from the first sample on, shape (n,)."""
    inner = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([[0.0], np.cumsum(inner)]) * step_s


def _slope(line: Floats, share: Floats, step_s: float) -> float:
    """Of the momentum over ∫g dt, which is −k0: k0 (Nm)."""
    weight = _integral(share, step_s)
    columns = np.column_stack([np.ones_like(weight), -weight])
    return float(np.linalg.lstsq(columns, line, rcond=None)[0][1])


def _fit(line: Floats, share: Floats, way: Floats, step_s: float, noise_nm: float) -> SlideLevel:
    """Slope of the momentum over ∫g dt, and whether the level drifts along the way.

    Beside the residual's own error stands that of the torque's noise, which the integral turns
    into a wander that a residual does not show: for a line through a random walk of n steps the
    slope's variance is 6/5 σ²/n.
    """
    weight = _integral(share, step_s)
    columns = np.column_stack([np.ones_like(weight), -weight])
    (_, offset), error = _least_squares(columns, line)
    along = way - float(np.mean(way))
    columns = np.column_stack([columns, -_integral(share * along, step_s)])
    (_, _, drift), drift_error = _least_squares(columns, line)
    wander = noise_nm * math.sqrt(1.2 / len(line))
    spread = max(float(np.std(way)), 1e-9)
    return SlideLevel(
        offset_nm=float(offset),
        standard_error_nm=math.hypot(float(error[1]), wander),
        lengths=0.0,
        travel_rad=0.0,
        rows=len(line),
        drift_nm_per_rad=float(drift),
        drift_error_nm_per_rad=math.hypot(float(drift_error[2]), 1.2 * wander / spread),
        form_nm=0.0,
        bent_rad=math.nan,
    )


def _noise(values: Floats) -> float:
    """Standard deviation of white noise on a smooth signal, from its second differences."""
    if len(values) < 3:
        return 0.0
    return float(np.sqrt(np.mean(np.diff(values, 2) ** 2) / 6.0))


def _least_squares(columns: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Coefficients and their standard errors, both (k,); errors are inf where not determined."""
    found, _, rank, _ = np.linalg.lstsq(columns, target, rcond=None)
    k = columns.shape[1]
    if rank < k or len(target) <= k:
        return np.asarray(found, np.float64), np.full(k, math.inf)
    left = target - columns @ found
    variance = float(left @ left) / (len(target) - k)
    covariance = variance * np.linalg.inv(columns.T @ columns)
    return np.asarray(found, np.float64), np.asarray(np.sqrt(np.diag(covariance)), np.float64)
