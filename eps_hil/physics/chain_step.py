"""One step of a steering chain, in compiled code (seed paper, eq. 1 to 3 and fig. 2).

Integration is the implicit midpoint rule: second order, stable for every stiffness, and it keeps
½ vᵀMv + ½ qᵀKq exactly, so the energy balance closes to the work that friction, the joints'
dampers and the outside really take. The bristle of eq. 2a moves by its exact solution.
"""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.physics.chain import (
    HAND_ANGLE,
    HAND_DAMPING,
    HAND_STIFFNESS,
    HAND_TORQUE,
    INPUTS,
    LOAD_DAMPING,
    LOAD_FORCE,
    LOAD_POSITION,
    LOAD_STIFFNESS,
    LOST_END_STOP,
    LOST_FRICTION,
    LOST_JOINTS,
    RACK,
    ROAD_WHEELS,
    ROTOR,
    STEERING_WHEEL,
    WORK_HAND,
    WORK_LOAD,
    WORK_MOTOR,
    Chain,
    ChainState,
    Reading,
)
from eps_hil.physics.friction import (
    FrictionLaw,
    bristle_step,
    friction_torque_nm,
    static_level_nm,
)

Floats = npt.NDArray[np.float64]


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
def _friction(
    law: FrictionLaw, dt: float, bristle: float, speed: float, load_n: float
) -> tuple[float, float, float]:
    """Mean friction torque of a step, its slope over speed, and the bristle after it."""
    level = static_level_nm(speed, load_n, law)
    after = bristle_step(bristle, speed * dt, abs(speed) * dt, level, law.sigma0_nm_per_rad)
    torque = friction_torque_nm(0.5 * (bristle + after), speed, level, law)
    ratio = speed / law.sigma1_speed_rad_s
    slope = law.sigma1_nm_s_per_rad * math.exp(-ratio * ratio) + 0.5 * dt * law.sigma0_nm_per_rad
    return torque, slope, after


@njit
def _middle_speed(chain: Chain, state: ChainState, row: Floats, rate: Floats) -> None:
    """Solve the midpoint equation for the speeds; friction by three Newton-like passes."""
    n, dt = chain.inertia.size, chain.step_s
    half = 0.5 * dt
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
                torque, slope, _z = _friction(
                    chain.drive, dt, state.bristle_rad[i], middle[i], load_n
                )
                matrix[i, i] += share * slope
                vector[i] += share * (slope * middle[i] - torque)
        torque, slope, _z = _friction(
            chain.column, dt, state.column_bristle_rad[0], middle[wheel] / side, 0.0
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
    torque, _s, after = _friction(chain.column, dt, state.column_bristle_rad[0], hand_speed, 0.0)
    energy[LOST_FRICTION] += torque * hand_speed * dt
    state.column_bristle_rad[0] = after
    for i in range(n):
        for j in range(n):
            energy[LOST_JOINTS] += middle[i] * chain.damping[i, j] * middle[j] * dt
        share = chain.friction_share[i]
        torque, _s, after = _friction(chain.drive, dt, state.bristle_rad[i], middle[i], load_n)
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
