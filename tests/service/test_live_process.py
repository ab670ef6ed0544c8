"""The service as a process of its own, stopped for two seconds, then killed and started anew.

In real time: a rig that was recorded is played onto the bus, and what a listener then hears is
compared, by the physical instant that each frame claims, with what is true of that instant. Where
the player itself was late (it measures that), nothing is asked of the instants around; being
valid before a fault, and again within two seconds, is asked wherever it was not. User-Mode Linux
never keeps time: vcan0 is tried with ``EPS_HIL_KILL_ON_VCAN=1`` only, for kernels that have CAN
themselves.
"""

import contextlib
import gc
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.port import Port, open_port
from eps_hil.oracle.faults.judge import SPELL_NS, WRONG_N
from eps_hil.oracle.faults.stretch import MS
from eps_hil.oracle.faults.traffic import T0_NS, VALID, Published, World

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
BACK_S = 2.0
_SLIP_NS = 20 * MS
_AROUND_NS = (-60 * MS, 400 * MS)
_READY_S = 150.0


@dataclass
class Player:
    """Plays the recording from its start, and keeps what is heard meanwhile."""

    world: World
    port: Port
    heard: list[Published] = field(default_factory=list)
    epochs: list[tuple[int, int]] = field(default_factory=list)
    """(from when on, real ns; real ns of the recording's time 0)."""
    slips: list[int] = field(default_factory=list)
    """When it was too late to catch up, real ns."""

    def begin(self) -> None:
        """The rig starts: its first millisecond is now."""
        self._items = iter(self.world.recordings["demo"].items)
        self._next = next(self._items)
        now_ns = time.time_ns()
        self.epochs.append((now_ns, now_ns - T0_NS))

    def play(self, seconds: float) -> None:
        """So much of it, by absolute deadlines."""
        end_ns = self._next.at + round(seconds * 1e9)
        while self._next.at < end_ns:
            due_ns = self._next.at + self.epochs[-1][1]
            late_ns = time.time_ns() - due_ns
            if late_ns > _SLIP_NS:
                now_ns = time.time_ns()
                self.slips.append(now_ns)
                self.epochs.append((now_ns, now_ns - self._next.at))
            elif late_ns < -MS // 2:
                self.hear()
                time.sleep(max(0.0, (due_ns - time.time_ns()) * 1e-9))
            self.port.send(self._next.frame)
            self._next = next(self._items)
        self.hear()

    def hear(self) -> None:
        for frame in self.port.recv(0.0):
            if frame.can_id == self.world.reader.can_id:
                self.heard.append(self.world.reader.read(frame.t_ns, frame))

    def wrong(self) -> list[tuple[int, float]]:
        """(real ns, N) of estimates that are valid and too far from the truth of their instant."""
        recording = self.world.recordings["demo"]
        found = []
        for each in self.heard:
            if each.status != VALID or self._slipped(each.instant):
                continue
            epoch = next(zero for since, zero in reversed(self.epochs) if since <= each.at)
            local = each.instant - epoch
            k = int(np.searchsorted(recording.instants, local))
            if not 0 < k < len(recording.valid) or not recording.valid[k - 1 : k + 1].all():
                continue
            off = each.force_n - float(np.interp(local, recording.instants, recording.force_n))
            if abs(off) > WRONG_N:
                found.append((each.at, off))
        return found

    def valid_share(self, since_ns: int, until_ns: int) -> float:
        """Of what came within [since, until)."""
        came = [each.status == VALID for each in self.heard if since_ns <= each.at < until_ns]
        return float(np.mean(came)) if came else 0.0

    def first_valid_s(self, since_ns: int) -> float:
        """From ``since`` to the first valid estimate."""
        came = [each.at for each in self.heard if each.at > since_ns and each.status == VALID]
        return (came[0] - since_ns) * 1e-9 if came else float("inf")

    def _slipped(self, at_ns: int) -> bool:
        low, high = _AROUND_NS
        return any(low < at_ns - slip < high for slip in self.slips)


