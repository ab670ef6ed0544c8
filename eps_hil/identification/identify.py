"""Identification of a rig from its recordings: from checks to a model with intervals (issue 3)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eps_hil.errors import InputError
from eps_hil.identification import delays, filters, findings, kinematics, plausibility
from eps_hil.identification.balance import Case, cases
from eps_hil.identification.cannot_tell import cannot_tell
from eps_hil.identification.finding import Finding
from eps_hil.identification.friction_map import friction_map
from eps_hil.identification.identifiable import beside_sliding, choose, widened
from eps_hil.identification.least_squares import Fit, linearised
from eps_hil.identification.motion_check import check_place
from eps_hil.identification.motor_lag import motor_lag
from eps_hil.identification.noise_bias import corrected
from eps_hil.identification.offsets import Offset, offset
from eps_hil.identification.prepare import Prepared, prepare
from eps_hil.identification.result import Estimate, Identification
from eps_hil.identification.stages import SETTLED_SHARE, Found, estimate
from eps_hil.identification.state import (
    BRISTLE_UNITS,
    FRICTION_UNITS,
    Parameter,
    Spring,
    State,
    get,
    put,
    sliding_parameters,
)
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.series import Series

METHOD_INERTIA, METHOD_BRISTLE = 3.3e-4, 6.5e-3
METHOD_SAMPLES = 0.03
"""Own error of the method (relative; of a 1 ms step): docs/theory-identification.md, section 5."""
LOOSEST_BRISTLE = 0.5
DAMPING, DAMPING_SPEED = "friction.sigma1_nm_s_per_rad", "friction.sigma1_speed_rad_s"
_SLOW = 0.25
"""Share of the turns that have to show the bristle's damping."""
OFFSET_EFFECTS = {
    "torque_sensor_nm": ("torque_sensor_offset", 1.0),
    "motor_torque_nm": ("motor_torque_offset", -1.0),
}
"""The effect that takes a signal's offset (Nm, of the reading) off, and the sign that it has."""
_NO_DELAY = "hardly changes, or was not recorded: its delay cannot be seen"
LEAST_OFFSET_NM = {"torque_sensor_nm": 0.005, "motor_torque_nm": 0.001}

Progress = Callable[[float], None]
Recordings = Mapping[str, Mapping[str, Series]]


def identify(
    recordings: Recordings, model: Model, on_progress: Progress | None = None
) -> Identification:
    """Identify ``model``'s numbers from ``recordings`` (canonical series by name).

    The model gives ratios, starting values, and whatever the recordings do not show. Raises
    :class:`InputError` for recordings that nothing can be learnt from, and for channels that are
    swapped or have the wrong sign or unit.
    """
    say = on_progress or (lambda _part: None)
    if not recordings:
        raise InputError("recordings", "", "none given", "name one or more")
    ready = [prepare(name, series) for name, series in recordings.items()]
    ratio = model.rack_to_rotor_ratio_rad_per_m
    angle = kinematics.skew(ready)
    placed = [told for one in ready for told in check_place(one, ratio)]
    late_s = angle.seconds if angle else 0.0
    start = State(
        with_model_effects(model),
        {k: Spring() for k, one in enumerate(ready) if not one.has("rack_force_n")},
    )
    if not any(one.has("motor_speed_rad_s") for one in ready):
        by_angle = delays.clocked_by_angle(start.model.delays_s)
        start = replace(start, model=replace(start.model, delays_s=by_angle))
    rows = cases(ready, [kinematics.kinematics(one, late_s) for one in ready])
    say(0.05)
    plausibility.check(rows, start)
    wheel = 1.0 / model.sensor_to_rotor
    offsets = {name: offset(rows, name, wheel) for name in ("torque_sensor_nm", "motor_torque_nm")}
    start = replace(start, model=_without_effects_of(start.model, offsets))
    ready = [_without_offsets(one, offsets) for one in ready]
    rows = cases(ready, [case.motion for case in rows])
    signals = {name for one in ready for name in one.raw}
    chosen = choose(rows, start, sliding_parameters(start, signals))
    findings.check_loads(rows, start, chosen.fit.state)
    say(0.3)

    def fitted_from(state: State, parameters: Sequence[Parameter], **how: Any) -> Found:
        found = estimate(rows, state, parameters, prior=start, **how)
        return corrected(found, ready, late_s, start, parameters)

    found = fitted_from(chosen.fit.state, chosen.fitted, on_progress=lambda p: say(0.3 + 0.4 * p))
    shown = _shown_of(found.bristle, rows, start)
    if found.bristle is not None and len(shown) < len(found.bristle.parameters):
        state = _as_in(start, found.sliding.state, found.bristle.parameters, shown)
        found = fitted_from(state, chosen.fitted, passes=1, bristle_of=shown)
    found, below = _above_zero(found, rows, fitted_from)
    say(0.9)
    sliding = widened(found.sliding, rows, chosen.kept, found.weights)
    found = replace(found, sliding=sliding)
    if found.bristle is not None:
        own = _method(sliding)
        found = replace(found, bristle=beside_sliding(rows, found.bristle, sliding, own))
    result = _result(model, start, ready, rows, found, below, angle, offsets, placed)
    say(1.0)
    return result


