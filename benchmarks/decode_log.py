#!/usr/bin/env python3
"""A CAN log to signals: this package beside python-can's reader with cantools' decode.

    python benchmarks/decode_log.py --seconds 120                   candump
    python benchmarks/decode_log.py --seconds 120 --suffix .blf
    python benchmarks/decode_log.py --seconds 120 --suffix .mf4     beside asammdf too

The log is made here: the reference rig's three messages of 1 kHz and one of 100 Hz, with counters
and CRCs. The peer reads each frame and decodes all its signals into lists, with neither counter nor
CRC looked at (of MF4: asammdf's ``extract_bus_logging``, and each channel that it makes read); this
package checks both, finds the sample instants and marks what is bad. Both are timed in this process
by turns, database and mapping included; the shortest of --runs counts. The values of the signals
are compared. Exit status 1 if any differs, or if the peer's time is less than --goal times ours.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import can
import numpy as np

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.record import open_log
from eps_hil.recordings.read import read_recording

ROOT = Path(__file__).resolve().parents[1]
DBC, SIGNALS = ROOT / "dbc/eps_rig.dbc", ROOT / "configs/eps_rig_signals.yaml"
START_NS = 1_757_617_431_000_000_000
COMPARED = {
    "motor_torque_nm": "MotorTorque",
    "motor_speed_rad_s": "MotorSpeed",
    "motor_angle_rad": "MotorAngle",
    "rack_force_n": "RackForce",
}


def write(path: Path, seconds: float) -> int:
    """A log of the reference rig's messages; how many frames."""
    database = load_database([DBC])
    names = ("EPS_MotorState", "EPS_Torques", "RIG_State", "EPS_SteeringWheel")
    motor, torques, rig, wheel = (FrameEncoder(database, name) for name in names)
    frames: list[Frame] = []
    for ms in range(round(1000 * seconds)):
        t_ns = START_NS + ms * 1_000_000
        wave, other = float(np.sin(0.003 * ms)), float(np.cos(0.0007 * ms))
        frames.append(motor.frame({"MotorSpeed": 20 * wave, "MotorAngle": 9 * other}, t_ns))
        values = {"MotorTorque": wave, "TorsionBarTorque": 0.5 * other}
        frames.append(torques.frame(values, t_ns + 120_000))
        values = {"RackForce": 500 * wave, "RackPosition": 0.01 * other}
        frames.append(rig.frame(values, t_ns + 250_000))
        if ms % 10 == 0:
            values = {"SteeringWheelAngle": 90 * other, "SteeringWheelSpeed": 9 * wave}
            frames.append(wheel.frame(values, t_ns + 400_000))
    if path.suffix == ".log":
        log = open_log(path, "can0", overwrite=True)
        log.write(frames)
        log.close()
    else:
        with can.Logger(path) as writer:
            for one in frames:
                writer.on_message_received(
                    can.Message(
                        timestamp=one.t_ns / 1e9, arbitration_id=one.can_id, data=one.data,
                        is_extended_id=one.extended, channel=0,
                    )
                )  # fmt: skip
    return len(frames)


def by_frame(path: Path) -> dict[str, tuple[Any, Any]]:
    """The peer: stamps (s) and values of every signal in the database."""
    database = load_database([DBC])
    times: dict[str, list[float]] = {}
    values: dict[str, list[float]] = {}
    with can.LogReader(path) as reader:
        for message in reader:
            found = database.decode_message(
                message.arbitration_id, message.data, decode_choices=False
            )
            for name, value in found.items():
                times.setdefault(name, []).append(message.timestamp)
                values.setdefault(name, []).append(value)
    return {name: (np.array(times[name]), np.array(values[name])) for name in times}


def by_column(path: Path) -> dict[str, tuple[Any, Any]]:
    """The peer for MF4: stamps (s) and values of every signal in the database, by asammdf."""
    from asammdf import MDF

    found: dict[str, tuple[Any, Any]] = {}
    with MDF(path) as raw, raw.extract_bus_logging({"CAN": [(str(DBC), 0)]}) as signals:
        masters = set(signals.masters_db.items())
        for group, content in enumerate(signals.groups):
            for index, channel in enumerate(content.channels):
                if (group, index) not in masters:
                    one = signals.get(group=group, index=index)
                    found[channel.name] = one.timestamps, one.samples
    return found


def main() -> int:
    """Run both, say what came out."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--seconds", type=float, default=120.0)
    ask.add_argument("--suffix", choices=(".log", ".blf", ".mf4"), default=".log")
    ask.add_argument("--runs", type=int, default=3)
    ask.add_argument("--goal", type=float, default=0.0, help="exit 1 below this ratio")
    chosen = ask.parse_args()
    mf4 = chosen.suffix == ".mf4"
    other, their_way = ("asammdf", by_column) if mf4 else ("python-can and cantools", by_frame)
    best = {"eps_hil": float("inf"), other: float("inf")}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"bus{chosen.suffix}"
        many = write(path, chosen.seconds)
        size = path.stat().st_size
        read_recording(path, dbc=[DBC], signals=SIGNALS)  # compiles
        for _ in range(chosen.runs):
            begun = time.perf_counter()
            ours = read_recording(path, dbc=[DBC], signals=SIGNALS)
            half = time.perf_counter()
            peer = their_way(path)
            took = half - begun, time.perf_counter() - half
            best = dict(zip(best, map(min, best.values(), took), strict=True))
    differ = [
        name for name, theirs in COMPARED.items()
        if not np.array_equal(ours.series[name].value, peer[theirs][1])
    ]  # fmt: skip
    print(f"{many} frames, {size / 1e6:.1f} MB {chosen.suffix}, {chosen.seconds:g} s of traffic")
    for name, seconds in best.items():
        print(f"{name:24} {seconds * 1e3:9.1f} ms  {seconds / many * 1e6:7.3f} us a frame")
    mine, theirs_s = best.values()
    print(f"ratio {theirs_s / mine:.1f}; signals that differ: {', '.join(differ) or 'none'}")
    return int(bool(differ) or theirs_s / mine < chosen.goal)


if __name__ == "__main__":
    sys.exit(main())
