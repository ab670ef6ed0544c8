"""The bristle's stiffness from full reversals, one by one, and which form its curve has.

From sliding into sliding the other way, friction runs along T − (T + T') exp(−u/ℓ) over the path u,
T and T' the levels this way and before. LuGre's length is ℓ = T/σ0, another one each way; slip
elements that stick up to their share of either level have one for both, (T + T')/2σ0 (Masing's
rule). What comes between (a rest, a turn back half way) depends on the form in more than that, and
the balance trusts none of it. Full reversals it can be asked about, each with a level and a
difference of its own that say nothing; how they scatter says how sure the answer is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.balance.fit import BRISTLE, Fit
from eps_hil.diagnosis.balance.problem import SETTLED_RAD, Problem
from eps_hil.diagnosis.data.entry import known
from eps_hil.diagnosis.data.prepare import STEP_S, THIN, Floats, Prepared
from eps_hil.physics.balance import Motion, residual_nm, sliding_levels_nm
from eps_hil.physics.effects.catalogue import catalogue, with_model_effects
from eps_hil.physics.friction import SMALLEST_LEVEL_NM
from eps_hil.physics.model import Model

Integers = npt.NDArray[np.intp]

FEWEST, FEWEST_KEPT = 20, 8
"""Reversals that an answer needs, and that a hold-out needs to confirm it."""
HALF_WINDOW_S = 0.12
LONGEST_INTERVAL_S = 2e-3
"""Between samples: a reversal is over in ten to thirty milliseconds."""
_FORM = 0.02
"""Deviation of ln σ0 for what a curve may be beside both forms, as of a few slip elements."""
_LEVELS = 0.15
"""Deviation of ln T_fs between the programmes that a rig is driven by: where the stiffness goes
with the level, the model's may be that of another level."""
_LEVEL = 1e-3
"""Of ln T_fs: less is the same level at all reversals."""
_SURE, _BEYOND_DOUBT, _SAME = 4.0, 8.0, 2.0
"""Deviations from nothing: of a finding, of one that no hold-out can judge, and of a hold-out's."""
_AS_NOISE = 1.25
"""Times the sensors' noise that may be left: where more is, something else acts at reversals."""
_MOST_LOG = 1.5
"""Farther off is left to the balance, which then shows it plainly."""
_MOST_STEP, _ROUNDS, _CLOSE, _STRAIGHT = 0.4, 8, 0.01, 0.2
_OWN_LEVELS = 2
"""Numbers of its own that each window has: fewer samples say nothing else."""
_REST_SAMPLES = 20
"""At 1 kHz: a rotor that stays longer has rested."""
_SPEED_RAD_S = 1.0
"""Below this the two levels of a window pass into one another."""
_LUGRE = "the form that the model file knows (LuGre's)"
_MASING = (
    "one length both ways, as slip elements have (Masing), where the model file's form has two"
)
_SMALL, _SMALL_S = 0.05, 1e-4
"""Of ln σ0 and of a delay, for a difference."""


@dataclass(frozen=True)
class Bristle:
    """Stiffness that full reversals show: ln of true per modelled, its deviation, how many."""

    log_ratio: float
    sigma: float
    count: int
    modelled: float
    """σ0 of the model, Nm/rad."""
    masing: bool
    """Whether both ways have one length."""
    times_noise: float
    """What is left in the usual window over the sensors' noise."""
    scatter: float
    """As ``sigma``, but for what these recordings' levels may have to do with it."""

    @property
    def entry(self) -> dict[str, Any]:
        """Of a model file."""
        sigma0 = self.modelled * float(np.exp(self.log_ratio))
        return {"effect": BRISTLE, "sigma0_nm_per_rad": float(f"{sigma0:.6g}")}

    @property
    def off(self) -> bool:
        """Whether it is another one, by more than reversals scatter and forms differ."""
        return abs(self.log_ratio) > _SURE * self.sigma

    def finding(self) -> dict[str, Any]:
        """The JSON entry (CONTRACT 7)."""
        effect = catalogue()[BRISTLE]
        value = float(self.entry["sigma0_nm_per_rad"])
        low, high = (value * float(np.exp(side * 1.96 * self.sigma)) for side in (-1, 1))
        sentence, values = effect.wording({"sigma0_nm_per_rad": value})
        form = _MASING if self.masing else _LUGRE
        return known(
            effect.id,
            f"{sentence.format(**values)} The model says {self.modelled:.3g}. Seen in {self.count} "
            f"full reversals of {form}.",
            {"sigma0_nm_per_rad": (value, low, high)},
            0.95,
            "reversals",
        )


