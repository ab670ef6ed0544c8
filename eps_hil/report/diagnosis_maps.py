"""Where a mismatch sits: a map over the operating region, profiles, and strips over time."""

from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.report.diagnosis_evidence import LABELS, Evidence
from eps_hil.report.plots import Line, Plot

Floats = npt.NDArray[np.float64]

CELLS = 20
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


def region(evidence: Evidence) -> dict[str, Any]:
    """Rms of what is left (N at the rack) in cells of speed and the signal that tells most."""
    second = _telling(evidence)
    x, y = evidence.signals["motor_speed_rad_s"], evidence.signals[second]
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
        for title, size in zip(("model as it was", "with the findings"), sizes, strict=False)
    ]
    return {
        "x_label": LABELS["motor_speed_rad_s"],
        "y_label": LABELS[second],
        "x_range": [float(x_edges[0]), float(x_edges[-1])],
        "y_range": [float(y_edges[0]), float(y_edges[-1])],
        "top_n": top,
        "maps": maps,
        "cells": CELLS,
    }


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
        x = evidence.signals[name][use]
        if name in ("motor_angle_rad", "time_s") or len(x) < 100 or np.ptp(x) < 1e-9:
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
            Line("model as it was", "before", along(evidence.before_nm)),
        ]
        if evidence.entries:
            lines.append(Line("with the findings", "after", along(evidence.after_nm)))
        centre = 0.5 * (edges[1:] + edges[:-1])
        plots.append(Plot(f"profile-{name}", LABELS[name], "left over, N", centre, lines))
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
    return {"rows": rows[:MOST_STRIPS], "longest_s": longest, "top_n": top, "left_out": left_out}
