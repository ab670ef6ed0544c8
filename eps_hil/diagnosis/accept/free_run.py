"""Simulation of hold-outs, whole from their first state and in half seconds that begin sliding.

A constant of a few mNm is nothing in the torque balance and metres in a free run of a whole
recording (issue 20). Half a second adds up little: it shows whether the model comes to rest, breaks
away and turns round as the rig does, of which a balance judged while sliding tells nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.prepare import STEP_S, Prepared
from eps_hil.diagnosis.data.quality import Quality
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.physics.balance import Motion as Measured
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.friction import friction_law, static_level_nm
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import Motion as Simulated
from eps_hil.physics.simulate import memories, simulate

if TYPE_CHECKING:
    from eps_hil.diagnosis.accept.proof_of_fit import Holdout

Floats = npt.NDArray[np.float64]

_FIGURES = (("speed_rmse_rad_s", "speed", "rad/s"), ("angle_rmse_rad", "angle", "rad"))
_WORSE = 1.05
"""Times the error that it was, from which a worse free run is said."""
WINDOW_S = 0.5
"""Length of the stretches that are simulated freely from a measured state."""
MOST_RUNS = 24
"""Of each hold-out; a longer one is sampled evenly."""
_FIT = "speed_fit_percent"
_POINTS = 1.0
"""Of the fit of half seconds, which are driven by the same noise before and after."""
_BEGINS_RAD_S, _TURNS_RAD_S = 5.0, 1.0
"""A half second begins at so much speed; where it falls below so little, the rotor turns."""
_MOST_OF_IT = 0.6
"""Share of the added error from which its place is the reason."""
DISAGREE = "Balance and free run disagree"
LASTS_S = 5.0
_DRIVEN = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")
_DRAWS, _SEED = 4, 20


def free_run(holdouts: "Sequence[Holdout]", model: Model) -> dict[str, float | None]:
    """``speed_rmse_rad_s`` and ``angle_rmse_rad`` over all hold-outs (CONTRACT 7); null: none.

    Driven by the recorded torques and rack force; nothing else is fed back.
    """
    pairs = each(lambda one: _errors(one, model), holdouts)
    speed, angle = (np.concatenate([np.zeros(0), *(p[k] for p in pairs)]) for k in (0, 1))
    return {"speed_rmse_rad_s": _rms(speed), "angle_rmse_rad": _rms(angle)}


def worse_free_run(
    told: Mapping[str, Mapping[str, Any]], noise: Mapping[str, float] | None = None
) -> list[str]:
    """A sentence where hold-outs (``fit.holdout``) simulated freely end further off than before.

    By more than twice the ``noise`` of each figure, if that is given. And one where half seconds
    fit worse.
    """
    further, said = _further(told, noise or {}), []
    if further:
        said.append(
            f"{DISAGREE}: the torque balance is better with the findings, but a "
            f"simulation of the whole hold-outs is not ({'; '.join(further)}). Nothing holds a "
            "free run, so it adds up what stays small in the balance, a constant first of all."
        )
    if worse := _worse_fit(told):
        said.append(
            f"{DISAGREE}: the torque balance is better with the findings, but the written model "
            f"makes the simulation of half seconds worse (speed fit {worse[1]:.3g} %, "
            f"{worse[0]:.3g} % without). The balance is judged while the rotor slides; such a "
            "simulation also has to come to rest, break away and turn round as the rig does."
        )
    return said


def _better_balance(told: Mapping[str, Mapping[str, Any]]) -> bool:
    before, after = (told[one]["torque_nrmse"] for one in ("baseline", "augmented"))
    return bool(after < before)


def _further(told: Mapping[str, Mapping[str, Any]], noise: Mapping[str, float]) -> list[str]:
    """Figures of the free run that are worse although the balance is better, in words."""
    if not _better_balance(told):
        return []
    runs = [told[one].get("free_run", {}) for one in ("baseline", "augmented")]
    return [
        f"{words} {after:.3g} {unit} off, {before:.3g} {unit} without"
        for name, words, unit in _FIGURES
        for before, after in [tuple(run.get(name) for run in runs)]
        if before is not None and after is not None and after > _WORSE * before
        if after - before > 2.0 * noise.get(name, 0.0)
    ]


def _worse_fit(told: Mapping[str, Mapping[str, Any]]) -> tuple[float, float] | None:
    """The fit of half seconds before and after, where it is worse and the balance better."""
    before, after = (told[one].get(_FIT) for one in ("baseline", "augmented"))
    if before is None or after is None or not _better_balance(told):
        return None
    clearly = before - after > max(_POINTS, (_WORSE - 1.0) * (100.0 - before))
    return (before, after) if clearly else None


def disagreement(
    told: Mapping[str, Mapping[str, Any]],
    holdouts: "Sequence[Holdout]",
    given: Model,
    written: Model,
) -> list[str]:
    """The same with what it is due to: sensor noise, or a finding and what lasts, or the place.

    ``holdouts`` as the figures were made of; ``given``, ``written``: the model files before, after.
    """
    whole = {**told, **{one: {**told[one], _FIT: None} for one in ("baseline", "augmented")}}
    said = _whole_runs(whole, holdouts, given, written)
    if worse := _worse_fit(told):
        (short,) = worse_free_run({one: {**told[one], "free_run": {}} for one in told})
        said.append(f"{short}{_of_half_seconds(worse, holdouts, given, written)}")
    return said


def _whole_runs(
    told: Mapping[str, Mapping[str, Any]],
    holdouts: "Sequence[Holdout]",
    given: Model,
    written: Model,
) -> list[str]:
    further = _further(told, {})
    if not further:
        return []
    noise = free_run_noise(holdouts, written)
    said = worse_free_run(told, noise)
    if not said:
        worth = ", ".join(f"{noise[name]:.2g} {unit}" for name, _, unit in _FIGURES)
        return [
            f"{DISAGREE}, by no more than the sensors' noise makes: the whole hold-outs simulated "
            f"freely are further off with the findings ({'; '.join(further)}); the noise of the "
            f"torques that drive the run is worth {worth}."
        ]
    after = told["augmented"]["free_run"]["angle_rmse_rad"]
    shares = []
    for words, spared in _without_each(given, written):
        off = free_run(holdouts, spared)["angle_rmse_rad"]
        shares.append((np.inf if off is None else off, words))
    why = ""
    if shares and after is not None and min(shares)[0] < after / _WORSE:
        nearest, words = min(shares)
        why = f" Most of it comes with {words}: without that the angle is {nearest:.3g} rad off."
    lasts, lasted = (_lasting_nm(holdouts, written, one) for one in (written, given))
    kind = "more" if lasts > lasted else "less: before, errors cancelled over the run"
    return [
        f"{said[0]}{why} What lasts of the balance's residual, in means over {LASTS_S:g} s, is "
        f"{1e3 * lasts:.2g} mNm with the findings and {1e3 * lasted:.2g} mNm without, {kind}."
    ]


def _without_each(given: Model, written: Model) -> list[tuple[str, Model]]:
    """Each of several things written, in words, and the written model without it."""
    new = [entry for entry in written.effects if entry not in given.effects]
    return [
        (_words(entry), replace(written, effects=tuple(o for o in written.effects if o != entry)))
        for entry in (new if len(new) > 1 else ())
    ]


def _of_half_seconds(
    worse: tuple[float, float], holdouts: "Sequence[Holdout]", given: Model, written: Model
) -> str:
    """Which half seconds became worse, and what that came with."""
    why = ""
    turning, all_of_it = _added(holdouts, given, written)
    if all_of_it > 0.0:
        share = float(np.clip(turning / all_of_it, 0.0, 1.0))
        if share > _MOST_OF_IT:
            why += (
                f" {100 * share:.0f} % of the error that was added is in half seconds in which the "
                "rig or the written model comes to rest or turns round: the model does not stick "
                "and break away as the rig does."
            )
        elif share < 1.0 - _MOST_OF_IT:
            why += (
                f" {100 * (1.0 - share):.0f} % of the error that was added is in half seconds in "
                "which the rotor only slides."
            )
    best = max(
        ((speed_fit_percent(holdouts, one), words) for words, one in _without_each(given, written)),
        default=(-np.inf, ""),
    )
    if best[0] - worse[1] > 0.5 * (worse[0] - worse[1]):
        why += f" Most of it comes with {best[1]}: without that the fit is {best[0]:.3g} %."
    return why


def _added(holdouts: "Sequence[Holdout]", given: Model, written: Model) -> tuple[float, float]:
    """Energy that ``written`` adds to the error of half seconds, (rad/s)² summed over samples.

    Of those in which the rig, or what ``written`` makes of it, turns or rests; and of all.
    """
    n, turning, total = round(WINDOW_S / STEP_S), 0.0, 0.0
    for one in holdouts:
        pair = [free_runs(one.prepared, model, one.quality) for model in (given, written)]
        # a finding may shift the speed itself, and so which half seconds begin while sliding
        first, second = (time[::n] for time, _, _ in pair)
        _, *same = np.intersect1d(first, second, return_indices=True)
        before, after = (
            np.sum((run - measured).reshape(-1, n)[at] ** 2, axis=1)
            for (_, run, measured), at in zip(pair, same, strict=True)
        )
        slowest = np.minimum(*(np.abs(speed).reshape(-1, n)[same[1]] for speed in pair[1][1:]))
        turns = np.min(slowest, axis=1, initial=np.inf) < _TURNS_RAD_S
        turning += float(np.sum((after - before)[turns]))
        total += float(np.sum(after - before))
    return turning, total


def speed_fit_percent(holdouts: "Sequence[Holdout]", model: Model) -> float:
    """100 (1 − rms error / rms of the speed about its mean) of all half seconds; NaN: none."""
    error, speed = [np.zeros(0)], [np.zeros(0)]
    for one in holdouts:
        _, run, measured = free_runs(one.prepared, model, one.quality)
        error.append(run - measured)
        speed.append(measured - np.mean(measured) if len(measured) else measured)
    off, size = np.concatenate(error), np.concatenate(speed)
    if not len(off):
        return float("nan")
    rms = float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(size**2)))
    return 100.0 * (1.0 - rms[0] / max(rms[1], 1e-12))


def free_runs(
    prepared: Prepared, model: Model, quality: Quality | None = None
) -> tuple[Floats, Floats, Floats]:
    """(time, simulated, measured speed) of half seconds that start while sliding; s, rad/s.

    Each is simulated freely from the measured state at its start; the rest is left out, and so
    are those in which ``quality`` finds bad data.
    """
    motion = prepared.motion(with_model_effects(model))
    n = round(WINDOW_S / STEP_S)
    bad = np.zeros(len(motion.time_s), bool) if quality is None else quality.bad_at(motion.time_s)
    starts = [
        first
        for first in range(0, len(motion.time_s) - n, n)
        if abs(motion.speed_rad_s[first]) >= _BEGINS_RAD_S and not bad[first : first + n].any()
    ]
    starts = starts[:: 1 + len(starts) // MOST_RUNS]
    if not starts:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    memory = dict(zip(starts, memories_at(motion, model, starts), strict=True))

    def run(first: int) -> Floats:
        return simulated(motion, model, slice(first, first + n), memory[first]).speed_rad_s

    kept = np.concatenate([np.arange(first, first + n) for first in starts])
    return motion.time_s[kept], np.concatenate(each(run, starts)), motion.speed_rad_s[kept]


def free_run_noise(holdouts: "Sequence[Holdout]", model: Model) -> dict[str, float]:
    """What the noise of the driving torques and force makes of either error (rms over draws)."""
    motions = [one.prepared.motion(with_model_effects(model)) for one in holdouts]
    quiet = each(lambda motion: _whole(motion, model), motions)

    def energies(drawn: tuple[int, int]) -> tuple[float, float]:
        """Of both errors: one draw for one hold-out, whose motion is not kept."""
        _, k = drawn
        rng = np.random.default_rng([_SEED, *drawn])
        there, here = _whole(_noisy(holdouts[k].prepared, motions[k], rng), model), quiet[k]
        speed, angle = there.speed_rad_s - here.speed_rad_s, there.angle_rad - here.angle_rad
        return float(speed @ speed), float(angle @ angle)

    draws = [(draw, k) for draw in range(_DRAWS) for k in range(len(holdouts))]
    samples = _DRAWS * sum(len(one.time_s) for one in motions)
    rms = np.sqrt(np.sum(each(energies, draws), axis=0) / samples)
    values = np.where(np.isfinite(rms), rms, np.inf).tolist()
    return {name: value for (name, _, _), value in zip(_FIGURES, values, strict=True)}


def _noisy(ready: Prepared, motion: Measured, rng: np.random.Generator) -> Measured:
    """A motion with as much noise again on what drives it."""
    wide = np.sqrt(ready.interval_s / STEP_S)  # as dense a spectrum as its own samples have
    return motion._replace(
        **{
            k: getattr(motion, k)
            + wide * ready.noise.get(k, 0.0) * rng.standard_normal(len(motion.time_s))
            for k in _DRIVEN
        }
    )


def _lasting_nm(holdouts: "Sequence[Holdout]", common: Model, model: Model) -> float:
    """Rms of the sliding residual's means over stretches of ``LASTS_S``, Nm."""
    means: list[float] = []
    for one in holdouts:
        use, left = one.judging(common), one.prepared.left_over(model)
        time_s = one.prepared.thin_time_s
        stretch = ((time_s - time_s[0]) // LASTS_S).astype(np.int64)
        count = np.bincount(stretch[use])
        sums = np.bincount(stretch[use], left[use])
        means += (sums[count > 0] / count[count > 0]).tolist()
    return float(np.sqrt(np.mean(np.square(means)))) if means else 0.0


def _words(entry: Mapping[str, Any]) -> str:
    """A finding's id, or what an effect without a name acts by."""
    if entry["effect"] != "empirical":
        return str(entry["effect"])
    return f"what has no name, by {' and '.join(dict.fromkeys(entry['inputs']))}"


def simulated(
    motion: Measured, model: Model, part: slice, memory: Floats | None = None
) -> Simulated:
    """``part`` of a recording simulated freely from its first measured state.

    The bristle begins as it is while sliding at the measured speed, and what a law remembers as
    ``memory`` (of :func:`memories_at`) has it.
    """
    model = with_model_effects(model)
    law, speed = friction_law(model.friction), float(motion.speed_rad_s[part][0])
    level = static_level_nm(speed, float(motion.rack_force_n[part][0]), law)
    bristle = float(np.sign(speed) * level / law.sigma0_nm_per_rad)
    return _run(motion, model, part, bristle, memory)


def memories_at(motion: Measured, model: Model, firsts: Sequence[int]) -> list[Floats | None]:
    """What the model's laws remember at samples of a recording; None where they remember nothing"""
    return memories(
        with_model_effects(model),
        motion.time_s,
        np.column_stack([getattr(motion, name) for name in _DRIVEN]),
        motion.speed_rad_s,
        motion.angle_rad,
        firsts,
    )


def _whole(motion: Measured, model: Model) -> Simulated:
    """The whole recording, begun as ``eps-hil simulate`` begins: with the bristle at rest.

    Recordings mostly begin at rest, where the sign of a noisy speed says nothing of the bristle;
    where one begins sliding, its bristle is there within its own deflection.
    """
    return _run(motion, with_model_effects(model), slice(None), 0.0)


def _run(
    motion: Measured,
    model: Model,
    part: slice,
    bristle_rad: float,
    memory: Floats | None = None,
) -> Simulated:
    return simulate(
        model,
        motion.time_s[part],
        motion.motor_torque_nm[part],
        motion.torque_sensor_nm[part],
        motion.rack_force_n[part],
        speed_rad_s=float(motion.speed_rad_s[part][0]),
        angle_rad=float(motion.angle_rad[part][0]),
        bristle_rad=bristle_rad,
        memory=memory,
    )


def _errors(one: "Holdout", model: Model) -> tuple[Floats, Floats]:
    motion = one.prepared.motion(with_model_effects(model))
    run = _whole(motion, model)
    bad = np.zeros(len(motion.time_s), bool)
    if one.quality is not None:
        bad = one.quality.bad_at(motion.time_s)
    return (
        np.asarray((run.speed_rad_s - motion.speed_rad_s)[~bad]),
        np.asarray((run.angle_rad - motion.angle_rad)[~bad]),
    )


def _rms(error: Floats) -> float | None:
    found = float(np.sqrt(np.mean(error**2))) if len(error) else np.inf
    return found if np.isfinite(found) else None
