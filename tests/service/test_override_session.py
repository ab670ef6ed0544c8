"""The override session on a bus, rig and session in one process: it starts, obeys, and ends.

What a killed or stopped process leaves behind is shown by test_override_kill.py.
"""

import asyncio
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.bus.config import BusConfig
from eps_hil.bus.port import Port, open_port
from eps_hil.errors import BusError
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.ecu import OverrideState
from eps_hil.rig.process import RigSimulation
from eps_hil.service import override_session
from eps_hil.service.config import RuntimeConfig, ServiceConfig, load_config
from eps_hil.service.journal import Journal
from eps_hil.service.operator import KeyOperator, Operator, Unattended
from eps_hil.service.override import State
from eps_hil.service.override_session import OverrideSession, open_for
from eps_hil.service.override_setup import OverrideParts

from .lockstep import CONFIG, Sawtooth, parts_of
from .patience import PATIENT, slow_dbc

UDP = BusConfig("udp_multicast", "239.74.163.83", fd=True, options={"port": 43183, "hop_limit": 0})
PEAK_NM = 0.04
ECU_TIMEOUT_S = 0.2


class RigThread(threading.Thread):
    """The simulated rig at its pace, as well as a thread can keep it.

    One that is late stays late: catching up would leave the session's thread no time at all.
    """

    def __init__(self, config: ServiceConfig) -> None:
        super().__init__()
        setup = load_rig_setup(CONFIG)
        rig = replace(setup.rig, override_timeout_s=ECU_TIMEOUT_S)
        self.simulation = RigSimulation(
            replace(setup, rig=rig, bus=replace(setup.bus, dbc=config.dbc))
        )
        bus = config.bus
        self._port = open_port(bus.interface, bus.channel, fd=bus.fd, options=bus.options)
        self._stopped = threading.Event()
        self.applied: list[float] = []
        self.start()

    def run(self) -> None:
        due = time.monotonic()
        while not self._stopped.is_set():
            for frame in self._port.recv(0.0):
                self.simulation.hear(frame, time.monotonic_ns())
            now_ns = time.monotonic_ns()
            self.applied.append(self.simulation.override.torque_nm(now_ns) or 0.0)
            for frame in self.simulation.step(now_ns):
                self._port.send(frame)
            due = max(due + 1e-3, time.monotonic() - 0.02)
            time.sleep(max(0.0, due - time.monotonic()))
        self._port.close()

    def stop(self) -> None:
        self._stopped.set()
        self.join()


class Stage:
    """A rig, a session, and what shall happen once the torque is on."""

    def __init__(self, config: ServiceConfig, folder: Path) -> None:
        assert config.override is not None
        # two busy threads of one process keep no time
        limits = replace(config.override.limits, **PATIENT, max_step_nm=0.05)  # type: ignore[arg-type]
        self.config = replace(config, override=replace(config.override, limits=limits))
        self.journal_file = folder / "j.jsonl"
        self.said: list[str] = []
        self.port: Port | None = None
        self.session: OverrideSession
        self.rig: RigThread

    def opener(self, parts: OverrideParts, dry_run: bool) -> Port:
        self.port = open_for(parts, dry_run)
        return self.port

    def run(self, then: Callable[[], None], operator: Operator | None = None) -> None:
        """Where the machine keeps no time (User-Mode Linux), a limit may end it early: again."""
        end = time.monotonic() + 240.0
        while time.monotonic() < end:
            if self._once(then, operator):
                return
            assert self.session.fault is not None, self.said
        pytest.fail(f"the torque never came: {self.said[-20:]}")

    def _once(self, then: Callable[[], None], operator: Operator | None) -> bool:
        journal = Journal(self.journal_file)
        done = [False]

        def look(_: object) -> None:
            injecting = self.session.core.state is State.INJECTING
            if injecting and not done[0] and max(self.rig.applied[-50:]) > 0.01:
                done[0] = True
                then()

        async def session() -> None:
            self.session = OverrideSession(
                parts_of(self.config), Sawtooth(PEAK_NM, 0.4), operator or Unattended(),
                self.said.append, show=look, journal=journal, opener=self.opener,
            )  # fmt: skip
            await self.session.run(60.0)

        self.rig = RigThread(self.config)
        try:
            asyncio.run(session())
        finally:
            time.sleep(0.1)  # what was sent last is still on its way
            self.rig.stop()
            journal.close()
        return done[0]


