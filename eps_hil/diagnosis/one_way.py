"""What recordings of one state show against all that another state is known to do.

The model with all that was found in the known state, names and what has no name, is the baseline
of the other one. Because a finding can be weak, each is then looked for in the known state's
recordings with the size and the shape that it has in the other. What is there already is no change:
it joins the baseline and the other state is diagnosed once more. What the known state's recordings
could not have shown is said in ``limits``, and is no change either.
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
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.diagnosis.in_numbers import Moved, anew, moved, ratio, shifted
from eps_hil.diagnosis.remainder.find import with_remainder
from eps_hil.physics.model import Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
Recordings = Mapping[str, Mapping[str, Series]]
Finding = Mapping[str, Any]

WIDE = 1.5
"""Half widths of the 95 % interval: about three deviations between the two states."""
_ROUNDS = 2
"""Diagnoses of the other state, once what is in both has joined the baseline."""
_ALIKE = 0.5
"""Squared correlation from which a change is the same effect in another size."""
_GONE = 0.15
"""Of an effect's size before: less is nothing."""
_NO_WORSE = 1.02
"""Times the residual of the other way of saying it."""
MORE = 2.0
"""Times the mean square that the known state leaves: less is no change of what has no name."""
UNKNOWN, _EMPIRICAL = "unknown", "empirical"


@dataclass(frozen=True, slots=True)
class Share:
    """How much of a finding is in the known state: 0 nothing, 1 all of it; half width at 95 %."""

    value: float
    half_width: float
    here: float
    """Half width of the finding's own size in the other state, as a share of it."""

    @property
    def shown(self) -> bool:
        """Whether the known recordings could tell all of it from nothing."""
        return self.half_width < 1.0 / WIDE

    @property
    def changed(self) -> bool:
        """Whether the states differ by more than their intervals."""
        return 1.0 - self.value > WIDE * float(np.hypot(self.half_width, self.here))


def against(
    known: Diagnosis,
    word: str,
    other: Recordings,
    say: Say | None = None,
    alone: tuple[Model, Diagnosis] | None = None,
) -> "OneWay":
    """What the recordings ``other`` show against all that was found in ``known``.

    ``word``: ``before`` or ``after``, which state the known one is. ``alone``: a diagnosis of
    ``other`` by itself, and the model that it was made with.
    """
    baseline, limits = known.model, list[str]()
    for turn in range(_ROUNDS + 1):
        start = turn / (_ROUNDS + 1)
        if alone is not None and baseline == alone[0]:
            told = alone[1]  # nothing was found in the known state
        else:
            told = diagnose(baseline, other, {}, part(say, start, 0.2))
        moved = _renewed(told, baseline, other, part(say, start + 0.2, 0.1))
        figures = told.content["fit"]["holdout"]["baseline"]
        anew = moved is not None
        way = OneWay(known, moved or told, baseline, word, figures, tuple(limits), anew)
        old = way.not_new()
        if not old:
            break
        baseline, said = way.joined(old)
        limits += said
        way = replace(way, limits=tuple(limits), old=tuple(old))
    return way


def _renewed(
    told: Diagnosis, baseline: Model, other: Recordings, say: Say | None
) -> Diagnosis | None:
    """The diagnosis with the changed effects fitted anew in the place of what they were before.

    An effect whose shape has moved (a Stribeck speed) is no sum of two of its kind: the difference
    would stay unknown. None where nothing is unknown, or where more is, done this way.
    """
    names = {one["effect"] for one in told.content["findings"]}
    held = {one["effect"] for one in baseline.effects} & names - {_EMPIRICAL}
    if UNKNOWN not in names or not held:
        return None
    bare = replace(
        baseline, effects=tuple(one for one in baseline.effects if one["effect"] not in held)
    )
    anew = diagnose(bare, other, {}, say, (_EMPIRICAL,))  # what is unknown needs no model here
    found = {one["effect"] for one in anew.content["findings"]}
    left = [one.content["fit"]["holdout"]["augmented"]["torque_nrmse"] for one in (anew, told)]
    better = UNKNOWN not in found and held <= found and left[0] <= _NO_WORSE * left[1]
    return anew if better else None


