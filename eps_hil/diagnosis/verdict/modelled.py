"""An ``unknown`` finding with the model of what is left (CONTRACT 7): law, share, range, place."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.entry import place
from eps_hil.diagnosis.mismatch.binned import means, places, points
from eps_hil.diagnosis.mismatch.locate import BINS, Region, interval
from eps_hil.diagnosis.mismatch.regions import operating_region
from eps_hil.diagnosis.remainder.find import Remainder
from eps_hil.diagnosis.remainder.intervals import parameters
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.diagnosis.remainder.table import band
from eps_hil.diagnosis.remainder.words import PLAIN, formula, resembles, sentence

Floats = npt.NDArray[np.float64]

_SUREST, _NEAR, _FEWEST = 0.95, 0.1, 6


def modelled(unknown: Mapping[str, Any], found: Remainder, remainder_of: Problem) -> dict[str, Any]:
    """The finding with its ``model``; ``remainder_of``: the problem that it was fitted to."""
    entries = found.entries
    like = [one for entry in entries for one in resembles(entry)]
    said = "; and ".join(sentence(entry) for entry in entries)
    names = list(dict.fromkeys(one["what"] for one in like))
    low, high = found.ci95
    where = _places(found, remainder_of) or unknown["where"]
    summary = (
        f"Physics that the catalogue has no name for: {said}"
        f"{f' (like {names[0]})' if names else ''}. It takes {100 * found.share:.0f} % of what was "
        f"unexplained off the hold-outs (95 %: {100 * low:.0f} to {100 * high:.0f} %)."
    )
    return {
        **unknown,
        "summary": summary,
        "confidence": round(min(_SUREST, max(low, 0.5)), 3),
        "equation": "; ".join(filter(None, map(formula, entries))),
        "parameters": parameters(remainder_of, found.model, entries),
        "where": where,
        "curve": _curve(found, remainder_of, where[0]["signal"]) or unknown["curve"],
        "model": {**content(found), **_bands(found, remainder_of)},
        "resembles": [
            {"what": name, "why": next(one["why"] for one in like if one["what"] == name)}
            for name in names
        ],
    }


def content(found: Remainder) -> dict[str, Any]:
    """``model`` of CONTRACT 7; of several terms ``form`` is the first one's, the largest.

    ``law`` joins the formulas of those that have one; ``terms`` are all, as a model file has them.
    """
    entries = found.entries
    laws = [formula(entry) for entry in entries]
    ranges: dict[str, list[float]] = {}
    for entry in entries:
        ranges |= {name: list(ends) for name, ends in entry.get("range", {}).items()}
    return {
        "form": entries[0]["form"],
        "inputs": list(dict.fromkeys(name for entry in entries for name in entry["inputs"])),
        "law": "; ".join(one for one in laws if one) or None,
        "acts_on": [PLAIN[entry["where"]] for entry in entries],
        "holdout_share_removed": round(found.share, 4),
        "ci95": [round(end, 4) for end in found.ci95],
        "range": ranges,
        "terms": [dict(entry) for entry in entries],
    }


def _bands(found: Remainder, problem: Problem) -> dict[str, Any]:
    """``band``: of each term that is a curve or map, how sure its values are; None for a law."""
    if not any("values" in entry for entry in found.entries):
        return {}
    sight = Sight(problem, found.model)
    return {"band": [band(sight, one) if "values" in one else None for one in found.entries]}


def _curve(found: Remainder, problem: Problem, signal: str) -> list[list[float]]:
    """What the model takes off, averaged along a signal: (value, Nm, band of what stays, Nm)."""
    rows = operating_region(problem)
    if signal not in rows:
        return []
    use = problem.sliding
    values = rows[signal][use]
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    if len(edges) < _FEWEST:
        return []
    bins, n = places(edges, values), len(edges) - 1
    taken = means(bins, ((found.before - found.after) * problem.scale)[use], n)
    stays = np.sqrt(means(bins, ((found.after * problem.scale)[use]) ** 2, n))
    band = 2.0 * stays / np.sqrt(np.maximum(np.bincount(bins, minlength=n), 1))
    return [list(point) for point in points(edges, taken, band)]


def _places(found: Remainder, problem: Problem) -> list[dict[str, Any]]:
    """The law's own inputs, each with the interval that holds most of what it takes away; first
    the one in which there is most of it beyond its share of the time.
    """
    gone = np.where(problem.sliding, found.before**2 - found.after**2, 0.0)
    gone = np.maximum(gone, 0.0)
    total = float(np.sum(gone))
    if total <= 0.0:
        return []
    rows = operating_region(problem)
    told: list[dict[str, Any]] = []
    for name in dict.fromkeys(name for entry in found.entries for name in entry["inputs"]):
        signal = _signal(name)
        if signal not in rows or any(one["signal"] == signal for one in told):
            continue
        values = np.abs(rows[signal]) if name.startswith("abs_") else rows[signal]
        use = problem.sliding
        region = interval(signal, values[use], (gone / total)[use])
        if region is not None:
            told += _sides(region, name.startswith("abs_"), rows[signal], gone / total, problem)
    return sorted(told, key=lambda one: one["share_of_time"] - one["share_of_excess"])


def _sides(
    region: Region, both: bool, values: Floats, share: Floats, problem: Problem
) -> list[dict[str, Any]]:
    """An interval; of a signal's size, on both sides of zero. Time is that which slides."""
    ends = [(region.low, region.high)]
    if both:
        near = region.low < _NEAR * region.high
        ends = [(-region.high, region.high)] if near else [(-region.high, -region.low), *ends]
    return [
        place(
            region.signal,
            low,
            high,
            round(float(np.sum(share[inside])), 4),
            float(np.mean(inside[problem.sliding])),
        )
        for low, high in ends
        for inside in [(values >= low) & (values <= high)]
    ]


def _signal(name: str) -> str:
    """The recorded signal that an input is made of."""
    if name.endswith("motor_power_w"):
        return "motor_torque_nm"
    if name.endswith("_power_sign"):
        made = {"motor": "motor_torque_nm", "load": "rack_force_n"}
        return made.get(name.removesuffix("_power_sign"), "torque_sensor_nm")
    if name == "motor_angle_rad":
        return "rack_position_m"
    return name.removeprefix("abs_")
