"""The running service on buses without hardware: publishing, silence, loss, other transmitters."""

import asyncio
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import dropwhile
from pathlib import Path

import pytest

from eps_hil.bus.config import BusConfig
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, OnLost, Port, PortCounts, open_port
from eps_hil.errors import BusError
from eps_hil.estimation.validity import Reason
from eps_hil.service.config import PublishConfig, ServiceConfig
from eps_hil.service.core import Status
from eps_hil.service.estimate_log import HEADER, EstimateLog
from eps_hil.service.health import Summary
from eps_hil.service.loop import Service, open_for
from eps_hil.service.setup import Parts, prepare
from eps_hil.service.status_line import Snapshot

from .conftest import DATABASE, Receiver, TinyRig

ESTIMATE, HEALTH = 0x120, 0x400
UDP = BusConfig("udp_multicast", "239.74.163.77", fd=True, options={"port": 43177, "hop_limit": 0})


class Tap:
    """The service's port with an ear on both directions, and a plug that can be pulled."""

    def __init__(self, port: Port) -> None:
        self._port, self.name = port, port.name
        self.received: list[Frame] = []
        self.sent: list[Frame] = []
        self._on_lost: OnLost | None = None
        self.closed = False

    @property
    def counts(self) -> PortCounts:
        return self._port.counts

    @property
    def state(self) -> BusState:
        return self._port.state

    def start(
        self, loop: asyncio.AbstractEventLoop, deliver: Deliver, on_lost: OnLost | None = None
    ) -> None:
        def both(frames: list[Frame]) -> None:
            self.received += frames
            deliver(frames)

        self._on_lost = on_lost
        self._port.start(loop, both, on_lost)

    def send(self, frame: Frame) -> bool:
        self.sent.append(frame)
        return self._port.send(frame)

    def recv(self, timeout_s: float) -> list[Frame]:
        return self._port.recv(timeout_s)

    def close(self) -> None:
        self.closed = True
        self._port.close()

    def pull_the_plug(self) -> None:
        assert self._on_lost is not None
        self._on_lost("the interface was removed")

    def estimates(self) -> list[Frame]:
        return [f for f in self.sent if f.can_id == ESTIMATE]


class Bench:
    """A service and a tiny rig on one bus; ``script`` is what the rig does, in a thread."""

    def __init__(self, config: ServiceConfig) -> None:
        self.config = config
        self.parts = prepare(config, Path("c.yaml"))
        self.parts.estimator.warm_up()
        self.taps: list[Tap] = []
        self.said: list[str] = []
        self.shown: list[Snapshot] = []
        self.log: EstimateLog | None = None
        self._rig, self._k = TinyRig(), 0
        self._ready = threading.Event()
        bus = config.bus
        self.peer = open_port(bus.interface, bus.channel, fd=bus.fd, options=bus.options)

    def opener(self, parts: Parts) -> Port:
        self.taps.append(Tap(open_for(parts)))
        return self.taps[-1]

    def say(self, line: str) -> None:
        self.said.append(line)
        if line == "READY":
            self._ready.set()

    def wait_ready(self) -> None:
        """For scripts that count on every frame being seen."""
        assert self._ready.wait(10.0)

    def drive(self, milliseconds: int) -> None:
        """Frames of so many milliseconds, at their pace."""
        start = time.monotonic() - self._k * 1e-3
        for _ in range(milliseconds):
            for frame in self._rig.millisecond(self._k):
                self.peer.send(frame)
            self._k += 1
            time.sleep(max(0.0, start + self._k * 1e-3 - time.monotonic()))

    def drive_when_ready(self, milliseconds: int) -> None:
        """So that the service sees every frame."""
        self.wait_ready()
        self.drive(milliseconds)

    def pause(self, milliseconds: int) -> None:
        """Silence; the rig's time goes on."""
        self._k += milliseconds
        time.sleep(milliseconds * 1e-3)

    def in_loop(self, action: Callable[[], None]) -> None:
        """Do it in the loop's thread, as a port would."""
        self._loop.call_soon_threadsafe(action)

    def run(self, script: Callable[[], None], duration_s: float = 10.0) -> Summary:
        service = Service(
            self.parts, self.say, show=self.shown.append, log=self.log, opener=self.opener
        )
        failure: list[BaseException] = []

        def act() -> None:
            try:
                script()
            except BaseException as error:  # carried over to the test's thread
                failure.append(error)
            finally:
                time.sleep(0.05)  # what was sent last is still on its way
                self.in_loop(service.stop)

        async def both() -> Summary:
            self._loop = asyncio.get_running_loop()
            thread = threading.Thread(target=act)
            thread.start()
            try:
                return await service.run(duration_s)
            finally:
                await asyncio.to_thread(thread.join)

        try:
            return asyncio.run(both())
        finally:
            self.peer.close()
            assert not failure, failure

    @property
    def tap(self) -> Tap:
        return self.taps[0]