def _above_zero(
    found: Found, rows: Sequence[Case], fitted_from: Callable[..., Found]
) -> tuple[Found, dict[str, float]]:
    """Friction that comes out below zero is zero, and everything else is fitted beside that.

    Returns the fit, and what the recordings alone say of those numbers, by name. Its covariance
    stays that of the free fit: a bound that holds makes nothing less certain.
    """
    free, below = found.sliding, dict[str, float]()
    bristle = found.bristle.parameters if found.bristle else ()
    while True:
        state = found.sliding.state
        out = {
            p.name: get(state, p.name)
            for p in found.sliding.parameters
            if p.name.startswith("friction.") and get(state, p.name) < 0.0
        }
        if not out:
            break
        below |= out
        for name in out:
            state = put(state, name, 0.0)
        left = [p for p in found.sliding.parameters if p.name not in out]
        found = fitted_from(state, left, passes=1, bristle_of=bristle)
    if not below:
        return found, below
    below = {name: get(free.state, name) for name in below}
    state = found.sliding.state
    seen = linearised(rows, state, free.parameters, found.weights)
    return replace(found, sliding=replace(free, state=state, rows=tuple(seen))), below


def _method(fit: Fit) -> dict[str, float]:
    """Deviations by the method itself, of what the sliding stage finds."""
    late = METHOD_SAMPLES * filters.STEP_S
    own = {p.name: late for p in fit.parameters if p.name.startswith("delays_s.")}
    return own | {"inertia_kg_m2": METHOD_INERTIA * get(fit.state, "inertia_kg_m2")}


def _without_offsets(one: Prepared, offsets: Mapping[str, Offset | None]) -> Prepared:
    for name, reading in offsets.items():
        if reading is not None and one.has(name) and _significant(name, reading):
            one = one.with_signal(name, one.raw[name] - reading.value)
    return one


def _significant(name: str, reading: Offset) -> bool:
    low, high = reading.ci95
    return abs(reading.value) > LEAST_OFFSET_NM[name] and (low > 0 or high < 0)


def _without_effects_of(model: Model, offsets: Mapping[str, Offset | None]) -> Model:
    """Without the offsets of the file for which the recordings have a reading.

    A reading is the whole offset of the recorded signal, the file's part included.
    """
    gone = []
    for name, (effect, sign) in OFFSET_EFFECTS.items():
        reading = offsets[name]
        if reading is None:
            continue
        low, high = sorted(sign * each for each in reading.ci95)
        for entry in model.effects:
            as_read = low <= float(entry.get("offset_nm", 0.0)) <= high
            if entry["effect"] == effect and (_significant(name, reading) or not as_read):
                gone.append(entry)
    return replace(model, effects=tuple(entry for entry in model.effects if entry not in gone))


