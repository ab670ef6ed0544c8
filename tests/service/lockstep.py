"""Rig, ECU and override session in one process, a millisecond a step: no thread, no real clock.

The frames are those of the bus (DBC, counters, CRCs). Commands reach the ECU in the millisecond
after they were sent; a session under test may be handed anything in between (``spoil``).
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.rig import process as rig_process
from eps_hil.rig.config import RigSetup, load_rig_setup
from eps_hil.rig.ecu import Command as EcuCommand
from eps_hil.rig.process import RigSimulation
from eps_hil.service import override_setup
from eps_hil.service.config import ServiceConfig, load_config
from eps_hil.service.guard import ARM_PAUSE_NS
from eps_hil.service.override import State
from eps_hil.service.override_core import OverrideCore, Source
from eps_hil.service.override_setup import OverrideParts, prepare_override

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "configs" / "calibrate_udp.yaml"
MS = 1_000_000
T0_NS = 7_000_000 * MS
WALL0_NS = 1_790_000_000_000_000_000

Spoil = Callable[[list[Frame]], list[Frame]]


class Sawtooth:
    """Wants up to ``peak_nm``, there and back, one way and the other, for ever."""

    def __init__(self, peak_nm: float = 0.12, rate_nm_per_s: float = 1.0) -> None:
        self.peak_nm, self._step_nm = peak_nm, rate_nm_per_s * 1e-3
        self.wanted_nm = 0.0
        self.wish: Callable[[float], float | None] = lambda wanted_nm: wanted_nm
        """What becomes of it on its way: the place for a source that has gone mad."""

    def step(
        self, t_ns: int, values: Mapping[str, float], *, engaged: bool, now_ns: int
    ) -> float | None:
        if not engaged:
            return None
        self.wanted_nm += self._step_nm
        if abs(self.wanted_nm) >= self.peak_nm:
            self._step_nm = -self._step_nm
        return self.wish(self.wanted_nm)


@dataclass
class Tick:
    """One millisecond as the judge needs it; torque None: the ECU's own control (here: none)."""

    ms: int
    applied_nm: float
    own: bool
    commands: list[EcuCommand] = field(default_factory=list)


@functools.cache
def _database(paths: tuple[Path, ...], strict: bool) -> Any:
    return load_database(paths, strict=strict)


def _read_once(paths: Sequence[Path], *, strict: bool = True) -> Any:
    """A database is read-only and takes longer to read than a case takes to run."""
    return _database(tuple(Path(path).resolve() for path in paths), strict)


def parts_of(config: ServiceConfig | None = None) -> OverrideParts:
    with patch.object(override_setup, "load_database", _read_once):
        parts = prepare_override(config or load_config(CONFIG), CONFIG)
    parts.estimator.warm_up()
    return parts


class Lockstep:
    """``ticks``: what ECU and bus saw; ``parts``: of the session, from :func:`parts_of`."""

    def __init__(
        self, parts: OverrideParts, source: Source, setup: RigSetup | None = None, seed: int = 0
    ) -> None:
        setup = setup or load_rig_setup(CONFIG)
        with patch.object(rig_process, "load_database", _read_once):
            self.rig = RigSimulation(replace(setup, rig=replace(setup.rig, seed=seed)))
        self.core = OverrideCore(parts, source)
        self.ms = 0
        self.wall_jump_ns = 0
        self.beating = True
        self.running = True
        """Whether the session's process runs; stopped, its frames wait in ``waiting``."""
        self.dead = False
        self.waiting: list[Frame] = []
        self.spoil: Spoil = lambda frames: frames
        """Frames on their way to the session."""
        self.spoil_commands: Spoil = lambda frames: frames
        """Frames on their way to the rig."""
        self.accepts: Callable[[], bool] = lambda: True
        """Whether the send queue takes a frame."""
        self.ticks: list[Tick] = []
        self.core.start(self.now_ns)
        self._on_wire: list[Frame] = []

    @property
    def now_ns(self) -> int:
        return T0_NS + self.ms * MS

    @property
    def wall_ns(self) -> int:
        return WALL0_NS + self.ms * MS + self.wall_jump_ns

    @property
    def state(self) -> State:
        return self.core.state

    def step(self, count: int = 1) -> None:
        for _ in range(count):
            self._step()

    def arm(self) -> None:
        """Until the inputs are good, then both steps of arming and the first heartbeat."""
        while self.core.reason:
            self.step()
            assert self.ms < 2000, self.core.reason
        self.step(5)
        assert self.core.prepare(self.now_ns)
        self.step(ARM_PAUSE_NS // MS)
        assert self.core.arm(self.now_ns), self.story()

    def story(self) -> list[str]:
        return [str(each) for each in self.core.override.take_transitions()]

    def send(self, frames: list[Frame]) -> None:
        """What the session answered, one frame after the other."""
        for frame in frames:
            sent = self.accepts()
            self.core.on_sent(self.now_ns, frame, sent)
            if sent:
                self._on_wire.append(frame)

    def _step(self) -> None:
        tick = Tick(self.ms, 0.0, own=False)
        for frame in self.spoil_commands(self._on_wire):
            if self.rig.reader is not None and frame.can_id == self.rig.reader.can_id:
                command = self.rig.reader.read(frame)
                tick.commands += [] if command is None else [command]
            self.rig.hear(frame, self.now_ns)
        self._on_wire = []
        torque_nm = self.rig.override.torque_nm(self.now_ns)
        tick.applied_nm, tick.own = torque_nm or 0.0, torque_nm is None
        self.ticks.append(tick)
        stamped = [replace(f, t_ns=self.wall_ns) for f in self.rig.step(self.now_ns)]
        self.waiting += self.spoil(stamped)
        if self.running and not self.dead:
            self._serve()
        self.ms += 1

    def _serve(self) -> None:
        core, (frames, self.waiting) = self.core, (self.waiting, [])
        if self.beating and self.ms % 10 == 0:
            core.heartbeat(self.now_ns)
        if frames:
            self.send(core.on_frames(frames, self.now_ns, self.wall_ns))
        self.send(core.on_timer(self.now_ns))
