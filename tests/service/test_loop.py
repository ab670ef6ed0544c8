"""The running service on buses without hardware: publishing, silence, loss, other transmitters."""

import asyncio
import errno
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import dropwhile, pairwise
from pathlib import Path

import pytest

from eps_hil.bus.config import BusConfig
from eps_hil.bus.eager_loop import EagerLoop
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Deliver, OnLost, Port, PortCounts, open_port
from eps_hil.errors import AbsentBusError, BusError
from eps_hil.estimation.settings import PlausibilitySettings
from eps_hil.estimation.validity import Reason
from eps_hil.service.config import PublishConfig, ServiceConfig
from eps_hil.service.core import Status
from eps_hil.service.estimate_log import HEADER, EstimateLog
from eps_hil.service.health import Summary
from eps_hil.service.loop import Service, open_for
from eps_hil.service.present import Present
from eps_hil.service.setup import Parts, prepare
from eps_hil.service.status_line import Snapshot
from eps_hil.service.verdict import NEEDED
from eps_hil.service.whole_lines import WholeLines

from .conftest import DATABASE, T0_NS, Receiver, TinyRig

SYNC, ESTIMATE, VERDICT, HEALTH = 0x100, 0x120, 0x121, 0x400
_PATIENCE_S = 30.0
"""A stalled guest, or a first compilation, may take so long over what takes milliseconds."""
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
        self._last: Frame | None = None
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
        assert self._ready.wait(_PATIENCE_S)

    def drive(self, milliseconds: int) -> None:
        """Frames of so many milliseconds, at their pace."""
        start = time.monotonic() - self._k * 1e-3
        for _ in range(milliseconds):
            for frame in self._rig.millisecond(self._k):
                self._last = frame
                while not self.peer.send(frame):
                    time.sleep(1e-3)
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

    def arrived(self) -> bool:
        """Whether what was driven last has reached the service, or never will."""
        if not self.taps:
            return True
        tap = self.taps[-1]
        seen = (frame.data for frame in tap.received[-50:])
        return tap.closed or self._last is None or self._last.data in seen

    def run(self, script: Callable[[], None], duration_s: float = 120.0) -> Summary:
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
                end = time.monotonic() + _PATIENCE_S
                while not self.arrived() and time.monotonic() < end:
                    time.sleep(0.01)
                time.sleep(0.05)  # and its answer is on its way
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
            with asyncio.Runner(loop_factory=EagerLoop) as runner:
                return runner.run(both())
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


