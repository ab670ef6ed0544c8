"""Steering chains of one to five masses (seed paper, fig. 2), built from table 1.

Every coordinate is reflected to the rotor: q = ratio · (the mass's own angle or position). Each
elastic joint then acts on a plain difference of two coordinates, and making a joint rigid is
nothing but giving two masses one coordinate and adding their inertias. So the reduction
5 → 4 → 3 → 2 → 1 is a table (``GROUPS``), and eq. 1b is what comes out of it.

The model file's effects act on it by the kernels of ``simulate``, each at its mass
(``chain_effects.py``); ``chain_step.py`` integrates what is built here.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.physics.chain_parameters import ChainParameters, rotor_inertia_kg_m2
from eps_hil.physics.effects.catalogue import joint_of, values_of, with_model_effects
from eps_hil.physics.effects.effect import RIGID, Effect, Joint, Kind, Mass, Slot
from eps_hil.physics.friction import FrictionLaw, friction_law
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import Drive, drive_of

Floats = npt.NDArray[np.float64]

STEERING_WHEEL, ROTOR, NUT, RACK, ROAD_WHEELS = range(5)

GROUPS = {
    5: (0, 1, 2, 3, 4),  # steering wheel | rotor | ball nut | rack | road wheels
    4: (0, 1, 2, 3, 3),  # tie rods rigid: m_2, "rack mass with road wheels" of table 1
    3: (0, 1, 1, 2, 2),  # belt rigid: the highest mode goes first
    2: (0, 1, 1, 1, 1),  # ball gear rigid: J_1m of eq. 1b and the steering wheel
    1: (0, 0, 0, 0, 0),  # torsion bar rigid: the fully condensed model of fig. 5
}
"""Coordinate of each mass by the number of masses."""

JOINTED = {**GROUPS, 3: (0, 1, 2, 3, 3), 2: (0, 1, 2, 2, 2), 1: (1, 0, 1, 1, 1)}
"""The same where an effect is in the belt: rotor and ball nut then have a joint in each chain."""

# Columns of an input row; values between two rows are interpolated.
(
    LOAD_FORCE,  # N, positive opposes positive speed
    LOAD_STIFFNESS,  # N/m, of the rig's linear motor about LOAD_POSITION
    LOAD_DAMPING,  # Ns/m
    LOAD_POSITION,  # m
    HAND_TORQUE,  # Nm, at the steering wheel
    HAND_STIFFNESS,  # Nm/rad, of arms or steering robot about HAND_ANGLE
    HAND_DAMPING,  # Nms/rad
    HAND_ANGLE,  # rad
) = range(8)
INPUTS = 8

# Work done on the chain, in J, by entry of ``ChainState.energy_j``; the last three are taken out.
WORK_MOTOR, WORK_LOAD, WORK_HAND, LOST_JOINTS, LOST_FRICTION, LOST_END_STOP = range(6)


class Chain(NamedTuple):
    """A chain as compiled code takes it; coordinates and torques at the rotor, n = 1 … 5."""

    inertia: Floats  # (n,) kg m²
    stiffness: Floats  # (n, n) Nm/rad
    damping: Floats  # (n, n) Nms/rad
    group: npt.NDArray[np.int64]  # (5,) coordinate of each mass
    friction_share: Floats  # (n,)
    drive: FrictionLaw
    column: FrictionLaw
    pinion_ratio: float  # i_pi, rad/m
    rack_to_rotor: float  # i_APA, rad/m
    steering_wheel_inertia: float
    torsion_stiffness: float
    torsion_damping: float
    dead_time_steps: int
    lag_keep: float  # exp(−Δt/τ_em)
    torque_limit: float
    stop_position: float  # inf: no end stop
    stop_stiffness: float
    stop_damping: float
    step_s: float
    late_steps: int  # shaft torque behind what the motor reports
    acting: bool  # whether any effect acts at run time
    joint: Joint  # of rotor and nut, where it has play; else in stiffness and damping
    at_rotor: Drive  # the model's effects: those at the rotor and all that have no mass
    at_nut: Drive
    at_rack: Drive
    sensor: Drive  # errors of the torsion bar's sensor


class ChainState(NamedTuple):
    """Arrays that a step changes in place; nothing is allocated while running."""

    angle_rad: Floats  # (n,)
    speed_rad_s: Floats  # (n,)
    bristle_rad: Floats  # (n,) of the drive
    column_bristle_rad: Floats  # (1,)
    motor: Floats  # (5,) torque, delayed command, both rings' write positions, shaft's input
    commands: Floats  # dead-time ring
    shaft: Floats  # ring of torques that the shaft has not had yet
    time_s: Floats  # (1,)
    energy_j: Floats  # (6,)
    effects_j: Floats  # (1,) taken out by effects
    matrix: Floats  # (n, n) scratch
    vector: Floats  # (n,) scratch
    middle: Floats  # (n,) scratch: speed in the middle of the step
    external: Floats  # (4, n) scratch: torque, stiffness, damping, spring torque at q
    more: Floats  # (n,) scratch: torque of effects
    half_way: Floats  # (n,) scratch: angle in the middle of the step


class Reading(NamedTuple):
    """Physical values of one instant, each in its own unit and side (CONTRACT 1, 2).

    The last two are what motor and torsion-bar sensor make of it, which effects may change; the
    sensor's own errors are not in it yet.
    """

    motor_torque_nm: float
    torque_sensor_nm: float
    motor_speed_rad_s: float
    motor_angle_rad: float
    rack_force_n: float
    rack_position_m: float
    steering_wheel_angle_rad: float
    steering_wheel_speed_rad_s: float
    friction_torque_nm: float
    motor_torque_told_nm: float
    torque_sensor_told_nm: float


def ratios(model: Model, parameters: ChainParameters) -> Floats:
    """Rotor radians per unit of each mass's own coordinate, shape (5,)."""
    rack = model.rack_to_rotor_ratio_rad_per_m
    return np.array(
        [
            rack / model.pinion_ratio_rad_per_m,
            1.0,
            model.belt_ratio,
            rack,
            rack / parameters.tie_rod_ratio_rad_per_m,
        ]
    )


