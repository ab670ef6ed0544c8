"""The numbers of a steering chain beside the model file: inertias, springs, motor lag (table 1).

The seed paper names these parameters and gives no values; ``configs/reference_chain.yaml`` holds
values with a reason for each, and docs/theory-plant.md says more.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field, with_config

from eps_hil import yaml_file
from eps_hil.errors import InputError
from eps_hil.physics.model import Model

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]

_STRICT = ConfigDict(extra="forbid")
_INERTIA_TOLERANCE = 1e-3


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class FrictionShare:
    """Where the drive's friction acts; fractions of T_f, each through its own bristle."""

    rotor: NotNegative = 1.0
    nut: NotNegative = 0.0
    rack: NotNegative = 0.0

    @property
    def total(self) -> float:
        """Sum of the fractions; 1 keeps the friction level of the model file."""
        return self.rotor + self.nut + self.rack


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class ColumnFriction:
    """Bearing friction of the steering column, at the steering wheel; no load dependence."""

    level_nm: NotNegative = 0.0
    sigma0_nm_per_rad: Positive = 20.0
    sigma1_nm_s_per_rad: NotNegative = 0.05
    sigma1_speed_rad_s: Positive = 0.1


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class EndStop:
    """Rubber stops in the housing; they push on the rack, not on the tie rods."""

    position_m: Positive = 0.08
    stiffness_n_per_m: NotNegative = 2.0e6
    damping_n_s_per_m: NotNegative = 4.0e3


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class ChainParameters:
    """Table 1 of the seed paper; both tie rods and both road wheels are counted as one.

    Without ``rotor_inertia_kg_m2`` the rotor gets what eq. 1b leaves of the model file's J_1m.
    ``belt_*`` are at the ball nut, ``torsion_bar_*`` at the column, the others at the rack.
    """

    steering_wheel_inertia_kg_m2: NotNegative
    ball_nut_inertia_kg_m2: Positive
    rack_mass_kg: Positive
    road_wheel_inertia_kg_m2: Positive
    tie_rod_ratio_rad_per_m: Positive
    torsion_bar_stiffness_nm_per_rad: Positive
    torsion_bar_damping_nm_s_per_rad: NotNegative
    belt_stiffness_nm_per_rad: Positive
    belt_damping_nm_s_per_rad: NotNegative
    ball_gear_stiffness_n_per_m: Positive
    ball_gear_damping_n_s_per_m: NotNegative
    tie_rod_stiffness_n_per_m: Positive
    tie_rod_damping_n_s_per_m: NotNegative
    motor_dead_time_s: Annotated[float, Field(ge=0, le=0.02)] = 0.0
    motor_time_constant_s: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    motor_torque_limit_nm: Positive = 5.0
    rotor_inertia_kg_m2: Positive | None = None
    friction_share: FrictionShare = field(default_factory=FrictionShare)
    column_friction: ColumnFriction = field(default_factory=ColumnFriction)
    end_stop: EndStop | None = None

    def without_steering_wheel(self) -> "ChainParameters":
        """The estimation model's side of eq. 1: the driver's torque *is* the sensor torque."""
        from dataclasses import replace

        return replace(
            self, steering_wheel_inertia_kg_m2=0.0, column_friction=ColumnFriction(level_nm=0.0)
        )


def load_chain(path: str | Path) -> ChainParameters:
    """Read the ``chain:`` block of a YAML file; :class:`InputError` names file and field."""
    parameters = yaml_file.load(path, ChainParameters, section="chain")
    if abs(parameters.friction_share.total - 1.0) > 1e-9:
        raise InputError(
            path,
            "chain.friction_share",
            f"the fractions add up to {parameters.friction_share.total:g}",
            "make them add up to 1",
        )
    return parameters


def masses_kg_m2(model: Model, parameters: ChainParameters) -> float:
    """What nut, rack and road wheels have of J_1m (eq. 1b), at the rotor."""
    rack_to_rotor = model.rack_to_rotor_ratio_rad_per_m
    return (
        parameters.rack_mass_kg / rack_to_rotor**2
        + parameters.road_wheel_inertia_kg_m2
        * (parameters.tie_rod_ratio_rad_per_m / rack_to_rotor) ** 2
        + parameters.ball_nut_inertia_kg_m2 / model.belt_ratio**2
    )


def rotor_inertia_kg_m2(model: Model, parameters: ChainParameters) -> float:
    """J_rot of eq. 1b: what the model file's J_1m leaves beside nut, rack and road wheels."""
    others = masses_kg_m2(model, parameters)
    left = model.inertia_kg_m2 - others
    given = parameters.rotor_inertia_kg_m2
    if given is not None:
        if abs(given + others - model.inertia_kg_m2) > _INERTIA_TOLERANCE * model.inertia_kg_m2:
            raise InputError(
                "chain",
                "rotor_inertia_kg_m2",
                f"eq. 1b gives {given + others:.4g} kg m2, the model file says"
                f" {model.inertia_kg_m2:.4g}",
                "leave rotor_inertia_kg_m2 out, or make the two agree",
            )
        return given
    if left <= 0.0:
        raise InputError(
            "chain",
            "ball_nut_inertia_kg_m2",
            f"nut, rack and road wheels alone are {others:.4g} kg m2 at the rotor, more than the"
            f" model file's inertia_kg_m2 of {model.inertia_kg_m2:.4g}",
            "use smaller masses",
        )
    return left
