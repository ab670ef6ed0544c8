"""The truth plant: the seed paper's steering drive, integrated at 20 kHz by code of its own.

    J dω/dt = T_em + (i_pi/i_APA) T_sen − F/i_APA − T_f        (eq. 1, with the masses of fig. 2)

Friction is generalised Maxwell-slip (elements that stick and slip, eq. 3 as the sum of their
limits) or a plain LuGre bristle (eq. 2). The motor controller runs at 1 kHz in the loop and acts
through a current lag. Integration: semi-implicit Euler, the bristle by backward Euler.

``_integrate`` is one function on purpose: with its state in scalars it runs twice as fast or more
as it does cut into steps that share a state, and a proof runs it thousands of times.
"""

import math

import numpy as np

from eps_hil.compiled import njit
from eps_hil.proof.laws import (
    beside_friction,
    bristle_friction,
    delayed,
    joint,
    on_the_shaft,
    pressed,
    sliding_level,
    slip_friction,
)
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
    "motor_off",
    "weight_n",
    "weight_rad_per_m",
    "weight_rad",
    "scrub_n",
    "scrub_m",
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
_DT_S = 1.0e-3 / SUBSTEPS
_BUFFER = 2048
_REST_RAD_S = 0.05
"""Slower than this a contact counts as at rest."""


@njit
def _joints(c: Chain, q: Floats, v: Floats, net: Floats) -> tuple[float, float]:
    """Adds the joints' torques to ``net``; elastic energy (J) and dissipated power (W)."""
    elastic, power = 0.0, 0.0
    for i in range(len(c.stiffness)):
        twist, rate = q[i] - q[i + 1], v[i] - v[i + 1]
        torque = joint(c, i, twist, rate)
        net[i] -= torque
        net[i + 1] += torque
        spring = joint(c, i, twist, 0.0)
        elastic += 0.5 * spring * spring / c.stiffness[i]
        power += (torque - spring) * rate
    return elastic, power


@njit
def _kinetic(c: Chain, v: Floats, wheel_speed: float) -> float:
    energy = 0.5 * c.wheel_inertia * wheel_speed * wheel_speed
    for i in range(len(v)):
        energy += 0.5 * c.inertia[i] * v[i] * v[i]
    return energy


