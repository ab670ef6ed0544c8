"""The override session on a bus, rig and session in one process: it starts, obeys, and ends.

What a killed or stopped process leaves behind is shown by test_override_kill.py.
"""

import asyncio
import errno
import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from eps_hil.bus.config import BusConfig
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Port, PortCounts, open_port
from eps_hil.errors import AbsentBusError, BusError, InputError
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.ecu import OverrideState
from eps_hil.rig.process import RigSimulation
from eps_hil.service import override_session
from eps_hil.service.config import RuntimeConfig, ServiceConfig, load_config
from eps_hil.service.ending import Ending
from eps_hil.service.guard import Command, Trip
from eps_hil.service.journal import Journal
from eps_hil.service.operator import KeyOperator, Unattended, terminal_operator
from eps_hil.service.override import State
from eps_hil.service.override_session import OverrideSession, open_for
from eps_hil.service.override_setup import OverrideParts

from .conftest import TinyRig
from .lockstep import CONFIG, Sawtooth, parts_of
from .patience import PATIENT
from .shared_clock import PromptOperator, SharedClock, StampedPort

UDP = BusConfig("udp_multicast", "239.74.163.83", fd=True, options={"port": 43183, "hop_limit": 0})
PEAK_NM = 0.04
ECU_TIMEOUT_S = 0.2


class RigThread(threading.Thread):
    """The simulated rig at its pace, as well as a thread can keep it, or at that of ``clock``.

    One that is late stays late: catching up would leave the session's thread no time at all.
    """

    def __init__(self, config: ServiceConfig, clock: SharedClock | None = None) -> None:
        super().__init__()
        setup = load_rig_setup(CONFIG)
        rig = replace(setup.rig, override_timeout_s=ECU_TIMEOUT_S)
        self.simulation = RigSimulation(replace(setup, rig=rig))
        bus = config.bus
        self._port = open_port(bus.interface, bus.channel, fd=bus.fd, options=bus.options)
        self._stopped = threading.Event()
        self._clock, self._due_s = clock, time.monotonic()
        self.session: StampedPort | None = None
        """The session's port, where rig and session go by one clock."""
        self.receive_ids: Sequence[int] = ()
        self.applied: list[float] = []
        self.start()

    def run(self) -> None:
        while not self._stopped.is_set():
            now_ns = (self._clock or time).monotonic_ns()
            for frame in self._port.recv(0.0):
                self.simulation.hear(frame, now_ns)
            self.applied.append(self.simulation.override.torque_nm(now_ns) or 0.0)
            frames = self.simulation.step(now_ns)
            for frame in frames:
                assert self._port.send(frame)
            self._pause(frames)
        self._port.close()

    def _pause(self, frames: list[Frame]) -> None:
        if self._clock is None:
            self._due_s = max(self._due_s + 1e-3, time.monotonic() - 0.02)
            time.sleep(max(0.0, self._due_s - time.monotonic()))
            return
        if self.session is None or not self.session.answers(frames, self.receive_ids):
            time.sleep(1e-3)  # nobody there yet, or any more
        self._clock.spent_ns += 1_000_000

    def go_on(self, milliseconds: int) -> None:
        """So much more of its time: what was sent to it last has been heard."""
        end = len(self.applied) + milliseconds
        while len(self.applied) < end and self.is_alive():
            time.sleep(0.01)

    def stop(self) -> None:
        self._stopped.set()
        self.join()


