"""The running diagnosis, as the page's server has it: one at a time, each a process of its own.

The process is given the samples as they were stamped, runs at the lowest priority on one core, and
is ended with its order. What it found is kept in a folder that goes with the server.
"""

import asyncio
import contextlib
import json
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.dashboard.order import PAGE, RESULT, SAMPLES, Order
from eps_hil.dashboard.store import Store

LEAST_S, LONGEST_S = 8.0, 900.0
"""A stretch that is worth a diagnosis; and what one order may hold on to memory and time for."""
COMMAND = (sys.executable, "-m", "eps_hil.dashboard.stretch")
_KEPT = 12
_END_S = 5.0
_ONE_CORE = {
    name: "1"
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
}


@dataclass(frozen=True, slots=True)
class Subject:
    """What a diagnosis is of: the model file, and where samples come from.

    ``measured``: the signals that are on the bus; ``late_ns``: how much later than what they speak
    of they are stamped. A ``recording`` is read anew, with ``dbc`` and ``signals``.
    """

    model: Path
    measured: tuple[str, ...] = ()
    late_ns: tuple[int, ...] = ()
    recording: Path | None = None
    dbc: tuple[Path, ...] = ()
    signals: Path | None = None
    limit_n: float = 0.0
    """Torque balance, N rms, beyond which the monitor raises its alarm."""


class Diagnoses:
    """What runs, and what was found. ``number`` goes up with every change."""

    def __init__(self, subject: Subject, name: str) -> None:
        self._subject, self._name = subject, name
        self._folder = tempfile.TemporaryDirectory(prefix="eps_hil-page-")
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None
        self._ends: set[asyncio.Task[None]] = set()
        self._running: dict[str, Any] | None = None
        self._found: list[dict[str, Any]] = []
        self._said = ""
        self._count = 0
        self.number = 0

    def as_json(self) -> dict[str, Any]:
        """For the page."""
        return {"running": self._running, "said": self._said, "found": self._found}

    def report(self, count: int) -> Path | None:
        """The page of a diagnosis that is kept."""
        path = Path(self._folder.name) / str(count) / PAGE
        return path if any(one["number"] == count for one in self._found) else None

    def start(self, store: Store, begin_s: float, end_s: float) -> None:
        """Diagnose a stretch; what speaks against it is said in :meth:`as_json`."""
        if self._running is not None:
            return
        problem = self._against(store, begin_s, end_s)
        if problem:
            self._say(problem)
            return
        self._count += 1
        folder = Path(self._folder.name) / str(self._count)
        folder.mkdir()
        order = self._order(begin_s, end_s, folder)
        samples = {} if order.recording else self._samples(store, order)
        self._running = {
            "from_s": begin_s, "to_s": end_s, "stage": "starting", "part": 0.0,
            "since_s": time.time(),
        }  # fmt: skip
        self._say("")
        self._task = asyncio.get_running_loop().create_task(self._run(order, samples))

    def cancel(self) -> None:
        """End what runs."""
        if self._running is not None and self._task is not None:
            self._task.cancel()

    async def close(self) -> None:
        """End what runs, and forget everything."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        if self._ends:
            await asyncio.wait(self._ends, timeout=_END_S)
        self._folder.cleanup()

    def _against(self, store: Store, begin_s: float, end_s: float) -> str:
        oldest, newest = store.oldest_ns, store.newest_ns
        if oldest is None or newest is None:
            return "there is nothing to diagnose yet"
        if not end_s - begin_s >= LEAST_S:
            return f"mark {LEAST_S:.0f} s or more: a diagnosis needs a rotor that slides"
        if end_s - begin_s > LONGEST_S:
            return f"mark at most {LONGEST_S / 60:.0f} min; eps-hil diagnose takes any length"
        if end_s * 1e9 < oldest or begin_s * 1e9 > newest:
            return "the stretch is not kept any more"
        return ""

    def _order(self, begin_s: float, end_s: float, folder: Path) -> Order:
        subject = self._subject
        return Order(
            name=f"{self._name}, {end_s - begin_s:.0f} s",
            begin_ns=round(begin_s * 1e9),
            end_ns=round(end_s * 1e9),
            model=str(subject.model.resolve()),
            folder=str(folder),
            recording=None if subject.recording is None else str(subject.recording.resolve()),
            dbc=tuple(str(one.resolve()) for one in subject.dbc),
            signals=None if subject.signals is None else str(subject.signals.resolve()),
        )

    def _samples(self, store: Store, order: Order) -> dict[str, Any]:
        """Copies of the stretch's samples by signal, stamped as they came."""
        found: dict[str, Any] = {}
        for name, late in zip(self._subject.measured, self._subject.late_ns, strict=True):
            track = store.tracks[name]
            cut = slice(*np.searchsorted(track.t_ns, (order.begin_ns, order.end_ns + 1)).tolist())
            if cut.stop - cut.start > 1:
                found[name] = track.value[cut].copy()
                found[f"{name}|t_ns"] = track.t_ns[cut] + late
        return found

    async def _run(self, order: Order, samples: dict[str, Any]) -> None:
        said = "the diagnosis ended without a word"
        try:
            if samples:
                await asyncio.to_thread(np.savez, Path(order.folder) / SAMPLES, **samples)
                samples.clear()
            said = await self._heard(order)
        except asyncio.CancelledError:
            said = "cancelled"
        except OSError as error:
            said = f"the diagnosis could not be started: {error.strerror or error}"
        finally:
            self._end()
            running, self._running = self._running, None
            with contextlib.suppress(OSError):
                (Path(order.folder) / SAMPLES).unlink()
            if not said and running is not None:
                self._keep(order, running)
            self._say(said)

    async def _heard(self, order: Order) -> str:
        """What went wrong, "" for nothing."""
        process = self._process = await asyncio.create_subprocess_exec(
            *COMMAND,
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL, env=os.environ | _ONE_CORE, start_new_session=True,
        )  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(order.line())
        async for line in process.stdout:
            told = json.loads(line)
            if "error" in told:
                return str(told["error"])
            if "done" in told:
                return ""
            if self._running is not None:
                self._running |= {"stage": told["stage"], "part": round(float(told["part"]), 3)}
                self.number += 1
        return "the diagnosis ended without a result; eps-hil diagnose on a recording says more"

    def _end(self) -> None:
        """Now; only :meth:`close` waits until it is gone, with its pipes."""
        process, self._process = self._process, None
        if process is None:
            return
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
        end = asyncio.get_running_loop().create_task(_gone(process))
        self._ends.add(end)
        end.add_done_callback(self._ends.discard)

    def _keep(self, order: Order, running: dict[str, Any]) -> None:
        content = json.loads((Path(order.folder) / RESULT).read_text(encoding="utf-8"))
        took_s = time.time() - running["since_s"]
        place = {"number": self._count, "from_s": running["from_s"], "to_s": running["to_s"]}
        self._found = [*self._found, {**place, "took_s": round(took_s, 1), **content}][-_KEPT:]

    def _say(self, text: str) -> None:
        self._said = text
        self.number += 1


async def _gone(process: asyncio.subprocess.Process) -> None:
    assert process.stdin is not None
    process.stdin.close()
    await process.communicate()
