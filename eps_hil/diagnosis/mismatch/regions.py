"""Where a mismatch sits, in one and two coordinates, with a test that counts every cell looked at.

Energy is averaged in cells of equal occupancy over each coordinate and each pair of them. A cell's
standard error treats the samples of one block as one (they are correlated), and of all cells of all
maps only those stand that survive a false discovery rate of 1 %.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import STEP_S, THIN
from eps_hil.diagnosis.mismatch.locate import coordinates

Floats = npt.NDArray[np.float64]
Axis = tuple[Floats, npt.NDArray[np.int8]]
"""Edges of a coordinate's parts, and the part that each sample is in."""

CELLS_1D, CELLS_2D = 12, 6
FALSE_DISCOVERIES = 0.01
LEAST_SAMPLES, LEAST_BLOCKS = 15, 6
LEAST_RATIO = 1.5
"""A cell worth naming holds this many times its share of the time."""
MOST_CELLS = 8
LEAST_REST_S = 0.1
"""A shorter rest is a rotor that turns round: no place by itself."""
UNITS = {
    "motor_speed_rad_s": "rad/s",
    "abs_motor_speed_rad_s": "rad/s",
    "rack_force_n": "N",
    "rack_position_m": "m",
    "motor_torque_nm": "Nm",
    "torque_sensor_nm": "Nm",
    "since_reversal_s": "s",
    "dwell_s": "s",
    "time_s": "s",
    "motor_temperature_degc": "°C",
}


@dataclass(frozen=True)
class Cell:
    """One cell: its sides, the share of the energy and of the time in it, its corrected p."""

    sides: tuple[tuple[str, float, float], ...]
    share: float
    time: float
    p: float

    def content(self) -> dict[str, Any]:
        """For the JSON."""
        return {
            "signals": [name for name, _, _ in self.sides],
            "from": [low for _, low, _ in self.sides],
            "to": [high for _, _, high in self.sides],
            "share_of_excess": round(self.share, 4),
            "share_of_time": round(self.time, 4),
            "p": float(f"{self.p:.2g}"),
        }


def operating_region(problem: Problem) -> Mapping[str, Floats]:
    """Every coordinate of the thinned samples, each (n,), those of the friction's past included."""
    found = dict(coordinates(problem))
    speed = found["motor_speed_rad_s"]
    found["abs_motor_speed_rad_s"] = np.abs(speed)
    since, dwell = np.empty(len(speed)), np.empty(len(speed))
    start = 0
    for one in problem.recordings:
        n = len(one.thin_time_s)
        part = slice(start, start + n)
        since[part], dwell[part] = _past(speed[part])
        start += n
    found["since_reversal_s"], found["dwell_s"] = since, dwell
    if all("motor_temperature_degc" in one.raw for one in problem.recordings):
        found["motor_temperature_degc"] = np.concatenate(
            [one.thin(one.raw["motor_temperature_degc"]) for one in problem.recordings]
        )
    return found


def _past(speed: Floats) -> tuple[Floats, Floats]:
    """(time since the last change of direction, length of the last rest), both in s."""
    step = THIN * STEP_S
    since, dwell = np.zeros(len(speed)), np.zeros(len(speed))
    direction, last, resting, rested = 0.0, 0.0, 0.0, 0.0
    for k, now in enumerate(np.sign(speed).tolist()):
        last += step
        if now == 0.0:
            resting += step
        else:
            if resting > 0.0:
                rested, resting = resting, 0.0
            if now != direction:
                direction, last = now, 0.0
        since[k], dwell[k] = last, rested
    return since, dwell