@dataclass(frozen=True)
class OneWay:
    """A state that is ``known``, and the ``other`` diagnosed against it."""

    known: Diagnosis
    other: Diagnosis
    baseline: Model
    """What was known when the other one was diagnosed: what both have has joined it."""
    word: str
    figures: Mapping[str, Any]
    """Of the baseline on the other state's hold-outs."""
    limits: Sequence[str] = ()
    anew: bool = False
    """Whether effects of the baseline were taken out of it, and found again with other numbers."""
    old: Sequence[int] = ()
    """Findings that are in both states all the same: no change."""

    @property
    def price(self) -> float:
        """What both states' hold-outs leave, and the numbers that it takes to say so."""
        return self.known.price + self.other.price

    @property
    def findings(self) -> Sequence[Finding]:
        """Of the other state's diagnosis, as its JSON has them."""
        return list(self.other.content["findings"])

    def told(self) -> list[tuple[int, Finding]]:
        """Findings that are changes, and their places."""
        told = [(k, one) for k, one in enumerate(self.findings) if k not in self.old]
        if self.as_much_unknown():
            told = [(k, one) for k, one in told if one["effect"] != UNKNOWN]
        return told

    def held(self, k: int) -> list[dict[str, Any]]:
        """Entries of the baseline with the name of finding ``k``."""
        name = self.findings[k]["effect"]
        return [dict(one) for one in self.baseline.effects if one["effect"] == name]

    def entries(self, k: int) -> Sequence[Mapping[str, Any]]:
        """What finding ``k`` adds to a model; empty where it is not one of the torque balance."""
        told, name = self.other, self.findings[k]["effect"]
        if name == UNKNOWN:
            return [] if told.remainder is None else told.remainder.entries
        entries, gains = told.selection.found.entries, told.selection.gains
        same = [one for one in told.accepted if entries[one]["effect"] == name]
        same.sort(key=lambda one: -gains.get(term_of(entries[one]), 0.0))
        rank = [one["effect"] for one in self.findings[:k]].count(name)
        return [plain(entries[same[rank]])] if rank < len(same) else []

    def share(self, k: int) -> Share | None:
        """How much of finding ``k`` the known state has; None where a balance cannot tell."""
        entries = self.entries(k)
        if not entries:
            return None
        old = self.held(k) if self.anew else []
        seen, wide = _amount(self.known.problem, _written(self.known), entries, old)
        model = self.other.problem.model
        others = [one for j in range(len(self.findings)) if j != k for one in self.entries(j)]
        beside = replace(model, effects=(*model.effects, *(dict(one) for one in others)))
        _, here = _amount(self.other.problem, beside, entries, [])
        return Share(seen, wide, here)

    def not_new(self) -> dict[int, Share]:
        """Findings that the known recordings hold as well, or could not have shown."""
        shares = {k: self.share(k) for k in range(len(self.findings))}
        return {
            k: share
            for k, share in shares.items()
            if share is not None and not (share.shown and share.changed)
        }

    def joined(self, old: Mapping[int, Share]) -> tuple[Model, list[str]]:
        """The baseline with what both states have, and what is said of it."""
        said, effects = [], list(self.baseline.effects)
        there = {"before": "after", "after": "before"}[self.word]
        for k, share in old.items():
            name = self.findings[k]["effect"]
            if self.anew:
                effects = [one for one in effects if one["effect"] != name]
            effects += [dict(one) for one in self.entries(k)]
            said.append(
                f"{name} is in both states ({_percent(share)} of it {self.word}): no change"
                if share.shown
                else f"{name} is there {there}; the recordings {self.word} could not have shown it "
                "(other speeds, loads or positions): whether it has changed is not known"
            )
        return replace(self.baseline, effects=tuple(effects)), said

    def as_much_unknown(self) -> bool:
        """Whether both states leave something without a name, and the other hardly more of it.

        By the hold-outs' mean squares beyond the noise, under the known state's model.
        """

        def beyond(told: Diagnosis, figures: str) -> float:
            holdout = told.content["fit"]["holdout"]
            left, noise = (holdout[one]["torque_nrmse"] for one in (figures, "noise_floor"))
            return float(left**2 - noise**2)

        states = (self.known, self.other)
        if not all(UNKNOWN in {f["effect"] for f in one.content["findings"]} for one in states):
            return False
        if len(self.findings) > 1:  # what the names leave, not what the known model leaves
            return beyond(self.other, "augmented") < MORE * beyond(self.known, "augmented")
        return beyond(self.other, "baseline") < MORE * beyond(self.known, "augmented")

    def change(self, k: int) -> dict[str, Any]:
        """In which way finding ``k`` makes the other state differ from the known one."""
        told: dict[str, Any] = {"is": "new", "before": self.held(k), "size_after": None}
        told["numbers"] = []
        share = self.share(k)
        if share is not None:
            low, high = share.value - share.half_width, share.value + share.half_width
            told[f"share_{self.word}"] = {"value": share.value, "ci95": [low, high]}
        entries, name = self.entries(k), self.findings[k]["effect"]
        effects = tuple(one for one in self.baseline.effects if one["effect"] != name)
        bare = replace(self.baseline, effects=effects)
        after = entries if self.anew else [*told["before"], *entries]
        if numbers := moved(name, self.baseline, self.other.model, entries):
            return told | _in_numbers(numbers, new=not told["before"])
        if not told["before"]:
            return told
        told["is"] = "different"
        if not entries:
            now = [one for one in self.other.model.effects if one["effect"] == name]
            return told | {"numbers": [one.content() for one in anew(name, told["before"], now)]}
        if numbers := shifted(name, told["before"], after):
            return told | {"is": "shifted", "numbers": [one.content() for one in numbers]}
        problem = replace(self.other.problem, remainder=None)
        size = _times(_added(problem, bare, told["before"]), _added(problem, bare, after))
        if size is not None:
            told["size_after"] = size
            told["is"] = "gone" if abs(size) < _GONE else "stronger" if size > 1.0 else "weaker"
        return told


def _in_numbers(numbers: Sequence[Moved], *, new: bool) -> dict[str, Any]:
    """A change of numbers that the model has as well: the way they all go, and their factor."""
    told = {"numbers": [one.content() for one in numbers]}
    factor = ratio(numbers)
    if factor == 0.0:
        return {**told, "is": "gone", "size_after": factor}
    up = {one.second > one.first for one in numbers}
    if len(up) > 1 or (new and any(one.first == 0.0 for one in numbers)):
        return {**told, "is": "new" if new else "different"}
    return {**told, "is": "higher" if True in up else "lower", "size_after": factor}


def _times(had: Floats, now: Floats) -> float | None:
    """The multiple of what was ``had`` that there is ``now``; None where it has another shape."""
    energy = float(had @ had)
    if energy <= 0.0:
        return None
    size = float(had @ now) / energy
    rest = float((now - size * had) @ (now - size * had))
    return size if rest < (1.0 - _ALIKE) * max(energy, float(now @ now)) else None


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


def part(say: Say | None, start: float, size: float, what: str = "") -> Say | None:
    """``say`` for a stretch of the whole work; what is done may be said of ``what``."""
    if say is None:
        return None
    before = f"{what}: " if what else ""
    return lambda done, now: say(before + done, min(1.0, start + now * size))
