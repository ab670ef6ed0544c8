"""Where a mismatch sits: a map over the operating region, profiles, and strips over time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.report.diagnosis_evidence import LABELS, Evidence
from eps_hil.report.plots import Line, Plot, ticks

Floats = npt.NDArray[np.float64]

CELLS = 20
MOST_MAPS = 3
_NO_PROFILE = ("motor_angle_rad", "time_s", "abs_motor_speed_rad_s")
LEAST_SAMPLES = 5
MOST_STRIPS = 12
MOST_WINDOWS = 200
_CIVIDIS = ((0, 34, 78), (65, 77, 107), (124, 123, 120), (188, 175, 111), (254, 232, 56))
"""Stops of a colour scale of rising lightness that every eye reads the same (cividis)."""


def colour(part: float) -> str:
    """Of the scale, for 0 (least) to 1 (most)."""
    place = float(np.clip(part, 0.0, 1.0)) * (len(_CIVIDIS) - 1)
    k = min(int(place), len(_CIVIDIS) - 2)
    low, high = np.array(_CIVIDIS[k]), np.array(_CIVIDIS[k + 1])
    red, green, blue = (round(v) for v in low + (place - k) * (high - low))
    return f"#{red:02x}{green:02x}{blue:02x}"


def scale() -> list[str]:
    """Colours for a legend, least first."""
    return [colour(k / 15) for k in range(16)]


def regions(evidence: Evidence, cells: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Maps of what is left (rms, N at the rack), over one pair of signals each.

    The pairs are those of the most telling ``cells`` (the JSON's location); where there is none,
    speed and the signal that tells most beside it. Cells that a map can show are framed in it.
    """
    pairs: list[tuple[str, str]] = []
    for cell in cells:
        names = [name for name in cell["signals"] if name in evidence.signals]
        if len(names) == 2 and (names[0], names[1]) not in pairs:
            pairs.append((names[0], names[1]))
    if not pairs:
        pairs = [("motor_speed_rad_s", _telling(evidence))]
    return [_map(evidence, pair, cells) for pair in pairs[:MOST_MAPS]]


