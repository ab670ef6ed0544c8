"""A rig of a few lines: the frames of one millisecond after the other, on any port."""

import math
import os
import socket
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import SignalMapping, load_mapping
from eps_hil.series import Series
from eps_hil.service.config import PublishConfig, ServiceConfig, load_config
from eps_hil.service.setup import Parts, prepare

ROOT = Path(__file__).parents[2]
T0_NS = 1_790_000_000_000_000_000
DATABASE = load_database([ROOT / "dbc" / "eps_rig.dbc"])
MAPPING = load_mapping(ROOT / "configs" / "eps_rig_signals.yaml")


class TinyRig:
    """Encodes torque, load cell and motor state (the sync frame, last) of millisecond ``k``."""

    def __init__(self) -> None:
        names = ("EPS_Torques", "RIG_State", "EPS_MotorState")
        self._encoders = [FrameEncoder(DATABASE, name) for name in names]

    def millisecond(self, k: int, t0_ns: int = T0_NS) -> list[Frame]:
        """Frames of one cycle; stamps with the jitter of a bus, the same for the same ``k``."""
        phase = 2 * math.pi * 2.0 * k * 1e-3
        values = {
            "MotorTorque": 0.4 * math.sin(phase),
            "TorsionBarTorque": 0.1 + 0.02 * math.sin(3.0 * phase),
            "RackForce": 1000.0 * math.sin(phase),
            "RackPosition": 0.0,
            "MotorSpeed": 8.0 * math.cos(phase),
            "MotorAngle": 0.6 * math.sin(phase),
        }
        start_ns = t0_ns + k * 1_000_000 + (k * 7919 % 97) * 1_000
        return [
            encoder.frame(values, start_ns + place * 120_000)
            for place, encoder in enumerate(self._encoders)
        ]


@dataclass
class Receiver:
    """Decodes what the service sent, checking CRC and counter as any receiver would."""

    decoder: FrameDecoder = field(
        default_factory=lambda: FrameDecoder(
            DATABASE,
            SignalMapping(
                signals={"rack_force_estimate_n": MAPPING.signals["rack_force_estimate_n"]},
                messages={"EPSHIL_Estimate": MAPPING.messages["EPSHIL_Estimate"]},
                sync="EPSHIL_Estimate",
            ),
        )
    )

    def read(self, frame: Frame) -> Mapping[str, float]:
        """All signals of an estimate frame; asserts that its CRC is right."""
        self.decoder.decode(frame)
        assert self.decoder.faults["crc"] == 0
        message = DATABASE.get_message_by_frame_id(frame.can_id)
        return dict(message.decode(frame.data, decode_choices=False))


@pytest.fixture
def rig() -> TinyRig:
    return TinyRig()


@pytest.fixture
def receiver() -> Receiver:
    return Receiver()


@pytest.fixture
def config_text() -> str:
    """A configuration on python-can's ``virtual`` bus; paths absolute."""
    return f"""bus: {{interface: virtual, channel: service-test}}
dbc: [{ROOT}/dbc/eps_rig.dbc]
signals: {ROOT}/configs/eps_rig_signals.yaml
model: {ROOT}/configs/reference_rig.yaml
service: {{realtime: off, start_wait_s: 0}}
"""


@pytest.fixture
def config_file(tmp_path: Path, config_text: str) -> Path:
    path = tmp_path / "c.yaml"
    path.write_text(config_text)
    return path


@pytest.fixture
def config(config_file: Path) -> ServiceConfig:
    return load_config(config_file)


@pytest.fixture
def parts(config: ServiceConfig, config_file: Path) -> Parts:
    made = prepare(config, config_file)
    made.estimator.warm_up()
    return made


@pytest.fixture(scope="session")
def vcan0() -> str:
    """The kernel's virtual bus; without one: a loud skip, or a failure where CI forbids it."""
    try:
        with socket.socket(29, socket.SOCK_RAW, 1) as sock:  # AF_CAN, CAN_RAW
            sock.bind(("vcan0",))
    except OSError as error:
        why = f"SocketCAN is NOT tested here: {error}; run scripts/ci/with-vcan.sh"
        if os.environ.get("EPS_HIL_REQUIRE_SOCKETCAN") == "1":
            pytest.fail(why)
        pytest.skip(why)
    return "vcan0"


@pytest.fixture
def quick(config: ServiceConfig) -> ServiceConfig:
    """Without the wait for another transmitter."""
    return replace(config, publish=PublishConfig(listen_first_s=0.0))


def decoded(decoder: FrameDecoder, frames: Iterable[Frame]) -> dict[str, Series]:
    """The signals that frames hold, as a recording of them would."""
    found: dict[str, list[tuple[int, float]]] = {}
    for frame in frames:
        for signal, t_ns, value in decoder.decode(frame):
            found.setdefault(signal, []).append((t_ns, value))
    return {
        signal: Series(np.array([t for t, _ in rows], np.int64), np.array([v for _, v in rows]))
        for signal, rows in found.items()
    }