def build_chain(
    model: Model, parameters: ChainParameters, order: int, *, step_s: float = 5e-5
) -> Chain:
    """The chain of ``order`` masses (1 … 5) with the model's effects; ``step_s``: integration step.

    What effects remember is in the chain: one chain, one run. ``ValueError`` names an effect that
    cannot act here.
    """
    if order not in GROUPS:
        raise ValueError(f"a chain has 1 to 5 masses, not {order}")
    _check(model)
    model = with_model_effects(model)
    joint = joint_of(model, _bare_belt(model, parameters, order))
    group = np.array((GROUPS if joint is None else JOINTED)[order], dtype=np.int64)
    stiffness, damping = _joints(model, parameters, group, joint)
    share = np.zeros(group.max() + 1)
    for mass, part in zip((ROTOR, NUT, RACK), _shares(parameters), strict=True):
        share[group[mass]] += part
    tau_s, stop = parameters.motor_time_constant_s, parameters.end_stop
    at_rotor, at_nut, at_rack, sensor = (drive_of(model, one) for one in _SIDES)
    played = joint if joint is not None and joint.gap_rad > 0.0 else RIGID
    sides = (at_rotor, at_nut, at_rack)
    return Chain(
        inertia=_inertias(model, parameters, group),
        stiffness=stiffness,
        damping=damping,
        group=group,
        friction_share=share,
        drive=friction_law(model.friction),
        column=_column_law(parameters),
        pinion_ratio=float(model.pinion_ratio_rad_per_m),
        rack_to_rotor=float(model.rack_to_rotor_ratio_rad_per_m),
        steering_wheel_inertia=float(parameters.steering_wheel_inertia_kg_m2),
        torsion_stiffness=float(parameters.torsion_bar_stiffness_nm_per_rad),
        torsion_damping=float(parameters.torsion_bar_damping_nm_s_per_rad),
        dead_time_steps=round(parameters.motor_dead_time_s / step_s),
        lag_keep=math.exp(-step_s / tau_s) if tau_s > 0 else 0.0,
        torque_limit=float(parameters.motor_torque_limit_nm),
        stop_position=float(stop.position_m) if stop else math.inf,
        stop_stiffness=float(stop.stiffness_n_per_m) if stop else 0.0,
        stop_damping=float(stop.damping_n_s_per_m) if stop else 0.0,
        step_s=float(step_s),
        late_steps=round(max(-model.delays_s.motor_torque, 0.0) / step_s),
        acting=played.gap_rad > 0.0 or any(any(side.use) for side in sides),
        joint=Joint(*(float(value) for value in played)),
        at_rotor=at_rotor,
        at_nut=at_nut,
        at_rack=at_rack,
        sensor=sensor,
    )


def rest_state(chain: Chain) -> ChainState:
    """Everything at zero and at rest."""
    n = chain.inertia.size
    return ChainState(
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(1),
        np.zeros(5),
        np.zeros(chain.dead_time_steps + 1),
        np.zeros(chain.late_steps + 1),
        np.zeros(1),
        np.zeros(6),
        np.zeros(1),
        np.zeros((n, n)),
        np.zeros(n),
        np.zeros(n),
        np.zeros((4, n)),
        np.zeros(n),
        np.zeros(n),
    )