class Stage:
    """A rig, a session, and what shall happen once the torque is on."""

    def __init__(
        self, config: ServiceConfig, folder: Path, clock: SharedClock | None = None
    ) -> None:
        assert config.override is not None
        # two busy threads of one process keep no time
        limits = replace(config.override.limits, **PATIENT, max_step_nm=0.05)  # type: ignore[arg-type]
        self.config = replace(config, override=replace(config.override, limits=limits))
        self.journal_file = folder / "j.jsonl"
        self.said: list[str] = []
        self.clock = clock
        self.session: OverrideSession
        self.rig: RigThread

    def opener(self, parts: OverrideParts, dry_run: bool) -> Port:
        port = open_for(parts, dry_run)
        if self.clock is None:
            return port
        self.rig.receive_ids = parts.receive_ids
        self.rig.session = StampedPort(port, self.clock)
        return self.rig.session

    def run(self, then: Callable[[], None]) -> None:
        """In real time a limit may end it before the torque is there: again. Not by ``clock``."""
        end = time.monotonic() + 240.0
        while time.monotonic() < end:
            if self._once(then):
                return
            assert self.clock is None, self.said
            assert self.session.fault is not None, self.said
        pytest.fail(f"the torque never came: {self.said[-20:]}")

    def _once(self, then: Callable[[], None]) -> bool:
        operator = Unattended() if self.clock is None else PromptOperator(self.clock)
        journal = Journal(self.journal_file)
        done = [False]

        def look(_: object) -> None:
            injecting = self.session.core.state is State.INJECTING
            if injecting and not done[0] and max(self.rig.applied[-50:]) > 0.01:
                done[0] = True
                then()

        async def session() -> None:
            self.session = OverrideSession(
                parts_of(self.config), Sawtooth(PEAK_NM, 0.4), operator,
                self.said.append, show=look, journal=journal, opener=self.opener,
            )  # fmt: skip
            await self.session.run(60.0 if self.clock is None else 240.0)

        self.rig = RigThread(self.config, self.clock)
        try:
            asyncio.run(session())
        finally:
            self.rig.go_on(100)
            self.rig.stop()
            journal.close()
        return done[0]


