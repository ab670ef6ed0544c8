"""What a finding of the kinematics is drawn from: rotor against rack, speed, angle and twist.

These findings do not show in the torque balance, so each has a plot of its own residual, on the
recordings that were kept from the fit where those hold what it needs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.data.drift import IN_BALANCE
from eps_hil.diagnosis.data.prepare import Prepared, prepare, with_play
from eps_hil.diagnosis.direct.rotor_and_rack import Rows, has_rack
from eps_hil.diagnosis.direct.speed_and_angle import SEEN_IN, compared, has_both
from eps_hil.diagnosis.direct.torsion_bar import has_twist, twist_rad
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model
from eps_hil.report.plots import Line, Plot

Floats = npt.NDArray[np.float64]

BINS = 40
_ROUNDS = 5
IN_ROTOR_AND_RACK: Mapping[str, tuple[str, str]] = {
    "backlash": ("torque from rotor to rack in Nm, at the rotor", "torque"),
    "belt_compliance": ("torque from rotor to rack in Nm, at the rotor", "torque"),
    "rack_ratio": ("rack position in m", "x"),
    "clock_drift": ("rotor speed times time since the start in rad", "drift"),
}
"""Label of the coordinate over which an effect is a plain curve, and where it comes from."""


def figure(diagnosis: Diagnosis, finding: Mapping[str, Any]) -> Plot | None:
    """The residual that shows ``finding``, and the finding's own part of it; None without data."""
    recordings = [_as_read(one) for one in diagnosis.judged]
    if finding["effect"] == "torque_sensor_hysteresis":
        return _twist(recordings, diagnosis.problem.model, finding)
    if finding["seen_in"] == SEEN_IN:
        return _against_rate(recordings, diagnosis.problem.model, finding)
    if finding["effect"] not in IN_ROTOR_AND_RACK or finding["seen_in"] == IN_BALANCE:
        return None
    model = _given(diagnosis)
    rows = [Rows(one, model) for one in recordings if has_rack(one, model)]
    if not rows:
        return None
    label, source = IN_ROTOR_AND_RACK[finding["effect"]]
    others = [
        one
        for one in diagnosis.content["findings"]
        if one["effect"] in IN_ROTOR_AND_RACK and one["effect"] != finding["effect"]
    ]
    x, left, own = [], [], []
    for one in rows:
        left_over = one.e - sum((_part(each, one) for each in others), np.zeros(len(one.e)))
        mine = _part(finding, one)
        x.append(_coordinate(one, source))
        left.append(left_over - np.mean(left_over - mine))
        own.append(mine)
    lines, centre = _binned(np.concatenate(x), np.concatenate(left), np.concatenate(own), 1e3)
    return Plot(
        f"kinematics-{finding['effect']}", label, "φ − i·x, mrad", centre, lines, height=260
    )


def size(finding: Mapping[str, Any], model: Model) -> str:
    """How large it is at the rack, in words."""
    values = {name: one["value"] for name, one in finding["parameters"].items()}
    ratio = model.rack_to_rotor_ratio_rad_per_m
    match finding["effect"]:
        case "backlash":
            return f"{1e3 * values['gap_rad'] / ratio:.3g} mm of free play"
        case "belt_compliance":
            stiffness = values["stiffness_nm_per_rad"] * ratio**2
            return f"the rack lags by {1e6 / stiffness:.3g} mm for every kN"
        case "torque_sensor_hysteresis":
            force = values["play_nm"] * model.pinion_ratio_rad_per_m
            return f"±{force:.3g} N of rack force that is not there"
        case "torque_sensor_offset":
            force = values["offset_nm"] * model.pinion_ratio_rad_per_m
            return f"{force:.3g} N of rack force that is not there"
        case "motor_torque_offset":
            return f"{values['offset_nm'] * ratio:.3g} N of rack force that nobody reports"
        case _:
            return ""


def _given(diagnosis: Diagnosis) -> Model:
    """The model before a wrong ratio was put right, which is what the residual is about."""
    model = diagnosis.problem.model
    effects = list(model.effects)
    for name in {one["effect"] for one in diagnosis.content["findings"] if "seen_in" in one}:
        last = max((k for k, one in enumerate(effects) if one["effect"] == name), default=None)
        if last is not None:
            del effects[last]
    return replace(model, effects=tuple(effects))


