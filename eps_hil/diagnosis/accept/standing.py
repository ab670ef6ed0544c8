"""Nothing that makes recordings kept from the fit worse stands in the written model.

Each gate before this asks something of its own: a gain beside what else was fitted, a gain
beside a remainder. What is written is what is left after all of them, without the entries that
were dropped on the way, and that is judged here as it is reported: the hold-outs' torque
residual while sliding, outliers and all.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.holdout_support import augmented_by, refitted
from eps_hil.diagnosis.accept.proof_of_fit import CLEARLY, Holdout
from eps_hil.diagnosis.attribute.scoring import LEAST_GAIN
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.baseline import ALL
from eps_hil.diagnosis.balance.problem import BLOCK_S, Problem
from eps_hil.diagnosis.remainder.as_effect import free_numbers
from eps_hil.diagnosis.remainder.find import Remainder
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

_NOTHING = 0.1
"""Share of the gain that counts: a change of the hold-outs by less is none."""


def standing(
    problem: Problem, selection: Selection, findings: Sequence[int], judged: Sequence[Holdout]
) -> list[int]:
    """Places of the findings without those that the hold-outs are better off without.

    One at a time, the worst first; the others are refitted once it has gone. None where all that is
    left together does worse than the baseline.
    """
    left = refitted(problem, selection, findings)
    while left:
        with_all = augmented_by(problem, selection.found, left)
        spared = [
            augmented_by(problem, selection.found, [place for place in left if place != k])
            for k in left
        ]
        losses = [_loss(problem, one, with_all, judged) for one in spared]
        most = int(np.argmax(losses))
        if losses[most] <= 0.0:
            return left if _loss(problem, problem.model, with_all, judged) <= 0.0 else []
        left = refitted(problem, selection, [k for k in left if k != left[most]])
    return []


def worse(problem: Problem, model: Model, judged: Sequence[Holdout]) -> bool:
    """Whether hold-outs are worse under a model, as it is written, than under the one given."""
    before, after = (_energies(problem, one, judged) for one in (problem.model, model))
    return bool(np.sum(after) > np.sum(before) + _NOTHING * LEAST_GAIN)


def price(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    judged: Sequence[Holdout],
    written: Model,
    extra: Remainder | None = None,
) -> float:
    """The hold-outs' energy under ``written`` (noise variances), and ln n for each of its numbers.

    Numbers are those of the findings, of laws, the knots of tables, and what was fitted beside.
    """
    energy = float(np.sum(_energies(problem, written, judged)))
    numbers = number_count(selection, findings, extra)
    return energy + numbers * price_of_one(problem, judged)


def number_count(
    selection: Selection, findings: Sequence[int], extra: Remainder | None = None
) -> int:
    """How many numbers the findings and what has no name have, see :func:`price`."""
    numbers = sum(k in findings for k, _ in selection.found.names)
    if extra is not None:
        numbers += len(ALL) * extra.refitted + sum(_numbers(one) for one in extra.entries)
    return numbers


def price_of_one(problem: Problem, judged: Sequence[Holdout]) -> float:
    """Of one number (Schwarz): ln n."""
    return float(np.log(max(_samples(problem, judged), 1)))


def only_noise(
    price: float, problem: Problem, judged: Sequence[Holdout], most: float = CLEARLY**2
) -> bool:
    """Whether what costs ``price`` leaves the hold-outs hardly more than the sensors' noise.

    ``most``: times its energy.
    """
    return price < most * noise_energy(problem, judged)


def noise_energy(problem: Problem, judged: Sequence[Holdout]) -> float:
    """What the sensors' noise alone leaves of the hold-outs, in its variances: their samples."""
    return float(_samples(problem, judged))


def _samples(problem: Problem, judged: Sequence[Holdout]) -> int:
    return sum(int(np.sum(one.judging(problem.model))) for one in judged)


def _numbers(entry: Mapping[str, Any]) -> int:
    if "values" in entry:
        return int(np.size(entry["values"]))
    return len(free_numbers(entry))


def _loss(problem: Problem, before: Model, after: Model, judged: Sequence[Holdout]) -> float:
    """By how much energy ``after`` is worse, beyond one standard error and what is nothing.

    The error is that of the sum over blocks in time: beside much that is unknown, what a small
    effect adds to it is chance.
    """
    change = _energies(problem, after, judged) - _energies(problem, before, judged)
    error = float(np.sqrt(np.sum(change**2)))
    return float(np.sum(change)) - error - _NOTHING * LEAST_GAIN


def _energies(problem: Problem, model: Model, judged: Sequence[Holdout]) -> Floats:
    """Of the hold-outs' torque residual while sliding, noise variances, block by block."""
    parts = []
    for one in judged:
        kept = one.prepared
        use = one.judging(problem.model)
        left = problem.left(kept, model) / kept.floor_nm(problem.model)
        block = ((kept.thin_time_s - kept.thin_time_s[0]) // BLOCK_S).astype(np.int64)
        parts.append(np.bincount(block, np.where(use, left, 0.0) ** 2))
    return np.concatenate(parts)
