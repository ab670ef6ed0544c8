"""What a model file's effects do to a steering chain, by the kernels of ``simulate``.

A motor effect stands between the torque that the motor reports and the shaft; a torque acts on its
mass; friction levels on the bristles; cardan joint and varying ratio between torsion bar and
pinion, and between rack and load. Where the ratio varies over x, a coordinate q is i_APA times what
x would be at the ratio of mid travel; inertias stay as they are there.
"""

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.physics.chain import (
    LOAD_DAMPING,
    LOAD_FORCE,
    LOAD_POSITION,
    LOAD_STIFFNESS,
    NUT,
    RACK,
    ROAD_WHEELS,
    ROTOR,
    STEERING_WHEEL,
    Chain,
)
from eps_hil.physics.effects import added
from eps_hil.physics.effects.effect import Instant
from eps_hil.physics.friction import static_level_nm
from eps_hil.physics.simulate import instant, level_nm, load_nm, motor_nm, sensor_nm
from eps_hil.physics.two_masses import joint_torque_nm

Floats = npt.NDArray[np.float64]

_NEAR_RAD = 1e-3
_NOTHING = np.zeros(3)


@kernel
def rack_m(chain: Chain, angle: float) -> float:
    """Position (m) at a coordinate of rack or road wheels."""
    if not chain.at_rotor.use.position:
        return angle / chain.rack_to_rotor
    return instant(chain.at_rotor, 0.0, 0.0, angle, _NOTHING).position_m


@kernel
def rack_m_per_rad(chain: Chain, angle: float) -> float:
    """dx/dq there."""
    if not chain.at_rotor.use.position:
        return 1.0 / chain.rack_to_rotor
    ahead, behind = rack_m(chain, angle + _NEAR_RAD), rack_m(chain, angle - _NEAR_RAD)
    return 0.5 * (ahead - behind) / _NEAR_RAD


@kernel
def load_force_n(chain: Chain, angle: float, speed: float, row: Floats, rate: Floats) -> float:
    """Force of the rig on the tie rods, N: profile and spring-damper of its linear motor."""
    if chain.at_rotor.use.position:
        x, speed_m_s = rack_m(chain, angle), speed * rack_m_per_rad(chain, angle)
    else:
        x, speed_m_s = angle / chain.rack_to_rotor, speed / chain.rack_to_rotor
    spring = row[LOAD_STIFFNESS] * (x - row[LOAD_POSITION])
    damper = row[LOAD_DAMPING] * (speed_m_s - rate[LOAD_POSITION])
    return float(row[LOAD_FORCE] + spring + damper)


@kernel
def linear_load_nm(chain: Chain, angle: float, speed: float, row: Floats, rate: Floats) -> float:
    """The same at the rotor, Nm, without effects: what the step has in its matrix."""
    i_apa = chain.rack_to_rotor
    spring = row[LOAD_STIFFNESS] * (angle / i_apa - row[LOAD_POSITION])
    damper = row[LOAD_DAMPING] * (speed / i_apa - rate[LOAD_POSITION])
    return float(row[LOAD_FORCE] + spring + damper) / i_apa


@kernel
def drive_level_nm(
    chain: Chain, t: float, speed: float, angle: float, rack: float, load_n: float
) -> float:
    """T_fs (Nm) at a mass that turns with ``speed``; ``rack``: the rack's coordinate."""
    if not chain.at_rotor.use.level:
        return static_level_nm(speed, load_n, chain.drive)
    u = seen(chain, t, speed, angle, rack, load_n, 0.0, 0.0)
    return level_nm(chain.at_rotor, u)


@kernel
def seen(
    chain: Chain,
    t: float,
    speed: float,
    angle: float,
    rack: float,
    load_n: float,
    motor_nm: float,
    bar_nm: float,
) -> Instant:
    """An instant as the kernels of one mass are told it; ``rack``: the rack's coordinate."""
    pinion = rack * chain.at_rotor.sensor_to_rotor
    x = rack_m(chain, rack)
    return Instant(t, speed, angle, x, load_n, pinion, motor_nm, bar_nm, chain.rack_to_rotor)


