"""The truth plant: the seed paper's steering drive, integrated at 20 kHz by code of its own.

    J dω/dt = T_em + (i_pi/i_APA) T_sen − F/i_APA − T_f        (eq. 1, with the masses of fig. 2)

Friction is generalised Maxwell-slip (elements that stick and slip, eq. 3 as the sum of their
limits) or a plain LuGre bristle (eq. 2). The motor controller runs at 1 kHz in the loop and acts
through a current lag. Integration: semi-implicit Euler, the bristle by backward Euler.
"""

import math

import numpy as np

from eps_hil.compiled import njit
from eps_hil.proof.truth import Chain, Drive, Floats, Hidden, Slip

SUBSTEPS = 20
PROGRAM = (
    "force_n",
    "rig_n_per_m",
    "rig_n_s_per_m",
    "target_rad",
    "motor_nm_per_rad",
    "motor_nm_s_per_rad",
    "feed_nm",
    "assist",
    "hand_nm",
    "wheel_target_rad",
    "wheel_nm_per_rad",
    "wheel_nm_s_per_rad",
)
"""Columns of a manoeuvre at 1 kHz: what rig, motor controller and driver are told to do."""
TRUTH = (
    "motor_torque_nm",
    "torque_sensor_nm",
    "motor_speed_rad_s",
    "motor_angle_rad",
    "rack_force_n",
    "rack_position_m",
    "steering_wheel_angle_rad",
    "steering_wheel_speed_rad_s",
    "friction_torque_nm",
    "kinetic_j",
    "elastic_j",
    "work_in_j",
    "friction_j",
)
"""Columns of the result, at physical instants; the last four are for the energy balance."""
_LEAST_LEVEL_NM = 1.0e-3
_BUFFER = 2048


@njit
def sliding_level(
    d: Drive, h: Hidden, side: float, speed: float, load: float, place: float, aged: float, t: float
) -> float:
    """T_fs (Nm) of eq. 3 for sliding towards ``side`` (±1), with all that is hidden in it."""
    w, f = abs(speed), abs(load)
    if side > 0:
        level = d.k0_pos * h.coulomb_scale + d.kw_pos * w + d.kr_pos * f
    else:
        level = d.k0_neg * h.coulomb_scale + d.kw_neg * w + d.kr_neg * f
    level += side * h.half_difference_nm + h.load_gain * f
    level += h.stribeck_nm * math.exp(-((w / h.stribeck_speed) ** 2))
    level += h.place_nm * math.exp(-(((place - h.place_centre_m) / h.place_width_m) ** 2))
    level += h.dwell_nm * aged
    level *= 1.0 + h.warmup * math.exp(-t / h.warmup_time_s)
    return max(level, _LEAST_LEVEL_NM)


@njit
def slip_friction(
    d: Drive, s: Slip, state: Floats, speed: float, forth: float, back: float, dt: float
) -> float:
    """One step of the Maxwell-slip elements; ``state`` (m,) holds their torques, returns T_f.

    An element is a spring that slips at its share of ``forth`` (Nm) in positive and of ``back``
    in negative direction; those that stick carry the damping σ1.
    """
    torque, sticking = 0.0, 0.0
    for i in range(len(state)):
        trial = state[i] + s.stiffness[i] * d.sigma0 * speed * dt
        top, bottom = s.level_share[i] * forth, -s.level_share[i] * back
        if trial > top:
            trial = top
        elif trial < bottom:
            trial = bottom
        else:
            sticking += s.stiffness[i]
        state[i] = trial
        torque += trial
    return torque + _damping(d, speed) * speed * sticking


@njit
def bristle_friction(d: Drive, state: Floats, speed: float, level: float, dt: float) -> float:
    """One step of a LuGre bristle (eq. 2); ``state[0]`` is z in rad, returns T_f."""
    stretch = abs(speed) * d.sigma0 / level
    state[0] = (state[0] + speed * dt) / (1.0 + stretch * dt)
    return d.sigma0 * state[0] + _damping(d, speed) * (speed - stretch * state[0])


@njit
def _damping(d: Drive, speed: float) -> float:
    return d.sigma1 * math.exp(-((speed / d.sigma1_speed) ** 2))