def cells(problem: Problem, energy: Floats) -> list[Cell]:
    """The cells that hold clearly more ``energy`` (n,) than the rest, most telling first.

    Only sliding samples count. One cell a map is kept, so that several coordinates are named.
    """
    use = problem.sliding
    values = {name: one[use] for name, one in operating_region(problem).items()}
    values = {name: one for name, one in values.items() if np.ptp(one) > 1e-9}
    total = float(np.sum(energy[use]))
    if total <= 0.0 or np.sum(use) < 10 * LEAST_SAMPLES:
        return []
    energy, block = energy[use], problem.block[use]
    maps: list[tuple[str, ...]] = [(name,) for name in values]
    maps += combinations(values, 2)
    looked: list[tuple[tuple[str, ...], Cell]] = []

    @cache
    def axis(name: str, count: int) -> Axis:
        return _divided(values[name], count)

    for names in maps:
        if {"motor_speed_rad_s", "abs_motor_speed_rad_s"} <= set(names):
            continue
        count = CELLS_1D if len(names) == 1 else CELLS_2D
        axes = [axis(name, count) for name in names]
        for cell in _map(names, axes, energy, block, total):
            looked.append((names, cell))
    accepted = _discoveries([cell.p for _, cell in looked])
    best: dict[tuple[str, ...], Cell] = {}
    for (names, cell), corrected in zip(looked, accepted, strict=True):
        if corrected > FALSE_DISCOVERIES or cell.share < LEAST_RATIO * cell.time:
            continue
        if any(name == "dwell_s" and high < LEAST_REST_S for name, _, high in cell.sides):
            continue
        kept = Cell(cell.sides, cell.share, cell.time, corrected)
        if names not in best or _telling(kept) > _telling(best[names]):
            best[names] = kept
    return sorted(best.values(), key=lambda cell: -_telling(cell))[:MOST_CELLS]


def _telling(cell: Cell) -> float:
    """How much more energy than time; the information that a cell gives of it, in nats."""
    return cell.share * float(np.log(max(cell.share, 1e-12) / max(cell.time, 1e-12)))


def _divided(values: Floats, count: int) -> Axis:
    """A coordinate in ``count`` parts that hold as many samples each."""
    edges = np.unique(np.quantile(values, np.linspace(0, 1, count + 1)))
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    return edges, place.astype(np.int8)


def _map(
    names: tuple[str, ...],
    axes: list[Axis],
    energy: Floats,
    block: npt.NDArray[np.int64],
    total: float,
) -> list[Cell]:
    edges = [one for one, _ in axes]
    if any(len(one) < 3 for one in edges):
        return []
    index = np.zeros(len(energy), dtype=np.int64)
    for edge, place in axes:
        index = index * (len(edge) - 1) + place
    cells, shape = np.prod([len(one) - 1 for one in edges]), (-1, int(np.max(block)) + 1)
    both = index * shape[1] + block

    def summed(weights: Floats | None = None) -> Floats:
        """Over each cell's samples of each block, (cells, blocks)."""
        found = np.bincount(both, weights, int(cells) * shape[1]).reshape(shape)
        return np.asarray(found, dtype=np.float64)

    overall = total / len(energy)
    samples, energies = summed(), summed(energy)
    found = []
    for k in np.flatnonzero(np.sum(samples, axis=1) >= LEAST_SAMPLES):
        visited = samples[k] > 0
        blocks, count = int(np.sum(visited)), int(np.sum(samples[k]))
        if blocks < LEAST_BLOCKS:
            continue
        above = float(np.sum(energies[k])) - count * overall
        groups = energies[k] - samples[k] * np.sum(energies[k]) / count
        error = float(np.sqrt(np.sum(groups**2) * blocks / (blocks - 1))) + 1e-300
        sides, rest = [], int(k)
        for name, edge in reversed(list(zip(names, edges, strict=True))):
            rest, i = divmod(rest, len(edge) - 1)
            sides.append((name, float(edge[i]), float(edge[i + 1])))
        share = float(np.sum(energies[k])) / total
        p = _tail(above / error, blocks - 1)
        found.append(Cell(tuple(reversed(sides)), share, count / len(energy), p))
    return found


def _tail(t: float, freedom: int) -> float:
    """P(T > t) of Student's t: few blocks make for wide tails."""
    from scipy.special import stdtr

    return float(stdtr(max(freedom, 1), -t))


def _discoveries(p: list[float]) -> Floats:
    """Benjamini and Hochberg's adjusted p of every test."""
    n = len(p)
    if n == 0:
        return np.zeros(0)
    order = np.argsort(p)[::-1]
    scaled = np.array(p)[order] * n / np.arange(n, 0, -1)
    adjusted = np.empty(n)
    adjusted[order] = np.minimum(1.0, np.minimum.accumulate(scaled))
    return adjusted


def sentence(found: list[Cell]) -> str:
    """The most telling cell in words; empty where nothing stands out."""
    if not found:
        return ""
    cell = found[0]
    sides = ", ".join(
        f"{name} {low:.4g} to {high:.4g} {UNITS.get(name, '')}".strip()
        for name, low, high in cell.sides
    )
    return f"{100 * cell.share:.0f} % of the excess in {100 * cell.time:.0f} % of the time: {sides}"
