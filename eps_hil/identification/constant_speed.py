"""Friction read off constant-speed passes, as the paper did: mean torque over what holds the speed.

With rack force F and acceleration nearly zero, eq. 1d leaves T_f = T_em + (i_pi/i_APA) T_sen −
F/i_APA − J ω̇; its mean over a pass is one reading of one cell (speed, load).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from eps_hil.physics.chain import HAND_ANGLE, LOAD_FORCE
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Friction, Model

Floats = npt.NDArray[np.float64]

_EDGE_S = 0.02
_LEAST_SPREAD = 0.01
"""Share of their largest by which speeds and loads must differ, each beside the other."""
_NAMES = ("offset", "viscous", "load")
_UNITS = ("nm", "nm_s_per_rad", "nm_per_n")


@dataclass(frozen=True, slots=True)
class Cell:
    """One pass: set-point speed (rotor, rad/s), mean speed, mean load (N), mean friction (Nm)."""

    set_speed_rad_s: float
    set_load_n: float
    speed_rad_s: float
    load_n: float
    friction_nm: float


@dataclass(frozen=True, slots=True)
class FrictionMap:
    """Level |T_f| by speed and load: ``level_nm[i, j]`` at ``speed_rad_s[i]``, ``load_n[j]``.

    ``spread_nm`` is the standard deviation over repetitions (NaN for one).
    """

    speed_rad_s: Floats
    load_n: Floats
    level_nm: Floats
    spread_nm: Floats

    def level(self, speed_rad_s: Floats, load_n: Floats) -> Floats:
        """2Q-map: bilinear within each speed quadrant, held at its edges; arrays (n,)."""
        from scipy.interpolate import RegularGridInterpolator

        load = np.clip(np.abs(load_n), self.load_n[0], self.load_n[-1])
        out = np.empty_like(load)
        for side in (True, False):
            rows = self.speed_rad_s > 0 if side else self.speed_rad_s < 0
            grid = self.speed_rad_s[rows]
            here = (speed_rad_s >= 0) == side
            speed = np.clip(speed_rad_s[here], grid[0], grid[-1])
            table = RegularGridInterpolator((grid, self.load_n), self.level_nm[rows])
            out[here] = table(np.column_stack([speed, load[here]]))
        return out


def cells_of(
    columns: Mapping[str, Floats], set_points: Floats, model: Model, settled_s: float
) -> list[Cell]:
    """Every constant-speed pass of one recording, cut by the set-points that the rig was given.

    ``settled_s`` after a set-point is reached its torque counts: by then the torsion bar is wound
    up, its ringing is over and the bristle is full.
    """
    rate = np.round(np.diff(set_points[:, HAND_ANGLE]) * 1000.0, 9)
    load = set_points[:-1, LOAD_FORCE]
    moved = np.r_[True, (np.abs(np.diff(rate)) > 1e-6) | (np.abs(np.diff(load)) > 1e-6), True]
    edges = np.flatnonzero(moved)
    model = with_model_effects(model)
    physical = _aligned(columns, model)
    ratio = model.rack_to_rotor_ratio_rad_per_m / model.pinion_ratio_rad_per_m
    found = []
    for first, last in pairwise(edges.tolist()):
        start, end = first + round(settled_s * 1000), last - round(_EDGE_S * 1000)
        if abs(rate[first]) < 1e-6 or end - start < 100:
            continue
        part = {name: value[start:end] for name, value in physical.items()}
        seconds = (end - start) / 1000.0
        found.append(reading(rate[first] * ratio, load[first], part, seconds, model))
    return found


def reading(
    set_speed_rad_s: float,
    set_load_n: float,
    samples: Mapping[str, Floats],
    seconds: float,
    model: Model,
) -> Cell:
    """One pass at constant speed: T_f = T_1m − F/i_APA − J ω̇ in the mean (eq. 1d).

    ``samples``: evenly spaced over the same ``seconds``, each signal at a rate of its own.
    """
    model = with_model_effects(model)
    mean = {name: float(np.mean(value)) for name, value in samples.items()}
    speed = samples["motor_speed_rad_s"]
    slope = float(np.polyfit(np.linspace(0.0, seconds, len(speed)), speed, 1)[0])
    torque = mean["motor_torque_nm"] + model.sensor_to_rotor * mean["torque_sensor_nm"]
    load = mean["rack_force_n"] / model.rack_to_rotor_ratio_rad_per_m
    return Cell(
        float(set_speed_rad_s),
        float(set_load_n),
        mean["motor_speed_rad_s"],
        mean["rack_force_n"],
        torque - load - model.inertia_kg_m2 * slope,
    )


def measured_map(cells: Sequence[Cell]) -> FrictionMap:
    """Mean level and spread of all passes of a cell."""
    speeds = sorted({round(cell.set_speed_rad_s, 3) for cell in cells})
    loads = sorted({cell.set_load_n for cell in cells})
    level, spread = np.full((2, len(speeds), len(loads)), np.nan)
    for i, speed in enumerate(speeds):
        for j, load in enumerate(loads):
            values = [
                abs(cell.friction_nm)
                for cell in cells
                if round(cell.set_speed_rad_s, 3) == speed and cell.set_load_n == load
            ]
            if values:
                level[i, j] = np.mean(values)
                spread[i, j] = np.std(values, ddof=1) if len(values) > 1 else np.nan
    return FrictionMap(np.array(speeds), np.array(loads), level, spread)


def fitted(cells: Sequence[Cell], friction: Friction) -> tuple[Friction, dict[str, float]]:
    """Eq. 3 by least squares, one fit per direction: the friction block and 95 % half widths.

    What eq. 3 does not hold (σ0, σ1, ω_σ1) is taken over from ``friction``. Each direction needs
    cells of which :func:`enough` is said. A number that would come out below zero is zero, and the
    others are the best beside that.
    """
    from scipy.optimize import nnls
    from scipy.stats import t as student

    values, widths = {}, {}
    for side, sign in (("pos", 1.0), ("neg", -1.0)):
        own = [cell for cell in cells if cell.speed_rad_s * sign > 0]
        a = _regressors(own)
        y = np.array([abs(cell.friction_nm) for cell in own])
        solution, *_ = np.linalg.lstsq(a, y, rcond=None)
        free = len(own) - a.shape[1]
        variance = float(np.sum((y - a @ solution) ** 2)) / free * np.linalg.inv(a.T @ a)
        wide = student.ppf(0.975, free) * np.sqrt(np.diag(variance))
        if solution.min() < 0.0:  # friction that falls with speed or load
            solution = nnls(a, y)[0]
        for name, unit, value, width in zip(_NAMES, _UNITS, solution, wide, strict=True):
            values[f"{name}_{side}_{unit}"] = float(value)
            widths[f"{name}_{side}_{unit}"] = float(width)
    return replace(friction, **values), widths


def enough(cells: Sequence[Cell]) -> bool:
    """Whether cells of one direction give the three numbers of eq. 3, and an error of theirs."""
    a = _regressors(cells)
    if len(a) <= a.shape[1]:
        return False
    scale = np.max(np.abs(a), axis=0)
    least = np.linalg.svd(a / np.where(scale > 0.0, scale, 1.0), compute_uv=False)[-1]
    return bool(least > _LEAST_SPREAD * math.sqrt(len(a)))


def _regressors(cells: Sequence[Cell]) -> Floats:
    """1, |speed| and |load| of each cell (n, 3)."""
    return np.array([[1.0, abs(cell.speed_rad_s), abs(cell.load_n)] for cell in cells])


def _aligned(columns: Mapping[str, Floats], model: Model) -> dict[str, Floats]:
    """Columns at physical instants: each read as much later as it is reported late."""
    time_s = columns["time_s"]
    return {
        name: np.interp(time_s + model.delays_s.of(name), time_s, value)
        for name, value in columns.items()
        if name != "time_s"
    }