def longest_spell_ns(at: list[int]) -> int:
    """Of wrong frames that are less than a spell apart."""
    longest = begun = before = 0
    for now in at:
        begun = now if now - before > SPELL_NS else begun
        longest, before = max(longest, now - begun), now
    return longest


def start(config: Path) -> "subprocess.Popen[bytes]":
    words = [sys.executable, "-m", "eps_hil.cli", "run", "--config", str(config)]
    return subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip


def until_ready(service: "subprocess.Popen[bytes]") -> None:
    assert service.stdout is not None
    said, until_s = b"", time.monotonic() + _READY_S
    while b"READY" not in said:
        assert time.monotonic() < until_s, said
        assert service.poll() is None, said
        if select.select([service.stdout], [], [], 0.5)[0]:
            said += os.read(service.stdout.fileno(), 4096)


@contextlib.contextmanager
def hurried() -> Iterator[None]:
    """Real-time priority for the player, where permitted: a rig would have it too."""
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(10))
    except OSError:
        yield
        return
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@pytest.fixture(scope="module")
def world() -> World:
    return World([("demo", 16)])


ON_VCAN = [pytest.param("vcan", marks=pytest.mark.socketcan)]


@pytest.fixture(params=["udp", *(ON_VCAN if "EPS_HIL_KILL_ON_VCAN" in os.environ else [])])
def stage(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Path, Port]]:
    """A configuration, and a port on its bus."""
    if request.param == "vcan":
        interface, channel = "socketcan", request.getfixturevalue("vcan0")
        options, fd = {}, False
    else:
        number = 44_000 + hash(str(tmp_path)) % 10_000
        interface, channel, fd = "udp_multicast", "239.74.163.89", True
        options = {"port": number, "hop_limit": 0}
    config = tmp_path / "c.yaml"
    bus = f"{{interface: {interface}, channel: {channel}, fd: {str(fd).lower()}, "
    config.write_text(
        f"bus: {bus}options: {options}}}\n".replace("'", "")
        + f"dbc: [{ROOT}/dbc/eps_rig.dbc]\nsignals: {ROOT}/configs/eps_rig_signals.yaml\n"
        f"model: {ROOT}/configs/reference_rig.yaml\n"
    )
    port = open_port(interface, channel, fd=fd, options=options)
    yield config, port
    port.close()


def test_stopped_then_killed_and_started_anew(stage: tuple[Path, Port], world: World) -> None:
    config, port = stage
    with hurried():
        _stopped_then_killed(config, Player(world, port))


def _stopped_then_killed(config: Path, player: Player) -> None:
    service = start(config)
    faults: list[tuple[str, int, int]] = []
    try:
        until_ready(service)
        player.begin()
        player.play(3.0)
        before_ns = time.time_ns()
        service.send_signal(signal.SIGSTOP)
        player.play(2.0)
        service.send_signal(signal.SIGCONT)
        faults.append(("stopped for 2 s", before_ns, time.time_ns()))
        player.play(3.0)
        before_ns = time.time_ns()
        service.kill()
        service.wait()
        player.play(0.5)
        service = start(config)
        until_ready(service)
        player.hear()
        faults.append(("killed", before_ns, time.time_ns()))
        player.begin()  # the rig waited for it
        player.play(3.0)
    finally:
        service.kill()
        service.wait()
        time.sleep(0.1)
        player.hear()
    wrong = player.wrong()
    assert longest_spell_ns([at for at, _ in wrong]) <= SPELL_NS, wrong[:5]
    assert len(player.heard) > 100
    for what, before_ns, end_ns in faults:
        late = [at for at in player.slips if before_ns - 1_000 * MS < at < end_ns + 2_500 * MS]
        if late:
            print(f"{what}: not asked, this machine kept no time ({len(late)} slips)")
            continue
        assert player.valid_share(before_ns - 1_000 * MS, before_ns) > 0.9, f"before {what}"
        assert player.first_valid_s(end_ns) < BACK_S, what
        assert player.valid_share(end_ns + 2_000 * MS, end_ns + 2_900 * MS) > 0.9, what
    print(f"valid: {player.valid_share(0, 1 << 62):.0%} of {len(player.heard)}")
