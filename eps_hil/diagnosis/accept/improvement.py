"""Whether recordings kept from the fit are better explained than before, by more than chance.

Before and after are judged on the same samples, so that what both leave alike cancels. How far the
difference would be another one with other recordings of the kind tells a bootstrap over blocks in
time, as for a law without a name: within a block what is left hangs together. How often a recording
visits the places where a finding acts (an end stop) is its manoeuvre's choice, no chance: blocks in
which it changes what is left are drawn from one another, and so are the others.

That asks of names which the torque balance gave. What the first look gave has evidence of its own,
and may change no torque: lost frames are counted from the time stamps, a late or drifting speed
shows against the angle, a gap between rotor and rack, a bristle in full reversals. A count is exact
on hold-outs as elsewhere; a torque residual that stays as it was says nothing against it. So it
neither needs a gain here, nor lends one to the names beside it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.balance.problem import BLOCK_S
from eps_hil.estimation.score import score
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

_DRAWS, _SEED = 1000, 20
_FEWEST = 6
"""Blocks in which a finding acts: fewer are cut into shorter ones, for one has no interval."""
_FINEST = 16
"""Parts of a block that it is cut into at most: 0.125 s are many times what the low-pass smears."""
_ACTING = 0.99
"""Of all change, that blocks hold in which a finding acts."""
TORQUE, FORCE = "torque_residual", "rack_force"
NOT_CLEAR = "The hold-outs are not better for what was found, beyond chance"


@dataclass(frozen=True)
class Improvement:
    """Share of a mean square that is gone since before, with its 95 % interval."""

    share: float
    ci95: tuple[float, float]

    @classmethod
    def of(
        cls, before: Sequence[Floats], after: Sequence[Floats], finest: int = 1
    ) -> "Improvement":
        """Of sums of squares of each recording, ``finest`` of which make a block of usual length.

        Blocks are no longer than that, and as much shorter as it takes for some to be acted in.
        """
        whole = sum(float(np.sum(one)) for one in before)
        if not whole > 0.0:
            return cls(0.0, (0.0, 0.0))
        together = finest
        was, now = (_blocks(some, together) for some in (before, after))
        acting = _acting(was - now)
        while together > 1 and int(np.sum(acting)) < _FEWEST:
            together //= 2
            was, now = (_blocks(some, together) for some in (before, after))
            acting = _acting(was - now)
        rng = np.random.default_rng(_SEED)
        gone, there = np.zeros(_DRAWS), np.zeros(_DRAWS)
        for some in (acting, ~acting):
            places = np.flatnonzero(some)
            drawn = places[rng.integers(0, max(len(places), 1), (_DRAWS, len(places)))]
            gone += np.sum((was - now)[drawn], axis=1)
            there += np.sum(was[drawn], axis=1)
        low, high = np.percentile(gone / np.maximum(there, 1e-12 * whole), [2.5, 97.5])
        return cls(float(np.sum(was - now)) / whole, (float(low), float(high)))

    def content(self) -> dict[str, Any]:
        """JSON-ready."""
        return {"share": round(self.share, 4), "ci95": [round(one, 4) for one in self.ci95]}


def _blocks(sums: Sequence[Floats], together: int) -> Floats:
    """Sums over so many of each recording, in turn."""
    return np.concatenate([np.add.reduceat(one, np.arange(0, len(one), together)) for one in sums])


def _acting(gone: Floats) -> npt.NDArray[np.bool_]:
    """The blocks with most change, as many as hold nearly all of it."""
    order = np.argsort(-np.abs(gone))
    held = np.cumsum(np.abs(gone[order]))
    acting = np.zeros(len(gone), dtype=np.bool_)
    acting[order[: int(np.searchsorted(held, _ACTING * held[-1])) + 1]] = True
    return acting


@dataclass(frozen=True)
class Judged:
    """Hold-outs, and a model of theirs."""

    holdouts: Sequence[Holdout]
    model: Model


def improvement(before: Judged, after: Judged, given: Model, written: Model) -> dict[str, Any]:
    """``fit.improvement`` of the JSON: of the torque residual and, where that is not clear, of the
    rack force's estimate.

    ``before`` and ``after`` as the balance has them; ``given`` and ``written``: the model files,
    that estimate from hold-outs as they were read.
    """
    told = {TORQUE: in_torque(before, after).content()}
    if written != given and not is_clear(told):
        force = in_force(before.holdouts, given, written)
        if force is not None:
            told[FORCE] = force.content()
    return told


def is_clear(told: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether the torque residual or the rack force (``fit.improvement``) is better for sure."""
    return any(one["ci95"][0] > 0.0 for one in told.values())


