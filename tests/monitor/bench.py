"""Simulated rig, service and monitor in lock-step: no bus, no clock, the same result each time."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from eps_hil.bus.frame import Frame
from eps_hil.monitor.alarm import limits_of
from eps_hil.monitor.figures import Figures
from eps_hil.monitor.view_model import Monitor
from eps_hil.physics.model import load_model
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.process import RigSimulation
from eps_hil.service.config import load_config
from eps_hil.service.setup import prepare

ROOT = Path(__file__).parents[2]
T0_NS = 1_790_000_000_000_000_000
MS = 1_000_000
CONFIG = f"""bus: {{interface: virtual, channel: monitor-test}}
dbc: [{ROOT}/dbc/eps_rig.dbc]
signals: {ROOT}/configs/eps_rig_signals.yaml
model: {ROOT}/configs/reference_rig.yaml
rig: {{manoeuvre: demo, loop: true}}
"""

Spoil = Callable[[int, list[Frame]], list[Frame]]


def spoil_nothing(_millisecond: int, frames: list[Frame]) -> list[Frame]:
    return frames


class Bench:
    """``figures``: what the monitor showed, every ``look_ms``; ``changes``: (ms, alarm, on)."""

    def __init__(
        self, config: Path, *, manoeuvre: str = "demo", service: bool = True, after_s: float = 6.0
    ) -> None:
        self.rig = RigSimulation(load_rig_setup(config, manoeuvre))
        loaded = load_config(config)
        self.core = prepare(loaded, config).core if service else None
        self.monitor = Monitor(loaded, limits_of(load_model(loaded.model), after_s=after_s))
        self.figures: list[Figures] = []
        self.changes: list[tuple[int, str, bool]] = []
        self.millisecond = 0

    def run(self, milliseconds: int, spoil: Spoil = spoil_nothing, look_ms: int = 250) -> Figures:
        for _ in range(milliseconds):
            k = self.millisecond
            now_ns = T0_NS + k * MS
            sent = self.rig.step(now_ns)
            frames = [replace(f, t_ns=now_ns + 100_000 * i) for i, f in enumerate(sent)]
            frames = spoil(k, frames)
            answer = [] if self.core is None else self.core.on_frames(frames)
            last_ns = frames[-1].t_ns if frames else now_ns
            self.monitor.take([*frames, *(replace(f, t_ns=last_ns + 50_000) for f in answer)])
            self.millisecond += 1
            if self.millisecond % look_ms == 0:
                self.figures.append(self.monitor.figures(now_ns + MS))
                self.changes += [(k, *change) for change in self.monitor.changes]
        return self.figures[-1]