def on_time(received: list[Frame]) -> list[Frame]:
    """The same frames as a bus that keeps time would have stamped them."""
    ours = [frame for frame in received if not frame.own and not frame.error]
    return [
        replace(frame, t_ns=T0_NS + place // 3 * 1_000_000 + place % 3 * 120_000)
        for place, frame in enumerate(ours)
    ]


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
    # so, as the replay of the same stamps does. In User-Mode Linux no number can be expected:
    # there, that these frames make valid estimates is seen with the stamps of a punctual bus.
    assert summary.valid_steps == valid_steps
    if bus == "socketcan":
        assert replayed(quick, on_time(bench.tap.received))[1] > 600
    else:
        assert len(live) > 100
        assert valid_steps > 100
    # In the same order, each one bit for bit; what a late loop left out is missing. Only age and
    # verdict are of the moment at which the service sent it.
    rest = iter([_numbers(receiver, Frame(0, 0x120, data)) for data in again])
    sent = [_numbers(receiver, Frame(0, 0x120, data)) for data in live]
    assert all(any(frame == other for other in rest) for frame in sent)
    # One counter, also where nothing is estimated: before the first frame and after the last.
    assert len(bench.tap.estimates()) > len(live)
    assert _jumped(receiver, bench.tap.estimates()) % 16 == summary.skipped % 16
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
    assert {f.can_id for f in seen} == {ESTIMATE, VERDICT, HEALTH}
    told = [DATABASE.decode_message(VERDICT, f.data) for f in seen if f.can_id == VERDICT]
    assert len(told) > 5 * len(health)
    fine = [each for each in told if not each["EstimateReasons"]]
    assert fine
    assert {str(fine[-1][name]) for name in NEEDED[:-1]} <= {"fine", "not_used"}
    assert bench.shown[-1].estimate is not None
    assert any("load cell" in shown.line() for shown in bench.shown)


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
        bench.drive(1300)

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
    live = [_numbers(receiver, f) for f in frames if not _silent(receiver, f)]
    replay = replayed(quick, bench.tap.received)[0]
    again = iter([_numbers(receiver, Frame(0, 0x120, data)) for data in replay])
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


def test_without_reconnect_a_lost_bus_ends_the_run_with_a_reason(quick: ServiceConfig) -> None:
    bench = Bench(replace(quick, bus=replace(quick.bus, reconnect=False)))

    def script() -> None:
        bench.wait_ready()
        bench.drive(100)
        bench.in_loop(bench.tap.pull_the_plug)

    with pytest.raises(BusError, match="the bus is lost: the interface was removed"):
        bench.run(script)
    assert bench.tap.closed


def test_reconnect_waits_and_goes_on(quick: ServiceConfig, receiver: Receiver) -> None:
    bench = Bench(replace(quick, service=replace(quick.service, reconnect_s=0.1)))

    def script() -> None:
        bench.wait_ready()
        bench.drive(300)
        bench.in_loop(bench.tap.pull_the_plug)
        bench.pause(200)
        bench.drive(1300)

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
    assert summary.bus_losses == 1


class LateBus(Bench):
    """Its interface is not there for the first ``missing`` attempts to open it."""

    missing = 3

    def opener(self, parts: Parts) -> Port:
        if self.missing:
            self.missing -= 1
            raise AbsentBusError("can0: the interface is down; sudo ip link set can0 up")
        return super().opener(parts)


def test_a_bus_that_is_not_there_yet_is_waited_for_and_listened_to_first(
    config: ServiceConfig, receiver: Receiver
) -> None:
    bench = LateBus(replace(config, service=replace(config.service, reconnect_s=0.05)))
    bench.run(lambda: bench.drive_when_ready(500))
    said = "bus absent can0: the interface is down; sudo ip link set can0 up; waiting for it"
    assert [line for line in bench.said if line.startswith(said)] == [f"{said} (bus.reconnect)"]
    order = [bench.said.index(line) for line in ("bus back   going on", "READY")]
    assert order == sorted(order)
    assert (Status.VALID, Reason.FINE) in verdicts(receiver, bench.tap.estimates())
    late = LateBus(config)

    def talk() -> None:  # somebody else sends our id: that is found out all the same
        while not late.taps:
            time.sleep(0.01)
        for _ in range(10):
            late.peer.send(Frame(0, ESTIMATE, bytes(8)))
            time.sleep(0.01)

    late.missing = 1
    with pytest.raises(BusError, match="another transmitter sends our ids"):
        late.run(talk)


def test_a_bus_that_never_comes(config: ServiceConfig) -> None:
    bench = LateBus(replace(config, service=replace(config.service, reconnect_s=0.05)))
    bench.missing = 1_000
    with pytest.raises(BusError, match=r"can0: the interface is down; .* not come within 0.3 s"):
        bench.run(lambda: time.sleep(0.5), duration_s=0.3)
    impatient = LateBus(replace(config, bus=replace(config.bus, reconnect=False)))
    with pytest.raises(AbsentBusError, match="the interface is down"):
        impatient.run(lambda: None)
    assert impatient.missing == 2, "one attempt"


@pytest.mark.socketcan
def test_an_interface_that_goes_down_and_up_again(
    quick: ServiceConfig, receiver: Receiver, vcan0: str
) -> None:
    # An emulated machine stamps in bursts: the waits after a hole, which have tests of their own,
    # would begin again and again there.
    hasty = replace(quick.estimator, settle_s=0.02, plausibility=PlausibilitySettings(unseen_s=0.0))
    config = replace(
        quick,
        bus=BusConfig("socketcan", vcan0),
        estimator=hasty,
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
        for _ in range(100):
            bench.drive(500)
            if (Status.VALID, Reason.FINE) in verdicts(receiver, bench.taps[-1].estimates()):
                return

    bench.run(script)
    assert "bus lost   the interface went down; waiting for it (bus.reconnect)" in bench.said
    assert len(bench.taps) == 2
    back = Counter(verdicts(receiver, bench.taps[1].estimates()))
    assert (Status.VALID, Reason.FINE) in back, back


def test_an_internal_error_ends_the_run_and_status_off_is_sent(
    quick: ServiceConfig, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(quick)

    def broken(_frames: list[Frame], _now_ns: int) -> list[Frame]:
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
    assert len(lines) == 1 + summary.steps - bench.parts.core.repeated
    times = [float(line.split(",")[0]) for line in lines[1:]]
    assert times == sorted(set(times))
    assert times[-1] - times[0] == pytest.approx(0.499, abs=0.02)


def test_the_age_is_that_when_the_answer_is_sent_and_what_waited_is_not_valid(
    quick: ServiceConfig, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(replace(quick, bus=UDP))
    sent: list[tuple[int, Frame, int]] = []
    send, now_ns, asked = Tap.send, Present.now_ns, [0]

    def looked(present: Present) -> int:
        asked[0] = now_ns(present)  # threads of a test take turns of 5 ms after that
        return asked[0]

    def noted(tap: Tap, frame: Frame) -> bool:
        syncs = [f.t_ns for f in tap.received[-40:] if f.can_id == SYNC]
        sent.append((asked[0], frame, max(syncs, default=0)))
        return send(tap, frame)

    monkeypatch.setattr(Tap, "send", noted)
    monkeypatch.setattr(Present, "now_ns", looked)

    def script() -> None:
        bench.drive_when_ready(300)
        for pause_s in (0.3, 0.06, 0.6):
            bench.in_loop(lambda pause_s=pause_s: time.sleep(pause_s))  # type: ignore[misc]
            bench.drive(800)  # its frames wait for the loop

    bench.run(script)
    look_back_ms = bench.parts.estimator.latency_s * 1e3
    waited = 0
    for at_ns, frame, sync_ns in sent:
        if frame.can_id != ESTIMATE or _silent(receiver, frame):
            continue
        told = receiver.read(frame)
        true_ms = (at_ns - sync_ns) * 1e-6 + look_back_ms
        if true_ms < 126.0 and told["EstimateAge"] < 126.0:
            # never younger than it is (half a millisecond of quantisation, a step of the grid);
            # older where the sender itself was late, which its counter tells
            assert told["EstimateAge"] > true_ms - 1.6
        waited += true_ms > look_back_ms + 25.0
        if true_ms > look_back_ms + 22.0:
            assert told["EstimateStatus"] != Status.VALID, true_ms
    assert waited > 0


def test_a_disk_that_is_full_costs_rows_and_nothing_else(
    quick: ServiceConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(quick)
    path = tmp_path / "e.csv"
    bench.log = EstimateLog(path, bench.said.append, waiting_max=300)
    append, full = WholeLines.append, threading.Event()

    def nearly_full(lines: WholeLines, text: str) -> None:
        if full.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        append(lines, text)

    monkeypatch.setattr(WholeLines, "append", nearly_full)

    def script() -> None:
        bench.drive_when_ready(300)
        full.set()
        bench.drive(1_200)
        full.clear()
        bench.drive(500)

    summary = bench.run(script)
    bench.log.close()
    assert summary.steps == 2_000
    lost = summary.failures["rows that the log lost"]
    assert 200 < lost < 1_200  # all but the 300 that waited
    assert len(path.read_text().splitlines()) == 1 + 2_000 - bench.parts.core.repeated - lost
    said = [line for line in bench.said if line.startswith("log")]
    assert len(said) == 2
    assert "No space left" in said[0]
    assert f"written again, {lost} rows are lost" in said[1]


def test_errors_of_jobs_beside_the_estimates_are_survived_said_once_and_counted(
    quick: ServiceConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(quick)
    health = bench.parts.health
    assert health is not None
    frame, broken = health.frame, threading.Event()

    def fragile(values: Mapping[str, float], t_ns: int = 0) -> Frame:
        if broken.is_set():
            raise ArithmeticError("broken")
        return frame(values, t_ns)

    monkeypatch.setattr(health, "frame", fragile)

    def script() -> None:
        bench.drive_when_ready(300)
        broken.set()
        bench.drive(500)
        broken.clear()
        bench.drive(300)

    summary = bench.run(script)
    assert summary.steps == 1_100
    assert summary.failures["health"] > 1
    said = [line for line in bench.said if line.startswith("trouble")]
    assert said == [
        "trouble    health: ArithmeticError: broken; the estimates go on",
        f"trouble    health: over, {summary.failures['health']} failures so far",
    ]
    assert any(f.can_id == HEALTH for f in bench.tap.sent)


def test_nothing_is_sent_while_the_controller_is_bus_off(
    quick: ServiceConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(quick)
    state = BusState.ERROR_ACTIVE
    monkeypatch.setattr(Tap, "state", property(lambda _: state))
    marks: list[int] = []

    def script() -> None:
        nonlocal state
        bench.drive_when_ready(300)
        state = BusState.BUS_OFF
        time.sleep(0.15)
        marks.append(len(bench.tap.sent))
        bench.drive(200)  # what waited in a queue
        marks.append(len(bench.tap.sent))
        state = BusState.ERROR_ACTIVE
        bench.drive(200)
        marks.append(len(bench.tap.sent))

    bench.run(script)
    assert marks[0] == marks[1] < marks[2]
    said = [line for line in bench.said if line.startswith("bus state")]
    assert len(said) == 2
    assert "bus off: nothing can be sent" in said[0]
    assert "error active" in said[1]


def _jumped(receiver: Receiver, frames: list[Frame]) -> int:
    """How many frames a receiver misses by their counter (0..15)."""
    counters = [int(receiver.read(frame)["Counter"]) for frame in frames]
    return sum((b - a - 1) % 16 for a, b in pairwise(counters))


def _numbers(receiver: Receiver, frame: Frame) -> tuple[float, ...]:
    told = receiver.read(frame)
    return told["RackForceEstimate"], told["FrictionTorque"]


def _silent(receiver: Receiver, frame: Frame) -> bool:
    status, reason = verdicts(receiver, [frame])[0]
    return status == Status.OFF or bool(reason & Reason.NO_INPUT)