@njit
def _integrate(  # noqa: PLR0912, PLR0915
    d: Drive, h: Hidden, c: Chain, s: Slip, program: Floats, out: Floats
) -> None:
    n, rack, per_m = len(c.inertia), c.rack, d.rack_rad_per_m
    to_rotor = d.pinion_rad_per_m / per_m
    q, v, net = np.zeros(n), np.zeros(n), np.zeros(n)
    elements, past = np.zeros(max(len(s.level_share), 1)), np.zeros(_BUFFER)
    wheel, wheel_speed, reported, hand, iron = 0.0, 0.0, 0.0, 0.0, 0.0
    aged, heat, memory, work, lost, t, tick = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0
    recent, bush, warm, wet, turned, way, scrub = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(program) - 1):
        row, ahead = program[k], program[k + 1]
        command = row[4] * (row[3] - q[0]) - row[5] * v[0] + row[6] + row[7] * hand
        for j in range(SUBSTEPS):
            a = j / SUBSTEPS
            place, pinion, pinion_speed = q[rack] / per_m, q[rack] * to_rotor, v[rack] * to_rotor
            load = row[0] + a * (ahead[0] - row[0]) + (row[1] * q[-1] + row[2] * v[-1]) / per_m
            if row[13] != 0.0:  # a weight that the rack turns about an axis
                load += row[13] * math.sin(row[14] * q[-1] / per_m + row[15])
            if row[17] > 0.0:  # a tyre or a bushing that gives way before it slides (Dahl)
                load += row[16] * scrub
                scrub += (v[-1] - abs(v[-1]) * scrub) / per_m * _DT_S / row[17]
            if c.wheel_inertia <= 0.0:
                wheel, wheel_speed = pinion, pinion_speed
            arm = row[8] + a * (ahead[8] - row[8]) - row[11] * wheel_speed
            arm += row[10] * (row[9] + a * (ahead[9] - row[9]) - wheel)
            twist, twist_rate = wheel - pinion, wheel_speed - pinion_speed
            hand = arm
            if c.wheel_inertia > 0.0:
                hand = c.bar_stiffness * twist + c.bar_damping * twist_rate
            handed = hand
            if h.cardan != 0.0:
                handed *= 1.0 + h.cardan * math.cos(2.0 * pinion + h.cardan_phase)
            # motor: current loop, dead time, iron, and what becomes of the torque on the shaft
            reported += (command - reported) * _DT_S / (c.motor_lag_s + _DT_S)
            past[tick % _BUFFER] = reported
            torque = delayed(past, tick, h.motor_late_s / _DT_S)
            iron = min(max(iron, torque - h.alien_iron_play_nm), torque + h.alien_iron_play_nm)
            shaft = on_the_shaft(d, h, iron, q[0], v[0], heat, t)
            if row[12] > 0.0:  # no current: the shaft is free, and what is off is all that is read
                shaft, reported = 0.0, -h.motor_offset_nm / h.motor_gain
            # friction and drag
            rubbing = v[c.rubs]
            felt = abs(load) + h.alien_load_memory * (memory - abs(load))
            more = pressed(h, v[0], shaft, hand, load, recent, turned)
            thin = 1.0 - h.alien_thinning * warm
            forth = thin * sliding_level(d, h, 1.0, rubbing, felt, place, aged, t, more)
            back = thin * sliding_level(d, h, -1.0, rubbing, felt, place, aged, t, more)
            if len(s.level_share) > 0:
                friction = slip_friction(d, s, elements, rubbing, forth, back, _DT_S)
            else:
                level = forth if rubbing >= 0.0 else back
                friction = bristle_friction(d, elements, rubbing, level, _DT_S)
            drag = beside_friction(d, h, v[0], q[0], place, load, bush, wet)
            outer = load
            if abs(place) > h.stop_at_m:
                outer += math.copysign(h.stop_n_per_m * (abs(place) - h.stop_at_m), place)
            net[:] = 0.0
            net[0] += shaft
            net[c.rubs] -= friction
            net[0] -= drag
            net[rack] += to_rotor * handed
            net[-1] -= outer / per_m
            elastic, damped = _joints(c, q, v, net)
            if j == 0:
                o = out[k]
                o[0], o[1], o[2], o[3], o[4], o[5] = reported, hand, v[0], q[0], load, place
                o[6], o[7], o[8] = wheel, wheel_speed, friction
                o[9] = _kinetic(c, v, wheel_speed)
                o[10], o[11], o[12] = elastic + 0.5 * c.bar_stiffness * twist**2, work, lost
            # energies, then the step itself
            work += (shaft * v[0] - outer / per_m * v[-1] + (handed - hand) * pinion_speed) * _DT_S
            work += arm * wheel_speed * _DT_S
            lost += (friction * rubbing + drag * v[0] + damped) * _DT_S
            lost += c.bar_damping * twist_rate**2 * _DT_S
            if c.wheel_inertia > 0.0:
                wheel_speed += _DT_S * (arm - hand) / c.wheel_inertia
                wheel += _DT_S * wheel_speed
            for i in range(n):
                v[i] += _DT_S * net[i] / c.inertia[i]
                q[i] += _DT_S * v[i]
            # what friction and motor remember
            if abs(rubbing) < _REST_RAD_S:
                aged += (1.0 - aged) * _DT_S / h.dwell_time_s
            aged /= 1.0 + abs(rubbing) * _DT_S / h.dwell_release_rad
            heat += (shaft * shaft - heat) * _DT_S / h.alien_heat_s
            memory += (abs(load) - memory) * _DT_S / h.alien_load_memory_s
            recent += (abs(v[0]) - recent) * _DT_S / h.alien_speed_memory_s
            wet += (v[0] - wet) * _DT_S / h.late_wet_drag_s
            turned += _DT_S
            if v[0] * way < 0.0:
                turned = 0.0
            way = v[0] if v[0] != 0.0 else way
            bush += (v[0] - abs(v[0]) * bush * abs(bush)) * _DT_S / h.alien_bushing_rad
            rubbed = abs(friction * rubbing)
            warm += (rubbed / (rubbed + 2.0) - warm) * _DT_S / h.alien_thinning_s
            t += _DT_S
            tick += 1
    out[-1] = out[-2]


def run(d: Drive, h: Hidden, c: Chain, s: Slip, program: Floats) -> dict[str, Floats]:
    """The truth of a manoeuvre: columns of :data:`TRUTH`, each (n,), at 1 kHz.

    ``program`` (n, 18) as :data:`PROGRAM`: forces and hand torques are straight between their
    samples, the motor command is held. Everything starts at rest in the middle.
    """
    out = np.zeros((len(program), len(TRUTH)))
    _integrate(d, h, c, s, np.ascontiguousarray(program, dtype=np.float64), out)
    return {name: out[:, i].copy() for i, name in enumerate(TRUTH)}
