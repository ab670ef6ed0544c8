"""The way to the rig's set-points against a simulated rig, on a clock that only they move."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from eps_hil.bus.config import BusSetup, load_bus_setup
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import PortCounts
from eps_hil.errors import BusError
from eps_hil.physics.model import load_model
from eps_hil.programme import link
from eps_hil.programme.conductor import Reading, Wanted
from eps_hil.programme.link import RigLink
from eps_hil.rig.command import CommandState, SetPoint
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.plant import TRUE_SIGNALS
from eps_hil.rig.process import RigSimulation

ROOT = Path(__file__).parents[2]
DBC, SIGNALS = ROOT / "dbc" / "eps_rig.dbc", ROOT / "configs" / "eps_rig_signals.yaml"
MODEL = load_model(ROOT / "configs" / "reference_rig.yaml")
RIG_STATE, TORQUES, MOTOR_STATE, RIG_COMMAND = 0x110, 0x101, 0x100, 0xA0
FAST = Wanted(40.0, 500.0)
EPOCH_NS = 1_700_000_000_000_000_000


class Clock:
    """In place of the module ``time``; the rig lives on while it goes."""

    CLOCK_BOOTTIME = 7

    def __init__(self, pass_ms: Callable[[], None]) -> None:
        self.now_ns = self._suspended_ns = 0
        self._pass_ms = pass_ms

    def monotonic(self) -> float:
        return (self.now_ns - self._suspended_ns) * 1e-9

    def clock_gettime(self, clock: int) -> float:
        assert clock == self.CLOCK_BOOTTIME
        return self.now_ns * 1e-9

    def suspend(self, seconds: float) -> None:
        """The computer stands still, the rig does not."""
        before_ns = self.now_ns
        self.sleep(seconds)
        self._suspended_ns += self.now_ns - before_ns

    def time_ns(self) -> int:
        return EPOCH_NS + self.now_ns

    def sleep(self, seconds: float) -> None:
        end_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end_ns:
            self._pass_ms()


@dataclass
class Turning:
    """Leads at a constant speed under a constant load for so many ticks."""

    ticks: int = 300
    wanted: Wanted = FAST
    readings: list[Reading] = field(default_factory=list)

    @property
    def over(self) -> bool:
        return len(self.readings) >= self.ticks

    def step(self, reading: Reading) -> Wanted:
        self.readings.append(reading)
        return self.wanted


class LinkBench:
    """Port, bus, clock and simulated rig of a :class:`RigLink`, with what goes wrong on the way.

    ``frames``: what becomes of the rig's frames; ``accepts``: whether a frame of ours is taken.
    """

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, signals: str = "") -> None:
        self.setup = written(folder, signals)
        self.rig = RigSimulation(load_rig_setup(folder / "c.yaml"))
        self.clock = Clock(self.pass_ms)
        self.commands: list[tuple[float, SetPoint]] = []
        self.truth: list[tuple[float, float, float]] = []
        self.frames: Callable[[list[Frame]], list[Frame]] = lambda frames: frames
        self.accepts: Callable[[], bool] = lambda: True
        self.closed = False
        self.name, self.counts = "bench", PortCounts()
        self._pending: list[Frame] = []
        monkeypatch.setattr(link, "time", self.clock)
        monkeypatch.setattr(link, "open_port", lambda *_, **__: self)
        self.link = RigLink(self.setup, MODEL)

    @property
    def now_s(self) -> float:
        return self.clock.now_ns * 1e-9

    @property
    def state(self) -> CommandState:
        return self.rig.control.state

    @property
    def speed_rad_s(self) -> float:
        """Of the rotor, as it is."""
        return self.truth[-1][1]

    def open(self) -> None:
        self.link.open(lambda: False, lambda: BusError("stopped"))

    def pass_ms(self) -> None:
        """A millisecond of the rig."""
        sent = self.rig.step(self.clock.now_ns)
        stamped = [replace(one, t_ns=self.clock.time_ns()) for one in sent]
        self._pending += self.frames(stamped)
        found = dict(zip(TRUE_SIGNALS, self.rig._truth.tolist(), strict=True))
        self.truth.append((self.now_s, found["motor_speed_rad_s"], found["rack_position_m"]))
        self.clock.now_ns += self.rig.tick_ns

    def since(self, t_s: float) -> list[tuple[float, SetPoint]]:
        """Commands of that moment and later that the rig heard."""
        return [one for one in self.commands if one[0] >= t_s]

    # The port.

    def recv(self, timeout_s: float) -> list[Frame]:
        end_ns = self.clock.now_ns + math.ceil(timeout_s * 1e9)
        while not self._pending and self.clock.now_ns < end_ns:
            self.pass_ms()
        found, self._pending = self._pending, []
        return found

    def send(self, frame: Frame) -> bool:
        if not self.accepts():
            return False
        assert self.rig.set_points is not None
        command = self.rig.set_points.read(frame)
        assert command is not None
        self.commands.append((self.now_s, command))
        self.rig.hear(frame, self.clock.now_ns)
        return True

    def close(self) -> None:
        self.closed = True


def written(folder: Path, signals: str = "") -> BusSetup:
    """A configuration, with a mapping of its own where ``signals`` is one."""
    mapping = SIGNALS
    if signals:
        mapping = folder / "signals.yaml"
        mapping.write_text(signals)
    (folder / "c.yaml").write_text(f"""\
bus: {{interface: virtual, channel: link_{folder.name}}}
dbc: [{DBC}]
signals: {mapping}
model: {ROOT / "configs" / "reference_rig.yaml"}
rig: {{manoeuvre: idle, realtime: false}}
""")
    return load_bus_setup(folder / "c.yaml")