def _against_rate(
    recordings: Sequence[Prepared], model: Model, finding: Mapping[str, Any]
) -> Plot | None:
    """Reported speed less the angle's rate: along the acceleration, or that times time."""
    both = [one for one in recordings if has_both(one)]
    if not both:
        return None
    delays, values = model.delays_s, finding["parameters"]
    late_s = values["delay_s"]["value"] if "delay_s" in values else 0.0
    apart_s = delays.of("motor_speed_rad_s") - delays.of("motor_angle_rad") - late_s
    shown = [compared(one, apart_s) for one in both]
    acceleration, grown, left = (np.concatenate(parts) for parts in zip(*shown, strict=True))
    if "ppm" in values:
        label, x, own = "acceleration times time in rad/s", grown, values["ppm"]["value"] * 1e-6
    else:
        label, x, own = "acceleration in rad/s²", acceleration, late_s
    lines, centre = _binned(x, left, -own * x, 1.0)
    name = f"kinematics-{finding['effect']}"
    return Plot(name, label, "speed less the angle's rate, rad/s", centre, lines, height=260)


def _coordinate(one: Rows, source: str) -> Floats:
    if source == "drift":
        return np.asarray(one.columns["drift"] * -1e6)
    return np.asarray(getattr(one, source))


def _part(finding: Mapping[str, Any], one: Rows) -> Floats:
    """What the finding makes of φ − i_APA·x, rad."""
    values = {name: each["value"] for name, each in finding["parameters"].items()}
    columns = one.columns
    match finding["effect"]:
        case "backlash":
            return np.asarray(0.5 * values["gap_rad"] * columns["half_gap"])
        case "belt_compliance":
            return np.asarray(columns["compliance"] / values["stiffness_nm_per_rad"])
        case "clock_drift":
            return np.asarray(values["ppm"] * columns["drift"])
        case "rack_ratio":
            return np.asarray(
                values["scale"] * columns["ratio"]
                + values.get("slope_per_m", 0.0) * columns["ratio_slope"]
                + values.get("bend_per_m2", 0.0) * columns["ratio_bend"]
            )
        case _:
            return np.zeros(len(one.e))


def _binned(x: Floats, left: Floats, own: Floats, scale: float) -> tuple[list[Line], Floats]:
    low, high = np.percentile(x, [0.5, 99.5])
    edges = np.linspace(low, high, BINS + 1)
    index = np.digitize(x, edges) - 1
    rows = [index == i for i in range(BINS) if np.sum(index == i) >= 10]
    centre = np.array([np.mean(x[r]) for r in rows])
    return [
        Line("recordings", "dots", scale * np.array([np.mean(left[r]) for r in rows])),
        Line("this finding, as fitted", "after", scale * np.array([np.mean(own[r]) for r in rows])),
    ], centre


def _as_read(one: Holdout) -> Prepared:
    """The hold-out before anything was put right in it, where it holds its own rack force."""
    if "rack_force_n" not in one.series:
        return one.prepared
    return prepare(one.prepared.name, one.series)


def _twist(recordings: Sequence[Prepared], model: Model, finding: Mapping[str, Any]) -> Plot | None:
    """Reported torque less the twist's, while it rises and while it falls: play parts the two."""
    play = finding["parameters"]["play_nm"]["value"]
    late = model.delays_s.of("torque_sensor_nm")
    kept: list[tuple[Floats, Floats]] = []
    for one in recordings:
        if has_twist(one):
            reported = np.interp(one.time_s, one.time_s - late, one.raw["torque_sensor_nm"])
            kept.append((one.thin(twist_rad(one, model)), one.thin(reported)))
    if not kept:
        return None
    twist, reported = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    rate = np.concatenate([np.gradient(one) for one, _ in kept])
    lag = np.zeros(len(twist))
    columns = np.column_stack([twist, rate, np.ones(len(twist))])  # stiffness, damping, offset
    for _ in range(_ROUNDS):
        torque = columns @ np.linalg.lstsq(columns, reported - lag, rcond=None)[0]
        lag = with_play(torque, play) - torque
    moving = np.abs(rate) > 0.2 * np.std(rate)
    low, high = np.percentile(torque, [1, 99])
    edges = np.linspace(low, high, BINS // 2 + 1)
    index = np.digitize(torque, edges) - 1
    centre = 0.5 * (edges[1:] + edges[:-1])

    def along(values: Floats, use: npt.NDArray[np.bool_]) -> Floats:
        picked = [use & moving & (index == i) for i in range(len(centre))]
        return np.array([np.mean(values[p]) if np.sum(p) > 9 else np.nan for p in picked])

    lines = [
        Line("torque rising", "dots", along(reported - torque, rate > 0)),
        Line("torque falling", "dots2", along(reported - torque, rate < 0)),
        Line("play as fitted", "after", along(lag, rate > 0)),
        Line("", "after", along(lag, rate < 0)),
    ]
    return Plot(
        "kinematics-torque_sensor_hysteresis",
        "torsion-bar torque by the twist in Nm",
        "reported less true, Nm",
        centre,
        lines,
        height=260,
    )
