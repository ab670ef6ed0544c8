"""What one step costs, what the garbage collector costs, and whether compiled code is kept."""

import gc
import os
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import find_message
from eps_hil.selftest.check import Check, Verdict, graded
from eps_hil.service.realtime import hurry
from eps_hil.service.setup import Parts

_GOOD_STEP_US, _LIMITED_STEP_US = 250.0, 500.0
_GOOD_PAUSE_MS, _LIMITED_PAUSE_MS = 0.2, 1.0
_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class StepCost:
    """``of``: what was timed; ``warm_up_s``: loading or compiling the machine code before it."""

    of: str
    warm_up_s: float
    p50_us: float
    p99_us: float
    fifo: bool = False


def service_step(parts: Parts, steps: int = 2_000) -> StepCost:
    """One cycle of the configuration's input frames through decoding, step and encoding.

    At the priority that the service will have, where that is granted: else what other programs
    take would count as the step's. In a thread, because the priority is gone with it.
    """
    began = time.perf_counter()
    parts.warm_up()
    warm_up_s = time.perf_counter() - began
    with ThreadPoolExecutor(1) as thread:
        spent, of, fifo = thread.submit(_timed, parts, steps).result()
    return StepCost(f"{of} frames of the configuration", warm_up_s, *_quantiles(spent), fifo)


def _timed(parts: Parts, steps: int) -> tuple[list[int], int, bool]:
    """Nanoseconds of each step, how many frames it has, and whether at real-time priority."""
    sync = parts.mapping.sync_message
    carriers = {source.carrier for source in parts.mapping.signals.values() if source.carrier}
    names = sorted(carriers, key=lambda name: (name == sync, name))  # the sync frame last
    encoders = [FrameEncoder(parts.database, name) for name in names]
    zeros = [_zeros(parts.database, name) for name in names]
    service = parts.config.service
    fifo = hurry("off" if service.realtime == "off" else "auto", service.priority)
    spent: list[int] = []
    for k in range(steps):
        frames = [
            replace(encoder.frame(values), t_ns=k * _MS + 1_000 * place)
            for place, (encoder, values) in enumerate(zip(encoders, zeros, strict=True))
        ]
        began_ns = time.perf_counter_ns()
        parts.core.on_frames(frames)
        spent.append(time.perf_counter_ns() - began_ns)
    return spent, len(names), fifo.startswith("SCHED_FIFO")


def _zeros(database: Any, name: str) -> dict[str, float]:
    message = find_message(database, name)
    return {} if message is None else {signal.name: 0.0 for signal in message.signals}


def _quantiles(spent_ns: list[int]) -> tuple[float, float]:
    ordered = sorted(spent_ns[len(spent_ns) // 10 :])  # the first ones warm the caches up
    return ordered[len(ordered) // 2] * 1e-3, ordered[int(0.99 * len(ordered))] * 1e-3


def judge_step(cost: StepCost) -> Check:
    """A quarter of the period, so that a frame that came late is answered in time all the same."""
    verdict = graded(cost.p99_us, _GOOD_STEP_US, _LIMITED_STEP_US)
    how = "SCHED_FIFO" if cost.fifo else "normal priority"
    return Check(
        "step", f"one step ({cost.of})",
        f"p50 {cost.p50_us:.0f} us, p99 {cost.p99_us:.0f} us ({how}); "
        f"code ready in {cost.warm_up_s:.1f} s",
        f"p99 {_GOOD_STEP_US:.0f} us", verdict,
        "a quarter of the period: late frames must not pile up",
        "" if verdict == Verdict.GOOD else "a faster CPU, or end what runs beside it",
        cost.p99_us, "us",
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Pauses:
    """A full garbage collection in ms, before and after ``gc.freeze()``."""

    before_ms: float
    after_ms: float


def collections() -> Pauses:
    """Measured in this process, whose heap is unfrozen again afterwards."""
    gc.collect()
    before_ms = min(_collection_ms() for _ in range(3))
    gc.freeze()
    try:
        after_ms = max(_collection_ms() for _ in range(5))
    finally:
        gc.unfreeze()
    return Pauses(before_ms, after_ms)


def _collection_ms() -> float:
    began = time.perf_counter_ns()
    gc.collect()
    return (time.perf_counter_ns() - began) * 1e-6


def judge_collections(found: Pauses) -> Check:
    """The service freezes its heap; what is left must not be felt."""
    verdict = graded(found.after_ms, _GOOD_PAUSE_MS, _LIMITED_PAUSE_MS)
    return Check(
        "gc", "garbage collection, heap frozen",
        f"{found.after_ms:.3f} ms ({found.before_ms:.0f} ms unfrozen)", f"{_GOOD_PAUSE_MS} ms",
        verdict, "a fifth of the period; the service freezes its heap before the bus is opened",
        "" if verdict == Verdict.GOOD else "a faster CPU, or end what runs beside it",
        found.after_ms, "ms",
    )  # fmt: skip


def compiled_cache() -> Path:
    """Where machine code is kept."""
    from eps_hil.compiled import FOLDER

    return Path("no folder") if FOLDER is None else FOLDER


def judge_cache(folder: Path) -> Check:
    """A folder that can be written: else each start compiles everything again."""
    writable = _writable(folder)
    said = "writable" if writable else "NOT writable"
    return Check(
        "cache", "cache of compiled code", f"{folder}, {said}",
        "writable", Verdict.GOOD if writable else Verdict.LIMITED,
        "else each start compiles for some ten seconds, beside a bus that waits",
        "" if writable else "export XDG_CACHE_HOME=<a folder that you may write>",
    )  # fmt: skip


def _writable(folder: Path) -> bool:
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        return False
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