@pytest.fixture(params=["udp_multicast", pytest.param("socketcan", marks=pytest.mark.socketcan)])
def stage(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Stage:
    """In real time on UDP; on vcan, which may be User-Mode Linux's, by a clock of the test."""
    config = replace(load_config(CONFIG), service=RuntimeConfig(realtime="off"))
    if request.param == "udp_multicast":
        return Stage(replace(config, bus=UDP), tmp_path)
    request.getfixturevalue("vcan0")
    clock = SharedClock()
    monkeypatch.setattr(override_session, "time", clock)
    return Stage(replace(config, bus=BusConfig("socketcan", "vcan0")), tmp_path, clock)


@pytest.mark.slow
def test_a_session_in_good_order(stage: Stage) -> None:
    stage.run(lambda: stage.session.finish("enough"))
    assert stage.rig.applied[-1] == 0.0
    assert stage.rig.simulation.override.state is OverrideState.RELEASED
    assert 0.01 < max(map(abs, stage.rig.applied)) <= PEAK_NM + 1e-3
    told = stage.journal_file.read_text()
    assert '"to": "injecting"' in told
    assert '"to": "off"' in told.splitlines()[-1]


@pytest.mark.slow
def test_an_error_in_the_loop_releases(stage: Stage) -> None:
    def go_wrong() -> None:
        raise ZeroDivisionError("a mistake")

    with pytest.raises(ZeroDivisionError):
        stage.run(go_wrong)
    assert stage.rig.applied[-1] == 0.0
    assert stage.rig.simulation.override.state is OverrideState.RELEASED
    assert '"to": "fault"' in stage.journal_file.read_text()


@pytest.mark.slow
def test_the_last_releases_wait_for_room_in_the_send_queue(stage: Stage) -> None:
    refused = []

    def fill_the_queue() -> None:
        port = stage.session._port
        assert port is not None
        send = port.send

        def refuse(frame: Frame) -> bool:
            refused.append(frame)
            return len(refused) > 20 and send(frame)

        port.send = refuse  # type: ignore[method-assign]
        stage.session.finish("enough")

    stage.run(fill_the_queue)
    assert len(refused) > 20
    assert stage.session.core.owed() == []
    assert stage.rig.applied[-1] == 0.0
    assert stage.rig.simulation.override.state is OverrideState.RELEASED


class PortThatFails:
    """Refuses so many frames, then one more with an error of its driver; keeps the rest."""

    def __init__(self, refusals: int, error: Exception | None = None) -> None:
        self.taken: list[Frame] = []
        self._refusals, self._error = refusals, error

    def send(self, frame: Frame) -> bool:
        self._refusals -= 1
        if self._refusals >= 0:
            return False
        error, self._error = self._error, None
        if error is not None:
            raise error
        self.taken.append(frame)
        return True

    def close(self) -> None: ...


@pytest.mark.parametrize("error", [None, RuntimeError("of a vendor's library")])
def test_releases_that_are_sent_again_count_on(error: Exception | None) -> None:
    """One counter each, or an ECU with an AUTOSAR profile takes none of them; and an error of the
    driver at one of them kept the others from being sent."""
    session, port = quiet_session(), PortThatFails(15, error)
    stand_in: Any = port
    session._port, session.core._owed = stand_in, 10
    session.core.override.state = State.ARMED
    session._tear_down()
    command = session._parts.command
    taken = [frame for frame in port.taken if frame.can_id == command.can_id]
    counters = [frame.data[1] for frame in taken]
    assert len(counters) == 10
    assert {(b - a) % 256 for a, b in pairwise(counters)} == {1}
    assert session._ending.failure is error


def test_a_driver_that_fails_as_it_closes_hides_no_trip() -> None:
    session = quiet_session()
    told: list[str] = []

    class Port(PortThatKeeps):
        def close(self) -> None:
            raise RuntimeError("of a vendor's library")

    stand_in: Any = Port()
    session._port, session._say = stand_in, told.append
    session.core.override.state = State.INJECTING
    session.core.override.trip(2, Trip.DRIVER)
    session._tear_down()
    assert session.fault is not None
    assert session.fault.trips == Trip.DRIVER
    assert told[-1] == "override   fault -> off: done"
    assert "vendor's library" in str(session._ending.failure)


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


def test_a_terminal_that_hangs_up_ends_the_session_and_is_no_error() -> None:
    """What its mode cannot be given back to made an internal error of a trip of the guard."""
    told: list[str] = []

    class Desk(NobodysDesk):
        def finish(self, why: str) -> None:
            told.append(why)

    async def hang_up() -> None:
        master, slave = os.openpty()
        operator = KeyOperator(slave)
        operator.start(asyncio.get_running_loop(), Desk())
        os.close(master)
        await asyncio.sleep(0.05)
        operator.stop()
        os.close(slave)

    asyncio.run(hang_up())
    assert told == ["the operator's terminal is gone"]


class NobodysDesk:
    """Of a session that does nothing."""

    def prepare(self) -> bool:
        return False

    def arm(self) -> bool:
        return False

    def heartbeat(self) -> None: ...

    def finish(self, why: str) -> None: ...


def test_an_error_while_nobody_is_at_the_keys_ends_the_session() -> None:
    """A full disk as it arms, say: it stayed armed for minutes, and nobody was told."""

    class FullDisk:
        def prepare(self) -> bool:
            raise OSError(28, "No space left on device")

        def arm(self) -> bool:
            raise AssertionError

        def heartbeat(self) -> None:
            raise AssertionError

        def finish(self, why: str) -> None:
            raise AssertionError(why)

    async def run() -> None:
        ending, loop = Ending(), asyncio.get_running_loop()
        ending.watch_over(loop)
        Unattended().start(loop, FullDisk())
        await ending.wait(2.0)
        ending.raise_failure()

    with pytest.raises(OSError, match="No space left"):
        asyncio.run(run())


def quiet_session() -> OverrideSession:
    """One that was not started: no bus, no operator's terminal."""
    parts = parts_of(replace(load_config(CONFIG), bus=UDP))
    return OverrideSession(parts, Sawtooth(), Unattended(), lambda _: None)


@pytest.mark.parametrize("moment", ["at the start", "later"])
def test_a_session_never_opens_a_bus_again(moment: str) -> None:
    """Neither one that is not there nor one that was lost, though it would be back at once."""
    config = replace(load_config(CONFIG), bus=UDP, service=RuntimeConfig(realtime="off"))
    assert config.bus.reconnect
    opened: list[Port] = []
    attempts = [0]

    def opener(parts: OverrideParts, dry_run: bool) -> Port:
        attempts[0] += 1
        if moment == "at the start" and attempts[0] == 1:
            raise AbsentBusError("can0: the interface is down")
        opened.append(open_for(parts, dry_run))
        return opened[-1]

    session = OverrideSession(
        parts_of(config), Sawtooth(), Unattended(), lambda _: None, opener=opener
    )

    async def run() -> None:
        loop = asyncio.get_running_loop()
        loop.call_later(0.6, session._lost, "the interface went down")
        await session.run(3.0)

    with pytest.raises(
        BusError, match=r"the interface is down|the bus is lost: the interface went"
    ):
        asyncio.run(run())
    assert attempts[0] == 1
    assert session.core.state is State.OFF
    for port in opened:
        with pytest.raises(BusError, match="closed"):
            port.recv(0.0)


class PortThatKeeps:
    """A port in name only: keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[Frame] = []

    def send(self, frame: Frame) -> bool:
        self.sent.append(frame)
        return True


class PortThatHears(PortThatKeeps):
    """The rig's frames, and one of ours that another session sent, where there is one."""

    name, state, counts = "can0", BusState.ERROR_ACTIVE, PortCounts()

    def __init__(self, other: Frame | None) -> None:
        super().__init__()
        self._other, self._rig = other, TinyRig()

    def start(self, loop: Any, deliver: Callable[[list[Frame]], None], _lost: object) -> None:
        def hear(k: int) -> None:
            frames = self._rig.millisecond(k, time.time_ns())
            deliver(frames + ([self._other] if self._other and k == 5 else []))
            loop.call_later(0.01, hear, k + 1)

        loop.call_soon(hear, 0)

    def close(self) -> None: ...


@pytest.mark.parametrize("ended", ["by another session", "by a signal", "in good order"])
def test_while_it_only_listens_it_sends_nothing(ended: str) -> None:
    """It refused to start beside a calibration, and its state 'off' ended that calibration."""
    config = load_config(CONFIG)
    parts = parts_of(replace(config, service=RuntimeConfig(realtime="off")))
    other = parts.command.frame(Command(0.0, False)) if "another" in ended else None
    port: Any = PortThatHears(other)
    session = OverrideSession(
        parts, Sawtooth(), Unattended(), lambda _: None, opener=lambda *_: port
    )
    if "signal" in ended:
        asyncio.run(ending_soon(session, "SIGTERM"))
    elif other is not None:
        with pytest.raises(BusError, match="somebody else sends our ids"):
            asyncio.run(session.run(0.1))
    else:
        asyncio.run(session.run(0.1))
    assert (port.sent == []) == ("good order" not in ended)


async def ending_soon(session: OverrideSession, why: str) -> None:
    asyncio.get_running_loop().call_later(0.05, session.finish, why)
    await session.run(1.0)


def test_a_command_that_was_late_is_thrown_away() -> None:
    """Five milliseconds from the decision to the bus: a process was stopped in between."""
    session, port = quiet_session(), PortThatKeeps()
    stand_in: Any = port
    session._port = stand_in
    session.core.override.state = State.INJECTING
    session.core.command = Command(0.04, True)
    frame = session._parts.command.frame(session.core.command)
    session._send([frame], time.monotonic_ns())
    assert port.sent == [frame]
    assert not session.core.override.guard.trips
    session._send([frame, frame], time.monotonic_ns() - 5_100_000)
    assert port.sent == [frame]
    assert session.core.state is State.FAULT
    assert session.core.override.guard.trips == Trip.CLOCK


def test_a_late_release_is_sent_all_the_same() -> None:
    session, port = quiet_session(), PortThatKeeps()
    stand_in: Any = port
    session._port = stand_in
    frame = session._parts.command.frame(session.core.command)
    session._send([frame], time.monotonic_ns() - 1_000_000_000)
    assert port.sent == [frame]


class FullDisk:
    """Stands in for the journal's file; refuses lines while ``full``."""

    def __init__(self) -> None:
        self.full = True
        self.lines: list[str] = []

    def append(self, text: str) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        self.lines.append(text)


def tripping_session(then: Callable[[FullDisk], None]) -> tuple[OverrideSession, FullDisk, Any]:
    """A hand is in the wheel while the disk is full; (session, disk, lines that were said)."""
    said: list[str] = []
    session, disk = quiet_session(), FullDisk()
    stand_in: Any = disk
    session._journal._file, session._say = stand_in, said.append

    async def first() -> None:
        session.core.override.listen(1)
        session.core.override.state = State.INJECTING
        session.core.override.trip(2, Trip.DRIVER)
        session._record()
        then(disk)

    async def nothing(duration_s: float | None) -> None: ...

    session._listen_first, session._serve = first, nothing  # type: ignore[method-assign]
    asyncio.run(session.run())  # the fault is told by ``session.fault``, as ever
    return session, disk, said


def test_a_trip_outlives_a_line_that_the_disk_refused() -> None:
    def make_room(disk: FullDisk) -> None:
        assert not disk.lines
        disk.full = False

    session, disk, said = tripping_session(make_room)
    assert session._ending.asked_for, "nothing is commanded that cannot be written down"
    assert session.fault is not None
    assert session.fault.trips == Trip.DRIVER
    assert ['"to": "listening"' in disk.lines[0], '"driver"' in disk.lines[1]] == [True, True]
    assert '"to": "off"' in disk.lines[2]
    assert "override   injecting -> fault: driver" in said
    assert not [line for line in said if "lacks" in line]


def test_a_trip_outlives_a_reader_that_is_gone() -> None:
    """The pipe's error came out in place of the trip: status 1 where 3 was due."""

    def gone(_: str) -> None:
        raise BrokenPipeError

    session = quiet_session()
    session._say = gone

    async def first() -> None:
        session.core.override.listen(1)
        session.core.override.state = State.INJECTING
        session.core.override.trip(2, Trip.DRIVER)
        session._record()

    session._listen_first = first  # type: ignore[method-assign]
    asyncio.run(session.run(0.05))
    assert session.fault is not None
    assert session.fault.trips == Trip.DRIVER


def test_a_journal_without_the_trip_is_told_as_such() -> None:
    session, disk, said = tripping_session(lambda disk: None)
    assert session.fault is not None
    assert not disk.lines
    assert "could not be written and lacks: off -> listening" in said[-1]
    assert "injecting -> fault: driver, fault -> off" in said[-1]


def test_a_full_disk_without_a_fault_is_the_error_of_the_session() -> None:
    session, disk = quiet_session(), FullDisk()
    stand_in: Any = disk
    session._journal._file = stand_in

    async def first() -> None:
        session.core.override.listen(1)
        session._record()

    session._listen_first = first  # type: ignore[method-assign]
    with pytest.raises(OSError, match="No space left"):
        asyncio.run(session.run())
    assert session.fault is None


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_signals_end_a_session(number: signal.Signals) -> None:
    """The first one ends it in good order; a second one would end the process, but for SIGHUP,
    of which a lost terminal sends two."""
    before = signal.getsignal(number)
    session = quiet_session()

    async def signalled() -> None:
        session._loop = asyncio.get_running_loop()
        with session._signals():
            os.kill(os.getpid(), number)
            await session._ending.wait(2.0)
            kept = signal.getsignal(number) is not signal.SIG_DFL
            assert kept == (number == signal.SIGHUP)

    try:
        asyncio.run(signalled())
    finally:
        signal.signal(number, before)
    assert session._ending.asked_for
    assert (session._why, session._abnormal) == (number.name, True)


def test_another_signal_does_not_cut_the_releases_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """SIGTERM, and SIGHUP a moment later, as a session manager sends them."""
    parts = parts_of(replace(load_config(CONFIG), service=RuntimeConfig(realtime="off")))
    port: Any = PortThatHears(None)
    session = OverrideSession(
        parts, Sawtooth(), Unattended(), lambda _: None, opener=lambda *_: port
    )
    tear_down, heeded = session._tear_down, [False]

    def slowly() -> None:
        heeded[0] = signal.getsignal(signal.SIGHUP) is not signal.SIG_DFL
        if heeded[0]:
            os.kill(os.getpid(), signal.SIGHUP)
        tear_down()

    monkeypatch.setattr(session, "_tear_down", slowly)

    async def run() -> None:
        asyncio.get_running_loop().call_later(0.05, os.kill, os.getpid(), signal.SIGTERM)
        await session.run(5.0)

    before = signal.getsignal(signal.SIGTERM)
    try:
        asyncio.run(run())
    finally:
        signal.signal(signal.SIGTERM, before)
    assert heeded[0]
    assert session.core.state is State.OFF


def test_without_a_terminal_there_is_no_operator(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull, encoding="ascii") as nobody:
        monkeypatch.setattr("sys.stdin", nobody)
        with pytest.raises(InputError, match="nobody can hold the dead-man key"):
            terminal_operator()