def stored_energy_j(chain: Chain, state: ChainState) -> float:
    """Kinetic and elastic energy of masses and joints (not of the bristles), in J."""
    speed, angle = state.speed_rad_s, state.angle_rad
    return float(0.5 * speed @ (chain.inertia * speed) + 0.5 * angle @ chain.stiffness @ angle)


def _inertias(model: Model, p: ChainParameters, group: npt.NDArray[np.int64]) -> Floats:
    own = np.array(
        [
            p.steering_wheel_inertia_kg_m2,
            rotor_inertia_kg_m2(model, p),
            p.ball_nut_inertia_kg_m2,
            p.rack_mass_kg,
            p.road_wheel_inertia_kg_m2,
        ]
    )
    inertia = np.zeros(group.max() + 1)
    np.add.at(inertia, group, own / ratios(model, p) ** 2)
    return inertia


def _check(model: Model) -> None:
    for entry in model.effects:
        effect, values = values_of(entry, model)
        slot = effect.slot if effect.slot_of is None else effect.slot_of(values)
        if slot is Slot.SENSOR and effect.kind is Kind.INSTRUMENT and effect.told is None:
            raise ValueError(
                f"'{effect.id}' says what a reading means, not how the sensor comes to it (told):"
                " a simulated rig cannot have it"
            )


def _at(mass: Mass) -> Callable[[Effect, Slot], bool]:
    """Effects of one mass; what has no mass of its own is the rotor's."""

    def picks(effect: Effect, slot: Slot) -> bool:
        if effect.told is not None:
            return False
        return (effect.mass if slot is Slot.TORQUE else Mass.ROTOR) is mass

    return picks


_SIDES = (*map(_at, (Mass.ROTOR, Mass.NUT, Mass.RACK)), lambda effect, _: effect.told is not None)


def _bare_belt(model: Model, p: ChainParameters, order: int) -> Joint:
    """The belt as the chain has it, at the rotor; a rigid one's stiffness where it is reduced."""
    if order not in {4, 5}:
        return RIGID
    square = model.belt_ratio**2
    return RIGID._replace(
        stiffness_nm_per_rad=p.belt_stiffness_nm_per_rad / square,
        damping_nm_s_per_rad=p.belt_damping_nm_s_per_rad / square,
    )


def _joints(
    model: Model, p: ChainParameters, group: npt.NDArray[np.int64], belt: Joint | None
) -> tuple[Floats, Floats]:
    """Stiffness and damping (n, n) of all joints; ``belt``: changed by effects, out if it has
    play."""
    if belt is not None:
        square, closed = model.belt_ratio**2, float(belt.gap_rad == 0.0)
        p = replace(
            p,
            belt_stiffness_nm_per_rad=closed * belt.stiffness_nm_per_rad * square,
            belt_damping_nm_s_per_rad=closed * belt.damping_nm_s_per_rad * square,
        )
    ratio = ratios(model, p)
    joints = (
        (STEERING_WHEEL, RACK, ratio[STEERING_WHEEL], "torsion_bar", "nm_per_rad", "nm_s_per_rad"),
        (ROTOR, NUT, ratio[NUT], "belt", "nm_per_rad", "nm_s_per_rad"),
        (NUT, RACK, ratio[RACK], "ball_gear", "n_per_m", "n_s_per_m"),
        (RACK, ROAD_WHEELS, ratio[RACK], "tie_rod", "n_per_m", "n_s_per_m"),
    )
    n = group.max() + 1
    stiffness, damping = np.zeros((n, n)), np.zeros((n, n))
    for one, other, side, name, stiffness_unit, damping_unit in joints:
        difference = np.zeros(n)
        difference[group[one]] += 1.0
        difference[group[other]] -= 1.0
        shape = np.outer(difference, difference) / side**2
        stiffness += getattr(p, f"{name}_stiffness_{stiffness_unit}") * shape
        damping += getattr(p, f"{name}_damping_{damping_unit}") * shape
    return stiffness, damping


def _shares(p: ChainParameters) -> tuple[float, float, float]:
    return p.friction_share.rotor, p.friction_share.nut, p.friction_share.rack


def _column_law(p: ChainParameters) -> FrictionLaw:
    c = p.column_friction
    return FrictionLaw(
        *(float(c.level_nm), float(c.level_nm), 0.0, 0.0, 0.0, 0.0),
        float(c.sigma0_nm_per_rad) if c.level_nm > 0 else 1e-9,
        float(c.sigma1_nm_s_per_rad) if c.level_nm > 0 else 0.0,
        float(c.sigma1_speed_rad_s),
    )
