"""What is done with each recording, or unit, of a batch, in whatever process or machine."""

import functools
import hashlib
import json
import os
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from eps_hil import provenance
from eps_hil.errors import EpsHilError
from eps_hil.fleet.tasks import AFTER, BEFORE, Task
from eps_hil.json_text import plain
from eps_hil.version import VERSION

if TYPE_CHECKING:
    from eps_hil.api.recording import Recording

Verb = Literal["estimate", "identify", "diagnose", "changes"]
Row = dict[str, Any]
"""JSON-ready: key, recording, unit, state ("done" or "failed"), error, seconds, start_s (null where
the recording has no date), output, ``notes`` of the reader, and ``values``, a list of quantity,
value, low, high, si (its unit). Of the verb ``changes`` it is of a unit: ``recordings_before``,
``recordings_after``, of which ``recording`` is the first, and ``changes``, see
:mod:`eps_hil.fleet.changed`."""
_NO_DATE_S = 1e8  # 1973: earlier stamps count from the start of a recording

_NO_NAME, _LONGEST = re.compile(r"[^\w.-]"), 60  # of a unit in a file's name

_catalogue = functools.cache(provenance.catalogue)


@dataclass(frozen=True, slots=True)
class Job:
    """One verb with its model and how recordings are read, the same for all of a batch.

    ``out``: the batch's folder; outputs of a recording go below it. ``reading``: options of
    :func:`eps_hil.api.load`, as text and numbers.
    """

    verb: Verb
    model: Path
    out: Path
    settings: Path | None = None
    reading: Mapping[str, Any] = field(default_factory=dict)

    def key(self, task: Task) -> str:
        """Names the result: of its recordings as they are now, by this job, version and catalogue.

        A recording counts as the same while path, size and time of change are.
        """
        digest = hashlib.sha256(f"{VERSION} {_catalogue()} {self.verb} {task.unit}".encode())
        digest.update(json.dumps(self.reading, sort_keys=True, default=str).encode())
        files = [self.model, self.settings, self.reading.get("signals")]
        for path in [*files, *self.reading.get("dbc", ())]:
            digest.update(b"-" if path is None else Path(path).read_bytes())
        if self.verb == "changes":
            digest.update(f"{len(task.before)} before, wrong: {task.wrong}".encode())
        for path in (*task.before, *task.after) or (task.path,):
            try:
                now = path.stat()
                digest.update(f"{path.resolve()} {now.st_size} {now.st_mtime_ns}".encode())
            except OSError:
                digest.update(f"{path} is not there".encode())
        return digest.hexdigest()[:16]


def blank(job: Job, task: Task, key: str) -> Row:
    """The row of a task of which nothing is known yet."""
    row: Row = {
        "key": key,
        "recording": str(task.path),
        "unit": task.unit,
        "state": "done",
        "error": "",
        "start_s": None,
        "output": "",
        "notes": [],
        "values": [],
    }
    if job.verb == "changes":
        row["recordings_before"] = [str(path) for path in task.before]
        row["recordings_after"] = [str(path) for path in task.after]
        row["changes"] = []
    return row


def run(job: Job, task: Task, key: str) -> Row:
    """The row of one task. Whatever goes wrong with it is its row, not an exception."""
    begun = time.monotonic()
    row = blank(job, task, key)
    try:
        if task.wrong:
            raise EpsHilError(task.wrong)
        (_fill_changes if job.verb == "changes" else _fill)(job, task, row)
    except EpsHilError as error:
        row |= {"state": "failed", "error": " ".join(str(error).split())}
    except Exception as error:  # one bad file is not the end of a batch
        said = " ".join(f"{type(error).__name__}: {error}".split())
        row |= {"state": "failed", "error": f"internal error: {said}"}
    row["values"] = [one for one in map(plain, row["values"]) if one["value"] is not None]
    return row | {"seconds": round(time.monotonic() - begun, 3), "process": os.getpid()}


