"""Steering chains of one to five masses (seed paper, fig. 2), integrated in compiled code.

Every coordinate is reflected to the rotor: q = ratio · (the mass's own angle or position). Each
elastic joint then acts on a plain difference of two coordinates, and making a joint rigid is
nothing but giving two masses one coordinate and adding their inertias. So the reduction
5 → 4 → 3 → 2 → 1 is a table (``GROUPS``), and eq. 1b is what comes out of it.

Integration is the implicit midpoint rule: second order, stable for every stiffness, and it keeps
½ vᵀMv + ½ qᵀKq exactly, so the energy balance closes to the work that friction and the joints'
dampers really take.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.physics.chain_parameters import ChainParameters, rotor_inertia_kg_m2
from eps_hil.physics.friction import (
    FrictionLaw,
    bristle_step,
    friction_law,
    friction_torque_nm,
    static_level_nm,
)
from eps_hil.physics.model import Model

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


class ChainState(NamedTuple):
    """Arrays that a step changes in place; nothing is allocated while running."""

    angle_rad: Floats  # (n,)
    speed_rad_s: Floats  # (n,)
    bristle_rad: Floats  # (n,) of the drive
    column_bristle_rad: Floats  # (1,)
    motor: Floats  # (3,) shaft torque, delayed command, write position of the ring
    commands: Floats  # dead-time ring
    energy_j: Floats  # (6,)
    matrix: Floats  # (n, n) scratch
    vector: Floats  # (n,) scratch
    middle: Floats  # (n,) scratch: speed in the middle of the step
    external: Floats  # (4, n) scratch: torque, stiffness, damping, spring torque at q


class Reading(NamedTuple):
    """Physical values of one instant, each in its own unit and side (CONTRACT 1, 2)."""

    motor_torque_nm: float
    torque_sensor_nm: float
    motor_speed_rad_s: float
    motor_angle_rad: float
    rack_force_n: float
    rack_position_m: float
    steering_wheel_angle_rad: float
    steering_wheel_speed_rad_s: float
    friction_torque_nm: float


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
    """The chain of ``order`` masses (1 … 5); ``step_s`` is the integration step."""
    if order not in GROUPS:
        raise ValueError(f"a chain has 1 to 5 masses, not {order}")
    group = np.array(GROUPS[order], dtype=np.int64)
    stiffness, damping = _joints(model, parameters, group)
    share = np.zeros(order)
    for mass, part in zip((ROTOR, NUT, RACK), _shares(parameters), strict=True):
        share[group[mass]] += part
    tau_s, stop = parameters.motor_time_constant_s, parameters.end_stop
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
    )


def rest_state(chain: Chain) -> ChainState:
    """Everything at zero and at rest."""
    n = chain.inertia.size
    return ChainState(
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(1),
        np.zeros(3),
        np.zeros(chain.dead_time_steps + 1),
        np.zeros(6),
        np.zeros((n, n)),
        np.zeros(n),
        np.zeros(n),
        np.zeros((4, n)),
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


def _joints(
    model: Model, p: ChainParameters, group: npt.NDArray[np.int64]
) -> tuple[Floats, Floats]:
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


@njit
def _solve(matrix: Floats, vector: Floats) -> None:
    """Solve in place by elimination; the matrix is symmetric and positive, so without pivots."""
    n = vector.size
    for k in range(n):
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                vector[i] -= factor * vector[k]
    for k in range(n - 1, -1, -1):
        total = vector[k]
        for j in range(k + 1, n):
            total -= matrix[k, j] * vector[j]
        vector[k] = total / matrix[k, k]


@njit
def _motor_step(chain: Chain, state: ChainState, command_nm: float) -> float:
    """Dead time T_t, then lag τ_em; returns the mean shaft torque of the step."""
    limited = min(max(command_nm, -chain.torque_limit), chain.torque_limit)
    size = state.commands.size
    at = int(state.motor[2])
    state.commands[at] = limited
    at = (at + 1) % size
    state.motor[2] = at
    delayed = state.commands[at] if size > 1 else limited
    before = state.motor[0]
    after = delayed + (before - delayed) * chain.lag_keep
    state.motor[0], state.motor[1] = after, delayed
    return float(0.5 * (before + after))


@njit
def _load_externals(
    chain: Chain, state: ChainState, motor_nm: float, row: Floats, row_rate: Floats
) -> None:
    """External torques and springs of this step, at the rotor, into ``state.external``."""
    ext, angle = state.external, state.angle_rad
    ext[:] = 0.0
    rotor, rack = chain.group[ROTOR], chain.group[RACK]
    end, wheel = chain.group[ROAD_WHEELS], chain.group[STEERING_WHEEL]
    i_apa = chain.rack_to_rotor
    ext[0, rotor] += motor_nm
    square = i_apa * i_apa
    k, d = row[LOAD_STIFFNESS] / square, row[LOAD_DAMPING] / square
    ext[0, end] += -row[LOAD_FORCE] / i_apa + d * row_rate[LOAD_POSITION] * i_apa
    ext[1, end] += k
    ext[2, end] += d
    ext[3, end] += k * (angle[end] - row[LOAD_POSITION] * i_apa)
    side = i_apa / chain.pinion_ratio
    k, d = row[HAND_STIFFNESS] / (side * side), row[HAND_DAMPING] / (side * side)
    ext[0, wheel] += row[HAND_TORQUE] / side + d * row_rate[HAND_ANGLE] * side
    ext[1, wheel] += k
    ext[2, wheel] += d
    ext[3, wheel] += k * (angle[wheel] - row[HAND_ANGLE] * side)
    limit = chain.stop_position * i_apa
    if abs(angle[rack]) > limit:
        k = chain.stop_stiffness / square
        ext[1, rack] += k
        ext[2, rack] += chain.stop_damping / square
        ext[3, rack] += k * (angle[rack] - math.copysign(limit, angle[rack]))


@njit
def _load_force_n(chain: Chain, angle: float, speed: float, row: Floats, rate: Floats) -> float:
    """Force of the rig on the tie rods, N: profile and spring-damper of its linear motor."""
    spring = row[LOAD_STIFFNESS] * (angle / chain.rack_to_rotor - row[LOAD_POSITION])
    damper = row[LOAD_DAMPING] * (speed / chain.rack_to_rotor - rate[LOAD_POSITION])
    return float(row[LOAD_FORCE] + spring + damper)


@njit
def _drive_friction(
    chain: Chain, bristle: float, speed: float, load_n: float
) -> tuple[float, float, float]:
    """Mean friction torque of a step at the rotor, its slope over speed, the bristle after it."""
    law, dt = chain.drive, chain.step_s
    level = static_level_nm(speed, load_n, law)
    after = bristle_step(bristle, speed * dt, abs(speed) * dt, level, law.sigma0_nm_per_rad)
    torque = friction_torque_nm(0.5 * (bristle + after), speed, level, law)
    ratio = speed / law.sigma1_speed_rad_s
    slope = law.sigma1_nm_s_per_rad * math.exp(-ratio * ratio) + 0.5 * dt * law.sigma0_nm_per_rad
    return torque, slope, after


@njit
def _column_friction(chain: Chain, bristle: float, speed: float) -> tuple[float, float, float]:
    """The same for the steering column, at the steering wheel."""
    law, dt = chain.column, chain.step_s
    level = static_level_nm(speed, 0.0, law)
    after = bristle_step(bristle, speed * dt, abs(speed) * dt, level, law.sigma0_nm_per_rad)
    torque = friction_torque_nm(0.5 * (bristle + after), speed, level, law)
    ratio = speed / law.sigma1_speed_rad_s
    slope = law.sigma1_nm_s_per_rad * math.exp(-ratio * ratio) + 0.5 * dt * law.sigma0_nm_per_rad
    return torque, slope, after


@njit
def _middle_speed(chain: Chain, state: ChainState, row: Floats, rate: Floats) -> None:
    """Solve the midpoint equation for the speeds; friction by three Newton-like passes."""
    n, half = chain.inertia.size, 0.5 * chain.step_s
    matrix, vector, middle, ext = state.matrix, state.vector, state.middle, state.external
    angle, speed = state.angle_rad, state.speed_rad_s
    end, wheel = chain.group[ROAD_WHEELS], chain.group[STEERING_WHEEL]
    side = chain.rack_to_rotor / chain.pinion_ratio
    for i in range(n):
        middle[i] = speed[i]
    for _ in range(3):
        load_n = _load_force_n(chain, angle[end] + half * middle[end], middle[end], row, rate)
        for i in range(n):
            vector[i] = chain.inertia[i] * speed[i] / half + ext[0, i] - ext[3, i]
            for j in range(n):
                matrix[i, j] = chain.damping[i, j] + half * chain.stiffness[i, j]
                vector[i] -= chain.stiffness[i, j] * angle[j]
            matrix[i, i] += chain.inertia[i] / half + ext[2, i] + half * ext[1, i]
            share = chain.friction_share[i]
            if share > 0.0:
                torque, slope, _z = _drive_friction(chain, state.bristle_rad[i], middle[i], load_n)
                matrix[i, i] += share * slope
                vector[i] += share * (slope * middle[i] - torque)
        torque, slope, _z = _column_friction(
            chain, state.column_bristle_rad[0], middle[wheel] / side
        )
        matrix[wheel, wheel] += slope / (side * side)
        vector[wheel] += slope / (side * side) * middle[wheel] - torque / side
        _solve(matrix, vector)
        for i in range(n):
            middle[i] = vector[i]


@njit
def _commit(chain: Chain, state: ChainState, motor_nm: float, row: Floats, rate: Floats) -> None:
    """Move the state to the end of the step and book the work that was done."""
    n, dt = chain.inertia.size, chain.step_s
    middle, energy = state.middle, state.energy_j
    rotor, end = chain.group[ROTOR], chain.group[ROAD_WHEELS]
    wheel, rack = chain.group[STEERING_WHEEL], chain.group[RACK]
    side, i_apa = chain.rack_to_rotor / chain.pinion_ratio, chain.rack_to_rotor
    end_angle = state.angle_rad[end] + 0.5 * dt * middle[end]
    load_n = _load_force_n(chain, end_angle, middle[end], row, rate)
    hand_speed = middle[wheel] / side
    hand_angle = (state.angle_rad[wheel] + 0.5 * dt * middle[wheel]) / side
    hand = (
        row[HAND_TORQUE]
        - row[HAND_STIFFNESS] * (hand_angle - row[HAND_ANGLE])
        - row[HAND_DAMPING] * (hand_speed - rate[HAND_ANGLE])
    )
    energy[WORK_MOTOR] += motor_nm * middle[rotor] * dt
    energy[WORK_LOAD] -= load_n * middle[end] / i_apa * dt
    energy[WORK_HAND] += hand * hand_speed * dt
    if abs(state.angle_rad[rack]) > chain.stop_position * i_apa:
        push = math.copysign(chain.stop_position * i_apa, state.angle_rad[rack])
        deep = state.angle_rad[rack] + 0.5 * dt * middle[rack] - push
        stop = chain.stop_stiffness * deep + chain.stop_damping * middle[rack]
        energy[LOST_END_STOP] += stop / (i_apa * i_apa) * middle[rack] * dt
    torque, _s, after = _column_friction(chain, state.column_bristle_rad[0], hand_speed)
    energy[LOST_FRICTION] += torque * hand_speed * dt
    state.column_bristle_rad[0] = after
    for i in range(n):
        for j in range(n):
            energy[LOST_JOINTS] += middle[i] * chain.damping[i, j] * middle[j] * dt
        share = chain.friction_share[i]
        torque, _s, after = _drive_friction(chain, state.bristle_rad[i], middle[i], load_n)
        energy[LOST_FRICTION] += share * torque * middle[i] * dt
        state.bristle_rad[i] = after
    for i in range(n):
        state.angle_rad[i] += dt * middle[i]
        state.speed_rad_s[i] = 2.0 * middle[i] - state.speed_rad_s[i]


@njit
def advance(
    chain: Chain,
    state: ChainState,
    command_nm: float,
    now: Floats,
    after: Floats,
    steps: int,
    scratch: Floats,
) -> None:
    """Integrate ``steps`` steps from input row ``now`` to row ``after`` (both (INPUTS,) or longer).

    ``command_nm`` is the motor torque the ECU asks for, held; ``scratch`` is (2, INPUTS) floats.
    """
    row, rate = scratch[0], scratch[1]
    for k in range(INPUTS):
        rate[k] = (after[k] - now[k]) / (steps * chain.step_s)
    for step in range(steps):
        part = (step + 0.5) / steps
        for k in range(INPUTS):
            row[k] = now[k] + (after[k] - now[k]) * part
        motor_nm = _motor_step(chain, state, command_nm)
        _load_externals(chain, state, motor_nm, row, rate)
        _middle_speed(chain, state, row, rate)
        _commit(chain, state, motor_nm, row, rate)


@njit
def read_out(chain: Chain, state: ChainState, row: Floats, rate: Floats) -> Reading:
    """What is physically true at this instant, under the input row of the instant."""
    angle, speed = state.angle_rad, state.speed_rad_s
    rotor, end = chain.group[ROTOR], chain.group[ROAD_WHEELS]
    rack, wheel = chain.group[RACK], chain.group[STEERING_WHEEL]
    i_apa = chain.rack_to_rotor
    side = i_apa / chain.pinion_ratio
    load_n = _load_force_n(chain, angle[end], speed[end], row, rate)
    friction = 0.0
    for i in range(chain.inertia.size):
        if chain.friction_share[i] > 0.0:
            level = static_level_nm(speed[i], load_n, chain.drive)
            friction += chain.friction_share[i] * friction_torque_nm(
                state.bristle_rad[i], speed[i], level, chain.drive
            )
    if wheel != rack:
        twist, rate_of_twist = angle[wheel] - angle[rack], speed[wheel] - speed[rack]
        sensor = (chain.torsion_stiffness * twist + chain.torsion_damping * rate_of_twist) / side
    else:
        sensor = _rigid_sensor_nm(chain, state, row, rate, load_n, friction)
    return Reading(
        state.motor[0],
        sensor,
        speed[rotor],
        angle[rotor],
        load_n,
        angle[rack] / i_apa,
        angle[wheel] / side,
        speed[wheel] / side,
        friction,
    )


@njit
def _rigid_sensor_nm(
    chain: Chain, state: ChainState, row: Floats, rate: Floats, load_n: float, friction: float
) -> float:
    """Torque through a rigid torsion bar: what the hand gives, less column friction and J_sw φ̈."""
    i_apa = chain.rack_to_rotor
    side = i_apa / chain.pinion_ratio
    angle, speed = state.angle_rad[0] / side, state.speed_rad_s[0] / side
    hand = (
        row[HAND_TORQUE]
        - row[HAND_STIFFNESS] * (angle - row[HAND_ANGLE])
        - row[HAND_DAMPING] * (speed - rate[HAND_ANGLE])
    )
    level = static_level_nm(speed, 0.0, chain.column)
    hand -= friction_torque_nm(state.column_bristle_rad[0], speed, level, chain.column)
    torque = state.motor[0] + hand / side - load_n / i_apa - friction
    if abs(state.angle_rad[0]) > chain.stop_position * i_apa:
        push = math.copysign(chain.stop_position, state.angle_rad[0])
        deep = state.angle_rad[0] / i_apa - push
        stop = chain.stop_stiffness * deep + chain.stop_damping * state.speed_rad_s[0] / i_apa
        torque -= stop / i_apa
    return float(hand - chain.steering_wheel_inertia * torque / chain.inertia[0] / side)
