"""What differs between two states of one rig: recordings before, recordings after (issue 24).

The recordings before are diagnosed first. The model with all that was found there, names and what
has no name, is the baseline of the recordings after: a finding there is something that the rig did
not do before. Because a finding can be weak, each is then looked for in the recordings before with
the size and the shape that it has after. What is there already is no change: it joins the baseline
and the recordings after are diagnosed once more. What the recordings before could not have shown is
said in ``limits``, and is no change either.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.holdout_support import augmented_by
from eps_hil.diagnosis.attribute.select import Say
from eps_hil.diagnosis.balance.problem import Problem, huber, knee, plain, term_of
from eps_hil.diagnosis.balance.spread import half_widths
from eps_hil.diagnosis.diagnose import Diagnosis, diagnose
from eps_hil.diagnosis.remainder.find import with_remainder
from eps_hil.physics.model import Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
Recordings = Mapping[str, Mapping[str, Series]]

WIDE = 1.5
"""Half widths of the 95 % interval: about three deviations between the two states."""
_ROUNDS = 2
"""Diagnoses of the recordings after, once what was there before has joined the baseline."""
_ALIKE = 0.5
"""Squared correlation from which a change is the same effect in another size."""
_GONE = 0.15
"""Of an effect's size before: less is nothing."""
_NO_WORSE = 1.02
"""Times the residual of the other way of saying it."""
_MORE = 2.0
"""Times the mean square that the first state leaves: less is no change of what has no name."""
_AS_BEFORE = (
    "what has no name is left in both states, and no more of it in the second: that is no change"
)
_UNKNOWN, _EMPIRICAL = "unknown", "empirical"


@dataclass(frozen=True, slots=True)
class Share:
    """How much of a finding was there before: 0 nothing, 1 all of it; half width at 95 %."""

    value: float
    half_width: float
    here: float
    """Half width of the finding's own size in the recordings after, as a share of it."""

    @property
    def shown(self) -> bool:
        """Whether the recordings before could tell all of it from nothing."""
        return self.half_width < 1.0 / WIDE

    @property
    def changed(self) -> bool:
        """Whether before and after differ by more than their intervals."""
        return 1.0 - self.value > WIDE * float(np.hypot(self.half_width, self.here))


@dataclass(frozen=True)
class Changes:
    """``before``: the diagnosis of the first state. ``after``: the second, against the first.

    ``after.content`` is the JSON (CONTRACT 7); its findings hold ``change`` and it has the key
    ``before``.
    """

    before: Diagnosis
    after: Diagnosis


def changes(model: Model, before: Recordings, after: Recordings, say: Say | None = None) -> Changes:
    """Find what the rig does in ``after`` that it did not do in ``before``.

    Of each state the last recording, or the last third of a single one, is kept from the fit.
    :class:`RecordingError` as for a diagnosis.
    """
    first = diagnose(model, before, {}, _part(say, "before", 0.0, 0.3))
    baseline, limits = first.model, []
    for turn in range(_ROUNDS + 1):
        second = diagnose(baseline, after, {}, _part(say, "after", 0.3 + 0.2 * turn, 0.2))
        moved = _renewed(second, baseline, after, _part(say, "after", 0.5 + 0.2 * turn, 0.1))
        state = _State(first, moved or second, baseline, moved is not None)
        old = state.not_new()
        if not old or turn == _ROUNDS:
            break
        baseline, said = state.joined(old)
        limits += said
    content = state.content(model, limits, before)
    content["fit"]["holdout"]["baseline"] = second.content["fit"]["holdout"]["baseline"]
    return Changes(first, replace(state.after, content=content))


def _renewed(
    second: Diagnosis, baseline: Model, after: Recordings, say: Say | None
) -> Diagnosis | None:
    """The diagnosis with the changed effects fitted anew in the place of what they were before.

    An effect whose shape has moved (a Stribeck speed) is no sum of two of its kind: the difference
    would stay unknown. None where nothing is unknown, or where more is, done this way.
    """
    names = {one["effect"] for one in second.content["findings"]}
    held = {one["effect"] for one in baseline.effects} & names - {_EMPIRICAL}
    if _UNKNOWN not in names or not held:
        return None
    bare = replace(
        baseline, effects=tuple(one for one in baseline.effects if one["effect"] not in held)
    )
    anew = diagnose(bare, after, {}, say, (_EMPIRICAL,))  # what is unknown needs no model here
    found = {one["effect"] for one in anew.content["findings"]}
    left = [one.content["fit"]["holdout"]["augmented"]["torque_nrmse"] for one in (anew, second)]
    better = _UNKNOWN not in found and held <= found and left[0] <= _NO_WORSE * left[1]
    return anew if better else None


