"""What a diagnosis' page is drawn from: residuals with and without each finding, in Nm.

Everything is recomputed from the model file and the augmented model, so that the page shows what
these two models do, and nothing that only the search had seen.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.given_load import EMPIRICAL, Diagnosis
from eps_hil.diagnosis.mismatch.regions import operating_region
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.signals import CANONICAL

Floats = npt.NDArray[np.float64]
Masks = npt.NDArray[np.bool_]


@dataclass
class Evidence:
    """Thinned samples (125 Hz) of some recordings under the models of one diagnosis."""

    problem: Problem
    augmented: Model
    entries: Sequence[Mapping[str, Any]]
    """The accepted findings' entries of the augmented model."""

    @cached_property
    def before_nm(self) -> Floats:
        """Residual (n,) of the model file."""
        return self.problem.residual(self.problem.model) * self.problem.scale

    @cached_property
    def after_nm(self) -> Floats:
        """Residual (n,) of the augmented model."""
        return self.problem.residual(self.augmented) * self.problem.scale

    @cached_property
    def without_nm(self) -> Sequence[Floats]:
        """Residual (n,) of the augmented model without each of the entries, the rest as it is."""
        result = []
        given = self.problem.model.effects
        for k in range(len(self.entries)):
            others = (*given, *self.entries[:k], *self.entries[k + 1 :])
            model = replace(self.augmented, effects=others)
            result.append(self.problem.residual(model) * self.problem.scale)
        return result

    @cached_property
    def signals(self) -> Mapping[str, Floats]:
        """Canonical signals (n,) at physical instants, and ``motor_angle_rad``."""
        found = dict(operating_region(self.problem))
        angle = [one.motion(self.problem.model).angle_rad for one in self.problem.recordings]
        times = self.problem.recordings
        found["motor_angle_rad"] = np.concatenate(
            [np.interp(one.thin_time_s, one.time_s, a) for one, a in zip(times, angle, strict=True)]
        )
        return found

    @property
    def sliding(self) -> Masks:
        """Samples (n,) at which the balance is judged."""
        return self.problem.sliding

    @cached_property
    def floor_nm(self) -> Floats:
        """Rms (n,) that sensor noise alone leaves."""
        parts = [
            np.full(len(one.thin_time_s), one.floor_nm(self.problem.model))
            for one in self.problem.recordings
        ]
        return np.concatenate(parts)

    def parts(self) -> list[slice]:
        """The samples of each recording."""
        ends = np.cumsum([0, *(len(one.thin_time_s) for one in self.problem.recordings)])
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    def rms_nm(self, residual: Floats) -> float:
        """Rms of a residual (n,) while sliding."""
        kept = residual[self.sliding]
        return float(np.sqrt(np.mean(kept**2))) if len(kept) else float("nan")


def fitted(diagnosis: Diagnosis) -> Evidence:
    """Of the recordings that were fitted."""
    return Evidence(diagnosis.problem, _judged_model(diagnosis), _entries(diagnosis))


def held_out(diagnosis: Diagnosis) -> Evidence:
    """Of the recordings that were kept from the fit."""
    problem = Problem([one.prepared for one in diagnosis.judged], diagnosis.problem.model)
    return Evidence(problem, _judged_model(diagnosis), _entries(diagnosis))


def _judged_model(diagnosis: Diagnosis) -> Model:
    """The augmented model as the torque balance meets it.

    What the kinematics showed was put right in the recordings themselves, and must not act twice.
    """
    own = diagnosis.problem.model.effects
    return replace(_balanced(diagnosis), effects=(*own, *_entries(diagnosis)))


def _balanced(diagnosis: Diagnosis) -> Model:
    """The augmented model, without a load that the recordings have got as their rack force."""
    return diagnosis.model if diagnosis.beside_load is None else diagnosis.beside_load


def _entries(diagnosis: Diagnosis) -> Sequence[Mapping[str, Any]]:
    elsewhere = {one["effect"] for one in diagnosis.content["findings"] if "seen_in" in one}
    new = _balanced(diagnosis).effects[len(diagnosis.problem.model.effects) :]
    return [entry for entry in new if entry["effect"] not in elsewhere]


