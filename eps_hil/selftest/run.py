"""The whole self-test, line by line, each guarded: a machine that lacks something is told so."""

import resource
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_hil import examples
from eps_hil.bus.database import find_message
from eps_hil.selftest import (
    bus_listen,
    can_interface,
    compute,
    disk,
    sockets,
    system,
    wake_ups,
)
from eps_hil.selftest.check import Check, guarded
from eps_hil.service.config import load_config
from eps_hil.service.setup import Parts, prepare

_QUICK_S, _QUICK_MIB, _MIB = 0.3, 4, 32


@dataclass(frozen=True, slots=True)
class Plan:
    """What is measured: ``seconds`` for each timing, ``folder`` for the disk.

    ``config`` None: the example configuration, and no bus is opened.
    """

    config: Path | None = None
    seconds: float = 3.0
    folder: Path = Path()
    quick: bool = False

    @property
    def timed_s(self) -> float:
        """Length of each timing."""
        return min(self.seconds, _QUICK_S) if self.quick else self.seconds


Measure = tuple[str, str, Callable[[], Sequence[Check]]]


def checks(plan: Plan, began: Callable[[str], None] = lambda _: None) -> Iterator[Check]:
    """Every line, in order; ``began`` is told what is measured next.

    :class:`~eps_hil.errors.InputError` for a wrong configuration, before anything is measured.
    """
    file = plan.config or examples.CONFIGS / "demo_udp.yaml"
    parts = prepare(load_config(file), file)
    for id, what, measure in (*_machine(plan, parts), *_bus(plan, parts)):
        began(what)
        yield from guarded(id, what, measure)


def _machine(plan: Plan, parts: Parts) -> Sequence[Measure]:
    seconds, priority = plan.timed_s, parts.config.service.priority
    mib = _QUICK_MIB if plan.quick else _MIB
    rate = _frames_per_s(parts)
    return (
        ("python", "Python and machine", system.facts),
        ("clock_source", "clocks", lambda: system.judge_clock(system.clock())),
        ("wake_ups", "1 kHz wake-ups", lambda: _wake_ups(seconds, priority)),
        ("cache", "compiled code", lambda: [compute.judge_cache(compute.compiled_cache())]),
        ("step", "one step", lambda: [compute.judge_step(compute.service_step(parts))]),
        ("gc", "garbage collection",
         lambda: [compute.judge_collections(compute.collections())]),
        ("loopback", "frame to another process",
         lambda: [sockets.judge_loopback(sockets.loopback(seconds, priority))]),
        ("receive_buffer", "receive buffer",
         lambda: [sockets.judge_room(sockets.receive_room(), _socketcan(plan, parts))]),
        ("software_stamps", "receive stamps", lambda: [sockets.software_stamps()]),
        ("disk", f"writing to {plan.folder.resolve()}",
         lambda: _disk(plan.folder, mib, rate)),
    )  # fmt: skip


def _disk(folder: Path, mib: int, rate: float) -> Sequence[Check]:
    try:
        return disk.judge(disk.measure(folder, mib), rate)
    except OSError as error:
        return [disk.refused(folder, error)]


def _wake_ups(seconds: float, priority: int) -> list[Check]:
    normal, fifo = wake_ups.measure(seconds, 0), wake_ups.measure(seconds, priority)
    rights = wake_ups.judge_rights(
        fifo, _limit(getattr(resource, "RLIMIT_RTPRIO", None)), _limit(resource.RLIMIT_MEMLOCK)
    )
    return [*rights, *wake_ups.judge(normal, fifo)]


def _limit(number: int | None) -> str:
    if number is None:
        return "unknown"
    soft, _ = resource.getrlimit(number)
    return "unlimited" if soft == resource.RLIM_INFINITY else str(soft)


def _socketcan(plan: Plan, parts: Parts) -> bool:
    return plan.config is not None and parts.config.bus.interface == "socketcan"


def _bus(plan: Plan, parts: Parts) -> Sequence[Measure]:
    bus, wanted = parts.config.bus, _socketcan(plan, parts)

    def kernel() -> Sequence[Check]:
        refused, found = can_interface.kernel_has_can(), can_interface.interfaces()
        lines = [can_interface.judge_kernel(refused, found, wanted)]
        if wanted and not refused:
            load = can_interface.load_bit_s(_messages(parts))
            lines += can_interface.judge_interface(bus.channel, found, load)
        return lines

    measures: list[Measure] = [("socketcan", "SocketCAN", kernel)]
    if plan.config is not None:
        measures.append(
            ("bus", f"frames on {bus}",
             lambda: bus_listen.judge(bus_listen.listen(parts, plan.timed_s), str(bus)))
        )  # fmt: skip
    return measures


def _messages(parts: Parts) -> Sequence[tuple[Any, float | None]]:
    """What the service listens to and what it sends, of cantools, with cycle times in s."""
    config = parts.config
    names = {source.carrier for source in parts.mapping.signals.values() if source.carrier}
    if config.publish.enabled:
        names |= {name for name in (config.publish.message, config.publish.health_message) if name}
    found = [find_message(parts.database, name) for name in sorted(names)]
    return [(message, _cycle_s(parts, message)) for message in found if message is not None]


def _cycle_s(parts: Parts, message: Any) -> float | None:
    if message.name == parts.config.publish.message:  # one with every sync frame
        return parts.sync_period_s
    return parts.mapping.rules(message.name).cycle_s(message)


def _frames_per_s(parts: Parts) -> float:
    """Frames that a recorder of this bus has to write."""
    cycles_s = [_cycle_s(parts, message) for message in parts.database.messages]
    return sum(1.0 / cycle_s for cycle_s in cycles_s if cycle_s) or 1_000.0
