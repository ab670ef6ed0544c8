"""A law's numbers by the simulator itself: what it leaves of the fitted recordings, least squares.

The size enters (nearly) linearly and is solved for; shapes, times and ways move by Gauss-Newton
with step control, positive ones in their logarithm.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.problem import Problem, huber, knee
from eps_hil.diagnosis.remainder.grammar import Law
from eps_hil.physics.empirical_entry import SIGNS
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
Ranges = dict[str, tuple[float, float]]

_ROUNDS = 8
_ENOUGH = 1e-3
"""Share of the cost by which a round has to lower it to be worth another one."""
_FARTHEST = 1.2
"""Most that a logarithm moves at once."""
_POSITIVE = ("width", "memory", "order")


def with_laws(model: Model, laws: Sequence[Law], ranges: Ranges) -> Model:
    """The model with laws added to its effects."""
    return replace(model, effects=(*model.effects, *(one.entry(ranges) for one in laws)))


def refine(
    problem: Problem,
    model: Model,
    law: Law,
    ranges: Ranges,
    beside: Floats | None = None,
    zero: Floats | None = None,
) -> Law:
    """The law with the numbers at which ``model`` with it leaves least of ``problem``.

    ``beside`` (n, p): sensitivities of the residual to numbers that move with it; what they can do
    does not count (variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973).
    ``zero``: the residual without the law, where it is known.
    """
    zero = problem.residual(model) if zero is None else zero
    use = problem.sliding
    weight = np.sqrt(np.where(use, huber(zero, knee(zero)), 0.0))
    names = [
        (i, name)
        for i, one in enumerate(law.inputs)
        for name in one.numbers
        if not (name == "centre" and one.name in SIGNS)
    ]
    basis = np.zeros((len(zero), 0)) if beside is None else orthonormal(beside * weight[:, None])

    def seen(residual: Floats) -> Floats:
        weighed = residual * weight
        return np.asarray(weighed - basis @ (basis.T @ weighed))

    base = seen(zero)

    def at(law: Law) -> tuple[Law, Floats, float]:
        """The law with its best size, the weighted residual and its cost."""
        size = law.size
        for _ in range(2):
            left = seen(problem.residual(with_laws(model, [replace(law, size=size)], ranges)))
            column = (left - base) / size if size else left * 0.0
            norm = float(column @ column)
            if norm <= 0.0:
                return law, base, float(base @ base)
            better = -float(column @ base) / norm
            if not np.isfinite(better) or better == 0.0:
                return law, base, float(base @ base)
            close = abs(better - size) < 0.02 * abs(better)
            size = better
            if close or law.where != "friction":
                break
        left = base + column * size
        return replace(law, size=size), left, float(left @ left)

    law, left, cost = at(law)
    for _ in range(_ROUNDS if names else 0):
        columns = []
        for key in names:
            step = _step(law, key)
            _, moved, _ = at(_moved(law, [key], np.array([step])))
            columns.append((moved - left) / step)
        jacobian = np.column_stack(columns)
        normal = jacobian.T @ jacobian
        size = np.sqrt(np.maximum(np.diag(normal), 1e-30))
        slope = jacobian.T @ left / size
        before = cost
        for damping in (1e-3, 0.1, 3.0):
            scaled = normal / np.outer(size, size) + damping * np.eye(len(size))
            change = -np.linalg.solve(scaled, slope) / size
            trial, remains, lower = at(_moved(law, names, change))
            if lower < cost:
                law, left, cost = trial, remains, lower
                break
        if before - cost < _ENOUGH * before:
            break
    return law


def orthonormal(columns: Floats) -> Floats:
    """An orthonormal basis (n, k) of what columns (n, p) span."""
    size = np.sqrt(np.sum(columns**2, axis=0))
    columns = columns[:, size > 0] / size[size > 0]
    if columns.shape[1] == 0:
        return columns
    q, r = np.linalg.qr(columns)
    return np.asarray(q[:, np.abs(np.diag(r)) > 1e-6])


def _step(law: Law, key: tuple[int, str]) -> float:
    i, name = key
    if name == "order":
        return 1e-4
    if name in _POSITIVE or name == "phase":
        return 0.02
    return 0.02 * max(abs(law.inputs[i].numbers.get("width", law.inputs[i].numbers[name])), 1e-6)


def _moved(law: Law, names: Sequence[tuple[int, str]], change: Floats) -> Law:
    numbers = {}
    for (i, name), step in zip(names, change.tolist(), strict=True):
        value = law.inputs[i].numbers[name]
        if name in _POSITIVE:
            value *= float(np.exp(np.clip(step, -_FARTHEST, _FARTHEST)))
        else:
            value += step
        if name == "phase":
            value = (value + np.pi) % (2 * np.pi) - np.pi
        numbers[i, name] = float(value)
    return law.with_numbers(numbers)
