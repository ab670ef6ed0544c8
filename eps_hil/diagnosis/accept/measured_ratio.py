"""A ratio that the balance wants although rotor against rack has measured it already.

It is measured to parts in a million there. What makes the rack force worth something else at the
rotor has another cause, for which the catalogue has no name (a load cell's gain, an efficiency).
"""

from collections.abc import Sequence

import numpy as np

from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.problem import Problem, term_of
from eps_hil.diagnosis.mismatch.leftover import Leftover
from eps_hil.diagnosis.mismatch.locate import coordinates

_ID = "rack_ratio"


def settled(
    problem: Problem, selection: Selection, findings: Sequence[int], measured: bool
) -> tuple[Sequence[int], Leftover | None]:
    """The findings without a wrong ratio, and what stands for it, where it has been ``measured``.

    Nor is it any other's rival there.
    """
    if not measured:
        return findings, None
    for term, rivals in selection.rivals.items():
        selection.rivals[term] = [one for one in rivals if one[0] != _ID]
    entries = selection.found.entries
    wanted = [k for k in findings if entries[k]["effect"] == _ID]
    if not wanted:
        return findings, None
    entry, kept = entries[wanted[0]], [k for k in findings if k not in wanted]
    return kept, _worth(problem, float(entry["scale"]), selection.gains[term_of(entry)])


def no_name(measured: bool) -> set[str]:
    """What is then not even tried as a name in another's place."""
    return {_ID} if measured else set()


def _worth(problem: Problem, scale: float, gain: float) -> Leftover:
    """What a ratio off by ``scale`` would do, and gains (noise variances), in words of its own."""
    share = 1.0 / (1.0 + scale) - 1.0
    excess = gain / max(float(np.sum(problem.sliding)), 1.0)
    low, high = np.percentile(coordinates(problem)["rack_force_n"], [2, 98])
    words = (
        f"the rack force is worth {abs(share):.2%} {'more' if share > 0.0 else 'less'} at the "
        "rotor than the ratio makes it, which rotor against rack shows to be right: look at the "
        "load cell's gain, and at what the drive loses under load"
    )
    return Leftover("rack_force_n", (), float(low), float(high), 1.0, excess, words)