def bristle(problem: Problem, found: Fit) -> Bristle | None:
    """What the reversals of the fitted recordings show beside what was ``found``.

    A stiffness among the findings is left out: it is what is asked for. None where there are too
    few, or where they show something else that nothing found explains, or something that was found
    changes the level while the rotor turns round: how slip elements go along with that is open.
    """
    if any(catalogue()[entry["effect"]].at_reversal for entry in found.entries):
        return None
    model = _without_it(problem, found)
    if model.friction.sigma0_nm_per_rad <= 0.0:
        return None
    forms = [_asked(problem.recordings, model, masing) for masing in (False, True)]
    known = [one for one in forms if one is not None]
    best = min(known, key=lambda one: one.times_noise, default=None)
    return best if best is not None and best.times_noise < _AS_NOISE else None


def times_noise(
    recordings: Sequence[Prepared], model: Model, masing: bool, fewest: int = FEWEST
) -> float | None:
    """What the usual full reversal leaves in a form, its stiffness fitted, over the sensors' noise.

    None where there are too few.
    """
    worked_in = with_model_effects(model)
    if worked_in.friction.sigma0_nm_per_rad <= 0.0:
        return None
    seen = _asked(recordings, worked_in, masing, fewest)
    return None if seen is None else seen.times_noise


def reversals_agree(one: Bristle, problem: Problem, found: Fit, judged: Sequence[Holdout]) -> bool:
    """Whether reversals of the hold-outs say the same, and are nearer to the model with it."""
    model = _without_it(problem, found)
    kept = [each.prepared for each in judged]
    seen = _asked(kept, model, one.masing, FEWEST_KEPT)
    if seen is None:
        few = sum(len(_reversals(each, model)) for each in kept) < FEWEST_KEPT
        return few and abs(one.log_ratio) > _BEYOND_DOUBT * one.sigma
    if seen.log_ratio * one.log_ratio < 0.0 or abs(seen.log_ratio) < _SAME * seen.scatter:
        return False
    costs = [
        sum(float(w.left @ w.left) for w in _windows(kept, _stiffer(model, by), one.masing))
        for by in (0.0, one.log_ratio)
    ]
    return costs[1] < costs[0]


def _without_it(problem: Problem, found: Fit) -> Model:
    others = [entry for entry in found.entries if entry["effect"] != BRISTLE]
    return with_model_effects(problem.with_entries(others, found.own))


@dataclass(frozen=True)
class _Window:
    """One reversal: what the balance leaves, and what ln σ0 and a delay do to that, (m,), (m, 2).

    Less a level before and after, which are the window's own.
    """

    left: Floats
    columns: Floats
    log_level: float
    """Of T_fs (Nm), the mean of both ways and of the window."""


def _asked(
    recordings: Sequence[Prepared], model: Model, masing: bool, fewest: int = FEWEST
) -> Bristle | None:
    """ln σ0 by Gauss-Newton over all windows; its deviation from how they differ."""
    if max((one.interval_s for one in recordings), default=np.inf) > LONGEST_INTERVAL_S:
        return None
    if sum(len(_reversals(one, model)) for one in recordings) < fewest:
        return None
    total, windows = 0.0, _windows(recordings, model, masing)
    if len(windows) < fewest:
        return None
    for _ in range(_ROUNDS):
        step, sigma, usual_nm = _step(windows)
        step = float(np.clip(step, -_MOST_STEP, _MOST_STEP))
        total += step
        if abs(total) > _MOST_LOG:
            return None
        if abs(step) < _CLOSE:
            break
        slopes = windows if abs(step) < _STRAIGHT else None
        windows = _windows(recordings, _stiffer(model, total), masing, slopes)
    else:
        return None
    floor = float(np.sqrt(np.mean([one.floor_nm(model) ** 2 for one in recordings])))
    sigma0 = model.friction.sigma0_nm_per_rad
    scatter = float(np.hypot(sigma, _FORM))
    deviation = float(np.hypot(scatter, _LEVELS * _power(windows)))
    return Bristle(total, deviation, len(windows), sigma0, masing, usual_nm / floor, scatter)


