"""What a replay plays, what it leaves out, when it stops for somebody else, pause and step."""

import contextlib
import os
import pty
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from eps_hil.bus import replay
from eps_hil.bus.commands import OWN, Command, Kind
from eps_hil.bus.frame import Frame
from eps_hil.bus.live_senders import LiveSenders
from eps_hil.bus.port import Port, open_port
from eps_hil.bus.replay_choice import Choice, between, refuse_asked, scan
from eps_hil.bus.replay_controls import ReplayControls
from eps_hil.errors import BusError, InputError

GROUP = "239.74.163.2"


def test_commands_stay_out_whatever_is_asked_for() -> None:
    choice = Choice(ids={0x80, 0xA0, 0x100})
    played = [
        choice(Frame(0, 0x80, b"")),
        choice(Frame(0, 0x80, b"", extended=True)),
        choice(Frame(0, 0xA0, b"", fd=True)),
        choice(Frame(0, 0x80, b"", remote=True)),
        choice(Frame(0, 0x100, b"")),
    ]
    assert played == [False, False, False, False, True]
    assert (dict(choice.commands), choice.skipped) == ({0x80: 3, 0xA0: 1}, 0)
    assert choice.left_out().startswith("0x80 EPSHIL_TorqueOverride (commands a torque) 3 x, 0xA0")


def test_ids_that_are_not_asked_for_stay_out_and_are_counted() -> None:
    choice = Choice(without={0x101}, commands={0x7: Command(0x7, "X", Kind.TORQUE)})
    frames = [Frame(0, i, b"") for i in (0x7, 0x80, 0x101)] + [Frame(0, 0x7, b"", error=True)]
    assert [choice(frame) for frame in frames] == [False, True, False, False]
    assert (dict(choice.commands), choice.skipped) == ({0x7: 1}, 2)


def test_the_player_leaves_commands_out_by_default_and_the_port_would_refuse_them(
    udp_port: int,
) -> None:
    options = {"port": udp_port, "hop_limit": 0}
    listener = open_port("udp_multicast", GROUP, options=options)
    player = open_port("udp_multicast", GROUP, options=options)
    frames = [Frame(k * 1000, 0x80 if k % 2 else 0x101, bytes([k])) for k in range(40)]
    report = replay.replay(frames, player)
    assert (report.sent, report.commands) == (20, {0x80: 20})
    with pytest.raises(BusError, match="0x80 commands a torque"):
        replay.replay(frames, player, choice=Choice(commands={}))  # a bug: nothing left out
    heard = []
    while batch := listener.recv(0.2):
        heard += batch
    assert {frame.can_id for frame in heard} == {0x101}
    player.close()
    listener.close()


def test_asking_for_a_command_is_refused_with_the_way_to_go() -> None:
    with pytest.raises(InputError, match=r"0x80 EPSHIL_TorqueOverride .* --commands with --config"):
        refuse_asked({0x80, 0x100}, OWN)
    refuse_asked({0x100}, OWN)


def test_the_scan_knows_what_will_be_sent_and_what_not() -> None:
    frames = [Frame(k, 0x80 if k % 2 else 0x101, b"", extended=bool(k % 4)) for k in range(20)]
    seen = scan(frames, Choice())
    assert (seen.frames, seen.whole, dict(seen.choice.commands)) == (20, True, {0x80: 10})
    assert seen.keys == {(0x101, False), (0x101, True)}
    assert not scan(frames, Choice(), limit=5).whole


def test_a_window_of_a_log() -> None:
    frames = [Frame(10**18 + k * 100_000_000, k, b"") for k in range(50)]
    found = between(replay.offsets(frames), 0.25, 0.6)
    assert [frame.can_id for frame in found] == [3, 4, 5]
    assert [f.can_id for f in between(replay.offsets(frames), 4.75, None)] == [48, 49]


@pytest.fixture
def two_ports(udp_port: int) -> Iterator[tuple[Port, Port]]:
    options = {"port": udp_port, "hop_limit": 0}
    made = open_port("udp_multicast", GROUP, options=options)
    other = open_port("udp_multicast", GROUP, options=options)
    yield made, other
    made.close()
    other.close()


def test_a_live_sender_is_not_talked_over(two_ports: tuple[Port, Port]) -> None:
    ours, other = two_ports
    live = LiveSenders(ours, {(0x101, False), (0x100, False)}, lambda ids: f"say --without {ids}")
    live.listen(0.05)  # nobody
    for can_id, extended in ((0x101, False), (0x100, True), (0x200, False)):
        other.send(Frame(0, can_id, b"", extended=extended))
    with pytest.raises(BusError, match=r"ids 0x101 are sent by somebody .* --without 0x101"):
        live.listen(0.1)


def test_what_came_while_the_log_was_looked_through_counts(two_ports: tuple[Port, Port]) -> None:
    """Reading the log may take longer than the time to listen: 3,000 frames wait by then."""
    ours, other = two_ports
    for k in range(3_000):
        while not other.send(Frame(0, 0x200 if k < 2_900 else 0x101, b"")):
            time.sleep(0.001)
    time.sleep(0.1)
    with pytest.raises(BusError, match="0x101 are sent by somebody else already"):
        LiveSenders(ours, {(0x101, False)}).listen(-5.0)