def _map(
    evidence: Evidence, pair: tuple[str, str], cells: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    x, y = (evidence.signals[name] for name in pair)
    use = evidence.sliding
    x_edges, y_edges = _edges(x[use]), _edges(y[use])
    column, row = np.digitize(x, x_edges) - 1, np.digitize(y, y_edges) - 1
    inside = use & (column >= 0) & (column < CELLS) & (row >= 0) & (row < CELLS)
    place = (row * CELLS + column)[inside]
    count = np.bincount(place, minlength=CELLS**2)
    ratio = evidence.problem.model.rack_to_rotor_ratio_rad_per_m
    sizes = []
    for residual in [evidence.before_nm] + ([evidence.after_nm] if evidence.entries else []):
        energy = np.bincount(place, weights=residual[inside] ** 2, minlength=CELLS**2)
        sizes.append(ratio * np.sqrt(energy / np.maximum(count, 1)))
    filled = np.flatnonzero(count >= LEAST_SAMPLES)
    top = float(np.max(sizes[0][filled])) if len(filled) else 1.0
    # a map of nothing but noise shall not look like a finding
    top = max(top, 3.0 * ratio * evidence.rms_nm(evidence.floor_nm))
    maps = [
        {"title": title, "cells": [_cell(int(k), size, top, count) for k in filled]}
        for title, size in zip(("baseline model", "with the findings"), sizes, strict=False)
    ]
    return {
        "axes": [_axis(pair[0], x_edges), _axis(pair[1], y_edges)],
        "frames": [one for cell in cells if (one := _frame(cell, pair, x_edges, y_edges))],
        "top_n": top,
        "maps": maps,
        "cells": CELLS,
    }


def _axis(name: str, edges: Floats) -> dict[str, Any]:
    """Label, and ticks as (part of the axis, value)."""
    low, high = float(edges[0]), float(edges[-1])
    return {
        "label": LABELS[name],
        "ticks": [((value - low) / (high - low), value) for value in ticks(low, high)],
    }


def _frame(
    cell: Mapping[str, Any], pair: tuple[str, str], x_edges: Floats, y_edges: Floats
) -> dict[str, float] | None:
    """Sides of a located cell as parts of the map; None for one over other signals."""
    if not set(cell["signals"]) <= set(pair):
        return None
    sides = []
    for name, edges in zip(pair, (x_edges, y_edges), strict=True):
        span = (0.0, 1.0)
        if name in cell["signals"]:
            k = cell["signals"].index(name)
            low, high = float(edges[0]), float(edges[-1])
            span = ((cell["from"][k] - low) / (high - low), (cell["to"][k] - low) / (high - low))
        sides.append([min(max(side, 0.0), 1.0) for side in span])
    (left, right), (bottom, top) = sides
    return {"x": left, "y": 1.0 - top, "width": right - left, "height": top - bottom}


def _cell(k: int, size: Floats, top: float, count: npt.NDArray[np.int64]) -> dict[str, Any]:
    return {
        "column": k % CELLS,
        "row": CELLS - 1 - k // CELLS,
        "fill": colour(float(size[k]) / max(top, 1e-12)),
        "value": float(size[k]),
        "count": int(count[k]),
    }


def _edges(values: Floats) -> Floats:
    low, high = np.percentile(values, [0.2, 99.8]) if len(values) else (0.0, 1.0)
    return np.linspace(low, max(high, low + 1e-9), CELLS + 1)


def _telling(evidence: Evidence) -> str:
    """The signal beside speed over whose range the mismatch before varies most."""
    use = evidence.sliding
    energy = evidence.before_nm[use] ** 2
    best, most = "rack_force_n", 0.0
    for name in ("rack_force_n", "rack_position_m", "motor_torque_nm", "torque_sensor_nm"):
        values = evidence.signals[name][use]
        if len(values) < 100 or np.ptp(values) < 1e-9:
            continue
        order = np.argsort(values)
        means = [float(np.mean(part)) for part in np.array_split(energy[order], CELLS)]
        spread = float(np.std(means))
        # the load is what every engineer has in mind: another signal has to tell clearly more
        if spread > most * (1.3 if best == "rack_force_n" and most > 0 else 1.0):
            best, most = name, spread
    return best


def profiles(evidence: Evidence) -> list[Plot]:
    """Rms of what is left (N at the rack) along each signal, with the noise floor."""
    ratio = 1.0 * evidence.problem.model.rack_to_rotor_ratio_rad_per_m
    use = evidence.sliding
    plots = []
    for name in LABELS:
        x = evidence.signals.get(name, np.zeros(len(use)))[use]
        if name in _NO_PROFILE or len(x) < 100 or np.ptp(x) < 1e-9:
            continue
        edges = _edges(x)
        index = np.clip(np.digitize(x, edges) - 1, 0, CELLS - 1)
        count = np.bincount(index, minlength=CELLS)

        def along(values: Floats, index: Any = index, count: Any = count) -> Floats:
            energy = np.bincount(index, weights=values[use] ** 2, minlength=CELLS)
            return np.where(
                count >= LEAST_SAMPLES, ratio * np.sqrt(energy / np.maximum(count, 1)), np.nan
            )

        lines = [
            Line("sensor noise", "noise", along(evidence.floor_nm)),
            Line("baseline model", "before", along(evidence.before_nm)),
        ]
        if evidence.entries:
            lines.append(Line("with the findings", "after", along(evidence.after_nm)))
        if np.sum(count >= LEAST_SAMPLES) < CELLS // 3:
            continue
        centre = 0.5 * (edges[1:] + edges[:-1])
        plots.append(
            Plot(f"profile-{name}", LABELS[name], "residual, N", centre, lines, height=170)
        )
    return plots


def strips(evidence: Evidence) -> dict[str, Any]:
    """One strip of rms over time for each recording, worst recordings first, N at the rack."""
    ratio = evidence.problem.model.rack_to_rotor_ratio_rad_per_m
    rows = []
    longest = max(float(one.time_s[-1]) for one in evidence.problem.recordings)
    for one, part in zip(evidence.problem.recordings, evidence.parts(), strict=True):
        time = evidence.signals["time_s"][part]
        window = max(0.5, longest / MOST_WINDOWS)
        index = ((time - time[0]) / window).astype(np.int64)
        use = evidence.sliding[part]
        count = np.bincount(index[use], minlength=int(index[-1]) + 1)
        row: dict[str, Any] = {"name": one.name, "before": [], "after": [], "worst": 0.0}
        pairs = [("before", evidence.before_nm)]
        if evidence.entries:
            pairs.append(("after", evidence.after_nm))
        for key, residual in pairs:
            energy = np.bincount(
                index[use], weights=residual[part][use] ** 2, minlength=int(index[-1]) + 1
            )
            size = ratio * np.sqrt(energy / np.maximum(count, 1))
            row[key] = [
                {"from": float(time[0] + k * window), "for": window, "value": float(size[k])}
                for k in np.flatnonzero(count > 0)
            ]
            row["worst"] = max(row["worst"], float(np.max(size)))
        rows.append(row)
    top = max((row["worst"] for row in rows), default=1.0) or 1.0
    top = max(top, 3.0 * ratio * evidence.rms_nm(evidence.floor_nm))
    for row in rows:
        for key in ("before", "after"):
            for block in row[key]:
                block["fill"] = colour(block["value"] / top)
    rows.sort(key=lambda row: -row["worst"])
    left_out = len(rows) - MOST_STRIPS
    return {
        "rows": rows[:MOST_STRIPS],
        "longest_s": longest,
        "ticks": ticks(0.0, longest, 8),
        "top_n": top,
        "left_out": left_out,
    }