def acts_over(
    entry: Mapping[str, Any], where: Sequence[Mapping[str, Any]], evidence: Evidence
) -> tuple[str, Floats]:
    """(axis label, coordinate (n,)) over which a finding's torque is best looked at."""
    signals, effect = evidence.signals, entry["effect"]
    if effect == EMPIRICAL:
        return _of_law(entry, signals)
    orders = {
        "cogging_torque": entry.get("order"),
        "torque_ripple": 6.0 * evidence.problem.model.pole_pairs,
        "screw_ripple": 1.0 / evidence.problem.model.belt_ratio,
        "cardan_joint": 2.0 * with_model_effects(evidence.problem.model).sensor_to_rotor,
    }
    order = float(orders.get(effect) or 0.0)
    if order:
        return _turn(order, signals["motor_angle_rad"])
    chosen = _COORDINATE.get(effect, "")
    for region in where:
        chosen = chosen or (region["signal"] if region["signal"] != "time_s" else "")
    chosen = chosen or "motor_speed_rad_s"
    return label(chosen), signals[chosen]


def shows(entry: Mapping[str, Any], evidence: Evidence) -> bool:
    """Whether a law's torque can be looked at over what it depends on, as it is at each instant."""
    return (
        entry.get("form") == "law"
        and all(one == "none" for one in entry["memory"])
        and all(one in evidence.signals for one in entry["inputs"])
    )


def _of_law(entry: Mapping[str, Any], signals: Mapping[str, Floats]) -> tuple[str, Floats]:
    """Over the phase of its ripple, if it has one, else over its last input: the first one of two
    is what the rest is a share of.
    """
    inputs, shapes = entry["inputs"], entry["shapes"]
    if "sine" not in shapes:
        return label(inputs[-1]), signals[inputs[-1]]
    at = shapes.index("sine")
    angle = signals[inputs[at]]
    name, turn = _turn(float(entry[f"order_{at + 1}"]), angle)
    odd = [signals[one] for one, shape in zip(inputs, shapes, strict=True) if shape == "linear"]
    for one in odd:  # of the other sign it is the same ripple half a period on
        turn = np.mod(turn + np.where(one < 0.0, 180.0, 0.0), 360.0)
    return name, turn


def _turn(order: float, angle_rad: Floats) -> tuple[str, Floats]:
    turn = np.mod(order * angle_rad, 2 * np.pi) * 180 / np.pi
    return f"angle of order {order:.4g} per rotor turn in °", turn


_COORDINATE: Mapping[str, str] = {
    "stribeck": "motor_speed_rad_s",
    "viscous_friction": "motor_speed_rad_s",
    "quadratic_drag": "motor_speed_rad_s",
    "coulomb_level": "motor_speed_rad_s",
    "friction_asymmetry": "motor_speed_rad_s",
    "load_dependent_friction": "rack_force_n",
    "rack_ratio": "rack_force_n",
    "position_dependent_friction": "rack_position_m",
    "position_torque": "rack_position_m",
    "end_stop": "rack_position_m",
    "unmodelled_spring": "motor_angle_rad",
    "motor_torque_gain": "motor_torque_nm",
    "motor_torque_saturation": "motor_torque_nm",
    "torque_sensor_gain": "torque_sensor_nm",
    "friction_warmup": "time_s",
}

LABELS: Mapping[str, str] = {
    "motor_speed_rad_s": "rotor speed in rad/s",
    "motor_angle_rad": "rotor angle in rad",
    "rack_position_m": "rack position in m",
    "rack_force_n": "rack force in N",
    "motor_torque_nm": "motor torque in Nm",
    "torque_sensor_nm": "torsion-bar torque in Nm",
    "abs_motor_speed_rad_s": "rotor speed either way in rad/s",
    "since_reversal_s": "time since the last reversal in s",
    "dwell_s": "length of the last rest in s",
    "motor_temperature_degc": "motor temperature in °C",
    "time_s": "time in s",
    "motor_power_w": "motor power in W",
    "motor_power_sign": "whether the motor drives or brakes",
    "load_power_sign": "whether the load drives or brakes",
    "torque_sensor_power_sign": "whether the torsion bar drives or brakes",
}
_DIRECTIONS = {"right": ", turning positive", "left": ", turning negative"}


def label(signal: str) -> str:
    """A signal (``name`` or ``name|right``) as an axis says it, with its unit."""
    name, _, direction = signal.partition("|")
    known = CANONICAL.get(name)
    told = name if known is None else f"{known.description} in {known.unit}"
    return LABELS.get(name, told) + _DIRECTIONS.get(direction, "")
