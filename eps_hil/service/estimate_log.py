"""Every estimate of a run into a CSV file, written in a thread beside the loop.

Rows are appended, so that what was written survives a crash. ``time_s`` counts from the first
sync frame; ``t_ns`` is the exact instant since the epoch, which a float cannot hold. A disk that
is full, or slow, costs rows and nothing else: they wait for it, some minutes' worth at most, and
what is lost then is counted. No row is ever half written.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from pathlib import Path

from eps_hil.errors import InputError
from eps_hil.estimation.stream import Estimate
from eps_hil.service.core import ServiceCore
from eps_hil.service.whole_lines import WholeLines

HEADER = "time_s,rack_force_estimate_n,friction_torque_nm,valid,reason,t_ns\n"
_PERIOD_S = 0.2
_WAITING_MAX = 200_000
_CHUNK = 2_000

Row = tuple[int, Estimate]


class EstimateLog:
    """An open log; :class:`InputError` if the file cannot be made.

    ``lost``: rows that are not in the file and will not be.
    """

    def __init__(
        self,
        path: Path,
        say: Callable[[str], None] = lambda _: None,
        *,
        waiting_max: int = _WAITING_MAX,
    ) -> None:
        self._path, self._say = path, say
        self._first_ns: int | None = None
        self._waiting: deque[Row] = deque()
        self._waiting_max = waiting_max
        self.written = self.lost = 0
        self._failing = False
        try:
            self._file = WholeLines(path, "w")
            self._file.append(HEADER)
        except OSError as error:
            raise InputError(path, "", f"cannot be written: {error.strerror}") from None

    async def keep(self, core: ServiceCore) -> None:
        """Write what ``core`` estimates until cancelled; the rest is written then."""
        core.record = []
        writing: asyncio.Future[list[Row]] | None = None
        try:
            while True:
                await asyncio.sleep(_PERIOD_S)
                rows, core.record = core.record, []
                hangs = writing is not None and not writing.done()  # the loop does not wait for it
                self._take([] if writing is None or hangs else writing.result(), rows)
                if hangs:
                    continue
                next_rows = [
                    self._waiting.popleft() for _ in range(min(_CHUNK, len(self._waiting)))
                ]
                writing = asyncio.ensure_future(asyncio.to_thread(self._write, next_rows))
        finally:
            back: list[Row] = []
            if writing is not None:
                (rest,) = await asyncio.gather(writing, return_exceptions=True)
                back = rest if isinstance(rest, list) else []
            rows, core.record = core.record or [], None
            self._take(back, rows)
            self._waiting = deque(self._write(list(self._waiting)))

    def close(self) -> None:
        """Close the file; rows that still wait for the disk are lost."""
        self.lost += len(self._waiting)
        self._waiting.clear()
        self._file.close()

    def _take(self, back: list[Row], rows: list[Row]) -> None:
        """Rows that the disk refused, and new ones; the oldest of too many are lost."""
        self._waiting.extendleft(reversed(back))
        self._waiting.extend(rows)
        while len(self._waiting) > self._waiting_max:
            self._waiting.popleft()
            self.lost += 1

    def _write(self, rows: list[Row]) -> list[Row]:
        """Append rows; those that the disk refused."""
        if not rows:
            return rows
        if self._first_ns is None:
            self._first_ns = rows[0][0]
        try:
            self._file.append("".join(_line(estimate, self._first_ns) for _, estimate in rows))
        except OSError as error:
            if not self._failing:
                said = error.strerror or str(error)
                self._say(f"log        {self._path}: cannot be written: {said}; trying again")
            self._failing = True
            return rows
        self.written += len(rows)
        if self._failing:
            self._failing = False
            self._say(f"log        {self._path}: written again, {self.lost} rows are lost")
        return []


def _line(estimate: Estimate, first_ns: int) -> str:
    return (
        f"{(estimate.t_ns - first_ns) * 1e-9:.9f},{estimate.rack_force_n!r},"
        f"{estimate.friction_torque_nm!r},{int(estimate.valid)},{int(estimate.reason)},"
        f"{estimate.t_ns}\n"
    )
