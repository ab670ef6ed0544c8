"""A whole programme on a bus: drive the rig cell by cell, record each, go on after an interruption.

The way to the rig, and how it is let go, is ``link.py``'s.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_hil.bus.config import BusSetup
from eps_hil.bus.record import open_log
from eps_hil.errors import EpsHilError, InputError, SafetyStop
from eps_hil.physics.model import Model
from eps_hil.programme import cell_record
from eps_hil.programme.cell_record import CellResult, Collector
from eps_hil.programme.conductor import Conductor, Phase, most_of
from eps_hil.programme.fingerprint import check_same
from eps_hil.programme.link import OnSamples, RigLink
from eps_hil.programme.plan import Plan, PlannedCell
from eps_hil.recordings.files import make_folder, replacing

PLAN_FILE = "programme.json"
SCHEMA = "eps-hil/programme/1"

OnProgress = Callable[[int, int, str], None]


class InterruptedProgrammeError(EpsHilError):
    """Somebody stopped the programme; finished cells are kept."""


@dataclass(frozen=True, slots=True)
class Summary:
    """All cells of a finished programme; ``resumed`` were there before.

    ``refused``: set-points that a full send queue refused.
    """

    results: Sequence[CellResult]
    resumed: int
    refused: int = 0

    @property
    def accepted(self) -> list[CellResult]:
        """Cells that may be used."""
        return [one for one in self.results if one.accepted]


def prepare_folder(folder: Path, plan: Plan, rig: str, *, resume: bool) -> list[CellResult]:
    """Make or check the folder of a programme; the cells that are finished and may be used.

    ``rig``: :func:`~eps_hil.programme.fingerprint.fingerprint`. :class:`InputError` where the
    folder holds finished cells and ``resume`` is not asked for, cells of another programme or
    another rig, or nothing that could be resumed.
    """
    file = folder / PLAN_FILE
    if not resume and any(folder.glob("cell_*.json")):
        remedy = "add --resume to go on, or choose another folder"
        raise InputError(folder, "--out", "holds finished cells of a programme", remedy)
    content = {"schema": SCHEMA, "programme": plan.content(), "rig": rig}
    if resume:
        _check_same(file, content)
    else:
        make_folder(folder, "--out")
        with replacing(file) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    found = (cell_record.read(cell, folder) for cell in plan.cells())
    return [one for one in found if one is not None and one.accepted]


def _check_same(file: Path, content: dict[str, Any]) -> None:
    """:class:`InputError` where the folder is not of this programme on this rig."""
    if not file.exists():
        raise InputError(
            file.parent, "--resume", "holds no programme to go on with",
            "name its folder, or leave out --resume to begin",
        )  # fmt: skip
    other = "by another programme, or by an earlier state of this one"
    check_same(file, content, other, "model, database, mapping or bus")


class ProgrammeRun:
    """A programme, checked; :meth:`run` opens the bus and returns when every cell is finished."""

    def __init__(self, setup: BusSetup, model: Model, plan: Plan, folder: Path) -> None:
        self._model, self._plan, self._folder = model, plan, folder
        self._link = RigLink(setup, model, most_of(plan))
        self._channel = setup.bus.channel

    def run(
        self,
        finished: Sequence[CellResult],
        *,
        stop: Callable[[], bool] = lambda: False,
        on_progress: OnProgress | None = None,
    ) -> Summary:
        """Run what is not finished yet, in the plan's order; the bus is let go in every case.

        :class:`InterruptedProgrammeError` after ``stop()``, :class:`BusError` when no rig is heard
        or somebody else commands it, :class:`EpsHilError` when it does not follow,
        :class:`SafetyStop` when it went beyond a limit or could not be led safely (``link.py``).
        """
        results = {one.cell.number: one for one in finished}
        cells = self._plan.cells()
        self._link.open(stop, _before_the_first)
        try:
            for cell in cells:
                if cell.number not in results:
                    results[cell.number] = self._cell(cell, stop, len(cells), on_progress)
        finally:
            self._link.let_go()
        ordered = [results[cell.number] for cell in cells]
        return Summary(ordered, len(finished), self._link.refused)

    def _cell(
        self,
        cell: PlannedCell,
        stop: Callable[[], bool],
        total: int,
        on_progress: OnProgress | None,
    ) -> CellResult:
        """One cell, repeated while it is not good enough; its log and its result are then kept."""
        for attempt in range(1, self._plan.attempts + 1):
            conductor = Conductor(cell, self._plan, self._model)
            collector = Collector(self._model)

            def before_tick(
                conductor: Conductor = conductor, collector: Collector = collector
            ) -> OnSamples | None:
                if stop():
                    raise InterruptedProgrammeError(
                        f"interrupted in cell {cell.number} of {total}; finished cells are kept in "
                        f"{self._folder}, go on with --resume"
                    )
                if on_progress:
                    on_progress(cell.number, total, conductor.phase.value)
                return collector.take if conductor.phase is Phase.MEASURE else None

            part = self._folder / f"{cell.name}.part.log"
            log = open_log(part, self._channel, overwrite=True)
            lost = self._link.lost
            try:
                self._link.lead(conductor, log, before_tick)
                if conductor.phase is not Phase.DONE:
                    self._link.stop()  # before the log is closed, which waits for the disk
            finally:
                log.close()
            if conductor.phase is Phase.TRIPPED:
                raise SafetyStop(f"{cell.name}: {conductor.reason}; finished cells are kept")
            if conductor.phase is Phase.FAILED:
                raise EpsHilError(f"{cell.name}: {conductor.reason}; finished cells are kept")
            result = collector.result(cell, self._link.lost - lost, attempt)
            if result.accepted:
                break
        part.replace(self._folder / f"{cell.name}.log")
        cell_record.write(result, self._folder)
        return result


def _before_the_first() -> InterruptedProgrammeError:
    return InterruptedProgrammeError("interrupted before the first cell")
