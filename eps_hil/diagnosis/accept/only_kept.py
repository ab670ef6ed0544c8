"""What recordings kept from the fit show and no fitted one does: a stop that is met only there.

No name can be given to it from the others, and none that was found stands for it. So it is no
explanation, whatever was named: it is something unknown, at its place. What it looks like in those
recordings alone is said as what it may be; nothing bears that out.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eps_hil.diagnosis.accept.proof_of_fit import MUCH_MORE, NOISES, Holdout
from eps_hil.diagnosis.attribute.select import select
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.entry import place, unknown
from eps_hil.diagnosis.mismatch import locate
from eps_hil.diagnosis.mismatch.locate import Region
from eps_hil.physics.model import Model

UNKNOWN = "unknown"
_MOST = 0.5
"""Of what such a recording holds beyond noise: what a name takes at least to be what it may be."""
_SUREST = 0.95


@dataclass(frozen=True)
class OnlyKept:
    """A hold-out: how much it leaves, in noise deviations, and where most of that is."""

    holdout: Holdout
    times: float
    places: Sequence[Region]

    def sentence(self) -> str:
        """For ``limits``."""
        where = [f"{one.signal} {one.low:.4g} to {one.high:.4g}" for one in self.places]
        return (
            f"{self._leaves()}, which what was fitted does not"
            f"{': most of it at ' + ' and '.join(where) if where else ''}. "
            "What acts there only cannot be named from the others; fit a recording like it too."
        )

    def finding(self, maybe: Sequence[str]) -> dict[str, Any]:
        """As something unknown; ``maybe``: what it looks like by itself."""
        told = unknown(
            f"{self._leaves()}: something acts there that no fitted recording shows"
            f"{'; by itself it looks like ' + maybe[0] if maybe else ''}.",
            round(min(_SUREST, 1.0 - float(np.exp(1.0 - self.times**2))), 3),
            [place(one.signal, one.low, one.high, one.share) for one in self.places],
        )
        advice = f"Fit a recording like {self.holdout.prepared.name} too, and keep another one."
        return {**told, "confusable_with": list(maybe), "next_experiment": advice}

    def _leaves(self) -> str:
        return f"{self.holdout.prepared.name} leaves {self.times:.2g} {NOISES}"


def only_kept(
    holdouts: Sequence[Holdout], before: Model, after: Model, fitted: float
) -> list[OnlyKept]:
    """The hold-outs that show what nothing fitted does.

    ``after``: the model with what was found; ``fitted``: the mean square, in noise variances, that
    it leaves of what was fitted. The balance is judged while sliding under ``before``.
    """
    told = []
    for one in holdouts:
        kept = Problem([one.prepared], before)
        energy = np.where(kept.sliding, kept.residual(after) ** 2, 0.0)
        left = float(np.sum(energy)) / max(int(np.sum(kept.sliding)), 1)
        if left >= MUCH_MORE * max(fitted, 1.0):
            told.append(OnlyKept(one, float(np.sqrt(left)), locate.where(kept, energy)))
    return told


def with_only_kept(
    content: Mapping[str, Any],
    shown: Sequence[OnlyKept],
    problem: Problem,
    after: Model,
    without: Collection[str],
) -> dict[str, Any]:
    """The content with what only hold-outs show as something unknown, unless that is told already.

    An explanation is one in part then, and an all-clear none. ``after``: the model with what was
    found; ``without``: effects (ids) that are not considered.
    """
    findings = content["findings"]
    if not shown or any(one["effect"] == UNKNOWN for one in findings):
        return dict(content)
    most = max(shown, key=lambda one: one.times)
    maybe = _looks_like(replace(problem.apart([most.holdout.prepared]), model=after), without)
    verdict = "partly_explained" if findings else "unknown_effect"
    return {**content, "verdict": verdict, "findings": [*findings, most.finding(maybe)]}


def _looks_like(there: Problem, without: Collection[str]) -> list[str]:
    """The effect (id) that takes most of what a recording holds beyond noise; none of little."""
    found = select(there, None, without).found
    beyond = float(np.sum(there.residual(there.model)[there.sliding] ** 2 - 1.0))

    def taken(entry: Mapping[str, Any]) -> float:
        after = there.residual(there.with_entries([entry]))[there.sliding]
        return beyond - float(np.sum(after**2 - 1.0))

    best = max(found.entries, key=taken, default=None)
    if best is None or taken(best) < _MOST * beyond:
        return []
    return [str(best["effect"])]
