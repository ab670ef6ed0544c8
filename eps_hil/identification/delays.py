"""From skews to delays: only differences show, so one signal is held at the model file's value."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from eps_hil.identification.kinematics import Skew
from eps_hil.identification.least_squares import Fit
from eps_hil.identification.result import Estimate
from eps_hil.identification.state import DELAYS, get
from eps_hil.physics.model import Delays

HOLD_BELOW_S = 2.5e-4
"""A reference whose skew is less sure than this would blur all other delays."""
LOOSEST_S = 3.6e-4
"""A delay less sure than this (deviation) is not called identified."""
_NAME = "delays_s."
_AS_GOOD_S = 2e-5
_TOGETHER = "shows only together with another delay that is kept; moved along with it"


@dataclass(frozen=True)
class Timing:
    """Delays for the model file, each with its interval; skews; how far all were moved later."""

    delays: Delays
    estimates: Mapping[str, Estimate]
    skews: Mapping[str, Estimate]
    reference: str
    moved_s: float


def timing(
    fit: Fit, angle: Skew | None, before: Delays, quantile: float, method_s: float, kept: str
) -> Timing:
    """Fix the common part that nobody can observe; ``kept`` says why a signal was not identified.

    ``method_s`` is the deviation of the method itself, added to every skew's.
    """
    names = [p.name for p in fit.parameters]
    found = [key for key in DELAYS if _NAME + key in names]
    spread = {key: fit.sigma(_NAME + key) for key in found}
    reference = _reference(spread)
    covariance = fit.covariance

    def between(one: str, other: str) -> float:
        """Deviation of the difference of two skews; "motor_speed" is 0 by definition."""
        weight = np.zeros(len(names))
        for key, sign in ((one, 1.0), (other, -1.0)):
            if key != "motor_speed":
                weight[names.index(_NAME + key)] += sign
        return float(np.sqrt(max(float(weight @ covariance @ weight), 0.0) + method_s**2))

    skews = {
        f"motor_speed_minus_{key}": _estimate(
            -get(fit.state, _NAME + key),
            quantile * between("motor_speed", key),
            before.motor_speed - getattr(before, key),
        )
        for key in found
        if spread[key] < LOOSEST_S
    }
    if reference:
        speed = float(getattr(before, reference)) - get(fit.state, _NAME + reference)
    else:
        speed = before.motor_speed
    value: dict[str, float] = {"motor_speed": speed}
    for key in DELAYS:
        known = float(getattr(before, key))
        value[key] = speed + get(fit.state, _NAME + key) if key in found else known
    with_angle = angle is not None and _matters(angle, before)
    if angle is not None:
        sigma = float(np.hypot(angle.sigma_s, method_s / 3))
        skews["motor_angle_minus_motor_speed"] = _estimate(
            angle.seconds, quantile * sigma, before.of("motor_angle_rad") - before.motor_speed
        )
    if with_angle and angle is not None:
        value["motor_angle"] = speed + angle.seconds
    elif angle is None and before.motor_angle is not None:
        value["motor_angle"] = before.motor_angle
    for key in found:
        if reference and key != reference:
            value[key] = _not_negative(value[key], quantile * between(key, reference))
    moved = max(0.0, -min(value.values()))
    halves = {
        key: quantile * between(key, reference)
        for key in found
        if reference and spread[key] < LOOSEST_S
    }
    if reference:
        halves["motor_speed"] = quantile * between("motor_speed", reference)
    if angle is not None and reference:
        halves["motor_angle"] = float(np.hypot(halves["motor_speed"], quantile * angle.sigma_s))
    estimates = {
        key: _delay(
            key, late + moved, before, reference, halves, _TOGETHER if key in found else kept
        )
        for key, late in value.items()
    }
    delays = Delays(**{key: late + moved for key, late in value.items()})
    return Timing(delays, estimates, skews, reference, moved)


def clocked_by_angle(before: Delays) -> Delays:
    """The file's delays where only the angle was recorded, which then stands in for the speed."""
    return replace(before, motor_speed=before.of("motor_angle_rad"), motor_angle=None)


def of_angle(found: Timing, before: Delays, kept: str) -> Timing:
    """What was found with :func:`clocked_by_angle` under the angle's own name.

    ``before`` are the file's delays; the speed's is kept, and ``kept`` says why.
    """
    late, was = before.motor_speed + found.moved_s, before.motor_angle
    mine = replace(found.estimates["motor_speed"], from_model=was)
    speed = Estimate(late, "s", None, before.motor_speed, "kept", kept)
    return replace(
        found,
        delays=replace(found.delays, motor_angle=found.delays.motor_speed, motor_speed=late),
        estimates={**found.estimates, "motor_speed": speed, "motor_angle": mine},
        skews={k.replace("motor_speed", "motor_angle"): one for k, one in found.skews.items()},
    )


def _delay(
    key: str, late: float, before: Delays, reference: str, halves: Mapping[str, float], kept: str
) -> Estimate:
    was = before.of("motor_angle_rad") if key == "motor_angle" else getattr(before, key)
    if key == reference:
        words = "only differences of delays can be observed"
        return Estimate(late, "s", None, was, "held", words)
    if key in halves:
        return _estimate(late, halves[key], was)
    return Estimate(late, "s", None, was, "kept", kept)


def _reference(spread: Mapping[str, float]) -> str:
    """The rig's own sensors before the ECU's; the surer of them, the torque sensor where equal."""
    for keys in (("torque_sensor", "rack_force"), ("motor_torque",)):
        sure = {key: spread[key] for key in keys if spread.get(key, np.inf) < HOLD_BELOW_S}
        if sure:
            best = min(sure.values())
            return next(key for key in sure if sure[key] <= max(2 * best, _AS_GOOD_S))
    return min(spread, key=lambda key: spread[key]) if spread else ""


def _not_negative(value: float, half: float) -> float:
    """Zero where that is as good: a delay in a model file cannot be negative."""
    return 0.0 if value < 0 <= value + half else value


def _matters(angle: Skew, before: Delays) -> bool:
    if before.motor_angle is not None:
        return True
    return abs(angle.seconds) > max(1e-4, 3 * angle.sigma_s)


def _estimate(value: float, half: float, was: float) -> Estimate:
    return Estimate(value, "s", (value - half, value + half), was, "identified")
