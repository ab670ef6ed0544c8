"""The JSON of a diagnosis (CONTRACT 7): verdict, findings, place of the mismatch, the proof."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.proof_of_fit import Holdout, measures, noise_floor
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee, term_of
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.mismatch import locate, regions
from eps_hil.diagnosis.mismatch.leftover import Leftover
from eps_hil.diagnosis.remainder.find import Remainder
from eps_hil.diagnosis.verdict.finding import finding, unknown
from eps_hil.diagnosis.verdict.modelled import modelled
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

SCHEMA = "eps-hil/diagnosis/1"


def without_nan(content: Any) -> Any:
    """The same with null for every number that does not exist."""
    if isinstance(content, float):
        return content if np.isfinite(content) else None
    if isinstance(content, Mapping):
        return {key: without_nan(one) for key, one in content.items()}
    if isinstance(content, list | tuple):
        return [without_nan(one) for one in content]
    return content


def content_of(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    left: Leftover | None,
    judged: Sequence[Holdout],
    extra: Remainder | None,
    written: Model,
    *,
    simulated: bool = True,
) -> dict[str, Any]:
    """What is told of ``findings`` and of what is ``left``; ``extra`` models it, if anything.

    Not ``simulated``: hold-outs are judged by their torque balance only.
    """
    found = selection.found
    by_gain = sorted(findings, key=lambda k: -selection.gains[term_of(found.entries[k])])
    listed = [finding(problem, selection, k) for k in by_gain]
    if left is not None:
        told = unknown(left)
        listed.append(told if extra is None else modelled(told, extra, problem))
    verdict = {
        (False, False): "no_mismatch",
        (True, False): "explained",
        (True, True): "partly_explained",
        (False, True): "unknown_effect",
    }[bool(findings), left is not None]
    excess = selection.null.residual**2 - (found.residual**2 if findings else 1.0)
    return {
        "schema": SCHEMA,
        "verdict": verdict,
        "findings": listed,
        "time_segments": [
            {"recording": name, "from_s": start, "to_s": end, "share_of_excess": share}
            for name, start, end, share in locate.time_segments(
                problem, np.where(problem.sliding, excess, 0.0)
            )
        ]
        if listed
        else [],
        "location": _location(problem, selection.null.residual, excess) if listed else {},
        "fit": {"holdout": _proof(problem.model, written, judged, simulated=simulated)},
    }


def _location(problem: Problem, residual: Floats, excess: Floats) -> dict[str, Any]:
    """Cells of one and two coordinates that hold more of the mismatch than of the time, and what
    each recording holds of both.
    """
    cut = clipped(residual, knee(residual))
    found = regions.cells(problem, np.maximum(cut**2 - 1.0, 0.0))
    return {
        "sentence": regions.sentence(found),
        "cells": [cell.content() for cell in found],
        "recordings": locate.by_recording(problem, excess),
    }


def _proof(
    model: Model, written: Model, judged: Sequence[Holdout], *, simulated: bool
) -> dict[str, Any]:
    """``fit.holdout`` of the model before and as it is written."""
    models = [model] if written is model else [model, written]
    told = each(lambda one: measures(judged, written, one, simulated=simulated), models)
    return {
        "baseline": told[0],
        "augmented": told[-1],
        "noise_floor": noise_floor(judged, written),
    }