def only_if_clear(content: Mapping[str, Any], elsewhere: Collection[str] = ()) -> dict[str, Any]:
    """The JSON's content without an explanation that hold-outs do not bear out beyond chance.

    ``elsewhere``: effects whose evidence is not the torque balance's.
    """
    told = content["fit"].get("improvement", {})
    asked = {one["effect"] for one in content["findings"]} - set(elsewhere)
    limits = [one for one in content["limits"] if not one.startswith(NOT_CLEAR)]
    if content["verdict"] == "explained" and asked and not is_clear(told):
        limits = [*limits, _sentence(told)]
        return {**content, "verdict": "partly_explained", "limits": limits}
    return {**content, "limits": limits}


def _sentence(told: Mapping[str, Mapping[str, Any]]) -> str:
    words = {TORQUE: "torque residual", FORCE: "error of the rack force"}
    parts = [
        f"{100 * one['share']:.2g} % less mean square {words[name]} (95 % interval "
        f"{100 * one['ci95'][0]:.2g} to {100 * one['ci95'][1]:.2g} %)"
        for name, one in told.items()
    ]
    return (
        f"{NOT_CLEAR}: {' and '.join(parts) or 'nothing that could be compared'}. Keep recordings "
        "from the fit in which what was found does more."
    )


def in_torque(before: Judged, after: Judged) -> Improvement:
    """Of the torque residual while sliding."""
    sums: list[list[Floats]] = [[], []]
    for was, now in zip(before.holdouts, after.holdouts, strict=True):
        n = min(len(was.prepared.thin_time_s), len(now.prepared.thin_time_s))
        use = was.judging(before.model)[:n] & now.judging(before.model)[:n]
        time_s = was.prepared.thin_time_s[:n]
        part = ((time_s - time_s[0]) // (BLOCK_S / _FINEST)).astype(np.int64)
        for side, one, model in ((0, was, before.model), (1, now, after.model)):
            left = np.where(use, one.prepared.left_over(model)[:n], 0.0)
            sums[side].append(np.bincount(part, left**2).astype(np.float64))
    return Improvement.of(sums[0], sums[1], finest=_FINEST)


def in_force(holdouts: Sequence[Holdout], given: Model, written: Model) -> Improvement | None:
    """Of the estimate of the rack force while moving; None without a load cell.

    Of each block the mean square, so that all count alike.
    """
    loaded = [one for one in holdouts if "rack_force_n" in one.series]
    if not loaded:
        return None
    seconds = _block_s([one.prepared.thin_time_s for one in loaded])
    before, after = (
        np.concatenate([_squares(one, model, given, seconds) for one in loaded])
        for model in (given, written)
    )
    use = np.isfinite(before) & np.isfinite(after)
    return Improvement.of([before[use]], [after[use]]) if use.any() else None


def _block_s(times_s: Sequence[Floats]) -> float:
    """Length of a block of recordings with these time stamps: enough to have an interval."""
    return min(BLOCK_S, sum(float(one[-1] - one[0]) for one in times_s) / _FEWEST)


def _squares(one: Holdout, model: Model, common: Model, seconds: float) -> Floats:
    """Mean squares (blocks,) of an estimate's error while moving; NaN where nothing moves."""
    trace = one.estimated(model)
    first = min(series.t_ns[0] for series in one.series.values())
    last = max(series.t_ns[-1] for series in one.series.values())
    edges = np.arange(first, last + 1, round(seconds * 1e9))
    told = []
    for part in np.split(np.arange(len(trace.t_ns)), np.searchsorted(trace.t_ns, edges[1:])):
        some = Trace(
            trace.t_ns[part],
            trace.rack_force_n[part],
            trace.friction_torque_nm[part],
            trace.reason[part],
        )
        found = score(some, one.series, common)
        told.append(np.nan if found is None else found.rmse_moving_n**2)
    return np.array(told)
