"""The listener on the bus: its samples and figures go to the server's process, or are dropped.

The port can send nothing, the server has none. Nothing here waits for the server: what it does not
take in time is counted and left out.
"""

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from eps_hil import compiled
from eps_hil.board import notices
from eps_hil.bus.database import find_message, load_database
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.port import Port
from eps_hil.bus.reconnecting_port import ReconnectingPort
from eps_hil.dashboard.collect import Collector
from eps_hil.dashboard.store import Block
from eps_hil.dashboard.traces import BALANCE, MEASURED
from eps_hil.dashboard.wire import pack
from eps_hil.dashboard.words import Source, state_of
from eps_hil.monitor.alarm import limits_of
from eps_hil.monitor.view_model import Monitor
from eps_hil.physics.model import load_model
from eps_hil.service.config import ServiceConfig

BATCH_S, STATE_S = 0.04, 0.25
_PAUSE_S = 0.01
"""Between two looks at the bus. Frames wait in the kernel, stamped; woken by each of them, this
process would take a core from the service thousands of times a second."""
SAMPLES, STATE = b"S", b"J"
_WARM = """
import os, sys
os.nice(19)
from eps_hil.monitor.residual import warm_up
from eps_hil.physics.model import load_model
warm_up(load_model(sys.argv[1]))
"""
_PIECE = 700
"""Samples of a trace in one message: all traces stay below a socket's buffer."""
_PENDING, _FEW, _MANY = 250, 20, 1000
"""Messages that wait for the server (10 s); frames that are few, that are many."""


class Taker(Protocol):
    """Where a listener's samples and figures go; ``dropped`` counts what was not taken."""

    dropped: int

    def samples(self, blocks: dict[str, Block]) -> None:
        """Of all traces, since the last call."""

    def state(self, content: dict[str, Any]) -> None:
        """The newest figures."""

    def flush(self) -> bool:
        """Send what can be sent; False when nobody is at the other end."""


class Outlet:
    """Messages to the server's process by a socket that never blocks.

    What does not fit waits, the oldest is dropped first; ``dropped`` counts them.
    """

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._end = end
        self._pending: deque[bytes] = deque()
        self.dropped = 0

    def samples(self, blocks: dict[str, Block]) -> None:
        """Of all traces, in pieces that fit a socket."""
        longest = max((len(t_ns) for t_ns, _ in blocks.values()), default=0)
        for begin in range(0, longest, _PIECE):
            cut = slice(begin, begin + _PIECE)
            piece = {name: (t[cut], v[cut]) for name, (t, v) in blocks.items() if len(t[cut])}
            self._put(SAMPLES + pack(piece))

    def state(self, content: dict[str, Any]) -> None:
        """The newest figures."""
        self._put(STATE + json.dumps(content, ensure_ascii=False).encode())

    def _put(self, message: bytes) -> None:
        self._pending.append(message)
        while len(self._pending) > _PENDING:
            self._pending.popleft()
            self.dropped += 1
        self.flush()

    def flush(self) -> bool:
        """Send what can be sent; False when nobody is at the other end."""
        try:
            while self._pending:
                self._end.send(self._pending[0])
                self._pending.popleft()
        except BlockingIOError:
            return True
        except OSError:
            return False
        return True


class Listener:
    """Monitor and collector of one configuration."""

    def __init__(self, config: ServiceConfig) -> None:
        mapping = load_mapping(config.signals)
        database = load_database(config.dbc, strict=mapping.strict)
        model = load_model(config.model)
        self.collector = Collector(model, frozenset(mapping.signals))
        self.monitor = Monitor(config, limits_of(model), ear=self.collector)
        published = find_message(database, config.publish.message)
        self.estimate: Source | None = (
            None if published is None else (published.name, int(published.frame_id))
        )
        self.sources: dict[str, Source] = {}
        for name, source in mapping.signals.items():
            message = None if source.carrier is None else find_message(database, source.carrier)
            if message is not None and message.name != config.publish.message:
                self.sources[name] = (message.name, int(message.frame_id))

        self.mapped = tuple(name for name in mapping.signals if name in MEASURED)
        self._bus, self._model_file = str(config.bus), config.model
        self._balanced_ns = 0
        self._warm = threading.Event()
        self._compiling: subprocess.Popen[bytes] | None = None

    def warm_up(self) -> None:
        """Load or compile the residual's code; the page moves meanwhile, without that figure.

        Compiling is another process' work, at the lowest priority: here it would keep the frames
        waiting, and what rig and service compile at the same time is wanted first.
        """

        def work() -> None:
            if compiled.FOLDER is not None:
                self._compiling = subprocess.Popen(
                    [sys.executable, "-c", _WARM, str(self._model_file)],
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )  # fmt: skip
                if self._compiling.wait() < 0:
                    return  # closed
            self.monitor.warm_up()
            self._warm.set()

        threading.Thread(target=work, daemon=True).start()

    def close(self) -> None:
        """What still compiles ends with us."""
        if self._compiling is not None:
            self._compiling.kill()

    def balance(self) -> dict[str, Block]:
        """The torque balance that the last state went by, what is new of it."""
        found = self.monitor.balance
        if found is None:
            return {}
        t_ns, left_n = found
        if self._balanced_ns > t_ns[-1] + 1_000_000_000:
            self._balanced_ns = 0  # the clock was set back
        new = t_ns > self._balanced_ns
        if not new.any():
            return {}
        self._balanced_ns = int(t_ns[-1])
        return {BALANCE: (t_ns[new], left_n[new])}

    def state(self, port: ReconnectingPort | Port) -> dict[str, Any]:
        """What the page shows beside its plots."""
        loading = not self._warm.is_set()
        figures = self.monitor.figures(time.time_ns(), port.counts, port.state, loading=loading)
        outages = getattr(port, "outages", [])
        lost = outages[-1].reason if outages and not outages[-1].until_ns else ""
        jobs = notices(self._bus)
        return state_of(figures, self.sources, self.estimate, lost, jobs)


def stand_back() -> None:
    """This process interrupts nobody: what wakes up keeps whoever runs running (SCHED_BATCH)."""
    if hasattr(os, "SCHED_BATCH"):  # a container may refuse it: the policy then stays
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def listen(
    listener: Listener,
    port: ReconnectingPort | Port,
    outlet: Taker,
    stop: Callable[[], bool] = lambda: False,
) -> bool:
    """Until ``stop``, or nobody takes it any more (then False); closes the port."""
    next_batch_s = next_state_s = time.monotonic()
    try:
        while not stop():
            frames = port.recv(0.0)
            listener.monitor.take(frames)
            if len(frames) < _MANY:
                time.sleep(_PAUSE_S)
            now_s = time.monotonic()
            if now_s >= next_batch_s:
                next_batch_s = max(next_batch_s + BATCH_S, now_s)
                outlet.samples(listener.collector.drain())
                if not outlet.flush():
                    return False
            if now_s >= next_state_s:
                next_state_s = max(next_state_s + STATE_S, now_s)
                if not _catch_up(listener.monitor, port):
                    continue  # ages of frames that wait to be read would be told as silence
                outlet.state(listener.state(port) | {"dropped": outlet.dropped})
                outlet.samples(listener.balance())
        return True
    finally:
        port.close()
        listener.close()


def _catch_up(monitor: Monitor, port: ReconnectingPort | Port) -> bool:
    """Take what waits, for as long as a batch lasts; whether nothing is left."""
    until_s = time.monotonic() + BATCH_S
    while time.monotonic() < until_s:
        frames = port.recv(0.0)
        monitor.take(frames)
        if len(frames) < _FEW:
            return True
    return False
