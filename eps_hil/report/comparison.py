"""What each block of the estimator is worth: the paper's variants against the rig's load cell.

The variants (w/o FC, no exten, 2Q-fa; figs 10 to 12) are run over the same recorded samples with
blocks switched off. What a running service published may be put beside them, so that a live
estimate that is worse than the recording allows shows.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.errors import InputError
from eps_hil.estimation import batch
from eps_hil.estimation.score import SECOND, VARIANTS, Score, score, variant
from eps_hil.estimation.settings import EstimatorSettings, at_pace
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import Model
from eps_hil.recordings.recording import Recording
from eps_hil.series import Series

LIVE = "live"

DESCRIPTIONS: Mapping[str, str] = {
    LIVE: "2Q-fa, as the service published it",
    "2Q-fa": "friction compensation, dead zone and limiter",
    "no exten": "friction compensation, without dead zone and limiter",
    "w/o FC": "no friction compensation",
    "bristle filter": "Kalman filter with the bristle inside, the same delay",
    "smoother": "the same over the whole recording, forth and back",
}


@dataclass(frozen=True, slots=True)
class Candidate:
    """One estimate of the recording's rack force and its errors against the load cell."""

    name: str
    trace: Trace
    score: Score


def compare(
    recording: Recording,
    model: Model,
    settings: EstimatorSettings,
    live: Trace | None = None,
    *,
    second: bool = False,
) -> list[Candidate]:
    """All variants over one recording, after what was published live if that is given.

    ``second`` adds the estimators beside the paper's.

    :class:`InputError` if the recording lacks an input or the load cell, or is too short.
    """
    settings = at_pace(settings, recording.pace)
    traces = {} if live is None else {LIVE: live}
    try:
        batch.check_rate(recording.series)
        for name in (*VARIANTS, *(SECOND if second else ())):
            chosen = variant(settings, name)
            traces[name] = batch.estimate(
                recording.series, model, chosen, arrivals=recording.arrivals
            )
    except ValueError as error:
        there = ", ".join(sorted(recording.series))
        raise InputError(recording.name, "", str(error), f"it holds {there}") from error
    return [_scored(recording, model, name, trace) for name, trace in traces.items()]


def _scored(recording: Recording, model: Model, name: str, trace: Trace) -> Candidate:
    found = score(trace, recording.series, model)
    if found is None:
        problem = "holds no load cell to compare with"
        raise InputError(recording.name, "rack_force_n", problem, "record or map it")
    if not found.rows:
        problem = f"no valid estimate ({name}) falls into the recording"
        raise InputError(recording.name, "", problem, "record longer, and at the same time")
    return Candidate(name, trace, found)


def start_ns(series: Mapping[str, Series]) -> int:
    """The first sample that the estimator steps on: where a comparison's time axis begins."""
    return int(series[batch.sync_signal(series)].t_ns[0])


def read_published(path: Path) -> Trace:
    """The file of ``eps-hil run --log-estimates``; :class:`InputError` where it is none."""
    wanted = ("rack_force_estimate_n", "friction_torque_nm", "reason", "t_ns")
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "", f"cannot be read: {error}", "check the path") from None
    if not rows:
        raise InputError(path, "", "holds no estimate", "was the rig running?")
    if missing := [name for name in wanted if name not in rows[0]]:
        remedy = "give a file of eps-hil run --log-estimates"
        raise InputError(path, missing[0], "column is missing", remedy)
    try:
        force, friction = (
            np.array([float(row[name]) for row in rows], np.float64) for name in wanted[:2]
        )
        reason, t_ns = (np.array([int(row[name]) for row in rows], np.int64) for name in wanted[2:])
    except (TypeError, ValueError) as error:
        remedy = "the last line of a killed run may be cut: delete it"
        raise InputError(path, "", f"a row is broken: {error}", remedy) from None
    return Trace(t_ns, force, friction, reason)


def summary(candidates: Sequence[Candidate]) -> list[dict[str, Any]]:
    """The scores as plain values, for JSON; newtons."""
    return [
        {
            "estimate": one.name,
            "what": DESCRIPTIONS[one.name],
            "rmse_overall_n": one.score.rmse_overall_n,
            "rmse_moving_n": one.score.rmse_moving_n,
            "rmse_resting_n": one.score.rmse_resting_n,
            "valid_share": float(one.trace.valid.mean()),
            "rows": one.score.rows,
        }
        for one in candidates
    ]