def _fill(job: Job, task: Task, row: Row) -> None:
    from eps_hil.api import jobs

    recording = jobs.load(task.path, **job.reading)
    row["notes"] = list(recording.notes)
    row["start_s"] = _start_s(recording)
    stem = f"{task.path.stem}-{row['key']}"
    if job.verb == "estimate":
        from eps_hil.recordings.coverage import in_words
        from eps_hil.recordings.write import write_table

        found = jobs.estimate(recording, job.model, job.settings)
        row["notes"] += in_words(found.gaps)
        row["output"] = f"estimates/{stem}.parquet"
        trace = found.trace
        columns = {
            "rack_force_estimate_n": trace.rack_force_n,
            "friction_torque_nm": trace.friction_torque_nm,
            "valid": trace.valid,
        }
        write_table(_place(job, row), columns, t_ns=trace.t_ns)
        row["values"] = [_value("valid_share", float(trace.valid.mean()), "")]
        if found.score is not None:
            row["values"] += [
                _value("error_moving", found.score.rmse_moving_n, "N"),
                _value("error_overall", found.score.rmse_overall_n, "N"),
                _value("bias_moving", found.score.bias_moving_n, "N"),
            ]
    elif job.verb == "identify":
        named = jobs.identify(recording, job.model)
        row["output"] = f"identifications/{stem}.json"
        _write_json(_place(job, row), named.result.content())
        row["values"] = [
            _value(name, one.value, one.unit, one.ci95)
            for name, one in {**named.result.parameters, **named.result.offsets}.items()
            if one.status == "identified"
        ]
    else:
        told = jobs.diagnose(recording, job.model)
        row["output"] = f"diagnoses/{stem}.json"
        _write_json(_place(job, row), told.content)
        row["verdict"] = told.verdict
        for finding in told.findings:
            row["values"].append(_value(finding.effect, finding.confidence, "confidence"))
            for name, one in finding.parameters.items():
                if not isinstance(one["value"], int | float):
                    continue  # a curve: it stands in the output
                row["values"].append(
                    _value(f"{finding.effect}.{name}", one["value"], one.get("unit", ""),
                           one.get("ci95"))
                )  # fmt: skip


def _fill_changes(job: Job, task: Task, row: Row) -> None:
    from eps_hil.api import jobs
    from eps_hil.fleet.changed import rows_of, values_of

    states: list[list[Recording]] = []
    for state, paths in ((BEFORE, task.before), (AFTER, task.after)):
        read = [replace(jobs.load(path, **job.reading), name=str(path)) for path in paths]
        said = dict.fromkeys(note for one in read for note in one.notes)
        row["notes"] += [f"{state}: {note}" for note in said]
        states.append(read)
    before, after = states
    row["start_s"] = _start_s(after[0])
    told = jobs.changes(before, after, job.model)
    unit = _NO_NAME.sub("_", task.unit)[:_LONGEST]
    row["output"] = f"changes/{unit}-{row['key']}.json"
    _write_json(_place(job, row), told.content)
    row["verdict"] = told.verdict
    row["changes"] = plain(rows_of(told.content))
    row["values"] = [_value(*one) for one in values_of(told.content, row["changes"])]


def _start_s(recording: "Recording") -> float | None:
    """Of its first sample since 1970; None where it has no date."""
    start_s = min(int(one.t_ns[0]) for one in recording.series.values()) * 1e-9
    return start_s if start_s >= _NO_DATE_S else None


def _place(job: Job, row: Row) -> Path:
    place = job.out / str(row["output"])
    place.parent.mkdir(parents=True, exist_ok=True)
    return place


def _value(quantity: str, value: float, si: str, ci95: Any = None) -> dict[str, Any]:
    low, high = (None if end is None else float(end) for end in ci95 or (None, None))
    return {"quantity": quantity, "value": float(value), "low": low, "high": high, "si": si}


def _write_json(path: Path, content: Any) -> None:
    from eps_hil.recordings.files import replacing

    text = json.dumps(plain(content), indent=2, allow_nan=False)
    with replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
