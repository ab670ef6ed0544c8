"""One step of a steering chain, in compiled code (seed paper, eq. 1 to 3 and fig. 2).

Integration is the implicit midpoint rule: second order, stable for every stiffness, and it keeps
½ vᵀMv + ½ qᵀKq exactly, so the energy balance closes to the work that friction, the joints'
dampers and the outside really take. The bristle of eq. 2a moves by its exact solution. Effects of
the model file act inside the same midpoint equation (``chain_effects.py``).
"""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
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
)
from eps_hil.physics.chain_effects import (
    act,
    drive_level_nm,
    linear_load_nm,
    load_force_n,
    rack_m_per_rad,
    remember,
)
from eps_hil.physics.chain_reading import hand_nm
from eps_hil.physics.friction import (
    FrictionLaw,
    bristle_step,
    friction_torque_nm,
    static_level_nm,
)

Floats = npt.NDArray[np.float64]

_PASSES, _MOST_PASSES = 3, 16
_SETTLED_RAD_S = 1e-10


@kernel
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


@kernel
def _motor_step(chain: Chain, state: ChainState, command_nm: float) -> float:
    """Dead time T_t, then lag τ_em; the mean torque of the step, as late as at the shaft."""
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
    if chain.late_steps > 0:
        before, at = state.motor[4], int(state.motor[3])
        state.shaft[at] = after
        at = (at + 1) % state.shaft.size
        after = state.shaft[at]
        state.motor[3] = at
    state.motor[4] = after
    return float(0.5 * (before + after))


@kernel
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


@kernel
def _friction(
    law: FrictionLaw, dt: float, bristle: float, speed: float, level: float
) -> tuple[float, float, float]:
    """Mean friction torque of a step, its slope over speed, and the bristle after it."""
    after = bristle_step(bristle, speed * dt, abs(speed) * dt, level, law.sigma0_nm_per_rad)
    torque = friction_torque_nm(0.5 * (bristle + after), speed, level, law)
    ratio = speed / law.sigma1_speed_rad_s
    slope = law.sigma1_nm_s_per_rad * math.exp(-ratio * ratio) + 0.5 * dt * law.sigma0_nm_per_rad
    return torque, slope, after


@kernel
def _rigid_bar_nm(chain: Chain, state: ChainState, row: Floats, rate: Floats) -> float:
    """Torque through a rigid torsion bar in the middle of the step (Nm, at the column)."""
    wheel, half = chain.group[STEERING_WHEEL], 0.5 * chain.step_s
    side = chain.rack_to_rotor / chain.pinion_ratio
    speed, angle = state.middle[wheel] / side, state.half_way[wheel] / side
    level = static_level_nm(speed, 0.0, chain.column)
    rubbed, _s, _z = _friction(
        chain.column, chain.step_s, state.column_bristle_rad[0], speed, level
    )
    acceleration = (state.middle[wheel] - state.speed_rad_s[wheel]) / half / side
    hand = hand_nm(chain, angle, speed, row, rate)
    return float(hand - rubbed - chain.steering_wheel_inertia * acceleration)


@kernel
def _act_in_the_middle(
    chain: Chain, state: ChainState, motor_nm: float, row: Floats, rate: Floats
) -> float:
    """Torques of effects in the middle of the step into ``state.more``; the shaft's torque."""
    for i in range(chain.inertia.size):
        state.half_way[i] = state.angle_rad[i] + 0.5 * chain.step_s * state.middle[i]
    bar, t = 0.0, state.time_s[0] + 0.5 * chain.step_s
    if chain.group[STEERING_WHEEL] == chain.group[RACK]:
        bar = _rigid_bar_nm(chain, state, row, rate)
    return act(chain, t, state.half_way, state.middle, motor_nm, bar, row, rate, state.more)


@kernel
def _drive_friction(
    chain: Chain, state: ChainState, i: int, load_n: float
) -> tuple[float, float, float]:
    """Of coordinate ``i`` in the middle of the step, before its share: as :func:`_friction`."""
    half, middle = 0.5 * chain.step_s, state.middle
    rack = chain.group[RACK]
    level = drive_level_nm(
        chain,
        state.time_s[0] + half,
        middle[i],
        state.angle_rad[i] + half * middle[i],
        state.angle_rad[rack] + half * middle[rack],
        load_n,
    )
    return _friction(chain.drive, chain.step_s, state.bristle_rad[i], middle[i], level)


