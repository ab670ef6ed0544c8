"""Small CAN logs of a rig: three 1 kHz messages and a 100 Hz one, each at its own instant."""

import math
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame

ROOT = Path(__file__).parents[2]
DBC = ROOT / "dbc" / "eps_rig.dbc"
SIGNALS = ROOT / "configs" / "eps_rig_signals.yaml"
START_NS = 1_757_617_431_821_276_000
CYCLES = 300

LogWriter = Callable[[str, list[Frame]], Path]


@pytest.fixture(scope="session")
def rig_frames() -> list[Frame]:
    """0.3 s of traffic; microsecond stamps, as the formats have them."""
    database = load_database([DBC])
    encoders = {
        name: FrameEncoder(database, name)
        for name in ("EPS_MotorState", "EPS_Torques", "RIG_State", "EPS_SteeringWheel")
    }
    frames = []
    for cycle in range(CYCLES):
        t_ns = START_NS + cycle * 1_000_000
        wave = math.sin(0.02 * cycle)
        frames += [
            encoders["EPS_MotorState"].frame({"MotorSpeed": 20 * wave, "MotorAngle": wave}, t_ns),
            encoders["EPS_Torques"].frame(
                {"MotorTorque": wave, "TorsionBarTorque": 0.5 * wave}, t_ns + 120_000
            ),
            encoders["RIG_State"].frame(
                {"RackForce": 500 * wave, "RackPosition": 0.01 * wave}, t_ns + 250_000
            ),
        ]
        if cycle % 10 == 0:
            wheel = encoders["EPS_SteeringWheel"]
            values = {"SteeringWheelAngle": 10 * wave, "SteeringWheelSpeed": wave}
            frames.append(wheel.frame(values, t_ns + 400_000))
    return frames


@pytest.fixture
def write_log(tmp_path: Path) -> LogWriter:
    """Write frames as a log of the named file, through python-can's writers."""

    def write(name: str, frames: list[Frame], channel: int = 0) -> Path:
        path = tmp_path / name
        with can.Logger(path) as log:
            for frame in frames:
                log.on_message_received(as_message(frame, channel))
        return path

    return write


def as_message(frame: Frame, channel: int = 0) -> can.Message:
    return can.Message(
        timestamp=frame.t_ns / 1e9,
        arbitration_id=frame.can_id,
        is_extended_id=frame.extended,
        is_fd=frame.fd,
        data=frame.data,
        channel=channel,
    )
