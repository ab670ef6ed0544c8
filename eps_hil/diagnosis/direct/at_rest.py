"""Rest and presliding, which no gate judges by: whether the model turns round as the rig does.

Friction that goes with speed, or whose presliding is of another form, may gain nothing by another
stiffness: the balance then bends other numbers, none of which hold-outs bear out, and nothing is
found. What is left there says all the same that the model's presliding is not the rig's.
"""

from collections.abc import Sequence

import numpy as np

from eps_hil.diagnosis.accept.proof_of_fit import CLEARLY, Holdout
from eps_hil.diagnosis.balance.problem import NOTHING_NM, Problem
from eps_hil.physics.model import Model

_FEWEST = 8
"""Samples of a block at rest that tell anything of it, and blocks that tell of a rig."""


def turns_otherwise(problem: Problem, judged: Sequence[Holdout], model: Model) -> list[str]:
    """A sentence where rest and turning leave clearly more than in a right model.

    Of the fitted recordings and of the hold-outs, and in most blocks of time: no single event.
    """
    fitted = _left(problem, model)
    kept = _left(problem.over([one.prepared for one in judged]), model)
    if min(fitted[0], kept[0]) < CLEARLY:
        return []
    times, torque_nm = kept
    return [
        f"At rest and while the rotor turns round, {torque_nm:.2g} Nm (rms, at the rotor) stay "
        f"unexplained on hold-outs, {times:.2g} times what the right presliding leaves: the rig's "
        "is not the model's, and no finding says what it is. Full reversals and slow travel at "
        "several speeds would show its form."
    ]


def _left(problem: Problem, model: Model) -> tuple[float, float]:
    """(times what a right model leaves, in Nm) at rest and in presliding; the usual block's rms."""
    residual = problem.residual(model)
    use = ~problem.sliding & (problem.scale < 0.5 * NOTHING_NM * problem.size.torque)
    count = np.bincount(problem.block[use], minlength=int(problem.block[-1]) + 1)
    told = count >= _FEWEST
    if np.sum(told) < _FEWEST:
        return 0.0, 0.0
    times, torque_nm = (
        np.sqrt(np.bincount(problem.block[use], values[use] ** 2, len(count))[told] / count[told])
        for values in (residual, residual * problem.scale)
    )
    return float(np.median(times)), float(np.median(torque_nm))
