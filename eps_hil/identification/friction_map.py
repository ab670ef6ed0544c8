"""Friction over speed and load as measured (2Q-map), and which cells still lack data.

What the balance leaves for friction while the rotor slides steadily, averaged over cells of signed
speed and |rack force|; the spread over strokes gives each cell its interval.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.identification import filters
from eps_hil.identification.balance import Case
from eps_hil.identification.stages import SETTLED_SHARE, Sliding
from eps_hil.identification.state import State
from eps_hil.physics.balance import residual_nm

Floats = npt.NDArray[np.float64]

SPEEDS = (0.5, 3.0, 7.5, 15.0, 25.0, 35.0, 50.0, 80.0, 160.0, 320.0, 640.0)
LOADS = (0.0, 250.0, 750.0, 1250.0, 1750.0, 2250.0, 2750.0, 3500.0, 5000.0, 10000.0)
STEADY_NM = 0.05
"""Acceleration torque up to which motion counts as steady."""
ENOUGH_S = 0.5
BLOCK_S = 1.0


@dataclass(frozen=True)
class Cell:
    """Friction (positive, Nm) against motion of one sign, at mean speed and load; steady seconds.

    ``ci95`` is None where fewer than three strokes of a second fall into the cell.
    """

    speed_range: tuple[float, float]
    load_range: tuple[float, float]
    speed_rad_s: float
    load_n: float
    friction_nm: float
    ci95: tuple[float, float] | None
    fit_nm: float
    seconds: float

    def content(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "speed_rad_s": self.speed_rad_s,
            "load_n": self.load_n,
            "friction_nm": self.friction_nm,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "fit_nm": self.fit_nm,
            "seconds": self.seconds,
            "speed_range_rad_s": list(self.speed_range),
            "load_range_n": list(self.load_range),
        }


@dataclass(frozen=True)
class FrictionMap:
    """Cells that hold data; ``seconds`` (2, speeds, loads) for the coverage table, + first."""

    cells: tuple[Cell, ...]
    speeds: tuple[float, ...]
    loads: tuple[float, ...]
    seconds: Floats

    def lacking(self) -> list[str]:
        """Cells within the region that was visited at all that hold less than ENOUGH_S."""
        words = []
        for sign, direction in enumerate("+-"):
            for i in range(len(self.speeds) - 1):
                for j in range(len(self.loads) - 1):
                    if self.seconds[sign, i, j] < ENOUGH_S:
                        words.append(
                            f"{direction}{self.speeds[i]:g} to {direction}{self.speeds[i + 1]:g} "
                            f"rad/s at {self.loads[j]:g} to {self.loads[j + 1]:g} N"
                        )
        return words

    def content(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "cells": [cell.content() for cell in self.cells],
            "coverage": {
                "speed_edges_rad_s": list(self.speeds),
                "load_edges_n": list(self.loads),
                "seconds_pos": self.seconds[0].round(2).tolist(),
                "seconds_neg": self.seconds[1].round(2).tolist(),
                "enough_s": ENOUGH_S,
                "lacking": self.lacking(),
            },
        }


def friction_map(cases: Sequence[Case], state: State, weights: Sliding) -> FrictionMap:
    """The map of all recordings under the identified inertia and delays."""
    parts = [_rows(case, state, weights) for case in cases]
    speed, load, friction, fitted, block = (
        np.concatenate(part) for part in zip(*parts, strict=True)
    )
    forth = speed > 0
    size = np.abs(speed)
    # edges: as far as the recordings went, and no further than anybody asked
    top_speed = np.searchsorted(SPEEDS, size.max()) if len(size) else 1
    top_load = np.searchsorted(LOADS, load.max()) if len(load) else 1
    speeds = SPEEDS[: max(2, int(top_speed) + 1)]
    loads = LOADS[: max(2, int(top_load) + 1)]
    seconds = np.zeros((2, len(speeds) - 1, len(loads) - 1))
    per_row = filters.STEP_S * filters.THIN
    cells = []
    for sign, mine in enumerate((forth, ~forth)):
        for i in range(len(speeds) - 1):
            for j in range(len(loads) - 1):
                rows = mine & (size >= speeds[i]) & (size < speeds[i + 1])
                rows &= (load >= loads[j]) & (load < loads[j + 1])
                seconds[sign, i, j] = rows.sum() * per_row
                if seconds[sign, i, j] < 0.05:
                    continue
                cells.append(
                    Cell(
                        (speeds[i], speeds[i + 1]),
                        (loads[j], loads[j + 1]),
                        float(speed[rows].mean()),
                        float(load[rows].mean()),
                        float(friction[rows].mean()),
                        _interval(friction[rows], block[rows]),
                        float(fitted[rows].mean()),
                        float(seconds[sign, i, j]),
                    )
                )
    return FrictionMap(tuple(cells), tuple(speeds), tuple(loads), seconds)


def _rows(case: Case, state: State, weights: Sliding) -> tuple[Floats, ...]:
    left, law = residual_nm(state.model, case.physical(state))
    force = case.rack_force_n(state)
    law = law - force / state.model.rack_to_rotor_ratio_rad_per_m
    acceleration = state.model.inertia_kg_m2 * case.motion.acceleration
    friction = filters.smooth(left + law) - acceleration
    speed = filters.thinned(case.motion.speed)
    share = weights.unsettled(case, state)
    mine = (share <= SETTLED_SHARE) & case.good & (np.abs(acceleration) < STEADY_NM)
    mine &= np.abs(speed) >= SPEEDS[0]
    sign = np.sign(speed)
    block = 100_000 * case.index + (case.time_s // BLOCK_S)
    columns = (
        speed,
        np.abs(filters.thinned(force)),
        sign * friction,
        sign * filters.smooth(law),
        block,
    )
    return tuple(column[mine] for column in columns)


def _interval(friction: Floats, block: Floats) -> tuple[float, float] | None:
    numbers, inverse = np.unique(block, return_inverse=True)
    if len(numbers) < 3:
        return None
    from scipy.stats import t

    n = np.bincount(inverse)
    mean = float(friction.mean())
    off = np.bincount(inverse, friction - mean)
    variance = float(np.sum(off**2)) / float(n.sum()) ** 2 * len(numbers) / (len(numbers) - 1)
    half = float(t.ppf(0.975, len(numbers) - 1)) * float(np.sqrt(variance))
    return mean - half, mean + half