def _power(windows: Sequence[_Window]) -> float:
    """Of the level by which the stiffness may go: 0 for LuGre's σ0, which is one number, up to 1
    for slip elements that give way after paths of their own, whatever the level.
    """
    level = np.array([one.log_level for one in windows])
    level -= np.median(level)
    if float(np.std(level)) < _LEVEL:
        return 1.0
    more = [
        replace(one, columns=np.column_stack([one.columns[:, 0] * by, one.columns]))
        for one, by in zip(windows, level, strict=True)
    ]
    power, sigma, _ = _step(more)
    return min(abs(power) + sigma, 1.0)


def _stiffer(model: Model, by: float) -> Model:
    sigma0 = model.friction.sigma0_nm_per_rad * float(np.exp(by))
    return replace(model, friction=replace(model.friction, sigma0_nm_per_rad=sigma0))


def _later(model: Model, seconds: float) -> Model:
    delays = model.delays_s
    moved = replace(
        delays,
        motor_speed=delays.motor_speed + seconds,
        motor_angle=delays.of("motor_angle_rad") + seconds,
    )
    return replace(model, delays_s=moved)


def _windows(
    recordings: Sequence[Prepared],
    model: Model,
    masing: bool,
    like: Sequence[_Window] | None = None,
) -> list[_Window]:
    """All windows in which the model has friction; what changes them as in those ``like`` them,
    or taken anew.
    """
    found: list[_Window] = []
    pairs = (
        (_stiffer(model, _SMALL), _stiffer(model, -_SMALL), 2 * _SMALL),
        (_later(model, _SMALL_S), _later(model, -_SMALL_S), 2 * _SMALL_S),
    )
    for one in recordings:
        at = _reversals(one, model)
        if not len(at):
            continue
        turning = one.never_resting()
        left = _left_over(turning, model, masing)
        slopes = [
            (_left_over(turning, a, masing) - _left_over(turning, b, masing)) / size
            for a, b, size in (pairs if like is None else ())
        ]
        way, level = _way(turning, model), one.thin(_mean_level(one.motion(model), model))
        for instant_s in at:
            rows = _rows(one, instant_s)
            usual_nm = float(np.mean(level[rows])) if len(rows) else 0.0
            if not usual_nm > 2.0 * SMALLEST_LEVEL_NM:
                continue  # friction that the model takes all away has no length to go along
            alone = _less_levels(left[rows], way[rows])
            log_level = float(np.log(usual_nm))
            if like is not None:
                found.append(_Window(alone, like[len(found)].columns, log_level))
                continue
            columns = np.column_stack([slope[rows] for slope in slopes])
            found.append(_Window(alone, _less_levels(columns, way[rows]), log_level))
    return found


def _rows(one: Prepared, instant_s: float) -> Integers:
    """Thinned samples of the window about a reversal."""
    return np.flatnonzero(np.abs(one.thin_time_s - instant_s) < HALF_WINDOW_S)


def _way(one: Prepared, model: Model) -> Floats:
    """Which way the rotor slides, −1 to 1, at the thinned samples."""
    speed = one.thin(one.motion(model).speed_rad_s) / one.size.angle
    return np.asarray(np.tanh(speed / _SPEED_RAD_S))


def _less_levels(values: Floats, way: Floats) -> Floats:
    """A window's values, (m,) or (m, k), less one level each way."""
    own, _ = np.linalg.qr(np.column_stack([np.ones(len(way)), way]))
    return np.asarray(values - own @ (own.T @ values))


