"""What a machine's rest and presliding leave that is no noise, and how much of it is one event.

At rest friction holds whatever there is between its two levels: of a joint that a controller and a
weight hold, the torque of one rest is one number, not one a sample, and which it is depends on
creep that no angle shows. In a model of another presliding such samples leave many times what
sliding leaves and, taken for independent, outweigh it: levels and inertia bend to what was held.
Where rest and presliding leave clearly more than they do in a right model, their deviation is what
they leave beside a fit to the sliding samples alone, and one stretch of them is one observation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import ALL, OFFSET, STIFFNESS
from eps_hil.diagnosis.balance.fit import FARTHEST_OWN, own_column
from eps_hil.diagnosis.balance.problem import (
    NOTHING_NM,
    PRESLIDING_SIGMA_NM,
    Problem,
    huber,
    knee,
)
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

_RIGHT = 2.0
"""Times what rest and presliding leave in a right model, up to which they count as they are."""
_NOT_SLIDING = (STIFFNESS, "sigma1_nm_s_per_rad", OFFSET)
"""Numbers that sliding says nothing of, or nothing beside both directions' levels."""
_ROUNDS, _TAIL = 5, 3.0


def problem_of(
    recordings: Sequence[Prepared], model: Model, tied: Mapping[str, float] | None = None
) -> Problem:
    """The recordings' problem, rest and presliding weighed by what they leave.

    A load cell shows what a rest is held against: with one, they count as in a right model.
    """
    problem = Problem(recordings, model, tied=tied or {})
    if not all(one.load_is_assumed for one in recordings):
        return problem
    held = _held_nm(problem)
    return replace(problem, held_nm=held) if held > 0.0 else problem


def _held_nm(problem: Problem) -> float:
    """Deviation (Nm) of one resting sample, beyond a right model's, where a rest counts once."""
    use = ~problem.sliding & (problem.scale < 0.5 * NOTHING_NM * problem.size.torque)
    if not use.any() or not problem.sliding.any():
        return 0.0
    left = np.abs(_left(problem) * problem.scale)[use]
    usual = 1.4826 * float(np.median(left))
    energy = float(np.mean(np.minimum(left, _TAIL * usual) ** 2))
    beyond = energy - (_RIGHT * PRESLIDING_SIGMA_NM * problem.size.torque) ** 2
    if beyond <= 0.0:
        return 0.0
    stretches = int(np.sum(np.diff(use.astype(np.int8), prepend=0) == 1))
    return float(np.sqrt(beyond * max(int(np.sum(use)) / stretches, 1.0)))


def _left(problem: Problem) -> Floats:
    """Weighted residual (n,) of the model whose own numbers were fitted to sliding alone.

    In one step, which is nearly linear; of the model as it is given, where that leaves less.
    """
    given = problem.residual(problem.model)
    names = [name for name in {**ALL, **problem.tied} if name not in _NOT_SLIDING]
    columns = np.column_stack([own_column(problem, name) for name in names])[problem.sliding]
    y = given[problem.sliding]
    weight: Floats = np.ones(len(y))
    moved: Floats = np.zeros(len(names))
    for _ in range(_ROUNDS):
        weighted = columns * weight[:, None]
        normal = weighted.T @ columns + np.eye(len(names))
        moved = np.asarray(-np.linalg.solve(normal, weighted.T @ y), dtype=np.float64)
        left = y + columns @ moved
        weight = huber(left, knee(left))
    own = dict(zip(names, np.clip(moved, -FARTHEST_OWN, FARTHEST_OWN).tolist(), strict=True))
    fitted = problem.residual(problem.with_entries([], own))
    better = np.median(np.abs(fitted[problem.sliding])) < np.median(np.abs(y))
    return fitted if better else given
