"""The variables of the model's FMU: what drives it, what it gives, every number of the model."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from eps_hil.physics.effects.added import terms
from eps_hil.physics.effects.catalogue import joint_of, with_model_effects
from eps_hil.physics.effects.effect import Joint
from eps_hil.physics.friction import FrictionLaw
from eps_hil.physics.model import Model

SMALLEST, LARGEST = 1e-12, 1e12
Exponents = Mapping[str, int]
UNITS: Mapping[str, tuple[str, Exponents]] = {
    "1": ("1", {}),
    "s": ("s", {"s": 1}),
    "m": ("m", {"m": 1}),
    "N": ("N", {"kg": 1, "m": 1, "s": -2}),
    "Nm": ("N.m", {"kg": 1, "m": 2, "s": -2}),
    "rad": ("rad", {"rad": 1}),
    "rad/s": ("rad/s", {"rad": 1, "s": -1}),
    "rad/m": ("rad/m", {"rad": 1, "m": -1}),
    "kg m²": ("kg.m2", {"kg": 1, "m": 2}),
    "Nm/N": ("N.m/N", {"m": 1}),
    "N/m": ("N/m", {"kg": 1, "s": -2}),
    "1/m": ("1/m", {"m": -1}),
    "1/m²": ("1/m2", {"m": -2}),
    "Nm/rad": ("N.m/rad", {"kg": 1, "m": 2, "s": -2, "rad": -1}),
    "Nm s/rad": ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
    "Nm s²/rad²": ("N.m.s2/rad2", {"kg": 1, "m": 2, "rad": -2}),
    "Nm/s": ("N.m/s", {"kg": 1, "m": 2, "s": -3}),
    "N/s": ("N/s", {"kg": 1, "m": 1, "s": -3}),
    "1/Nm²": ("1/(N.m)2", {"kg": -2, "m": -4, "s": 4}),
}
"""Our units as FMI writes them, with the powers of the SI units in them."""


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable; ``place``: where the C model keeps a parameter (empty: read by its number)."""

    name: str
    unit: str
    meaning: str
    causality: str = "parameter"
    start: float | None = None
    lower: float = -math.inf
    upper: float = math.inf
    place: str = ""
    tunable: bool = False


INPUTS = (
    Variable("motor_torque_nm", "Nm", "Motor torque as reported, at its instant", "input", 0.0),
    Variable("torque_sensor_nm", "Nm", "Torsion-bar torque as reported, column", "input", 0.0),
    Variable("rack_force_n", "N", "Rack force; positive opposes positive speed", "input", 0.0),
)
RATES = (
    Variable("motor_torque_rate_nm_per_s", "Nm/s", "Its slope over the next step", "input", 0.0),
    Variable("torque_sensor_rate_nm_per_s", "Nm/s", "Its slope over the next step", "input", 0.0),
    Variable("rack_force_rate_n_per_s", "N/s", "Its slope over the next step", "input", 0.0),
)
"""For a master that knows where its inputs go: held over a step where it leaves these at zero."""
OUTPUTS = (
    Variable("motor_speed_rad_s", "rad/s", "Rotor speed", "output"),
    Variable("motor_angle_rad", "rad", "Rotor angle", "output"),
    Variable("rack_position_m", "m", "Rack position", "output"),
    Variable("friction_torque_nm", "Nm", "Friction and added torques, at the rotor", "output"),
)
_START = (
    Variable("start_motor_speed_rad_s", "rad/s", "Rotor speed at the start", start=0.0),
    Variable("start_motor_angle_rad", "rad", "Rotor angle at the start", start=0.0),
    Variable("start_bristle_rad", "rad", "Bristle deflection at the start", start=0.0),
)
_LAW = {
    "offset_pos_nm": ("Nm", "Friction offset, positive speed"),
    "offset_neg_nm": ("Nm", "Friction offset, negative speed"),
    "viscous_pos_nm_s_per_rad": ("Nm s/rad", "Viscous friction, positive speed"),
    "viscous_neg_nm_s_per_rad": ("Nm s/rad", "Viscous friction, negative speed"),
    "load_pos_nm_per_n": ("Nm/N", "Friction per rack force, positive speed"),
    "load_neg_nm_per_n": ("Nm/N", "Friction per rack force, negative speed"),
    "sigma0_nm_per_rad": ("Nm/rad", "Bristle stiffness"),
    "sigma1_nm_s_per_rad": ("Nm s/rad", "Bristle damping"),
    "sigma1_speed_rad_s": ("rad/s", "Speed over which the bristle's damping fades"),
}
_POSITIVE = ("sigma0_nm_per_rad", "sigma1_speed_rad_s")
_JOINT = {
    "stiffness_nm_per_rad": ("Nm/rad", "Stiffness of the joint between rotor and rack"),
    "damping_nm_s_per_rad": ("Nm s/rad", "Damping of that joint"),
    "gap_rad": ("rad", "Play of that joint, at the rotor"),
    "behind_share": ("1", "Share of the inertia behind the joint"),
}


