"""A map over two signals that was learnt, as the page draws it: its values in its range."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.remainder.words import PLAIN, SYMBOLS
from eps_hil.report.diagnosis_evidence import label
from eps_hil.report.diagnosis_maps import colour
from eps_hil.report.plots import ticks

Floats = npt.NDArray[np.float64]

COLUMNS, ROWS = 24, 16
_UNKNOWN = 1e9
"""Half width where nothing was seen."""


def maps(finding: Mapping[str, Any]) -> list[dict[str, Any]]:
    """For each term of a finding's model that is a map: axes, cells and the ends of its scale.

    Values are mNm, or percent where the map is a factor. A cell is ``sure`` where its value is
    beyond its 95 % half width (``band`` of the model).
    """
    model = finding.get("model") or {}
    terms = model.get("terms", [])
    bands = model.get("band", [None] * len(terms))
    return [
        _map(term, band)
        for term, band in zip(terms, bands, strict=True)
        if len(term["inputs"]) == 2 and "values" in term
    ]


def _map(term: Mapping[str, Any], band: Any) -> dict[str, Any]:
    knots = [np.array(axis, dtype=np.float64) for axis in term["knots"]]
    ends = [
        term.get("range", {}).get(name, (axis[0], axis[-1]))
        for name, axis in zip(term["inputs"], knots, strict=True)
    ]
    x, y = (
        low + (np.arange(count) + 0.5) / count * (high - low)
        for (low, high), count in zip(ends, (COLUMNS, ROWS), strict=True)
    )
    factor = 100.0 if term["how"] == "factor" else 1e3
    values = factor * float(term.get("size", 1.0)) * _between(term["values"], knots, x, y)
    half = np.zeros(values.shape)
    if band is not None:
        known = [[np.inf if one is None else one for one in row] for row in band]
        half = factor * _between(np.minimum(known, _UNKNOWN), knots, x, y)
    low, high = float(np.min(values)), float(np.max(values))
    cells = [
        {
            "column": i,
            "row": ROWS - 1 - j,
            "fill": colour((values[i, j] - low) / max(high - low, 1e-12)),
            "value": float(values[i, j]),
            "half": float(half[i, j]),
            "sure": bool(abs(values[i, j]) >= half[i, j]),
        }
        for i in range(COLUMNS)
        for j in range(ROWS)
    ]
    return {
        "title": f"{PLAIN[term['where']]}, {'%' if factor == 100.0 else 'mNm'}",
        "axes": [_axis(name, end) for name, end in zip(term["inputs"], ends, strict=True)],
        "cells": cells,
        "columns": COLUMNS,
        "rows": ROWS,
        "low": low,
        "high": high,
    }


def _between(rows: Any, knots: list[Floats], x: Floats, y: Floats) -> Floats:
    """Straight lines between knots, (len(x), len(y))."""
    table = np.array(rows, dtype=np.float64)
    along = np.column_stack([np.interp(x, knots[0], column) for column in table.T])
    return np.vstack([np.interp(y, knots[1], row) for row in along])


def _axis(name: str, ends: tuple[float, float]) -> dict[str, Any]:
    low, high = float(ends[0]), float(ends[1])
    return {
        "label": label(name) if not name.startswith("abs_") else f"size of {label(name[4:])}",
        "symbol": SYMBOLS[name],
        "ticks": [((one - low) / (high - low), one) for one in ticks(low, high, 5)],
    }
