"""The simulated rig of a configuration led in lock-step: no bus, no clock, faster than it turns.

The frames are those that the rig process would send, and the commands those that it would get.
"""

import hashlib
from dataclasses import replace
from pathlib import Path

from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.record import LogFile
from eps_hil.physics.model import Model, dump_model
from eps_hil.programme.conductor import TICK_S, Wanted
from eps_hil.programme.link import (
    COMMAND,
    BetweenTicks,
    Leader,
    Readings,
    check_cycles,
    command_values,
    position_signal,
)
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.process import RigSimulation

START_NS = 1_700_000_000_000_000_000
_ENABLE, _RELEASE = 1.0, 0.0
_LONGEST_STOP = 300


def simulated_rig(config: str | Path) -> str:
    """By what a folder knows the rig of a configuration: physics, chain, sensors, seed."""
    setup = load_rig_setup(config, "idle")
    parts = (dump_model(setup.model), setup.chain, setup.reported, setup.rig)
    return hashlib.sha256(repr(parts).encode()).hexdigest()


class LockstepRig:
    """A rig that waits for whoever leads it; its clock runs on from ``start_ns``."""

    def __init__(self, config: str | Path, model: Model, start_ns: int = START_NS) -> None:
        setup = load_rig_setup(config, "idle")
        mapping = load_mapping(setup.bus.signals)
        database = load_database(setup.bus.dbc, strict=mapping.strict)
        self._rig = RigSimulation(setup)
        self._decoder = FrameDecoder(database, mapping)
        self._encoder = FrameEncoder(database, COMMAND)
        self._model, self._start_ns = model, start_ns
        position = position_signal(setup.bus, mapping.signals)
        check_cycles(setup.bus, position, self._decoder.period_s)
        self._readings = Readings(position, model, self._decoder.period_s)
        self._per_tick = round(TICK_S * 1e9) // self._rig.tick_ns
        self._now_ns = 0
        self._run(None, None)

    @property
    def simulated_s(self) -> float:
        """Of the rig's time so far."""
        return self._now_ns * 1e-9

    def lead(self, leader: Leader, log: LogFile | None, before_tick: BetweenTicks) -> None:
        """Until the leader is over; :class:`SafetyStop` as on the bus."""
        while not leader.over:
            self._run(log, before_tick)
            self._readings.check(self.simulated_s)
            self._command(leader.step(self._readings.now()), _ENABLE)

    def let_go(self) -> None:
        """Speed and preload to zero, then release."""
        for _ in range(_LONGEST_STOP):
            self._command(Wanted(0.0, 0.0), _ENABLE)
            self._run(None, None)
            if self._readings.at_rest(self.simulated_s):
                break
        self._command(Wanted(0.0, 0.0), _RELEASE)

    def _command(self, wanted: Wanted, request: float) -> None:
        frame = self._encoder.frame(command_values(wanted, self._model, request))
        self._rig.hear(frame, self._now_ns)

    def _run(self, log: LogFile | None, before_tick: BetweenTicks | None) -> None:
        """A tick of the rig's time: its frames to ``log`` and to whoever asked for samples."""
        sink = before_tick() if before_tick else None
        for _ in range(self._per_tick):
            frames = self._rig.step(self._now_ns)
            stamped = [replace(one, t_ns=self._start_ns + self._now_ns) for one in frames]
            if log is not None:
                log.write(stamped)
            for frame in stamped:
                samples = self._decoder.decode(frame)
                self._readings.take(samples, self.simulated_s)
                if sink is not None:
                    sink(samples)
            self._now_ns += self._rig.tick_ns