@kernel
def torsion_nm(chain: Chain, angle: Floats, speed: Floats, linear: bool) -> float:
    """Torque of the torsion bar, at the column; ``linear``: as the step has it in its matrix."""
    wheel, rack = chain.group[STEERING_WHEEL], chain.group[RACK]
    side = chain.rack_to_rotor / chain.pinion_ratio
    twist, rate = angle[wheel] - angle[rack], speed[wheel] - speed[rack]
    if chain.at_rotor.use.position and not linear:
        i_apa = chain.rack_to_rotor
        twist = angle[wheel] - i_apa * rack_m(chain, angle[rack])
        rate = speed[wheel] - i_apa * rack_m_per_rad(chain, angle[rack]) * speed[rack]
    return (chain.torsion_stiffness * twist + chain.torsion_damping * rate) / side


@kernel
def act(
    chain: Chain,
    t: float,
    angle: Floats,
    speed: Floats,
    told_nm: float,
    bar_nm: float,
    row: Floats,
    rate: Floats,
    more: Floats,
) -> float:
    """Torques of all effects at an instant into ``more`` (n,); returns the shaft torque, Nm.

    Beside what the step has without them; ``told_nm``: motor torque as the motor knows it, at its
    instant; ``bar_nm``: of a rigid torsion bar (else it is worked out here).
    """
    rotor, nut, rack = chain.group[ROTOR], chain.group[NUT], chain.group[RACK]
    end, wheel = chain.group[ROAD_WHEELS], chain.group[STEERING_WHEEL]
    side = chain.rack_to_rotor / chain.pinion_ratio
    load_n = load_force_n(chain, angle[end], speed[end], row, rate)
    bar, linear = bar_nm, bar_nm
    if wheel != rack:
        bar, linear = torsion_nm(chain, angle, speed, False), torsion_nm(chain, angle, speed, True)
    more[:] = 0.0
    at_rotor = seen(chain, t, speed[rotor], angle[rotor], angle[rack], load_n, told_nm, bar)
    at_nut = seen(chain, t, speed[nut], angle[nut], angle[rack], load_n, told_nm, bar)
    at_rack = seen(chain, t, speed[rack], angle[rack], angle[rack], load_n, told_nm, bar)
    at_end = seen(chain, t, speed[end], angle[end], angle[end], load_n, told_nm, bar)
    shaft_nm = motor_nm(chain.at_rotor, at_rotor)
    more[rotor] += shaft_nm - told_nm
    if chain.at_rotor.use.torque:
        more[rotor] -= added.torque_nm(chain.at_rotor.effects, at_rotor, 0.0)
    if chain.at_nut.use.torque:
        more[nut] -= added.torque_nm(chain.at_nut.effects, at_nut, 0.0)
    if chain.at_rack.use.torque:
        more[rack] -= added.torque_nm(chain.at_rack.effects, at_rack, 0.0)
    more[rack] += (sensor_nm(chain.at_rotor, at_rack) - linear) / side
    more[wheel] -= (bar - linear) / side
    more[end] -= load_nm(chain.at_rotor, at_end) - linear_load_nm(
        chain, angle[end], speed[end], row, rate
    )
    if chain.joint.gap_rad > 0.0:
        torque = joint_torque_nm(chain.joint, angle[rotor] - angle[nut], speed[rotor] - speed[nut])
        more[rotor] -= torque
        more[nut] += torque
    return shaft_nm


@kernel
def remember(
    chain: Chain,
    t: float,
    angle: Floats,
    speed: Floats,
    told_nm: float,
    bar_nm: float,
    load_n: float,
) -> None:
    """Move on what effects remember, by one step about this instant."""
    rotor, nut, rack = chain.group[ROTOR], chain.group[NUT], chain.group[RACK]
    bar, dt = bar_nm, chain.step_s
    if chain.group[STEERING_WHEEL] != rack:
        bar = torsion_nm(chain, angle, speed, False)
    if chain.at_rotor.use.memory:
        u = seen(chain, t, speed[rotor], angle[rotor], angle[rack], load_n, told_nm, bar)
        added.advance(chain.at_rotor.effects, u, dt)
    if chain.at_nut.use.memory:
        u = seen(chain, t, speed[nut], angle[nut], angle[rack], load_n, told_nm, bar)
        added.advance(chain.at_nut.effects, u, dt)
    if chain.at_rack.use.memory:
        u = seen(chain, t, speed[rack], angle[rack], angle[rack], load_n, told_nm, bar)
        added.advance(chain.at_rack.effects, u, dt)


@kernel
def reported_nm(chain: Chain, reading_nm: float) -> float:
    """What the torsion bar's sensor makes of the true torque (Nm); once a sample, in order."""
    if not chain.sensor.use.sensor:
        return reading_nm
    u = Instant(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, reading_nm, chain.rack_to_rotor)
    return added.told_nm(chain.sensor.effects, u, reading_nm)
