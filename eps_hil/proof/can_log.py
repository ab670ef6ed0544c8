"""Recordings as a CAN logger would have kept them: frames by the DBC, late, jittering, some lost.

The project's own frame encoder (counter, CRC, scaling) and database are used: a bus knows no
physics. Receive stamps are late by the time on the bus and a jitter that only ever adds.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.proof.truth import Floats

_DEG = 180.0 / math.pi
_MESSAGES: dict[str, tuple[int, dict[str, tuple[str, float]]]] = {
    "EPS_MotorState": (
        1,
        {"MotorSpeed": ("motor_speed_rad_s", 1.0), "MotorAngle": ("motor_angle_rad", 1.0)},
    ),
    "EPS_Torques": (
        1,
        {
            "MotorTorque": ("motor_torque_nm", 1.0),
            "TorsionBarTorque": ("torque_sensor_nm", 1.0),
        },
    ),
    "RIG_State": (
        1,
        {"RackForce": ("rack_force_n", 1.0), "RackPosition": ("rack_position_m", 1.0)},
    ),
    "EPS_SteeringWheel": (
        10,
        {
            "SteeringWheelAngle": ("steering_wheel_angle_rad", _DEG),
            "SteeringWheelSpeed": ("steering_wheel_speed_rad_s", _DEG),
        },
    ),
}
"""Message: cycle in ms, and signal by (canonical name, factor to the DBC's unit)."""
_EPOCH_S = 1_700_000_000


@dataclass(frozen=True, slots=True)
class Wire:
    """What the way through bus and logger adds: least delay, mean jitter, hiccups, losses."""

    delay_s: float = 2.0e-4
    jitter_s: float = 6.0e-5
    hiccup_s: float = 3.0e-3
    hiccups_per_frame: float = 5.0e-5
    lost_per_frame: float = 0.0
    frame_s: float = 1.3e-4


def write_log(
    path: Path, columns: Mapping[str, Floats], database: Any, wire: Wire, rng: np.random.Generator
) -> int:
    """Write canonical columns at 1 kHz as a candump log; returns how many frames were lost.

    ``database`` is what ``eps_hil.bus.database.load_database`` made of ``dbc/eps_rig.dbc``.
    Signals that the columns lack leave their message out.
    """
    from eps_hil.bus.codec import FrameEncoder

    frames: list[tuple[float, str]] = []
    lost = 0
    for place, (message, (cycle, signals)) in enumerate(_MESSAGES.items()):
        if any(name not in columns for name, _ in signals.values()):
            continue
        encoder = FrameEncoder(database, message)
        series = {s: (columns[name][::cycle] * k).tolist() for s, (name, k) in signals.items()}
        instants = columns["time_s"][::cycle]
        stamps = _arrivals(instants + place * wire.frame_s, wire, rng).tolist()
        kept = (rng.uniform(size=len(instants)) >= wire.lost_per_frame).tolist()
        for k, stamp in enumerate(stamps):
            data = encoder.encode({signal: values[k] for signal, values in series.items()})
            if kept[k]:
                frames.append((stamp, f"{encoder.can_id:03X}#{data.hex().upper()}"))
            else:
                lost += 1
    frames.sort()
    with path.open("w") as file:
        for stamp, frame in frames:
            file.write(f"({_EPOCH_S + stamp:.6f}) can0 {frame}\n")
    return lost


def _arrivals(instants: Floats, wire: Wire, rng: np.random.Generator) -> Floats:
    """Receive stamps (s), in order: what a hiccup holds up comes in a burst after it."""
    n = len(instants)
    late = wire.delay_s + rng.exponential(wire.jitter_s, n)
    late += wire.hiccup_s * (rng.uniform(size=n) < wire.hiccups_per_frame)
    queue = np.arange(n) * wire.frame_s
    stamps = np.maximum.accumulate(instants + late - queue) + queue
    return np.asarray(np.round(stamps, 6))