@kernel
def _middle_speed(
    chain: Chain, state: ChainState, motor_nm: float, row: Floats, rate: Floats
) -> None:
    """Solve the midpoint equation for the speeds; friction by three Newton-like passes.

    What effects add is taken from the pass before, until it changes nothing more.
    """
    n, dt = chain.inertia.size, chain.step_s
    half = 0.5 * dt
    matrix, vector, middle, ext = state.matrix, state.vector, state.middle, state.external
    angle, speed = state.angle_rad, state.speed_rad_s
    end, wheel = chain.group[ROAD_WHEELS], chain.group[STEERING_WHEEL]
    side = chain.rack_to_rotor / chain.pinion_ratio
    for i in range(n):
        middle[i] = speed[i]
        state.more[i] = 0.0
    for _ in range(_MOST_PASSES if chain.acting else _PASSES):
        load_n = load_force_n(chain, angle[end] + half * middle[end], middle[end], row, rate)
        if chain.acting:
            _act_in_the_middle(chain, state, motor_nm, row, rate)
        for i in range(n):
            vector[i] = chain.inertia[i] * speed[i] / half + ext[0, i] - ext[3, i] + state.more[i]
            for j in range(n):
                matrix[i, j] = chain.damping[i, j] + half * chain.stiffness[i, j]
                vector[i] -= chain.stiffness[i, j] * angle[j]
            matrix[i, i] += chain.inertia[i] / half + ext[2, i] + half * ext[1, i]
            share = chain.friction_share[i]
            if share > 0.0:
                torque, slope, _z = _drive_friction(chain, state, i, load_n)
                matrix[i, i] += share * slope
                vector[i] += share * (slope * middle[i] - torque)
        level = static_level_nm(middle[wheel] / side, 0.0, chain.column)
        torque, slope, _z = _friction(
            chain.column, dt, state.column_bristle_rad[0], middle[wheel] / side, level
        )
        matrix[wheel, wheel] += slope / (side * side)
        vector[wheel] += slope / (side * side) * middle[wheel] - torque / side
        _solve(matrix, vector)
        moved = 0.0
        for i in range(n):
            moved = max(moved, abs(vector[i] - middle[i]))
            middle[i] = vector[i]
        if chain.acting and moved < _SETTLED_RAD_S:
            break


@kernel
def _commit(chain: Chain, state: ChainState, motor_nm: float, row: Floats, rate: Floats) -> None:
    """Move the state to the end of the step and book the work that was done."""
    n, dt = chain.inertia.size, chain.step_s
    middle, energy = state.middle, state.energy_j
    rotor, end = chain.group[ROTOR], chain.group[ROAD_WHEELS]
    wheel, rack = chain.group[STEERING_WHEEL], chain.group[RACK]
    side, i_apa = chain.rack_to_rotor / chain.pinion_ratio, chain.rack_to_rotor
    end_angle = state.angle_rad[end] + 0.5 * dt * middle[end]
    load_n = load_force_n(chain, end_angle, middle[end], row, rate)
    hand_speed = middle[wheel] / side
    hand_angle = (state.angle_rad[wheel] + 0.5 * dt * middle[wheel]) / side
    energy[WORK_MOTOR] += motor_nm * middle[rotor] * dt
    energy[WORK_LOAD] -= load_n * middle[end] / i_apa * dt
    energy[WORK_HAND] += hand_nm(chain, hand_angle, hand_speed, row, rate) * hand_speed * dt
    if chain.acting:
        _book_effects(chain, state, motor_nm, load_n, row, rate)
    if abs(state.angle_rad[rack]) > chain.stop_position * i_apa:
        push = math.copysign(chain.stop_position * i_apa, state.angle_rad[rack])
        deep = state.angle_rad[rack] + 0.5 * dt * middle[rack] - push
        stop = chain.stop_stiffness * deep + chain.stop_damping * middle[rack]
        energy[LOST_END_STOP] += stop / (i_apa * i_apa) * middle[rack] * dt
    level = static_level_nm(hand_speed, 0.0, chain.column)
    torque, _s, after = _friction(chain.column, dt, state.column_bristle_rad[0], hand_speed, level)
    energy[LOST_FRICTION] += torque * hand_speed * dt
    state.column_bristle_rad[0] = after
    for i in range(n):
        for j in range(n):
            energy[LOST_JOINTS] += middle[i] * chain.damping[i, j] * middle[j] * dt
        share = chain.friction_share[i]
        torque, _s, after = _drive_friction(chain, state, i, load_n)
        energy[LOST_FRICTION] += share * torque * middle[i] * dt
        state.bristle_rad[i] = after
    if chain.acting:
        bar, t = 0.0, state.time_s[0] + 0.5 * dt
        if wheel == rack:
            bar = _rigid_bar_nm(chain, state, row, rate)
        remember(chain, t, state.half_way, middle, motor_nm, bar, load_n)
    for i in range(n):
        state.angle_rad[i] += dt * middle[i]
        state.speed_rad_s[i] = 2.0 * middle[i] - state.speed_rad_s[i]
    state.time_s[0] += dt


@kernel
def _book_effects(
    chain: Chain, state: ChainState, motor_nm: float, load_n: float, row: Floats, rate: Floats
) -> None:
    """The shaft's work is the motor's, F ẋ the load's; all else that effects did is theirs."""
    dt, middle, energy = chain.step_s, state.middle, state.energy_j
    end = chain.group[ROAD_WHEELS]
    shaft_nm = _act_in_the_middle(chain, state, motor_nm, row, rate)
    more_motor = (shaft_nm - motor_nm) * middle[chain.group[ROTOR]] * dt
    angle = state.half_way[end]
    rack_speed = middle[end] * rack_m_per_rad(chain, angle)
    linear = linear_load_nm(chain, angle, middle[end], row, rate)
    energy[WORK_MOTOR] += more_motor
    energy[WORK_LOAD] += load_n * (middle[end] / chain.rack_to_rotor - rack_speed) * dt
    taken = more_motor + (linear * middle[end] - load_n * rack_speed) * dt
    for i in range(chain.inertia.size):
        taken -= state.more[i] * middle[i] * dt
    state.effects_j[0] += taken


@kernel
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
        _middle_speed(chain, state, motor_nm, row, rate)
        _commit(chain, state, motor_nm, row, rate)
