"""How a late motor torque is late: after a dead time, or behind a first-order lag.

To first order in frequency both are the same delay, and so are their sensitivities at none: only a
torque that changes faster than slowly parts them, by the square of the delay.
"""

from eps_hil.diagnosis.attribute.scoring import penalised
from eps_hil.diagnosis.balance.baseline import HOLD
from eps_hil.diagnosis.balance.fit import Fit, fit
from eps_hil.diagnosis.balance.problem import Problem

_LEAST_S = 1.5e-3
"""A shorter delay has no shape that a torque balance at 40 Hz could show."""
_SHARES = (0.5, 1.0)
_CLEAR = 1.5
"""Half widths of its interval that the lag's share is away from none."""


def as_lag(problem: Problem, found: Fit) -> Fit:
    """The fit with the share of a late torque's delay that is a lag, where that is clear."""
    late = [k for k, entry in enumerate(found.entries) if entry["effect"] == HOLD]
    if not late or found.entries[late[0]]["delay_s"] < _LEAST_S:
        return found
    (k,) = late
    trials = []
    for share in _SHARES:
        entries = [{**e, "lag_share": share} if i == k else e for i, e in enumerate(found.entries)]
        trials.append(fit(problem, entries, own=found.own, like=found))
    best = min(trials, key=lambda one: one.cost)
    clear = best.entries[k]["lag_share"] > _CLEAR * best.half_width[k, "lag_share"]
    return best if clear and penalised(best) < penalised(found) else found


def as_dead_time(problem: Problem, found: Fit) -> Fit:
    """The fit without a lag's share that only an effect had asked for which has gone since."""
    late = [k for k, entry in enumerate(found.entries) if entry.get("lag_share", 0.0) > 0.0]
    if not late:
        return found
    (k,) = late
    dead = {key: value for key, value in found.entries[k].items() if key != "lag_share"}
    entries = [dead if i == k else entry for i, entry in enumerate(found.entries)]
    without = fit(problem, entries, own=found.own, like=found)
    return without if penalised(without) <= penalised(found) else found
