"""The running service on buses without hardware: publishing, silence, age, other transmitters."""

import time
from dataclasses import replace
from itertools import dropwhile
from pathlib import Path

import pytest

from eps_hil.bus.config import BusConfig
from eps_hil.bus.frame import Frame
from eps_hil.errors import BusError
from eps_hil.estimation.validity import Reason
from eps_hil.service.config import PublishConfig, ServiceConfig
from eps_hil.service.core import Status
from eps_hil.service.estimate_log import HEADER, EstimateLog
from eps_hil.service.loop import open_for
from eps_hil.service.present import Present
from eps_hil.service.verdict import NEEDED

from .conftest import DATABASE, Receiver
from .loop_bench import (
    ESTIMATE,
    HEALTH,
    SYNC,
    UDP,
    VERDICT,
    Bench,
    Tap,
    jumped,
    last_verdict,
    numbers,
    on_time,
    replayed,
    silent,
    verdicts,
)


@pytest.mark.parametrize(
    "bus",
    [
        pytest.param("virtual", marks=pytest.mark.slow),
        "udp_multicast",
        pytest.param("socketcan", marks=pytest.mark.socketcan),
    ],
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
    live = [f.data for f in bench.tap.estimates() if not silent(receiver, f)]
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
    rest = iter([numbers(receiver, Frame(0, 0x120, data)) for data in again])
    sent = [numbers(receiver, Frame(0, 0x120, data)) for data in live]
    assert all(any(frame == other for other in rest) for frame in sent)
    # One counter, also where nothing is estimated: before the first frame and after the last.
    assert len(bench.tap.estimates()) > len(live)
    # It begins at zero: what a slow machine left out before its first frame counts, too.
    before = int(receiver.read(bench.tap.estimates()[0])["Counter"])
    assert (before + jumped(receiver, bench.tap.estimates())) % 16 == summary.skipped % 16
    assert verdicts(receiver, bench.tap.sent[-1:])[0][0] == Status.OFF


def test_peer_sees_estimates_and_health(quick: ServiceConfig, receiver: Receiver) -> None:
    bench = Bench(quick)
    seen: list[Frame] = []
    first: list[Frame] = []
    took_s = 0.0

    def script() -> None:
        nonlocal took_s
        bench.wait_ready()
        start = time.monotonic()
        for _ in range(30):
            bench.drive(20)
            first.extend(bench.peer.recv(0.0))
        took_s = time.monotonic() - start
        seen.extend(first)
        bench.drive_until_valid(receiver, 20)
        seen.extend(bench.peer.recv(0.0))

    bench.run(script)
    estimates = [f for f in seen if f.can_id == ESTIMATE]
    assert (Status.VALID, Reason.FINE) in verdicts(receiver, estimates)
    health = [DATABASE.decode_message(HEALTH, f.data) for f in first if f.can_id == HEALTH]
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
        bench.drive_until_valid(receiver, 300)
        marks.append(len(bench.tap.estimates()))
        bench.pause(300)
        marks.append(len(bench.tap.estimates()))
        bench.drive_until_valid(receiver, 1300)

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
    driven = [f for f in frames[marks[0] : marks[1]] if not silent(receiver, f)]
    assert verdicts(receiver, driven)[-1] == (Status.VALID, Reason.FINE)
    assert last_verdict(receiver, frames) == (Status.VALID, Reason.FINE)
    # The counters of the estimates do not depend on the watchdog's timer.
    live = [numbers(receiver, f) for f in frames if not silent(receiver, f)]
    replay = replayed(quick, bench.tap.received)[0]
    again = iter([numbers(receiver, Frame(0, 0x120, data)) for data in replay])
    assert all(any(frame == other for other in again) for frame in live)


def test_silence_is_told_at_once_however_seldom_it_is_told(
    quick: ServiceConfig, receiver: Receiver
) -> None:
    """Told every 60 s, the last estimate stood as valid for up to so long."""
    bench = Bench(replace(quick, service=replace(quick.service, no_input_period_s=60.0)))
    told: list[int] = []

    def script() -> None:
        bench.drive_when_ready(50)
        before = len(bench.tap.estimates())
        bench.pause(500)
        during = verdicts(receiver, bench.tap.estimates()[before:])
        told.append(during.count((Status.INVALID, Reason.NO_INPUT)))

    bench.run(script)
    assert told[0] in {1, 2}  # a busy machine may have been silent for 20 ms before


def test_off_is_said_once_the_send_queue_has_room(quick: ServiceConfig, receiver: Receiver) -> None:
    """A queue that was full at the end left a valid estimate as the last word."""
    bench = Bench(quick)
    taken: list[Frame] = []
    refused: list[Frame] = []

    def script() -> None:
        bench.drive_when_ready(20)
        send = bench.tap._port.send

        def full(frame: Frame) -> bool:
            off = frame.can_id == ESTIMATE and verdicts(receiver, [frame])[0][0] == Status.OFF
            if off and len(refused) < 5:
                refused.append(frame)
                return False
            taken.append(frame)
            return send(frame)

        bench.tap._port.send = full  # type: ignore[method-assign]

    bench.run(script)
    assert len(refused) == 5
    last = [frame for frame in taken if frame.can_id == ESTIMATE][-1]
    assert verdicts(receiver, [last])[0][0] == Status.OFF


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
    status, reason = last_verdict(receiver, bench.tap.estimates())
    assert status == Status.INVALID
    assert reason & Reason.OTHER_TRANSMITTER


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


@pytest.mark.slow
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
        if frame.can_id != ESTIMATE or silent(receiver, frame):
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
