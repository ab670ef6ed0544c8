"""Which of the accepted effects the hold-outs bear out, and the model with those."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eps_hil.diagnosis.accept.proof_of_fit import WORSE, Holdout, rack_force_error_n
from eps_hil.diagnosis.attribute.scoring import FINAL_SHARE, threshold
from eps_hil.diagnosis.attribute.select import Selection, timed
from eps_hil.diagnosis.balance.baseline import DAMPING, HOLD, STIFFNESS, is_free
from eps_hil.diagnosis.balance.fit import BRISTLE, Fit, ablated, deviation, fit, matters
from eps_hil.diagnosis.balance.problem import SLIDING_RAD_S, Problem, clipped, knee, plain, term_of
from eps_hil.diagnosis.balance.turning import half_widths_off
from eps_hil.diagnosis.mismatch.curve import winds
from eps_hil.diagnosis.mismatch.leftover import BESIDE_UNKNOWN
from eps_hil.diagnosis.remainder.find import rounded
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

_SPOILT = 1.5
"""Times the rack force's error without it: right ones were up to 1.2 on development cases."""
_SILENT = 0.1
"""Share of the gain that counts: an entry that changes hold-outs by less cannot be judged there."""
_BEYOND_DOUBT = 10.0
"""Times the gain that counts: what hold-outs cannot judge has to show as clearly as this."""

BRISTLE_HALVES = 2.5
"""Half widths of its interval: on rigs of several forms of friction nearly all below were the
form's own, and no other stiffness."""
_BESIDE_HALVES = 4.0
"""Beside something unknown: names that only stood in for a part of it had up to 3.2 on development
cases, right ones 8 or more."""
_CREEPING_RAD_S, _CREEPING_HALVES = 2.5 * SLIDING_RAD_S, 3.0
"""Slower than this a friction's damping near standstill has a form of its own on every rig."""


def holdout_support(
    problem: Problem, selection: Selection, judged: Sequence[Holdout]
) -> Sequence[int]:
    """Places of the findings; the fit goes on without what the hold-outs do not bear out."""
    entries, visited_m = selection.found.entries, problem.visited_m
    findings = [
        k for k in _held_out(problem, selection, judged) if not winds(entries[k], visited_m)
    ]
    findings = refitted(problem, selection, findings)
    findings = _told_from_damping(problem, selection, findings, judged)
    findings = _only_clear(problem, selection, findings)
    findings = refitted(
        problem, selection, _without_spoiling_bristle(problem, selection, findings, judged)
    )
    if findings and not _better(problem, selection.found, findings, judged):
        silent = not_shown(selection.found, findings, judged, problem)
        return findings if len(silent) == len(findings) else []
    return findings


def _told_from_damping(
    problem: Problem, selection: Selection, findings: Sequence[int], judged: Sequence[Holdout]
) -> list[int]:
    """The findings, a bristle that only its damping hides fitted beside the model file's own σ1.

    σ1 has no name and is free beside that of σ0. Where friction goes with speed near standstill
    both rise instead of it, and each is unclear beside the other; but σ1 does nothing for a rack
    force, and σ0 does. So the hold-outs' force decides whether σ0 alone is a finding.
    """
    found, left = selection.found, list(findings)
    at = [k for k in left if found.entries[k]["effect"] == BRISTLE]
    if not at or is_free(found.own) or DAMPING not in found.own or _clear(problem, found, at[0]):
        return left
    own = {name: value for name, value in found.own.items() if name != DAMPING}
    alone = timed(problem, fit(problem, found.entries, own=own, like=found))
    terms = {term_of(found.entries[k]) for k in left}
    places = [k for k, entry in enumerate(alone.entries) if term_of(entry) in terms]
    (k,) = (place for place in places if alone.entries[place]["effect"] == BRISTLE)
    if not _clear(problem, alone, k):
        return left
    others = [place for place in left if place != at[0]]
    force, without = (
        rack_force_error_n(judged, problem.model, augmented_by(problem, one, named))
        for one, named in ((alone, places), (found, others))
    )
    if force is None or without is None or force * WORSE > without:
        return left
    selection.found = alone
    for place in places:
        term, spared = term_of(alone.entries[place]), ablated(problem, alone, place)
        selection.without[term], selection.gains[term] = spared, spared.cost - alone.cost
    return [place for place in _held_out(problem, selection, judged) if place in places]