@pytest.fixture
def quick(config: ServiceConfig) -> ServiceConfig:
    """Without the wait for another transmitter."""
    return replace(config, publish=PublishConfig(listen_first_s=0.0))


def replayed(config: ServiceConfig, received: list[Frame]) -> tuple[list[bytes], int]:
    """The same frames through a new core as fast as it takes them; how many steps were valid."""
    core = prepare(config, Path("c.yaml")).core
    return [f.data for frame in received for f in core.on_frames([frame])], core.valid_steps


def verdicts(receiver: Receiver, frames: list[Frame]) -> list[tuple[int, Reason]]:
    read = [receiver.read(f) for f in frames]
    return [(int(r["EstimateStatus"]), Reason(int(r["EstimateReason"]))) for r in read]


def last_verdict(receiver: Receiver, frames: list[Frame]) -> tuple[int, Reason]:
    """Of the last frame that carried an estimate."""
    return verdicts(receiver, [f for f in frames if not _silent(receiver, f)][-1:])[0]


@pytest.mark.parametrize(
    "bus",
    ["virtual", "udp_multicast", pytest.param("socketcan", marks=pytest.mark.socketcan)],
)
def test_publishes_what_a_replay_gives_bit_for_bit(
    bus: str, quick: ServiceConfig, receiver: Receiver, request: pytest.FixtureRequest
) -> None:
    if bus == "udp_multicast":
        quick = replace(quick, bus=UDP)
    elif bus == "socketcan":
        request.getfixturevalue("vcan0")
        quick = replace(quick, bus=BusConfig("socketcan", "vcan0"))
    bench = Bench(quick)
    summary = bench.run(lambda: bench.drive_when_ready(900))
    assert summary.steps == 900
    again, valid_steps = replayed(quick, bench.tap.received)
    assert len(again) == 900
    live = [f.data for f in bench.tap.estimates() if not _silent(receiver, f)]
    assert len(live) == 900 - summary.skipped
    # A slow machine leaves many out, and stamps that come in bursts make steps invalid; it says
    # so, as the replay of the same stamps does. In User-Mode Linux no number can be expected.
    assert len(live) > (0 if bus == "socketcan" else 100)
    assert summary.valid_steps == valid_steps
    assert valid_steps > (0 if bus == "socketcan" else 100)
    # In the same order, each one bit for bit; what a late loop left out is missing.
    rest = iter(again)
    assert all(any(frame == other for other in rest) for frame in live)
    assert verdicts(receiver, bench.tap.sent[-1:])[0][0] == Status.OFF


