"""The running service while something fails: lost bus, bus-off, full disk, an error inside."""

import errno
import subprocess
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.bus.config import BusConfig
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, Port, open_port
from eps_hil.errors import AbsentBusError, BusError
from eps_hil.estimation.validity import Reason
from eps_hil.service.config import ServiceConfig
from eps_hil.service.core import Status
from eps_hil.service.estimate_log import EstimateLog
from eps_hil.service.setup import Parts
from eps_hil.service.whole_lines import WholeLines

from .conftest import Receiver
from .loop_bench import (
    ESTIMATE,
    HEALTH,
    Bench,
    Tap,
    last_verdict,
    on_time,
    replayed,
    silent,
    verdicts,
)


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
        bench.drive_until_valid(receiver, 1300)

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


@pytest.mark.slow
def test_a_bus_that_is_not_there_yet_is_waited_for_and_listened_to_first(
    config: ServiceConfig, receiver: Receiver
) -> None:
    bench = LateBus(replace(config, service=replace(config.service, reconnect_s=0.05)))

    def script() -> None:
        bench.wait_ready()
        bench.drive_until_valid(receiver, 500)

    bench.run(script)
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
    config = replace(
        quick,
        bus=BusConfig("socketcan", vcan0),
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
        bench.drive(900)

    bench.run(script)
    assert "bus lost   the interface went down; waiting for it (bus.reconnect)" in bench.said
    assert len(bench.taps) == 2
    back = bench.taps[1]
    assert [f for f in back.estimates() if not silent(receiver, f)], "nothing is estimated"
    # A slow emulated machine stamps in bursts that are never believed: that the frames after the
    # outage make valid estimates is seen with the stamps of a punctual bus.
    assert replayed(config, on_time(back.received))[1] > 600


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