def _without_spoiling_bristle(
    problem: Problem, selection: Selection, findings: Sequence[int], judged: Sequence[Holdout]
) -> list[int]:
    """The findings without a bristle's stiffness that spoils the hold-outs' rack force.

    Where an angle's noise drowns presliding, the balance at reversals may gain by any stiffness;
    the estimate of the force loses by a wrong one.
    """
    entries, left = selection.found.entries, list(findings)
    for k in findings:
        if entries[k]["effect"] != BRISTLE:
            continue
        others = [place for place in left if place != k]
        with_it, without = (
            rack_force_error_n(judged, problem.model, augmented_by(problem, selection.found, named))
            for named in (left, others)
        )
        if with_it is not None and without is not None and with_it > _SPOILT * without:
            left = others
    return left


def _held_out(problem: Problem, selection: Selection, judged: Sequence[Holdout]) -> list[int]:
    """Places of the entries that improve recordings which were not used to fit them."""
    keep = []
    entries = selection.found.entries
    test = problem.over([one.prepared for one in judged])
    full = test.residual(test.with_entries(entries, selection.found.own))
    at = knee(full)
    cost = float(np.sum(clipped(full, at) ** 2))
    least = 0.3 * threshold(test, full, FINAL_SHARE)
    for k, entry in enumerate(entries):
        if term_of(entry) not in selection.gains:
            continue
        spared = selection.without[term_of(entry)]
        without = test.residual(test.with_entries(spared.entries, spared.own))
        gain = float(np.sum(clipped(without, at) ** 2)) - cost
        if gain > least or (
            _beyond_doubt(problem, selection, k)
            and not_shown(selection.found, [k], judged, problem)
        ):
            keep.append(k)
    return keep


def not_shown(
    found: Fit, places: Sequence[int], judged: Sequence[Holdout], problem: Problem
) -> list[int]:
    """Those of the entries at ``places`` that do nothing in the hold-outs, to judge them by.

    A stop that is not touched there, a rest that is never long enough: their residual is the same
    with the entry and without, to less than what would count.
    """
    test = problem.over([one.prepared for one in judged])
    full = test.residual(test.with_entries(found.entries, found.own))
    kept = []
    for k in places:
        others = [entry for i, entry in enumerate(found.entries) if i != k]
        change = full - test.residual(test.with_entries(others, found.own))
        if float(np.sum(change**2)) < _SILENT * threshold(test, full, FINAL_SHARE):
            kept.append(k)
    return kept


def unjudged(
    found: Fit, findings: Sequence[int], judged: Sequence[Holdout], problem: Problem
) -> list[str]:
    """A sentence for each finding that the hold-outs do not show."""
    return [
        f"The hold-outs never come where {found.entries[k]['effect']} acts, and cannot bear it "
        "out: it rests on the fitted recordings alone. Keep one from the fit that shows it."
        for k in not_shown(found, findings, judged, problem)
    ]


def _beyond_doubt(problem: Problem, selection: Selection, k: int) -> bool:
    """Whether the fitted recordings alone show an entry: by far, and in more stretches than one."""
    found, term = selection.found, term_of(selection.found.entries[k])
    without = selection.without[term].residual
    at = knee(found.residual)
    gained = clipped(without, at) ** 2 - clipped(found.residual, at) ** 2
    by_stretch = np.bincount(problem.stretch, np.where(problem.sliding, gained, 0.0))
    least = threshold(problem, found.residual, FINAL_SHARE)
    elsewhere = float(np.sum(by_stretch) - np.max(by_stretch))
    return selection.gains[term] > _BEYOND_DOUBT * least and elsewhere > least


def _clear(problem: Problem, found: Fit, k: int) -> bool:
    """Whether an effect of one number is more than that number's 95 % interval is wide.

    Its gain counts samples, as if they were independent; the interval knows that they are not. A
    bristle's does not know that its form is another one than the model's: where full reversals do
    not show it, it takes more. So does what fades out at speeds at which sliding only begins.
    """
    entry = found.entries[k]
    halves = {name: half for (place, name), half in found.half_width.items() if place == k}
    if entry.get("speed_rad_s", np.inf) < _CREEPING_RAD_S * problem.size.angle:
        probe = catalogue()[entry["effect"]].probe
        assert probe is not None
        return deviation(entry, problem) > _CREEPING_HALVES * halves[probe.amplitude]
    if problem.remainder is not None and halves:
        probe = catalogue()[entry["effect"]].probe
        assert probe is not None
        return half_widths_off(entry, halves[probe.amplitude], problem) > _BESIDE_HALVES
    if len(halves) != 1:
        return True
    least = BRISTLE_HALVES if entry["effect"] == BRISTLE else 1.0
    return half_widths_off(entry, next(iter(halves.values())), problem) > least