def test_peer_sees_estimates_and_health(quick: ServiceConfig, receiver: Receiver) -> None:
    bench = Bench(quick)
    seen: list[Frame] = []
    took_s = 0.0

    def script() -> None:
        nonlocal took_s
        bench.wait_ready()
        start = time.monotonic()
        for _ in range(30):
            bench.drive(20)
            seen.extend(bench.peer.recv(0.0))
        took_s = time.monotonic() - start

    bench.run(script)
    estimates = [f for f in seen if f.can_id == ESTIMATE]
    assert (Status.VALID, Reason.FINE) in verdicts(receiver, estimates)
    health = [DATABASE.decode_message(HEALTH, f.data) for f in seen if f.can_id == HEALTH]
    assert 3 <= len(health) <= took_s / 0.1 + 2  # every 100 ms of 600, less on a busy machine
    assert health[-1]["StepRate"] == pytest.approx(600 / took_s, rel=0.3)
    assert health[-1]["CrcErrors"] == 0
    assert {f.can_id for f in seen} == {ESTIMATE, HEALTH}
    assert bench.shown[-1].estimate is not None
    assert "load cell" in bench.shown[-1].line()


def test_silence_is_told_at_a_lower_rate_and_ends_by_itself(
    quick: ServiceConfig, receiver: Receiver
) -> None:
    bench = Bench(quick)
    marks: list[int] = []

    def script() -> None:
        bench.wait_ready()
        time.sleep(0.2)
        marks.append(len(bench.tap.estimates()))
        bench.drive(300)
        marks.append(len(bench.tap.estimates()))
        bench.pause(300)
        marks.append(len(bench.tap.estimates()))
        bench.drive(400)

    bench.run(script)
    frames = bench.tap.estimates()
    silence = (Status.INVALID, Reason.NO_INPUT)
    before, after = verdicts(receiver, frames[: marks[0]]), frames[marks[1] : marks[2]]
    assert before
    assert set(before) == {silence}
    # what was driven last may still be on its way; then silence, and nothing but silence
    during = list(dropwhile(lambda verdict: verdict != silence, verdicts(receiver, after)))
    assert 10 < len(during) < 32  # one in 10 ms, after 20 ms; a busy machine is later
    assert set(during) == {silence}
    driven = [f for f in frames[marks[0] : marks[1]] if not _silent(receiver, f)]
    assert verdicts(receiver, driven)[-1] == (Status.VALID, Reason.FINE)
    assert last_verdict(receiver, frames) == (Status.VALID, Reason.FINE)
    # The counters of the estimates do not depend on the watchdog's timer.
    live = [f.data for f in frames if not _silent(receiver, f)]
    again = iter(replayed(quick, bench.tap.received)[0])
    assert all(any(frame == other for other in again) for frame in live)


def test_refuses_to_start_beside_another_transmitter(config: ServiceConfig) -> None:
    bench = Bench(config)

    def script() -> None:
        for _ in range(20):
            bench.peer.send(Frame(0, ESTIMATE, bytes(8)))
            time.sleep(0.01)

    with pytest.raises(BusError, match="another transmitter sends our ids"):
        bench.run(script)
    assert bench.tap.sent == []  # not even a last frame
    assert bench.tap.closed


def test_another_transmitter_later_makes_it_invalid(
    quick: ServiceConfig, receiver: Receiver
) -> None:
    bench = Bench(quick)

    def script() -> None:
        bench.wait_ready()
        bench.drive(400)
        bench.peer.send(Frame(0, ESTIMATE, bytes(8)))
        bench.drive(60)

    summary = bench.run(script)
    assert summary.foreign == 1
    assert any("somebody else" in line for line in summary.lines())
    assert last_verdict(receiver, bench.tap.estimates()) == (3, Reason.OTHER_TRANSMITTER)


def test_listen_only_sends_nothing(config: ServiceConfig) -> None:
    bench = Bench(replace(config, publish=PublishConfig(enabled=False)))
    summary = bench.run(lambda: bench.drive(200))
    assert bench.tap.sent == []
    assert bench.tap.counts.sent == 0
    assert summary.steps > 150
    port = open_for(bench.parts)  # and could not if it tried
    with pytest.raises(BusError, match="not configured to send"):
        port.send(Frame(0, ESTIMATE, bytes(8)))
    port.close()