@njit
def _beside_friction(
    d: Drive, h: Hidden, speed: float, angle: float, place: float, load: float
) -> float:
    """Torque that opposes the drive and is neither load nor dry friction."""
    torque = h.viscous * speed + h.quadratic * speed * abs(speed) + h.spring * angle
    torque += h.screw_nm * math.sin(h.screw_harmonic * angle / d.belt_ratio + h.screw_phase)
    torque += h.cogging_nm * math.sin(h.cogging_order * angle + h.cogging_phase)
    torque += h.static_nm * math.exp(-(((place - h.static_centre_m) / h.static_width_m) ** 2))
    relative = speed / h.alien_eddy_speed
    torque += h.alien_eddy_nm * 2.0 * relative / (1.0 + relative * relative)
    torque += h.alien_load_ripple * load * math.sin(h.alien_load_ripple_order * angle)
    if place > 0.0:
        torque += h.alien_one_way_drag * min(place / 0.01, 1.0) * speed
    return torque


@njit
def _on_the_shaft(d: Drive, h: Hidden, reported: float, angle: float, heat: float) -> float:
    torque = h.motor_gain * reported + h.motor_offset_nm
    torque /= 1.0 + h.saturation * torque * torque
    torque *= 1.0 + h.ripple * math.sin(6.0 * d.pole_pairs * angle + h.ripple_phase)
    return torque * (1.0 - h.alien_heat_loss * heat)


@njit
def _joint(c: Chain, i: int, twist: float, rate: float) -> float:
    """Torque that joint ``i`` hands from mass i to mass i + 1."""
    if c.gap_rad > 0.0 and i == c.rack - 1:
        half = 0.5 * c.gap_rad
        if abs(twist) <= half:
            return 0.0
        pressed = twist - math.copysign(half, twist)
        torque = c.stiffness[i] * pressed + c.damping[i] * rate
        return torque if torque * pressed > 0.0 else 0.0
    return c.stiffness[i] * twist + c.damping[i] * rate