def _result(
    before: Model,
    start: State,
    ready: Sequence[Prepared],
    rows: Sequence[Case],
    found: Found,
    below: Mapping[str, float],
    angle: kinematics.Skew | None,
    offsets: Mapping[str, Offset | None],
    placed: Sequence[Finding],
) -> Identification:
    lag = motor_lag(rows, found.sliding.state, found.sliding)
    fit = lag.beside(found.sliding)
    quantile = _quantile(fit.blocks)
    timing = delays.timing(
        fit,
        angle,
        start.model.delays_s,
        quantile,
        METHOD_SAMPLES * filters.STEP_S,
        _NO_DELAY,
    )
    was = with_model_effects(before).delays_s
    if was.motor_angle is not None and start.model.delays_s.motor_angle is None:
        timing = delays.of_angle(timing, was, _NO_DELAY)
    parameters = _sliding_estimates(fit, start, quantile, below)
    parameters |= {f"delays_s.{key}": one for key, one in timing.estimates.items()}
    bristle = _bristle_estimates(found.bristle, start)
    parameters |= bristle
    state = fit.state
    friction = replace(
        state.model.friction,
        **{name.removeprefix("friction."): one.value for name, one in bristle.items()},
    )
    state = replace(state, model=replace(state.model, friction=friction))
    residual, floor = findings.residual(rows, state, found.weights)
    told = [one for recording in ready for one in recording.findings]
    told += [*placed, *kinematics.ratio_findings(ready, angle)]
    told += findings.of_fit(rows, state, found, residual, floor, timing.moved_s)
    quiet = _offset_estimates(offsets)
    unknown = cannot_tell(parameters, quiet, rows, timing.reference, lag)
    names, seconds = tuple(one.name for one in ready), sum(len(one.time_s) for one in ready)
    return Identification(
        model=_model(before, state, timing.delays, offsets),
        parameters=parameters,
        skews_s=timing.skews,
        delay_reference=timing.reference,
        offsets=quiet,
        loads=_loads(ready, state, fit, quantile),
        map=friction_map(rows, state, found.weights),
        findings=tuple(told),
        cannot_tell=unknown,
        motor_lag=lag.estimate(quantile),
        recordings=names,
        seconds=seconds * filters.STEP_S,
        residual_nm=residual,
        floor_nm=floor,
        presliding_misfit=found.rough if found.bristle else None,
    )


def _quantile(blocks: int) -> float:
    from scipy.stats import t

    return float(t.ppf(0.975, max(blocks - 1, 1)))


def _sliding_estimates(
    fit: Fit, start: State, quantile: float, below: Mapping[str, float]
) -> dict[str, Estimate]:
    fitted = {p.name for p in fit.parameters}
    units = {"inertia_kg_m2": "kg m²"} | {f"friction.{k}": u for k, u in FRICTION_UNITS.items()}
    result = {}
    for name, unit in units.items():
        was = get(start, name)
        if name not in fitted:
            result[name] = Estimate(was, unit, None, was, "kept", findings.why_not(name))
            continue
        value = get(fit.state, name)
        own = METHOD_INERTIA * value if name == "inertia_kg_m2" else 0.0
        half = quantile * float(np.hypot(fit.sigma(name), own))
        free, note = below.get(name, value), ""
        if name in below:
            note = "the recordings say less than zero; it is zero, and the rest fitted beside that"
        ci95 = (free - half, free + half)
        result[name] = Estimate(value, unit, ci95, was, "identified", note)
    return result


def _shown(fit: Fit, name: str) -> bool:
    """Whether a bristle parameter is known at all."""
    return fit.sigma(name) < LOOSEST_BRISTLE * get(fit.state, name)


def _shown_of(fit: Fit | None, rows: Sequence[Case], start: State) -> list[Parameter]:
    """The bristle's parameters that are known; the speed of a damping only with the damping."""
    known = [p for p in fit.parameters if _shown(fit, p.name)] if fit else []
    damped = any(p.name == DAMPING for p in known) and _slow_turns(rows, start)
    return [p for p in known if damped or p.name not in (DAMPING, DAMPING_SPEED)]