def test_a_lost_bus_ends_the_run_with_a_reason(quick: ServiceConfig) -> None:
    bench = Bench(quick)

    def script() -> None:
        bench.wait_ready()
        bench.drive(100)
        bench.in_loop(bench.tap.pull_the_plug)

    with pytest.raises(BusError, match="the bus is lost: the interface was removed"):
        bench.run(script)
    assert bench.tap.closed


def test_reconnect_waits_and_goes_on(quick: ServiceConfig, receiver: Receiver) -> None:
    config = replace(
        quick,
        bus=replace(quick.bus, reconnect=True),
        service=replace(quick.service, reconnect_s=0.1),
    )
    bench = Bench(config)

    def script() -> None:
        bench.wait_ready()
        bench.drive(300)
        bench.in_loop(bench.tap.pull_the_plug)
        bench.pause(200)
        bench.drive(500)

    summary = bench.run(script)
    assert [line.split("  ")[0] for line in bench.said if line.startswith("bus")] == [
        "bus lost",
        "bus back",
    ]
    first, second = bench.taps
    assert first.closed
    assert second.closed
    assert last_verdict(receiver, second.estimates()) == (Status.VALID, Reason.FINE)
    assert summary.published == summary.steps - summary.skipped


@pytest.mark.socketcan
def test_an_interface_that_goes_down_and_up_again(
    quick: ServiceConfig, receiver: Receiver, vcan0: str
) -> None:
    config = replace(
        quick,
        bus=BusConfig("socketcan", vcan0, reconnect=True),
        service=replace(quick.service, reconnect_s=0.1),
    )
    bench = Bench(config)

    def link(state: str) -> None:
        subprocess.run(["ip", "link", "set", vcan0, state], check=True)

    def script() -> None:
        bench.drive_when_ready(300)
        bench.peer.close()
        try:
            link("down")
            bench.pause(300)
        finally:
            link("up")
        bench.pause(300)
        bench.peer = open_port("socketcan", vcan0)
        for _ in range(20):  # a machine that stamps in bursts needs more than one go
            bench.drive(600)
            if (Status.VALID, Reason.FINE) in verdicts(receiver, bench.taps[-1].estimates()):
                return

    bench.run(script)
    assert "bus lost   the interface went down; waiting for it (bus.reconnect)" in bench.said
    assert len(bench.taps) == 2
    assert (Status.VALID, Reason.FINE) in verdicts(receiver, bench.taps[1].estimates())


def test_an_internal_error_ends_the_run_and_status_off_is_sent(
    quick: ServiceConfig, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(quick)

    def broken(_frames: list[Frame]) -> list[Frame]:
        raise ArithmeticError("broken")

    monkeypatch.setattr(bench.parts.core, "on_frames", broken)
    with pytest.raises(ArithmeticError):
        bench.run(lambda: bench.drive_when_ready(5))
    assert verdicts(receiver, bench.tap.sent[-1:])[0][0] == Status.OFF


def test_log_holds_every_estimate(quick: ServiceConfig, tmp_path: Path) -> None:
    bench = Bench(quick)
    bench.log = EstimateLog(tmp_path / "e.csv")
    summary = bench.run(lambda: bench.drive_when_ready(500))
    bench.log.close()
    lines = (tmp_path / "e.csv").read_text().splitlines()
    assert lines[0] + "\n" == HEADER
    assert len(lines) == 1 + summary.steps
    times = [float(line.split(",")[0]) for line in lines[1:]]
    assert times == sorted(times)
    assert times[-1] - times[0] == pytest.approx(0.499, abs=0.02)


def _silent(receiver: Receiver, frame: Frame) -> bool:
    status, reason = verdicts(receiver, [frame])[0]
    return status == Status.OFF or bool(reason & Reason.NO_INPUT)