def _only_clear(problem: Problem, selection: Selection, findings: Sequence[int]) -> list[int]:
    """The findings that are clear of nothing; again without the others, which may have made up for
    one another.
    """
    left = list(findings)
    while True:
        found = selection.found
        clear = [
            k for k in left if matters(found.entries[k], problem) and _clear(problem, found, k)
        ]
        if len(clear) == len(left):
            return left
        left = refitted(problem, selection, clear)


def refitted(problem: Problem, selection: Selection, findings: Sequence[int]) -> list[int]:
    """Take out what the hold-outs do not bear out, so that it bends no other finding's numbers.

    Returns the findings' places in the new fit.
    """
    found = selection.found
    left = [
        k
        for k, entry in enumerate(found.entries)
        if k in findings or term_of(entry) not in selection.gains
    ]
    if len(left) == len(found.entries):
        return list(findings)
    terms = {term_of(found.entries[k]) for k in findings}
    entries = [found.entries[k] for k in left]
    selection.found = timed(problem, fit(problem, entries, own=found.own, like=found))
    # a delay that is too small for a name without the others has gone from the entries by now
    return [k for k, entry in enumerate(selection.found.entries) if term_of(entry) in terms]


def bristle_of_unknown(problem: Problem, found: Fit) -> bool:
    """Whether the stiffness that full reversals gave the model explains less than what no name
    explains: friction of another kind turns over another way, too.
    """
    model = problem.with_entries(found.entries, found.own)
    others = tuple(entry for entry in model.effects if entry["effect"] != BRISTLE)
    if len(others) == len(model.effects):
        return False
    at, use = knee(found.residual), problem.sliding
    without = clipped(problem.residual(replace(model, effects=others)), at)[use]
    with_it = clipped(found.residual, at)[use]
    unexplained = float(np.sum(with_it**2 - 1.0))
    return float(np.sum(without**2 - with_it**2)) < BESIDE_UNKNOWN * unexplained


def _better(
    problem: Problem, found: Fit, findings: Sequence[int], judged: Sequence[Holdout]
) -> bool:
    """Whether the findings, as a model file would hold them, lower the hold-outs' error."""
    test = problem.over([one.prepared for one in judged])
    augmented = augmented_by(problem, found, findings)
    before, after = test.residual(problem.model), test.residual(augmented)
    at = knee(before)
    return float(np.sum(clipped(after, at) ** 2)) < float(np.sum(clipped(before, at) ** 2))


def augmented_by(
    problem: Problem,
    found: Fit,
    findings: Sequence[int],
    but: Collection[str] = (),
    *,
    moved: bool = False,
) -> Model:
    """The model with the findings; what else was fitted (how a torque is held) goes with them.

    But for the numbers that stand for something else, as a load that nobody measured, and for a
    bristle that no name is given to. Without findings nothing does, unless ``moved``.
    """
    if not findings and not moved:
        return problem.model
    entries = [_entry(plain(found.entries[k])) for k in findings]
    but = but if is_free(found.own) else {*but, STIFFNESS}
    own = {name: value for name, value in found.own.items() if name not in but}
    model = problem.with_entries(entries, _entry(own))
    given = problem.model.effects
    effects = tuple(one if one in given else rounded(one) for one in model.effects)
    return _late_enough(replace(model, effects=effects))


def _late_enough(model: Model) -> Model:
    """The model as a file can hold it: what a negative delay would say is an effect of its own."""
    late = model.delays_s.motor_torque
    if late >= 0.0:
        return model
    model = replace(model, delays_s=replace(model.delays_s, motor_torque=0.0))
    more = {"effect": HOLD, "delay_s": float(f"{-late:.6g}")}
    for k, entry in enumerate(model.effects):
        if entry["effect"] == HOLD:
            delay, lag = entry["delay_s"] - late, entry["delay_s"] * entry.get("lag_share", 0.0)
            more = {**entry, "delay_s": delay, **({"lag_share": lag / delay} if lag else {})}
            return replace(model, effects=(*model.effects[:k], more, *model.effects[k + 1 :]))
    return replace(model, effects=(*model.effects, more))


def _entry(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: (round(float(f"{value:.6g}"), 12) if isinstance(value, float) else value)
        for key, value in entry.items()
    }
