"""All parameters of the chosen effects together: bounded least squares on the torque balance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.probes import neutral_value
from eps_hil.diagnosis.problem import Problem, knee
from eps_hil.physics.effects.catalogue import catalogue

Floats = npt.NDArray[np.float64]

_FIXED = ("belt_ratio", "pole_pairs", "harmonic", "curve")
"""Not moved by the joint fit: given by the model file, or solved for in one step (a curve)."""


@dataclass(frozen=True)
class Fit:
    """Fitted entries, weighted residual (n,), and parameter covariance in the order of names."""

    entries: tuple[dict[str, Any], ...]
    residual: Floats
    names: tuple[tuple[int, str], ...]
    covariance: Floats
    jacobian: Floats

    @property
    def cost(self) -> float:
        """Sum of squares in units of the sensor noise."""
        return float(self.residual @ self.residual)


def fit(problem: Problem, entries: Sequence[Mapping[str, Any]], rounds: int = 6) -> Fit:
    """Levenberg-Marquardt within bounds from the given entries; Huber weights against outliers."""
    names = tuple(
        (k, p.name)
        for k, entry in enumerate(entries)
        for p in catalogue()[entry["effect"]].parameters
        if p.name in entry and p.name not in _FIXED
    )
    work = [dict(entry) for entry in entries]
    residual = problem.residual(problem.with_entries(work))
    jacobian = np.zeros((len(residual), len(names)))
    damping, at = 1e-3, knee(residual)
    for _ in range(rounds if names else 0):
        jacobian = _jacobian(problem, work, names, residual)
        weight = _huber(residual, at)
        weighted = jacobian * weight[:, None]
        normal, slope = weighted.T @ jacobian, weighted.T @ residual
        size = np.sqrt(np.maximum(np.diag(normal), 1e-30))
        improved = False
        for _attempt in range(5):
            scaled = normal / np.outer(size, size) + damping * np.eye(len(names))
            step = -np.linalg.lstsq(scaled, slope / size, rcond=None)[0] / size
            trial = _moved(work, names, step)
            changed = problem.residual(problem.with_entries(trial))
            cost, lower = float(np.sum(_rho(residual, at))), float(np.sum(_rho(changed, at)))
            if lower < cost:
                gain = 1.0 - lower / cost
                work, residual, improved = trial, changed, True
                damping = max(damping / 10, 1e-9)
                break
            damping *= 10
        if not improved or gain < 1e-5:
            break
    return Fit(tuple(work), residual, names, _covariance(jacobian, residual, problem), jacobian)


def _rho(residual: Floats, at: float) -> Floats:
    size = np.abs(residual)
    return np.where(size < at, 0.5 * residual**2, at * size - 0.5 * at * at)


def _huber(residual: Floats, at: float) -> Floats:
    size = np.abs(residual)
    return np.where(size < at, 1.0, at / np.maximum(size, at))


def _jacobian(
    problem: Problem,
    entries: Sequence[Mapping[str, Any]],
    names: Sequence[tuple[int, str]],
    residual: Floats,
) -> Floats:
    columns = []
    for k, name in names:
        effect = catalogue()[entries[k]["effect"]]
        (parameter,) = (p for p in effect.parameters if p.name == name)
        value = float(entries[k][name])
        size = _step(effect, name, value, parameter.upper - parameter.lower)
        step = size if value + size <= parameter.upper else -size
        changed = [dict(entry) for entry in entries]
        changed[k][name] = value + step
        columns.append((problem.residual(problem.with_entries(changed)) - residual) / step)
    return np.column_stack(columns)


def _step(effect: Any, name: str, value: float, span: float) -> float:
    probe = effect.probe
    if probe is not None and name == probe.amplitude:
        return float(probe.step)
    return max(abs(value) * 0.01, min(span * 1e-4, 0.01))


def _moved(
    entries: Sequence[Mapping[str, Any]], names: Sequence[tuple[int, str]], step: Floats
) -> list[dict[str, Any]]:
    moved = [dict(entry) for entry in entries]
    for (k, name), change in zip(names, step, strict=True):
        effect = catalogue()[moved[k]["effect"]]
        (parameter,) = (p for p in effect.parameters if p.name == name)
        value = moved[k][name] + change
        if effect.probe is not None and name == effect.probe.phase:
            value = (value + np.pi) % (2 * np.pi) - np.pi
        elif parameter.lower > 0:  # a scale: no more than a factor of three at once
            value = np.clip(value, moved[k][name] / 3, moved[k][name] * 3)
        moved[k][name] = float(np.clip(value, parameter.lower, parameter.upper))
    return moved


def _covariance(jacobian: Floats, residual: Floats, problem: Problem) -> Floats:
    """Sandwich over blocks: residuals of one block hang together, and so count once."""
    if jacobian.shape[1] == 0:
        return np.zeros((0, 0))
    normal = jacobian.T @ jacobian
    inverse = np.linalg.pinv(normal)
    middle = np.zeros_like(normal)
    for block in np.unique(problem.block):
        rows = problem.block == block
        score = jacobian[rows].T @ residual[rows]
        middle += np.outer(score, score)
    blocks = len(np.unique(problem.block))
    return np.asarray(inverse @ middle @ inverse * blocks / max(blocks - 1, 1))


def ablated(problem: Problem, found: Fit, k: int, rounds: int = 3) -> Fit:
    """The fit without entry ``k``, the others refitted."""
    return fit(problem, [e for i, e in enumerate(found.entries) if i != k], rounds)


def deviation(entry: Mapping[str, Any], problem: Problem) -> float:
    """How far an entry's amplitude is from where the effect is not there."""
    probe = catalogue()[entry["effect"]].probe
    assert probe is not None
    if probe.scan == "curve":
        return max(abs(torque) for _, torque in entry[probe.amplitude])
    return float(abs(entry[probe.amplitude] - neutral_value(probe, problem.model)))


def matters(entry: Mapping[str, Any], problem: Problem) -> bool:
    """Whether an entry is large enough to be a finding rather than how rigs are."""
    probe = catalogue()[entry["effect"]].probe
    assert probe is not None
    return deviation(entry, problem) > max(probe.least, 1e-9)