def variables_of(model: Model) -> list[Variable]:
    """Inputs, outputs and parameters of a model's FMU; the value reference is the place here.

    Effects that change the model's own numbers are worked into these.
    """
    worked_in = with_model_effects(model)
    found = [*INPUTS, *RATES, *OUTPUTS, *_START]
    found += [
        _number("inertia_kg_m2", "kg m²", "Inertia J_1m, at the rotor",
                worked_in.inertia_kg_m2, SMALLEST, "drive->inertia"),
        _number("pinion_ratio_rad_per_m", "rad/m", "Pinion angle per rack travel, i_pi",
                worked_in.pinion_ratio_rad_per_m, SMALLEST, ""),
        _number("rack_to_rotor_ratio_rad_per_m", "rad/m", "Rotor angle per rack travel, i_APA",
                worked_in.rack_to_rotor_ratio_rad_per_m, SMALLEST, "drive->ratio"),
    ]  # fmt: skip
    for name in FrictionLaw._fields:
        unit, meaning = _LAW[name]
        least = SMALLEST if name in _POSITIVE else 0.0
        value = getattr(worked_in.friction, name)
        found.append(_number(f"friction.{name}", unit, meaning, value, least, f"drive->law.{name}"))
    joint = joint_of(worked_in)
    if joint is not None:
        found += _of_joint(joint)
    return found + _of_effects(worked_in)


def _number(name: str, unit: str, meaning: str, value: float, least: float, at: str) -> Variable:
    return Variable(name, unit, meaning, "parameter", float(value), least, LARGEST, at, True)


def _of_joint(joint: Joint) -> list[Variable]:
    found = []
    for name, value in joint._asdict().items():
        unit, meaning = _JOINT[name]
        least = 0.0 if name in ("damping_nm_s_per_rad", "gap_rad") else SMALLEST
        found.append(_number(f"joint.{name}", unit, meaning, value, least, f"joint->{name}"))
    return found


def _of_effects(model: Model) -> list[Variable]:
    found = []
    acting = terms(model)
    for k, (effect, values, _, _, numbers) in enumerate(acting):
        same = [j for j, one in enumerate(acting) if one[0].id == effect.id]
        name = effect.id if len(same) == 1 else f"{effect.id}[{same.index(k) + 1}]"
        for i, start in enumerate(numbers):
            known = _effect_number(effect, values, i)
            if known is not None:
                label, unit, meaning, lower, upper = known
                found.append(
                    Variable(f"{name}.{label}", unit, f"{effect.name}: {meaning}", "parameter",
                             float(start), lower, upper, f"parameters[{k} * WIDTH + {i}]", True)
                )  # fmt: skip
    return found


def _effect_number(effect: Any, values: Mapping[str, Any], i: int) -> Any:
    """Name, unit, meaning and bounds of an effect's number ``i``; None for a code of its shape."""
    if effect.read is not None:  # packed: only its size is a number of its own
        return ("size", "1", "factor before it", -LARGEST, LARGEST) if i == 3 else None
    if "curve" in values:
        if i == 0:
            return None
        knot, what = (i + 1) // 2, ("position_m", "m", "place of knot") if i % 2 else (
            "torque_nm", "Nm", "torque at knot")  # fmt: skip
        return f"curve_{knot}_{what[0]}", what[1], f"{what[2]} {knot}", -LARGEST, LARGEST
    one = effect.parameters[i]
    lower, upper = one.domain
    return one.name, one.unit, one.meaning, lower, upper
