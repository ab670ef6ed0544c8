"""What added effects remember over a hole, and how much of that nobody knows.

A motor cools by the clock, not by the samples that arrive. So what is remembered goes on over held
steps and jumps of time by the last inputs; what others would have made of it is kept as a rack
force (N), which dies out as the effects forget.
"""

import math

from eps_hil.compiled import kernel
from eps_hil.estimation import acting
from eps_hil.estimation.levels import told_last
from eps_hil.estimation.setup import Constants, Physics
from eps_hil.estimation.state import NEVER_RAN, RUNS, Moment, Rig
from eps_hil.physics.effects.added import Added
from eps_hil.physics.effects.effect import Instant

LONG_S = 1e4
"""A hole of which nobody knows how long it was."""
_LARGE = 0.5
"""Share of the largest torque so far, above which the farthest from the last torque is none.

The same of the speed.
"""


@kernel
def hold_memory(x: Physics, s: Moment, time_s: float) -> None:
    """Move what is remembered on by ``time_s`` without inputs; before ``s`` is said to be held."""
    if not x.use.memory or s.running == NEVER_RAN:
        return
    if s.running == RUNS:
        _move(x.effects, False)
    acting.advance(x.effects, told_last(s, s.told[1], s.told[4]), time_s)


@kernel
def end_hold(c: Constants, x: Physics, s: Moment, r: Rig, time_s: float) -> None:
    """After a hole of ``time_s``: what the memory would be worth by the farthest inputs of it."""
    if not x.use.memory or s.running == NEVER_RAN or c.memory_keep == 0.0:
        return
    told = told_last(s, s.told[1], s.told[4])
    speed, motor = told.speed_rad_s, told.motor_torque_nm
    most = math.copysign(r.most_nm, motor)
    asked = _by(told, speed, most, told.torque_sensor_nm)
    known = _made(x, asked)
    _move(x.effects, True)
    loaded, quick = abs(motor) > _LARGE * r.most_nm, abs(speed) > _LARGE * r.most_rad_s
    farthest = _by(
        told,
        0.0 if quick else math.copysign(r.most_rad_s, speed),
        0.0 if loaded else most,
        0.0 if loaded else told.torque_sensor_nm,
    )
    acting.advance(x.effects, farthest, time_s)
    apart = _apart_n(c, known, _made(x, asked))
    _move(x.effects, True)
    r.memory_n = max(r.memory_n, apart)


def memory_of_a_start(
    c: Constants, x: Physics, r: Rig, unknown: bool, most_nm: float, most_rad_s: float
) -> None:
    """The largest rack force (N) that an unknown memory makes; where it is ``unknown`` from the
    start, as much is unknown now. ``most_nm``, ``most_rad_s``: largest torque and speed."""
    if not x.use.memory or c.memory_keep == 0.0:
        return
    r.memory_most_n = _most_n(c, x, most_nm, most_rad_s)
    r.memory_n = r.memory_most_n if unknown else 0.0


@kernel
def _most_n(c: Constants, x: Physics, most_nm: float, most_rad_s: float) -> float:
    """The same for effects that remember nothing yet; nor do they afterwards."""
    most = 0.0
    for loaded in range(2):
        for quick in range(2):
            asked = Instant(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, most_nm, 0.0, c.ratio)
            known = _made(x, asked)
            farthest = _by(asked, quick * most_rad_s, loaded * most_nm, 0.0)
            acting.advance(x.effects, farthest, LONG_S)
            most = max(most, _apart_n(c, known, _made(x, asked)))
            x.effects.state[:] = 0.0
    return most


@kernel
def _apart_n(
    c: Constants,
    known: tuple[float, float, float, float, float],
    other: tuple[float, float, float, float, float],
) -> float:
    """As a rack force (N), how far what effects make is from something else."""
    torque = abs(other[0] - known[0]) + c.sensor_to_rotor * abs(other[1] - known[1])
    for k in range(2, 5):
        torque += abs(other[k] - known[k])
    return c.ratio * torque


@kernel
def _by(i: Instant, speed_rad_s: float, motor_nm: float, sensor_nm: float) -> Instant:
    """The same instant with another speed and other torques."""
    return Instant(i[0], speed_rad_s, i[2], i[3], i[4], i[5], motor_nm, sensor_nm, i[8])


@kernel
def _made(x: Physics, i: Instant) -> tuple[float, float, float, float, float]:
    """Torques (Nm) that the effects make at an instant: motor, sensor, level, load, others."""
    a, level = x.effects, max(x.law.offset_pos_nm, x.law.offset_neg_nm)
    return (
        acting.motor_nm(a, i, i.motor_torque_nm),
        acting.sensor_nm(a, i, i.torque_sensor_nm),
        acting.level_nm(a, i, level),
        acting.load_nm(a, i, i.rack_force_n / i.ratio_rad_per_m),
        acting.torque_nm(a, i, 0.0),
    )


@kernel
def _move(a: Added, swap: bool) -> None:
    """What is remembered into the spare room; with ``swap`` what is there, back."""
    rows, terms, states = a.state.shape
    for i in range(rows):
        for j in range(terms):
            for k in range(states):
                now, spare = a.state[i, j, k], a.spare[i, j, k]
                a.spare[i, j, k] = now
                a.state[i, j, k] = spare if swap else now
