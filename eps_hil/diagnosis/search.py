"""What the balance shows, and again beside what only then is known: sensors, bristle, a channel."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from eps_hil.diagnosis.accept.as_name import as_name
from eps_hil.diagnosis.accept.as_one_law import as_one_law
from eps_hil.diagnosis.accept.beside_law import beside_law
from eps_hil.diagnosis.accept.holdout_support import augmented_by, holdout_support
from eps_hil.diagnosis.accept.measured_ratio import settled
from eps_hil.diagnosis.accept.named_terms import named_terms
from eps_hil.diagnosis.accept.nameless import nameless, sensitivities, simulated_too
from eps_hil.diagnosis.accept.proof_of_fit import MUCH_MORE, Holdout
from eps_hil.diagnosis.accept.standing import (
    noise_energy,
    only_noise,
    price,
    price_of_one,
    standing,
)
from eps_hil.diagnosis.attribute.beside import not_whitened, selected_beside
from eps_hil.diagnosis.attribute.channel_fault import (
    ChannelFault,
    held_out_energy,
    no_worse,
    refined,
)
from eps_hil.diagnosis.attribute.select import Say, Selection, select
from eps_hil.diagnosis.balance.fit import BRISTLE
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.balance.resting import problem_of
from eps_hil.diagnosis.direct.reversals import bristle, reversals_agree
from eps_hil.diagnosis.direct.zero_reading import ZeroReadings
from eps_hil.diagnosis.first_look import FirstLook
from eps_hil.diagnosis.mismatch.curve import ID as CURVE
from eps_hil.diagnosis.mismatch.curve import winds
from eps_hil.diagnosis.mismatch.leftover import BESIDE_UNKNOWN, Leftover, leftover
from eps_hil.diagnosis.remainder.find import Remainder, find, with_remainder
from eps_hil.series import Series


def searched(
    look: FirstLook,
    problem: Problem,
    tied: Mapping[str, float],
    judged: Sequence[Holdout],
    say: Say | None,
    without: Collection[str],
) -> tuple[FirstLook, Problem, Selection]:
    """Effects that the balance shows; again beside what only then is known of sensor and bristle.

    Again where the balance takes back what sensors were read to be, and where full reversals show
    another stiffness than the model's, or none where the balance named one.
    """
    selection = _selected(problem, look, say, without)
    zero = look.zero.behind(selection.found)
    if zero.refuted(problem, selection.found, [one.prepared for one in judged]):
        zero = ZeroReadings()
    if zero != look.zero:
        look = look.with_zero(zero)
        problem = problem_of(look.fitted, look.model, tied)
        selection = _selected(problem, look, say, without)
    asked = BRISTLE not in without and not tied  # a load that nobody measured moves the levels
    seen = bristle(selection.part, selection.searched) if asked else None
    if seen is None:
        return look, problem, selection
    named = any(entry["effect"] == BRISTLE for entry in selection.found.entries)
    off = seen.off and reversals_agree(seen, problem, selection.found, judged)
    if off:
        look = look.with_bristle(seen)
        problem = problem_of(look.fitted, look.model, tied)
    if off or named:
        selection = _selected(problem, look, say, {*without, BRISTLE})
    return look, problem, selection


Searched = tuple[FirstLook, Problem, Selection, list[Holdout]]
"""What is known of recordings, what was found in them, and the hold-outs that go with it."""


class Told(Protocol):
    """What a diagnosis says, as far as it is weighed against another."""

    @property
    def price(self) -> float:
        """What its written model leaves of the hold-outs, and its numbers (``standing.py``)."""

    @property
    def remainder(self) -> Remainder | None:
        """Its model of what has no name."""


AnyTold = TypeVar("AnyTold", bound=Told)


def likelier(
    given: Searched,
    right: Searched,
    told: Callable[[Searched], AnyTold],
    beside: Callable[[AnyTold, AnyTold], AnyTold],
) -> AnyTold:
    """What is ``told`` with a signal put ``right``, or as ``given``: where hold-outs cost less.

    Where the other costs hardly more, it is told ``beside`` the one.

    A law beside no fault of a channel has to leave less than the fault and the names beside it, at
    Schwarz's price for every number. A constant factor of the load is no law of its own: that is
    the load cell, in other words.
    """
    _, problem, selection, judged = right
    names = range(len(selection.found.entries))
    written = augmented_by(problem, selection.found, names)
    least = price(problem, selection, names, judged, written) + price_of_one(problem, judged)
    settled = only_noise(least, problem, judged)
    if settled and not names:
        return told(right)
    physics = told(given)
    laws = () if physics.remainder is None else physics.remainder.entries
    if not laws or any(one.get("shapes") == ["one"] for one in laws):
        return told(right)
    if (settled or only_noise(physics.price, given[1], given[3])) and physics.price < least:
        return physics
    channel = told(right)
    best, other = sorted((physics, channel), key=lambda one: one.price)
    near = other.price - best.price < price_of_one(problem, judged)
    return beside(best, other) if near else best


def put_right(
    wrong: ChannelFault,
    given: Searched,
    tied: Mapping[str, float],
    say: Say | None,
    without: Collection[str],
    kept: Mapping[str, Mapping[str, Series]],
) -> tuple[ChannelFault, Searched] | None:
    """What is found beside a signal put right, and that signal.

    None where hold-outs are worse so, or where what is found beside it leaves nothing of it.
    """
    found = _beside(wrong, given[0], tied, say, without)
    better = refined(wrong, found[2].part, found[2])
    if not better.matters(given[1].recordings):
        return None
    if better is not wrong:
        found = _beside(better, given[0], tied, say, without)
    judged = holdouts(found[0], kept)
    before, after = (
        held_out_energy(problem, selection.found, [one.prepared for one in these])
        for problem, selection, these in ((*given[1:3], given[3]), (*found[1:3], judged))
    )
    spared = len(given[2].found.names) - len(found[2].found.names) - 1
    samples = sum(int(np.sum(one.judging(given[0].model))) for one in given[3])
    borne = no_worse(before, after, spared, samples, wrong.share)
    return (better, (*found, judged)) if borne else None


def _beside(
    wrong: ChannelFault,
    look: FirstLook,
    tied: Mapping[str, float],
    say: Say | None,
    without: Collection[str],
) -> tuple[FirstLook, Problem, Selection]:
    """What is found once a signal that nobody has a name for is put right."""
    right = look.with_signal(wrong.put_right, wrong.in_model(look.model))
    problem = problem_of(right.fitted, right.model, tied)
    seen = {one["effect"] for one in right.findings} & {BRISTLE}
    return right, problem, _selected(problem, right, say, {*without, *seen})


def _selected(
    problem: Problem, look: FirstLook, say: Say | None, without: Collection[str]
) -> Selection:
    """Effects that the balance shows, its constant as sensors with nothing on them have settled."""
    settled_there = look.zero.settled
    selection = select(problem, say, without, settled_there)
    if any(winds(entry, problem.visited_m) for entry in selection.found.entries):
        # a pattern over the rack's position is no place on it: the curve stood in for its name
        curves = [one for one in selection.pool if one.effect.id == CURVE]
        selection = select(problem, say, {*without, CURVE}, settled_there)
        selection.pool += curves  # beside a law of the pattern there may be one
    selection.possible = frozenset(look.zero.possible)
    return selection


def holdouts(look: FirstLook, kept: Mapping[str, Mapping[str, Series]]) -> list[Holdout]:
    """Recordings kept from the fit as the first look made them ready, with what was read."""
    return [
        Holdout(one, kept[one.name], data)
        for one, data in zip(look.kept, look.kept_quality, strict=True)
    ]


@dataclass(frozen=True)
class Names:
    """What is found, and what stays unknown beside it.

    ``told`` is of the problem ``weighed``, in which the names were judged; ``shown`` is the same
    with all that is left of the given problem, as figures and words need it.
    """

    weighed: Problem
    told: Selection
    shown: Selection
    findings: Sequence[int]
    left: Leftover | None
    extra: Remainder | None = None

    @property
    def as_told(self) -> tuple[Selection, Sequence[int], Leftover | None, Remainder | None]:
        """What the verdict is made of."""
        return self.shown, self.findings, self.left, self.extra


def beside_left(
    problem: Problem,
    selection: Selection,
    judged: Sequence[Holdout],
    look: FirstLook,
    force: Leftover | None,
) -> Names:
    """Names weighed beside a free discrepancy."""
    weighed, told = selected_beside(selection)
    named = holdout_support(weighed, told, judged)
    findings, more = settled(weighed, told, named, look.ratio_is_measured)
    findings = standing(weighed, told, findings, judged)
    shown = not_whitened(problem, told, selection)
    left = force or more or left_of(problem, shown, judged)
    return Names(weighed, told, shown, findings, left)


def cheapest(
    problem: Problem,
    ordinary: Names,
    found: Names,
    judged: Sequence[Holdout],
    tied: Mapping[str, float],
    say: Say | None,
) -> Names:
    """What came out of :func:`modelled`, or the ``ordinary`` names, found before anything was
    weighed beside what is left, where they explain most and cost hold-outs less.

    They stand with a model of their own rest, or without. Much that is small, together, is no
    reason to give up what is named.
    """
    if not _explains_most(problem, ordinary, judged, tied):
        return found
    there = [ordinary, _with_rest(problem, ordinary, judged, tied, say), found]
    return min(there, key=lambda one: _price(problem, one, judged, tied))


def _explains_most(
    problem: Problem, names: Names, judged: Sequence[Holdout], tied: Mapping[str, float]
) -> bool:
    """Whether names leave hold-outs no more than as much again as noise, and explain together as
    many times that as a name has to (:data:`BESIDE_UNKNOWN`).
    """
    if not names.findings:
        return False
    before = _price(problem, replace(names, findings=()), judged, tied)
    after = _price(problem, names, judged, tied)
    beyond = after - noise_energy(problem, judged)
    little = only_noise(after, problem, judged, MUCH_MORE)
    return little and before - after > BESIDE_UNKNOWN * beyond


def _price(
    problem: Problem, names: Names, judged: Sequence[Holdout], tied: Mapping[str, float]
) -> float:
    shown, findings, extra = names.shown, names.findings, names.extra
    written = with_remainder(augmented_by(problem, shown.found, findings, tied), extra)
    return price(problem, shown, findings, judged, written, extra)


def _with_rest(
    problem: Problem,
    names: Names,
    judged: Sequence[Holdout],
    tied: Mapping[str, float],
    say: Say | None,
) -> Names:
    """The names, and a model of what they leave if there is one."""
    kept = problem.apart([one.prepared for one in judged])
    shown, findings = names.shown, names.findings
    given = augmented_by(problem, shown.found, findings, tied)
    part = (lambda done: say("modelling the rest", done)) if say else None
    extra = find(problem, kept, given, sensitivities(shown.found, findings), part)
    if extra is not None and not tied:
        extra = simulated_too(problem, shown, findings, extra, judged)
    return replace(names, extra=extra)


def modelled(
    problem: Problem,
    now: Names,
    ordinary: Names,
    judged: Sequence[Holdout],
    look: FirstLook,
    force: Leftover | None,
    tied: Mapping[str, float],
    say: Say | None,
) -> Names:
    """With a model of what has no name, and the names that stand beside that.

    ``ordinary``: what was found before anything was weighed beside what is left.
    """
    starts = () if tied else tuple((one.shown, one.findings) for one in (now, ordinary))
    ratio = look.ratio_is_measured
    found, whole = beside_law(problem, starts, judged, measured=ratio, say=say), None
    if found is None:
        extra, findings = nameless(problem, now.shown, now.findings, judged, tied, say)
        now = replace(now, findings=findings, extra=extra)
        if extra is None:
            return now
        if tied:  # where a load was measured, names have had their turn beside laws
            return _by_name(problem, now, judged, tied)
        found = named_terms(problem, now.shown, findings, extra, judged, measured=ratio)
        if found is None:
            return now
    else:
        all_there = found.selection, found.findings, found.remainder
        found = named_terms(problem, *all_there, judged, measured=ratio) or found
        whole = as_one_law(problem, found.selection, found.findings, found.remainder, judged)
    shown, findings, extra = found.selection, found.findings, found.remainder
    weighed, told = found.weighed, found.told
    if whole is not None:
        shown, findings, extra = whole.selection, whole.findings, whole.law
        weighed, told = whole.weighed, whole.told
    extra = simulated_too(problem, shown, findings, extra, judged)
    left = force or left_of(problem, shown, judged) or now.left
    return Names(weighed, told, shown, findings, left, extra)


def _by_name(
    problem: Problem, now: Names, judged: Sequence[Holdout], tied: Mapping[str, float]
) -> Names:
    """The same with a name in the place of the law, where one says the same."""
    assert now.extra is not None
    found = as_name(problem, now.shown, now.findings, now.extra, judged, tied)
    if found is None:
        return now
    told, findings, extra = found
    return Names(problem, told, told, findings, left_of(problem, told, judged), extra)


def left_of(problem: Problem, selection: Selection, judged: Sequence[Holdout]) -> Leftover | None:
    """What is left of the fitted recordings, on those themselves or on the hold-outs."""
    test = problem.over([one.prepared for one in judged])
    found = selection.found
    residual = test.residual(test.with_entries(found.entries, found.own))
    return leftover(problem, found.residual, (test, residual))
