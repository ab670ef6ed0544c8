"""A diagnosis in short, for a page that shows it where the mismatch was: JSON-ready."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.report import diagnosis_evidence
from eps_hil.report.diagnosis_evidence import Evidence
from eps_hil.report.diagnosis_page import titled
from eps_hil.report.page import number
from eps_hil.unit_words import spaced

Floats = npt.NDArray[np.float64]

SPEED, LOAD = "motor_speed_rad_s", "rack_force_n"
_MOST_VALUES = 6


def summary(
    diagnosis: Diagnosis,
    cards: Sequence[Mapping[str, Any]],
    measures: Sequence[Mapping[str, Any]],
    verdict: str,
) -> dict[str, Any]:
    """Verdict, findings, gain, and the residual of both models over speed, load and time.

    ``cards``, ``measures`` and ``verdict`` as the full page has them. Times are s since the first
    stamp of the recording, residuals N at the rack.
    """
    fitted, kept = diagnosis_evidence.fitted(diagnosis), diagnosis_evidence.held_out(diagnosis)
    return {
        "verdict": verdict,
        "kind": diagnosis.content["verdict"],
        "findings": [_finding(card, diagnosis) for card in cards],
        "gain": [
            {key: row[key] for key in ("name", "title", "unit", "before", "after", "floor")}
            for row in measures
        ],
        "samples": _samples((fitted, kept)),
        "kept_from_s": float(kept.problem.recordings[0].begins_s),
        "segments": [
            [one["from_s"], one["to_s"], one["share_of_excess"]]
            for one in diagnosis.content["time_segments"]
        ],
        "limits": list(diagnosis.content.get("limits", [])),
    }


def _finding(card: Mapping[str, Any], diagnosis: Diagnosis) -> dict[str, Any]:
    return {
        "effect": card["effect"],
        "title": titled(card["effect"]) if card["effect"] != "unknown" else "unknown effect",
        "summary": card["summary"],
        "confidence": card["confidence"],
        "values": [
            {"name": card["meanings"].get(name, name.replace("_", " ")), "text": _value(one)}
            for name, one in card["parameters"].items()
            if isinstance(one.get("value"), int | float)
        ][:_MOST_VALUES],
        "size": _size(card),
        "frame": _frame(card, diagnosis.content.get("location", {}).get("cells", [])),
        "confusable_with": [titled(name) for name in card["confusable_with"]],
    }


def _value(one: Mapping[str, Any]) -> str:
    """A number with its interval: as ± where that lies about evenly on both sides."""
    value, unit, ends = float(one["value"]), one.get("unit", ""), one.get("ci95")
    text = number(value)
    if ends:
        below, above = value - ends[0], ends[1] - value
        even = min(below, above) > 0.7 * max(below, above) > 0.0
        half = number(0.5 * (below + above), 2)
        text += f" ± {half}" if even else f" ({number(ends[0])} to {number(ends[1])})"
    return text + spaced(unit)


def _size(card: Mapping[str, Any]) -> str:
    sizes = card["sizes"]
    if not sizes:
        return str(card["size"])
    told = [f"{number(sizes['rms_n'])} N rms"] if "rms_n" in sizes else []
    return ", ".join([*told, f"up to {number(sizes['peak_n'])} N"]) + " at the rack"


def _frame(
    card: Mapping[str, Any], cells: Sequence[Mapping[str, Any]]
) -> dict[str, list[float]] | None:
    """Ends on speed and load within which it sits: the finding's own, or the map's first cell's."""
    found: dict[str, list[float]] = {}
    for region in card["where"]:
        name = region["signal"].partition("|")[0]
        if name in {SPEED, LOAD} and name not in found:
            found[name] = [region["from"], region["to"]]
    if found:
        return found
    for cell in cells:
        if set(cell["signals"]) <= {SPEED, LOAD}:
            ends = zip(cell["from"], cell["to"], strict=True)
            return dict(zip(cell["signals"], map(list, ends), strict=True))
    return None


def _samples(parts: Sequence[Evidence]) -> dict[str, Floats]:
    """Time, speed, load and both residuals of each thinned sample that is judged."""
    rows: dict[str, list[Floats]] = {key: [] for key in ("time_s", "x", "y", "before", "after")}
    for one in parts:
        ratio = one.problem.model.rack_to_rotor_ratio_rad_per_m
        time_s = np.concatenate([r.thin_time_s + r.begins_s for r in one.problem.recordings])
        use, after = one.sliding, one.after_nm if one.entries else one.before_nm
        for key, values in (
            ("time_s", time_s), ("x", one.signals[SPEED]), ("y", one.signals[LOAD]),
            ("before", ratio * one.before_nm), ("after", ratio * after),
        ):  # fmt: skip
            rows[key].append(values[use])
    return {key: np.concatenate(values) for key, values in rows.items()}
