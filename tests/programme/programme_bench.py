"""Rig and conductor in lock-step on no bus: cells of a programme in a tenth of their time."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.record import LogFile
from eps_hil.physics.model import load_model
from eps_hil.programme.cell_record import Collector
from eps_hil.programme.conductor import Conductor, Phase, Reading
from eps_hil.programme.plan import Plan, PlannedCell
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.process import RigSimulation

ROOT = Path(__file__).parents[2]
MODEL = load_model(ROOT / "configs" / "reference_rig.yaml")
PLAN = Plan("p", (20.0,), (0.0, 2000.0), run_s=0.5, settle_s=0.3)
MS = 1_000_000
START_NS = 1_700_000_000_000_000_000


class Bench:
    """Rig and conductor in lock-step: 10 ms of frames, one command."""

    def __init__(self, folder: Path) -> None:
        text = f"""\
bus: {{interface: virtual, channel: conductor_{folder.name}}}
dbc: [{ROOT / "dbc" / "eps_rig.dbc"}]
signals: {ROOT / "configs" / "eps_rig_signals.yaml"}
model: {ROOT / "configs" / "reference_rig.yaml"}
rig: {{manoeuvre: idle, realtime: false}}
"""
        (folder / "c.yaml").write_text(text)
        database = load_database([ROOT / "dbc" / "eps_rig.dbc"])
        mapping = load_mapping(ROOT / "configs" / "eps_rig_signals.yaml")
        self.rig = RigSimulation(load_rig_setup(folder / "c.yaml"))
        self.decoder = FrameDecoder(database, mapping)
        self.encoder = FrameEncoder(database, "RIG_Command")
        self.ms = 0

    def run(
        self, cell: PlannedCell, log: LogFile | None = None, plan: Plan = PLAN
    ) -> tuple[Conductor, Collector, list[Phase]]:
        """One cell to its end; with ``log`` every frame of the rig is written."""
        conductor, collector = Conductor(cell, plan, MODEL), Collector(MODEL)
        phases = [conductor.phase]
        while not conductor.over:
            sums: dict[str, list[float]] = {}
            for _ in range(10):
                for frame in self.rig.step(self.ms * MS):
                    stamped = replace(frame, t_ns=START_NS + self.ms * MS)
                    if log is not None:
                        log.write([stamped])
                    samples = self.decoder.decode(stamped)
                    if conductor.phase is Phase.MEASURE:
                        collector.take(samples)
                    for name, _, value in samples:
                        sums.setdefault(name, []).append(value)
                self.ms += 1
            names = ("motor_speed_rad_s", "rack_position_m", "rack_force_n")
            wanted = conductor.step(Reading(*(float(np.mean(sums[name])) for name in names)))
            values = {
                "WheelSpeedSetPoint": wanted.speed_rad_s * MODEL.sensor_to_rotor,
                "RackForceSetPoint": wanted.force_n,
                "MotorShare": 0.0,
                "CommandRequest": 1.0,
            }
            self.rig.hear(self.encoder.frame(values), self.ms * MS)
            if conductor.phase is not phases[-1]:
                phases.append(conductor.phase)
        return conductor, collector, phases