@dataclass(frozen=True)
class _State:
    """Both diagnoses, and what the second one took for known."""

    before: Diagnosis
    after: Diagnosis
    baseline: Model
    anew: bool
    """Whether effects of the baseline were taken out of it, and found again with other numbers."""

    @property
    def findings(self) -> Sequence[Mapping[str, Any]]:
        """Of the second diagnosis, as its JSON has them."""
        return list(self.after.content["findings"])

    def held(self, k: int) -> list[dict[str, Any]]:
        """Entries of the baseline with the name of finding ``k``."""
        name = self.findings[k]["effect"]
        return [dict(one) for one in self.baseline.effects if one["effect"] == name]

    def entries(self, k: int) -> Sequence[Mapping[str, Any]]:
        """What finding ``k`` adds to a model; empty where it is not one of the torque balance."""
        told, name = self.after, self.findings[k]["effect"]
        if name == _UNKNOWN:
            return [] if told.remainder is None else told.remainder.entries
        entries, gains = told.selection.found.entries, told.selection.gains
        same = [one for one in told.accepted if entries[one]["effect"] == name]
        same.sort(key=lambda one: -gains.get(term_of(entries[one]), 0.0))
        rank = [one["effect"] for one in self.findings[:k]].count(name)
        return [plain(entries[same[rank]])] if rank < len(same) else []

    def share(self, k: int) -> Share | None:
        """How much of finding ``k`` was there before; None where a balance cannot tell."""
        entries = self.entries(k)
        if not entries:
            return None
        old = self.held(k) if self.anew else []
        seen, wide = _amount(self.before.problem, _written(self.before), entries, old)
        model = self.after.problem.model
        others = [one for j in range(len(self.findings)) if j != k for one in self.entries(j)]
        beside = replace(model, effects=(*model.effects, *(dict(one) for one in others)))
        _, here = _amount(self.after.problem, beside, entries, [])
        return Share(seen, wide, here)

    def not_new(self) -> dict[int, Share]:
        """Findings that the recordings before hold as well, or could not have shown."""
        shares = {k: self.share(k) for k in range(len(self.findings))}
        return {
            k: share
            for k, share in shares.items()
            if share is not None and not (share.shown and share.changed)
        }

    def joined(self, old: Mapping[int, Share]) -> tuple[Model, list[str]]:
        """The baseline with what both states have, and what is said of it."""
        said, effects = [], list(self.baseline.effects)
        for k, share in old.items():
            name = self.findings[k]["effect"]
            if self.anew:
                effects = [one for one in effects if one["effect"] != name]
            effects += [dict(one) for one in self.entries(k)]
            said.append(
                f"{name} is in both states ({_percent(share)} of it before): no change"
                if share.shown
                else f"{name} is there after; the recordings before could not have shown it (other "
                "speeds, loads or positions): whether it is new is not known"
            )
        return replace(self.baseline, effects=tuple(effects)), said

    def content(self, given: Model, limits: Sequence[str], before: Recordings) -> dict[str, Any]:
        """The JSON of the second diagnosis with each finding's ``change``, and what was before."""
        content, first = dict(self.after.content), self.before.content
        told = [{**one, "change": self.change(k)} for k, one in enumerate(self.findings)]
        if self.as_unknown_as_before():
            told = [one for one in told if one["effect"] != _UNKNOWN]
            limits = [*limits, _AS_BEFORE]
            content["verdict"] = "explained" if told else "no_mismatch"
        content["findings"] = told
        content["limits"] = [*limits, *content["limits"]]
        content["fit"] = {**content["fit"], "holdout": dict(content["fit"]["holdout"])}
        content["before"] = {
            "recordings": list(before),
            "verdict": first["verdict"],
            "findings": first["findings"],
            "limits": first["limits"],
            "effects_given": [dict(one) for one in given.effects],
        }
        return content

    def as_unknown_as_before(self) -> bool:
        """Whether both states leave something without a name, and the second hardly more of it.

        By the hold-outs' mean squares beyond the noise, under the first state's model.
        """

        def beyond(told: Diagnosis, figures: str) -> float:
            holdout = told.content["fit"]["holdout"]
            left, noise = (holdout[one]["torque_nrmse"] for one in (figures, "noise_floor"))
            return float(left**2 - noise**2)

        states = (self.before, self.after)
        if not all(_UNKNOWN in {f["effect"] for f in one.content["findings"]} for one in states):
            return False
        if len(self.findings) > 1:  # what the names leave, not what the first model leaves
            return beyond(self.after, "augmented") < _MORE * beyond(self.before, "augmented")
        return beyond(self.after, "baseline") < _MORE * beyond(self.before, "augmented")

    def change(self, k: int) -> dict[str, Any]:
        """In which way finding ``k`` is a change of what the rig was before."""
        told: dict[str, Any] = {"is": "new", "before": self.held(k), "size_after": None}
        share = self.share(k)
        if share is not None:
            low, high = share.value - share.half_width, share.value + share.half_width
            told["share_before"] = {"value": share.value, "ci95": [low, high]}
        if not told["before"]:
            return told
        told["is"] = "different"
        entries, problem = self.entries(k), replace(self.after.problem, remainder=None)
        if not entries:
            return told
        name = self.findings[k]["effect"]
        effects = tuple(one for one in self.baseline.effects if one["effect"] != name)
        bare = replace(self.baseline, effects=effects)
        had = _added(problem, bare, told["before"])
        now = _added(problem, bare, entries if self.anew else [*told["before"], *entries])
        energy, product = float(had @ had), float(had @ now)
        if energy <= 0.0:
            return told
        size = product / energy
        rest = float((now - size * had) @ (now - size * had))
        if rest < (1.0 - _ALIKE) * max(energy, float(now @ now)):
            told["size_after"] = size
            told["is"] = "gone" if abs(size) < _GONE else "stronger" if size > 1.0 else "weaker"
        return told