def test_who_begins_to_send_while_it_plays_ends_it(two_ports: tuple[Port, Port]) -> None:
    ours, other = two_ports
    frames = [Frame(k * 1_000_000, 0x101, b"") for k in range(5_000)]
    live = LiveSenders(ours, {(0x101, False)})
    live.listen(0.02)
    timer = threading.Timer(0.15, lambda: other.send(Frame(0, 0x101, b"")))
    timer.start()
    started_s = time.monotonic()
    with pytest.raises(BusError, match="0x101 are now sent by somebody else too"):
        replay.replay(frames, ours, live=live)
    assert time.monotonic() - started_s < 1.0
    timer.join()


def test_an_id_that_comes_late_in_the_log_is_looked_up_too(two_ports: tuple[Port, Port]) -> None:
    ours, other = two_ports
    live = LiveSenders(ours, {(0x101, False)})
    other.send(Frame(0, 0x300, b""))
    live.listen(0.1)
    with pytest.raises(BusError, match="0x300 are sent by somebody else"):
        replay.replay([Frame(0, 0x101, b""), Frame(1, 0x300, b"")], ours, live=live)
    assert ours.counts.sent == 1


def test_what_is_no_frame_of_somebody_does_not_stop_it(two_ports: tuple[Port, Port]) -> None:
    ours, other = two_ports
    live = LiveSenders(ours, {(0x101, False), (0x4, False)})
    other.send(Frame(0, 0x101, b"", remote=True))
    other.send(Frame(0, 0x4, bytes(8), error=True))
    ours.send(Frame(0, 0x101, b""))  # our own
    live.listen(0.1)


class Sink:
    def __init__(self) -> None:
        self.sent: list[float] = []

    def send(self, frame: Frame) -> bool:
        self.sent.append(time.monotonic())
        return True


def wait_for(true: Callable[[], bool]) -> None:
    until_s = time.monotonic() + 10.0
    while not true():
        assert time.monotonic() < until_s
        time.sleep(0.005)


def test_pause_step_and_going_on() -> None:
    """Paused it sends what it is told, one by one; afterwards the spacing is the log's again."""
    frames = [Frame(k * 50_000_000, 0x100 + k, b"") for k in range(8)]
    sink, controls, stepped = Sink(), ReplayControls(), []
    controls.paused = True
    reports = []

    def play() -> None:
        reports.append(
            replay.replay(
                frames, sink, controls=controls,  # type: ignore[arg-type]
                on_step=lambda t_ns, frame: stepped.append((t_ns, frame.can_id)),
            )
        )  # fmt: skip

    thread = threading.Thread(target=play)
    thread.start()
    time.sleep(0.1)
    assert sink.sent == []
    for k in range(3):
        controls.step()
        wait_for(lambda k=k: len(sink.sent) == k + 1)  # type: ignore[misc]
    time.sleep(0.1)
    assert len(sink.sent) == 3
    assert stepped == [(0, 0x100), (50_000_000, 0x101), (100_000_000, 0x102)]
    resumed_s = time.monotonic()
    controls.toggle()
    thread.join(10.0)
    gaps = [after - before for before, after in zip([resumed_s, *sink.sent[3:]], sink.sent[3:])]  # noqa: B905
    assert len(gaps) == 5
    assert all(gap > 0.025 for gap in gaps[1:])  # no burst to catch up with the pause
    assert 0.2 < sink.sent[-1] - resumed_s < 0.6
    assert reports[0].late_max_ns < 200_000_000  # a pause is no lateness


def test_quit_ends_a_paused_replay() -> None:
    controls = ReplayControls()
    controls.paused = True
    threading.Timer(0.1, lambda: setattr(controls, "quit", True)).start()
    report = replay.replay([Frame(0, 0x100, b"")], Sink(), controls=controls)  # type: ignore[arg-type]
    assert report.stopped
    assert report.sent == 0


def test_signals_pause_and_step_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    with Path(os.devnull).open() as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        controls = ReplayControls()
        before = signal.getsignal(signal.SIGUSR1), signal.getsignal(signal.SIGUSR2)
        try:
            with controls.open() as keys:
                assert not keys
                os.kill(os.getpid(), signal.SIGUSR1)
                assert controls.paused
                os.kill(os.getpid(), signal.SIGUSR2)
                assert controls.take_step()
                assert not controls.take_step()
                os.kill(os.getpid(), signal.SIGUSR1)
                assert not controls.paused
        finally:
            signal.signal(signal.SIGUSR1, before[0])
            signal.signal(signal.SIGUSR2, before[1])


KEYS = """
import time
from eps_hil.bus.replay_controls import ReplayControls
controls = ReplayControls()
with controls.open() as keys:
    print("keys", keys, flush=True)
    until_s = time.monotonic() + 10.0
    while not controls.quit and time.monotonic() < until_s:
        controls.look()
        time.sleep(0.005)
steps = [controls.take_step() for _ in range(3)]
print("paused", controls.paused, "steps", *steps)
"""


def test_keys_of_a_terminal() -> None:
    """In a process of its own, whose terminal is the pseudo-terminal."""
    pid, master = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", KEYS])
    said = b""
    with contextlib.suppress(OSError):  # the end of a pseudo-terminal is an error
        while b"keys True" not in said:
            said += os.read(master, 1000)
        os.write(master, b" n")
        time.sleep(0.05)
        os.write(master, b"sq")
        while True:
            said += os.read(master, 1000)
    os.waitpid(pid, 0)
    os.close(master)
    assert b"paused True steps True True False" in said
