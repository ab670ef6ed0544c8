"""Where rig and model part: a map over speed and load, and a strip over time, of all that is kept.

What is shown is the residual of the torque balance (or, where there is none, of the published
estimate), as rms force at the rack.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from eps_hil.dashboard.decimate import Float64, Int64
from eps_hil.dashboard.store import Store
from eps_hil.dashboard.traces import BALANCE, CELL, ERROR, ESTIMATE, SPEED

CELLS = 16
LEAST_SAMPLES = 8
_WINDOWS, _LEAST_WINDOW_S = 180, 0.5
_THIN_NS = 8_000_000
"""Instants are no closer, so that a map of minutes at 1 kHz costs no more than a screen shows."""


def overview(store: Store, limit_n: float) -> dict[str, Any] | None:
    """JSON-ready; None where there is nothing to show. ``limit_n``: that of the alarm."""
    what, t_ns, left_n = _residual(store)
    good = np.isfinite(left_n)
    t_ns, left_n = t_ns[good], left_n[good]
    if not len(t_ns):
        return None
    return {
        "what": "torque balance" if what == BALANCE else "estimate less load cell",
        "limit_n": limit_n,
        "map": _map(store, t_ns, left_n, limit_n),
        "strip": strip_of(t_ns, {"now": left_n}),
        "kept": [(store.oldest_ns or 0) * 1e-9, (store.newest_ns or 0) * 1e-9],
    }


def _residual(store: Store) -> tuple[str, Int64, Float64]:
    """That which there is; the estimate's is thinned."""
    for name in (BALANCE, ERROR):
        track = store.tracks[name]
        if len(track.t_ns) and np.isfinite(track.value).any():
            step = 1 if name == BALANCE else _every(track.t_ns)
            return name, track.t_ns[::step], track.value[::step]
    return ERROR, np.empty(0, np.int64), np.empty(0)


def _every(t_ns: Int64) -> int:
    if len(t_ns) < 2:
        return 1
    return max(1, round(_THIN_NS * (len(t_ns) - 1) / max(int(t_ns[-1] - t_ns[0]), 1)))


def _map(store: Store, t_ns: Int64, left_n: Float64, limit_n: float) -> dict[str, Any] | None:
    load = CELL if len(store.tracks[CELL].t_ns) else ESTIMATE
    x, y = store.at(SPEED, t_ns), store.at(load, t_ns)
    good = np.isfinite(x) & np.isfinite(y)
    if not good.any():
        return None
    return map_of(x[good], y[good], {"now": left_n[good]}, limit_n)


def map_of(x: Float64, y: Float64, left_n: Mapping[str, Float64], limit_n: float) -> dict[str, Any]:
    """Cells over speed ``x`` and load ``y`` (n,) of each residual, on axes of their own."""
    ends = [nice(float(np.percentile(np.abs(one), 99.8))) for one in (x, y)]
    axes = {"x": [-ends[0], ends[0]], "y": [-ends[1], ends[1]]}
    cells = {name: grid(x, y, one, ends[0], ends[1]) for name, one in left_n.items()}
    most = max((value for one in cells.values() for _, _, value, _ in one), default=0.0)
    return {**axes, "cells": CELLS, "top_n": max(most, limit_n, 1e-9), **cells}


def grid(
    x: Float64, y: Float64, left_n: Float64, x_end: float, y_end: float
) -> list[tuple[int, int, float, int]]:
    """(column, row from below, rms, samples) of each visited cell; axes go from -end to end."""
    place = [
        np.floor(0.5 * (one / end + 1.0) * CELLS).astype(np.int64)
        for one, end in ((x, x_end), (y, y_end))
    ]
    inside = np.all([(one >= 0) & (one < CELLS) for one in place], axis=0)
    cell = (place[1] * CELLS + place[0])[inside]
    count = np.bincount(cell, minlength=CELLS**2)
    energy = np.bincount(cell, weights=left_n[inside] ** 2, minlength=CELLS**2)
    return [
        (
            int(k % CELLS),
            int(k // CELLS),
            float(f"{np.sqrt(energy[k] / count[k]):.4g}"),
            int(count[k]),
        )
        for k in np.flatnonzero(count >= LEAST_SAMPLES)
    ]


def nice(most: float) -> float:
    """A round number that is no less: axes of a map that grows shall not creep."""
    if not most > 0.0:
        return 1.0
    unit = 10.0 ** np.floor(np.log10(most))
    return float(next(unit * one for one in (1, 1.5, 2, 3, 4, 6, 8, 10) if unit * one >= most))


def strip_of(t_ns: Int64, left_n: Mapping[str, Float64]) -> dict[str, Any]:
    """(begin s, rms N) of stretches of equal length, of each residual (n,)."""
    begin = int(t_ns[0])
    window_s = max((int(t_ns[-1]) - begin) * 1e-9 / _WINDOWS, _LEAST_WINDOW_S)
    if window_s > _LEAST_WINDOW_S:
        window_s = nice(window_s)
    window_ns = round(window_s * 1e9)
    first = begin // window_ns
    place = t_ns // window_ns - first
    count = np.bincount(place)
    there = np.flatnonzero(count).tolist()
    strip: dict[str, Any] = {"window_s": window_s}
    for name, one in left_n.items():
        rms = np.sqrt(np.bincount(place, weights=one**2) / np.maximum(count, 1))
        strip[name] = [((first + k) * window_ns * 1e-9, float(f"{rms[k]:.4g}")) for k in there]
    return strip