@pytest.fixture(params=["udp_multicast", pytest.param("socketcan", marks=pytest.mark.socketcan)])
def config(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> ServiceConfig:
    loaded = replace(load_config(CONFIG), service=RuntimeConfig(realtime="off"))
    if request.param == "udp_multicast":
        return replace(loaded, bus=UDP)
    request.getfixturevalue("vcan0")
    monkeypatch.setattr(override_session, "_LATE_NS", 50_000_000)
    return replace(
        loaded,
        bus=BusConfig("socketcan", "vcan0"),
        dbc=(slow_dbc(request.getfixturevalue("tmp_path")),),
        estimator=replace(loaded.estimator, stale_after_s=0.1),
    )


@pytest.mark.slow
def test_a_session_in_good_order(config: ServiceConfig, tmp_path: Path) -> None:
    stage = Stage(config, tmp_path)
    stage.run(lambda: stage.session.finish("enough"))
    assert stage.rig.applied[-1] == 0.0
    assert stage.rig.simulation.override.state is OverrideState.RELEASED
    assert 0.01 < max(map(abs, stage.rig.applied)) <= PEAK_NM + 1e-3
    told = stage.journal_file.read_text()
    assert '"to": "injecting"' in told
    assert '"to": "off"' in told.splitlines()[-1]


@pytest.mark.slow
def test_an_error_in_the_loop_releases(config: ServiceConfig, tmp_path: Path) -> None:
    stage = Stage(config, tmp_path)

    def go_wrong() -> None:
        raise ZeroDivisionError("a mistake")

    with pytest.raises(ZeroDivisionError):
        stage.run(go_wrong)
    assert stage.rig.applied[-1] == 0.0
    assert stage.rig.simulation.override.state is OverrideState.RELEASED
    assert '"to": "fault"' in stage.journal_file.read_text()


@pytest.mark.slow
def test_a_lost_bus_is_left_to_the_ecu(tmp_path: Path) -> None:
    stage = Stage(replace(load_config(CONFIG), bus=UDP), tmp_path)

    def pull_the_plug() -> None:
        stage.session._lost("the interface was removed")

    with pytest.raises(BusError, match="the bus is lost: the interface was removed"):
        stage.run(pull_the_plug)
    time.sleep(ECU_TIMEOUT_S)  # a command that was still on its way counts from when it came
    assert stage.session.fault is not None
    assert "bus: the interface was removed" in stage.session.fault.why
    end = stage.rig.applied[-1]
    assert end == 0.0 or stage.rig.simulation.override.torque_nm(time.monotonic_ns()) == 0.0


def test_keys_of_the_operator() -> None:
    """Bytes of a pipe, as a terminal gives them; its end ends the session."""
    import os

    told: list[str] = []

    class Desk:
        def prepare(self) -> bool:
            told.append("prepare")
            return True

        def arm(self) -> bool:
            told.append("arm")
            return True

        def heartbeat(self) -> None:
            told.append("beat")

        def finish(self, why: str) -> None:
            told.append(why)

    async def type_keys() -> None:
        reading, writing = os.pipe()
        operator = KeyOperator(reading)
        operator.start(asyncio.get_running_loop(), Desk())
        os.write(writing, b"ay x ")
        await asyncio.sleep(0.05)
        os.close(writing)
        await asyncio.sleep(0.05)
        operator.stop()
        os.close(reading)

    asyncio.run(type_keys())
    assert told == ["prepare", "arm", "beat", "beat", "the operator's terminal is gone"]
