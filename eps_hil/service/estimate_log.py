"""Every estimate of a run into a CSV file, written in a thread beside the loop.

Rows are appended, so that what was written survives a crash. ``time_s`` counts from the first
sync frame; ``t_ns`` is the exact instant since the epoch, which a float cannot hold.
"""

import asyncio
from pathlib import Path
from typing import TextIO

from eps_hil.errors import InputError
from eps_hil.estimation.stream import Estimate
from eps_hil.service.core import ServiceCore

HEADER = "time_s,rack_force_estimate_n,friction_torque_nm,valid,reason,t_ns\n"
_PERIOD_S = 0.2


class EstimateLog:
    """An open log; :class:`InputError` if the file cannot be written."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._first_ns: int | None = None
        try:
            self._file: TextIO = path.open("w", encoding="utf-8")
            self._file.write(HEADER)
        except OSError as error:
            raise InputError(path, "", f"cannot be written: {error.strerror}") from None

    async def keep(self, core: ServiceCore) -> None:
        """Write what ``core`` estimates until cancelled; the rest is written then."""
        core.record = []
        try:
            while True:
                await asyncio.sleep(_PERIOD_S)
                rows, core.record = core.record, []
                await asyncio.to_thread(self._write, rows)
        finally:
            rows, core.record = core.record, None
            self._write(rows)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, rows: list[tuple[int, Estimate]]) -> None:
        if rows and self._first_ns is None:
            self._first_ns = rows[0][0]
        first_ns = self._first_ns or 0
        text = "".join(
            f"{(e.t_ns - first_ns) * 1e-9:.9f},{e.rack_force_n!r},{e.friction_torque_nm!r},"
            f"{int(e.valid)},{int(e.reason)},{e.t_ns}\n"
            for _, e in rows
        )
        try:
            self._file.write(text)
            self._file.flush()
        except OSError as error:
            raise InputError(self._path, "", f"cannot be written: {error.strerror}") from None
