"""A bus that is only listened to: samples of the mapped signals, handed on at each sync frame."""

import asyncio
import contextlib
import math
import signal
from collections.abc import Callable, Mapping
from typing import Protocol

from eps_hil.bus.codec import FrameDecoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.port import open_port
from eps_hil.errors import BusError
from eps_hil.estimation.stream import SIGNALS
from eps_hil.service.config import ServiceConfig
from eps_hil.service.latest import LatestValues
from eps_hil.service.setup import GATING, service_mapping

_LOOK_S = 0.1


def silent(config: ServiceConfig, message: str | None, silence_s: float) -> str:
    """What is said where nothing comes."""
    return f"{config.bus}: no frame {message} for {silence_s:g} s; is the rig on this bus?"


class Listens(Protocol):
    """Who is told."""

    def step(self, t_ns: int, values: Mapping[str, float]) -> None:
        """The newest values at a sync frame."""


class Listener:
    """One run; the port it opens cannot send."""

    def __init__(self, config: ServiceConfig, target: Listens) -> None:
        mapping = service_mapping(load_mapping(config.signals), (*SIGNALS, *GATING))
        database = load_database(config.dbc, strict=mapping.strict)
        self._decoder = FrameDecoder(
            database, mapping, mapping_file=config.signals,
            dbc_file=" + ".join(path.name for path in config.dbc),
        )  # fmt: skip
        self._config, self._target = config, target
        self._latest = LatestValues(self._decoder.period_s)
        self._failure: BaseException | None = None
        self._sync_name, self._syncs = mapping.sync_message, 0

    async def run(
        self,
        over: Callable[[], bool],
        show: Callable[[], None],
        duration_s: float | None = None,
        silence_s: float = math.inf,
    ) -> None:
        """Until ``over``, ``duration_s``, SIGINT or SIGTERM.

        :class:`BusError` on a lost bus, and where no sync frame came for ``silence_s``.
        """
        loop, bus = asyncio.get_running_loop(), self._config.bus
        self._done = asyncio.Event()
        with contextlib.suppress(RuntimeError, ValueError):  # not in the main thread
            for number in (signal.SIGINT, signal.SIGTERM):
                loop.add_signal_handler(number, self._done.set)
        port = open_port(
            bus.interface, bus.channel, fd=bus.fd, receive_ids=self._decoder.receive_ids,
            send_ids=(), options=bus.options,
        )  # fmt: skip
        port.start(loop, self._deliver, self._lost)
        syncs, heard_s = self._syncs, loop.time()
        end_s = None if duration_s is None else loop.time() + duration_s
        try:
            while not (self._done.is_set() or over() or (end_s and loop.time() >= end_s)):
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._done.wait(), _LOOK_S)
                show()
                if self._syncs > syncs:
                    syncs, heard_s = self._syncs, loop.time()
                if loop.time() - heard_s > silence_s and not self._done.is_set():
                    raise BusError(silent(self._config, self._sync_name, silence_s))
        finally:
            port.close()
        if self._failure is not None:
            raise self._failure

    def _deliver(self, frames: list[Frame]) -> None:
        for frame in frames:
            if frame.own or frame.error:
                continue
            samples = self._decoder.decode(frame)
            for name, t_ns, value in samples:
                self._latest.take(name, t_ns, value)
            if samples and self._decoder.sync(frame):
                self._syncs += 1
                t_ns = samples[0].t_ns
                self._target.step(t_ns, self._latest.at(t_ns))

    def _lost(self, reason: str) -> None:
        self._failure = BusError(f"{self._config.bus}: the bus is lost: {reason}")
        self._done.set()