def _slow_turns(rows: Sequence[Case], start: State) -> bool:
    """Whether the rotor turns round slowly enough to be seen within the damping's speed.

    Where it passes all of it between two samples, a damping is fitted to what sampling does; a
    few slow turns do not outweigh that.
    """
    found = []
    for case in rows:
        speed, moving = case.motion.speed, ~case.motion.resting[1:]
        turned = (speed[1:] * speed[:-1] < 0.0) & moving
        found.append(np.abs(np.diff(speed))[turned])
    steps = np.concatenate(found)
    return not len(steps) or float(np.quantile(steps, _SLOW)) < 2.0 * get(start, DAMPING_SPEED)


def _as_in(
    start: State, state: State, fitted: Sequence[Parameter], shown: Sequence[Parameter]
) -> State:
    """``state`` with what the recordings do not show as it was at ``start``.

    What is shown has to be found beside the numbers that will stand in the model file.
    """
    for parameter in fitted:
        if parameter not in shown:
            state = put(state, parameter.name, get(start, parameter.name))
    return state


def _bristle_estimates(fit: Fit | None, start: State) -> dict[str, Estimate]:
    result = {}
    for key, unit in BRISTLE_UNITS.items():
        name = f"friction.{key}"
        was = get(start, name)
        value = get(fit.state, name) if fit else was
        if fit is None or not _shown(fit, name):
            result[name] = Estimate(was, unit, None, was, "kept", findings.why_not(name))
            continue
        half = _quantile(fit.blocks) * float(np.hypot(fit.sigma(name), METHOD_BRISTLE * value))
        result[name] = Estimate(value, unit, (value - half, value + half), was, "identified")
    return result


def _offset_estimates(offsets: Mapping[str, Offset | None]) -> dict[str, Estimate]:
    result = {}
    for name, reading in offsets.items():
        key = name.replace("_nm", "_offset_nm")
        if reading is None:
            result[key] = Estimate(0.0, "Nm", None, None, "kept", findings.why_not(key))
            continue
        used = _significant(name, reading)
        note = f"from {reading.seconds:g} s in which nothing drives it"
        note += "" if used else "; too small to be taken off"
        result[key] = Estimate(reading.value, "Nm", reading.ci95, None, "identified", note)
    return result


def _loads(
    ready: Sequence[Prepared], state: State, fit: Fit, quantile: float
) -> dict[str, dict[str, Any]]:
    result: dict[str, dict[str, Any]] = {}
    for k, spring in state.springs.items():
        half = quantile * fit.sigma(f"spring{k}.stiffness_n_per_m")
        known = bool(np.isfinite(half))
        result[ready[k].name] = {
            "rack_force": "not measured; taken as a spring of its own",
            "stiffness_n_per_m": spring.stiffness_n_per_m,
            "ci95": [spring.stiffness_n_per_m - half, spring.stiffness_n_per_m + half]
            if known
            else None,
            "damping_n_s_per_m": spring.damping_n_s_per_m,
            "force_at_centre_n": spring.force_n,
        }
    return result


def _model(before: Model, state: State, late: Any, offsets: Mapping[str, Offset | None]) -> Model:
    """The model to write."""
    effects = [dict(entry) for entry in state.model.effects]
    for name, (effect, sign) in OFFSET_EFFECTS.items():
        reading = offsets[name]
        if reading is not None and _significant(name, reading):
            effects.append({"effect": effect, "offset_nm": sign * reading.value})
    return replace(
        before,
        inertia_kg_m2=state.model.inertia_kg_m2,
        rack_to_rotor_ratio_rad_per_m=state.model.rack_to_rotor_ratio_rad_per_m,
        delays_s=late,
        friction=state.model.friction,
        effects=tuple(effects),
    )


__all__ = ["SETTLED_SHARE", "Finding", "identify"]