def _written(told: Diagnosis) -> Model:
    """The model that explains the recordings of ``told`` as it prepared them."""
    named = augmented_by(told.problem, told.selection.found, told.accepted)
    return with_remainder(named, told.remainder)


def _added(problem: Problem, bare: Model, entries: Sequence[Mapping[str, Any]]) -> Floats:
    """What ``entries`` change of the weighted residual (n,)."""
    full = replace(bare, effects=(*bare.effects, *(dict(one) for one in entries)))
    return problem.residual(full) - problem.residual(bare)


def _amount(
    problem: Problem,
    model: Model,
    entries: Sequence[Mapping[str, Any]],
    old: Sequence[Mapping[str, Any]],
) -> tuple[float, float]:
    """Least-squares multiple of ``entries`` in the place of ``old``, and its half width at 95 %."""
    problem = replace(problem, model=model, remainder=None)
    residual = problem.residual(model)
    names = {one["effect"] for one in old}
    kept = tuple(one for one in model.effects if one["effect"] not in names)
    there = replace(model, effects=(*kept, *(dict(one) for one in entries)))
    column = problem.residual(there) - residual
    weight = np.sqrt(huber(residual, knee(residual[problem.sliding])))
    column, residual = column * weight, residual * weight
    energy = float(column @ column)
    if energy < 1.0:  # less than one noise variance in all of the recordings
        return 0.0, np.inf
    amount = -float(column @ residual) / energy
    left = residual + amount * column
    groups = (problem.block, problem.stretch)
    return amount, float(half_widths(column[:, None], left, groups)[0])


def _percent(share: Share) -> str:
    return f"{100 * share.value:.0f} ± {100 * share.half_width:.0f} %"


def in_words(change: Mapping[str, Any]) -> str:
    """``gone``, ``new``, ``stronger: 1.4 times what it was`` of a finding's ``change``."""
    size = change["size_after"]
    if size is None or change["is"] in ("gone", "new"):
        return str(change["is"])
    if size < 0.0:
        return "other sign than before"
    return f"{change['is']}: {size:.3g} times what it was"


def _part(say: Say | None, what: str, start: float, size: float) -> Say | None:
    if say is None:
        return None
    return lambda done, part: say(f"{what}: {done}", min(1.0, start + part * size))
