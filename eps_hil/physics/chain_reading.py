"""What is physically true in a steering chain at an instant, and what motor and bar tell of it."""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.physics.chain import (
    HAND_ANGLE,
    HAND_DAMPING,
    HAND_STIFFNESS,
    HAND_TORQUE,
    NUT,
    RACK,
    ROAD_WHEELS,
    ROTOR,
    STEERING_WHEEL,
    Chain,
    ChainState,
    Reading,
)
from eps_hil.physics.chain_effects import (
    act,
    drive_level_nm,
    linear_load_nm,
    load_force_n,
    rack_m,
    seen,
    torsion_nm,
)
from eps_hil.physics.effects import added
from eps_hil.physics.friction import friction_torque_nm, static_level_nm

Floats = npt.NDArray[np.float64]

_PASSES = 12


@kernel
def hand_nm(chain: Chain, angle: float, speed: float, row: Floats, rate: Floats) -> float:
    """Torque of hands or robot on the steering wheel, Nm, at its own angle and speed."""
    return float(
        row[HAND_TORQUE]
        - row[HAND_STIFFNESS] * (angle - row[HAND_ANGLE])
        - row[HAND_DAMPING] * (speed - rate[HAND_ANGLE])
    )


@kernel
def read_out(chain: Chain, state: ChainState, row: Floats, rate: Floats) -> Reading:
    """What is physically true at this instant, under the input row of the instant."""
    angle, speed = state.angle_rad, state.speed_rad_s
    rotor, end = chain.group[ROTOR], chain.group[ROAD_WHEELS]
    rack, wheel = chain.group[RACK], chain.group[STEERING_WHEEL]
    side = chain.rack_to_rotor / chain.pinion_ratio
    load_n = load_force_n(chain, angle[end], speed[end], row, rate)
    friction = 0.0
    for i in range(chain.inertia.size):
        if chain.friction_share[i] > 0.0:
            friction += _rubbing_nm(chain, state, i, load_n)
    if wheel != rack:
        sensor = torsion_nm(chain, angle, speed, False)
    else:
        sensor = _rigid_sensor_nm(chain, state, row, rate, load_n)
    shaft = state.motor[4]
    if chain.acting:
        friction += _torques_nm(chain, state, load_n, sensor)
        t, more = state.time_s[0], state.more
        shaft = act(chain, t, angle, speed, state.motor[4], sensor, row, rate, more)
    return Reading(
        shaft,
        sensor,
        speed[rotor],
        angle[rotor],
        load_n,
        rack_m(chain, angle[rack]),
        angle[wheel] / side,
        speed[wheel] / side,
        friction,
        state.motor[0],
        sensor,
    )


@kernel
def _rubbing_nm(chain: Chain, state: ChainState, i: int, load_n: float) -> float:
    """Friction at coordinate ``i``: its share of eq. 2d."""
    angle, speed, t = state.angle_rad, state.speed_rad_s, state.time_s[0]
    level = drive_level_nm(chain, t, speed[i], angle[i], angle[chain.group[RACK]], load_n)
    torque = friction_torque_nm(state.bristle_rad[i], speed[i], level, chain.drive)
    return float(chain.friction_share[i] * torque)


@kernel
def _torques_nm(chain: Chain, state: ChainState, load_n: float, bar_nm: float) -> float:
    """What effects add beside friction and load, on all masses."""
    angle, speed, t = state.angle_rad, state.speed_rad_s, state.time_s[0]
    rotor, nut, rack = chain.group[ROTOR], chain.group[NUT], chain.group[RACK]
    told, total, x = state.motor[4], 0.0, angle[rack]
    if chain.at_rotor.use.torque:
        u = seen(chain, t, speed[rotor], angle[rotor], x, load_n, told, bar_nm)
        total += added.torque_nm(chain.at_rotor.effects, u, 0.0)
    if chain.at_nut.use.torque:
        u = seen(chain, t, speed[nut], angle[nut], x, load_n, told, bar_nm)
        total += added.torque_nm(chain.at_nut.effects, u, 0.0)
    if chain.at_rack.use.torque:
        u = seen(chain, t, speed[rack], angle[rack], x, load_n, told, bar_nm)
        total += added.torque_nm(chain.at_rack.effects, u, 0.0)
    return total


@kernel
def _rigid_sensor_nm(
    chain: Chain, state: ChainState, row: Floats, rate: Floats, load_n: float
) -> float:
    """Torque through a rigid torsion bar: what the hand gives, less column friction and J_sw φ̈."""
    i_apa, wheel = chain.rack_to_rotor, chain.group[STEERING_WHEEL]
    side = i_apa / chain.pinion_ratio
    speeds, angles = state.speed_rad_s, state.angle_rad
    angle, speed = angles[wheel] / side, speeds[wheel] / side
    level = static_level_nm(speed, 0.0, chain.column)
    rubbed = friction_torque_nm(state.column_bristle_rad[0], speed, level, chain.column)
    hand = hand_nm(chain, angle, speed, row, rate) - rubbed
    torque = state.motor[4] if chain.group[ROTOR] == wheel else 0.0
    torque += hand / side - linear_load_nm(chain, angles[wheel], speeds[wheel], row, rate)
    torque -= _rubbing_nm(chain, state, wheel, load_n)
    for j in range(chain.inertia.size):
        torque -= chain.stiffness[wheel, j] * angles[j] + chain.damping[wheel, j] * speeds[j]
    if abs(angles[wheel]) > chain.stop_position * i_apa:
        push = math.copysign(chain.stop_position, angles[wheel])
        deep = angles[wheel] / i_apa - push
        stop = chain.stop_stiffness * deep + chain.stop_damping * speeds[wheel] / i_apa
        torque -= stop / i_apa
    inertia = chain.inertia[wheel]
    bar = hand - chain.steering_wheel_inertia * torque / inertia / side
    if not chain.acting:
        return float(bar)
    for _ in range(_PASSES):  # an effect between bar and pinion asks for the bar's torque
        t, more = state.time_s[0], state.more
        act(chain, t, angles, speeds, state.motor[4], bar, row, rate, more)
        whole = torque + more[wheel]
        bar = hand - chain.steering_wheel_inertia * whole / inertia / side
    return float(bar)