def about_reversals(
    recordings: Sequence[Prepared], model: Model, masing: bool
) -> tuple[Floats, Floats, int]:
    """What the balance leaves about full reversals, less a level each way; and how many there are.

    Seconds since the reversal (m,) and torque at the rotor in Nm (m,), as if all turned positive.
    """
    seconds, torque = [], []
    for one in recordings:
        turning = one.never_resting()
        left, way = _left_over(turning, model, masing), _way(turning, model)
        for instant_s in _reversals(one, model):
            rows = _rows(one, instant_s)
            seconds.append(one.thin_time_s[rows] - instant_s)
            torque.append(np.sign(way[rows[-1]]) * _less_levels(left[rows], way[rows]))
    if not seconds:
        return np.zeros(0), np.zeros(0), 0
    return np.concatenate(seconds), np.concatenate(torque), len(seconds)


def _left_over(one: Prepared, model: Model, masing: bool) -> Floats:
    """As ``one.left_over``; under Masing's rule the bristle's path is times T over their mean."""
    motion = one.motion(model)
    if masing:
        share = sliding_levels_nm(model, motion) / _mean_level(motion, model)
        motion = motion._replace(
            travel_rad=motion.travel_rad * share, slip_rad=motion.slip_rad * share
        )
    return one.thin(residual_nm(model, motion)[0])


def _mean_level(motion: Motion, model: Model) -> Floats:
    """T_fs (Nm) at this speed and load, the mean of both ways, (n,)."""
    speed = np.abs(motion.speed_rad_s)
    up, down = (
        sliding_levels_nm(model, motion._replace(speed_rad_s=way)) for way in (speed, -speed)
    )
    return 0.5 * (up + down)


def _step(windows: Sequence[_Window]) -> tuple[float, float, float]:
    """ln σ0 that the windows ask for, its deviation by how they differ, the usual rms that is left.

    Windows that are far off count less.
    """
    weight = np.ones(len(windows))
    for _ in range(10):
        normal = sum(
            w * one.columns.T @ one.columns for w, one in zip(weight, windows, strict=True)
        )
        slope = sum(w * one.columns.T @ one.left for w, one in zip(weight, windows, strict=True))
        value = -np.linalg.lstsq(np.asarray(normal), np.asarray(slope), rcond=None)[0]
        rms = np.array([np.sqrt(np.mean((one.left + one.columns @ value) ** 2)) for one in windows])
        usual = float(np.median(rms)) + 1e-300
        weight = (usual / np.maximum(rms, usual)) ** 2
    pulls = np.array(
        [
            w * one.columns.T @ (one.left + one.columns @ value)
            for w, one in zip(weight, windows, strict=True)
        ]
    )
    inverse = np.linalg.pinv(np.asarray(normal))
    sigma = float(np.linalg.norm(pulls @ inverse[:, 0]))
    return float(value[0]), sigma, usual


def _reversals(one: Prepared, model: Model) -> Floats:
    """Instants (s) at which the rotor turns from settled sliding into settled sliding."""
    motion = one.motion(model)
    speed = motion.speed_rad_s
    moving = np.flatnonzero(speed != 0.0)
    if len(moving) < 2:
        return np.zeros(0)
    way = np.sign(speed[moving])
    turn = np.flatnonzero(way[1:] != way[:-1])
    last, first = moving[turn], moving[turn + 1]
    path = np.concatenate([[0.0], np.cumsum(motion.slip_rad)])
    start, end = np.concatenate([[moving[0]], first]), np.concatenate([last, [moving[-1]]])
    way_rad = path[end + 1] - path[start]
    at = 0.5 * (last + first)
    settled = SETTLED_RAD * one.size.angle
    full = (way_rad[:-1] > 2 * settled) & (way_rad[1:] > settled)
    full &= first - last < _REST_SAMPLES
    room = round(HALF_WINDOW_S / STEP_S) + THIN
    edge = (len(speed) - len(one.thin_time_s) * THIN) // 2
    full &= (at > edge + room) & (at < len(speed) - edge - room)
    instants = one.time_s[0] + at[full] * STEP_S
    first, end = (
        np.searchsorted(one.thin_time_s, instants + side)
        for side in (-HALF_WINDOW_S, HALF_WINDOW_S)
    )
    instants = instants[end - first > _OWN_LEVELS]
    if one.barred is None:
        return np.asarray(instants)
    bad = one.thin_time_s[one.barred]
    clear = [not np.any(np.abs(bad - each) < HALF_WINDOW_S) for each in instants]
    return np.asarray(instants[np.array(clear, dtype=bool)])