@njit
def integrate(d: Drive, h: Hidden, c: Chain, s: Slip, program: Floats, out: Floats) -> None:
    """Run a manoeuvre: ``program`` (n, 12) as :data:`PROGRAM`, ``out`` (n, 13) as :data:`TRUTH`.

    Forces and hand torques are straight between their samples; the motor command is held.
    """
    n, dt = len(c.inertia), 1.0e-3 / SUBSTEPS
    to_rotor = d.pinion_rad_per_m / d.rack_rad_per_m
    q, v, net = np.zeros(n), np.zeros(n), np.zeros(n)
    elements = np.zeros(max(len(s.level_share), 1))
    past = np.zeros(_BUFFER)
    wheel, wheel_speed, reported, hand, aged, heat = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    memory, iron, work_in, dissipated, t = 0.0, 0.0, 0.0, 0.0, 0.0
    late = min(h.motor_late_s / dt, _BUFFER - 2.0)
    tick = 0
    for k in range(len(program) - 1):
        row, ahead = program[k], program[k + 1]
        command = row[4] * (row[3] - q[0]) - row[5] * v[0] + row[6] + row[7] * hand
        for j in range(SUBSTEPS):
            a = j / SUBSTEPS
            place, pinion = q[c.rack] / d.rack_rad_per_m, q[c.rack] * to_rotor
            pinion_speed = v[c.rack] * to_rotor
            load = row[0] + a * (ahead[0] - row[0])
            load += row[1] * q[n - 1] / d.rack_rad_per_m + row[2] * v[n - 1] / d.rack_rad_per_m
            # driver and torsion bar
            arm = row[8] + a * (ahead[8] - row[8])
            target = row[9] + a * (ahead[9] - row[9])
            if c.wheel_inertia > 0.0:
                arm += row[10] * (target - wheel) - row[11] * wheel_speed
                hand = c.bar_stiffness * (wheel - pinion)
                hand += c.bar_damping * (wheel_speed - pinion_speed)
            else:
                wheel, wheel_speed = pinion, pinion_speed
                arm += row[10] * (target - wheel) - row[11] * wheel_speed
                hand = arm
            # motor
            if c.motor_lag_s > 0.0:
                reported += (command - reported) * dt / (c.motor_lag_s + dt)
            else:
                reported = command
            past[tick % _BUFFER] = reported
            delayed = reported
            if late > 0.0:
                whole = int(late)
                newer, older = past[(tick - whole) % _BUFFER], past[(tick - whole - 1) % _BUFFER]
                delayed = newer + (late - whole) * (older - newer)
            iron = min(max(iron, delayed - h.alien_iron_play_nm), delayed + h.alien_iron_play_nm)
            shaft = _on_the_shaft(d, h, iron, q[0], heat)
            # friction
            felt = abs(load) + h.alien_load_memory * (memory - abs(load))
            forth = sliding_level(d, h, 1.0, v[0], felt, place, aged, t)
            back = sliding_level(d, h, -1.0, v[0], felt, place, aged, t)
            if len(s.level_share) > 0:
                friction = slip_friction(d, s, elements, v[0], forth, back, dt)
            else:
                level = forth if v[0] >= 0.0 else back
                friction = bristle_friction(d, elements, v[0], level, dt)
            drag = _beside_friction(d, h, v[0], q[0], place, load)
            transmitted = hand * (1.0 + h.cardan * math.cos(2.0 * pinion + h.cardan_phase))
            outer = load
            if abs(place) > h.stop_at_m:
                outer += math.copysign(h.stop_n_per_m * (abs(place) - h.stop_at_m), place)
            # sum up
            net[:] = 0.0
            net[0] += shaft - friction - drag
            net[c.rack] += to_rotor * transmitted
            net[n - 1] -= outer / d.rack_rad_per_m
            elastic = 0.0
            for i in range(n - 1):
                twist = q[i] - q[i + 1]
                torque = _joint(c, i, twist, v[i] - v[i + 1])
                net[i] -= torque
                net[i + 1] += torque
                elastic += 0.5 * c.stiffness[i] * twist * twist
                dissipated += c.damping[i] * (v[i] - v[i + 1]) ** 2 * dt
            if j == 0:
                o = out[k]
                o[0], o[1], o[2], o[3] = reported, hand, v[0], q[0]
                o[4], o[5], o[6], o[7], o[8] = load, place, wheel, wheel_speed, friction
                o[9], o[10], o[11], o[12] = 0.0, elastic, work_in, dissipated
                for i in range(n):
                    o[9] += 0.5 * c.inertia[i] * v[i] * v[i]
                if c.wheel_inertia > 0.0:
                    o[9] += 0.5 * c.wheel_inertia * wheel_speed * wheel_speed
                    o[10] += 0.5 * c.bar_stiffness * (wheel - pinion) ** 2
            # move
            if c.wheel_inertia > 0.0:
                work_in += arm * wheel_speed * dt
                dissipated += c.bar_damping * (wheel_speed - pinion_speed) ** 2 * dt
                wheel_speed += dt * (arm - hand) / c.wheel_inertia
                wheel += dt * wheel_speed
            else:
                work_in += transmitted * pinion_speed * dt
            work_in += (shaft * v[0] - outer / d.rack_rad_per_m * v[n - 1]) * dt
            dissipated += (friction + drag) * v[0] * dt
            for i in range(n):
                v[i] += dt * net[i] / c.inertia[i]
                q[i] += dt * v[i]
            if abs(v[0]) < 0.05:
                aged += (1.0 - aged) * dt / h.dwell_time_s
            aged /= 1.0 + abs(v[0]) * dt / h.dwell_release_rad
            heat += (shaft * shaft - heat) * dt / h.alien_heat_s
            memory += (abs(load) - memory) * dt / h.alien_load_memory_s
            t += dt
            tick += 1
    out[-1] = out[-2]


def run(d: Drive, h: Hidden, c: Chain, s: Slip, program: Floats) -> dict[str, Floats]:
    """The truth of a manoeuvre, columns of :data:`TRUTH`, each (n,), at 1 kHz."""
    out = np.zeros((len(program), len(TRUTH)))
    integrate(d, h, c, s, np.ascontiguousarray(program, dtype=np.float64), out)
    return {name: out[:, i].copy() for i, name in enumerate(TRUTH)}
