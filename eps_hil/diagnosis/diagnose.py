"""The whole way from recordings to a verdict (CONTRACT 7)."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis import locate, regions
from eps_hil.diagnosis.baseline import HOLD
from eps_hil.diagnosis.channels import check_channels
from eps_hil.diagnosis.curve import winds
from eps_hil.diagnosis.excerpt import only_part
from eps_hil.diagnosis.first_look import FirstLook, first_look
from eps_hil.diagnosis.fit import Fit, deviation, fit
from eps_hil.diagnosis.held import own_samples
from eps_hil.diagnosis.intake import RecordingError, prepared, same_load, split, unseen
from eps_hil.diagnosis.leftover import BESIDE_UNKNOWN, Leftover, alone, late_torque, leftover
from eps_hil.diagnosis.load import doubted, load_knobs, load_of, missing, not_told_apart, with_load
from eps_hil.diagnosis.misread import misread, with_misread
from eps_hil.diagnosis.numbers import CONSTANTS
from eps_hil.diagnosis.placebo import placebos
from eps_hil.diagnosis.problem import Problem, clipped, knee, plain, term_of
from eps_hil.diagnosis.proof_of_fit import Holdout, measures, noise_floor, only_kept, still_left
from eps_hil.diagnosis.scoring import FINAL_SHARE, threshold
from eps_hil.diagnosis.select import Say, Selection, select, timed
from eps_hil.diagnosis.spread import left_open
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect
from eps_hil.physics.model import Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

SCHEMA = "eps-hil/diagnosis/1"
LEAST_JUDGED = 125
"""Sliding samples (of 8 ms) that hold-outs need to judge anything: 1 s."""
RIVAL = 0.97
"""Reaching this share of a finding's gain makes another effect its confusable twin…"""
RIVAL_GAIN = 60.0
"""…and so does missing it by less than this many noise variances."""
SUREST = 0.95
"""No name is surer, set on development cases; docs/proof.md says how many such were right."""
INSTANT = 0.1
"""Of a sampling interval: deviation of what a delay means, when nobody knows at which instant of
its interval a value was taken, how the controller held it and how its filters shaped it."""
_INTERNAL = ("belt_ratio", "pole_pairs", "harmonic")


@dataclass(frozen=True)
class Diagnosis:
    """The result as JSON-ready ``content``, the model with the effects added, and what it rests on.

    ``problem`` and ``selection`` hold the fitted recordings, residuals and fits, ``judged`` the
    hold-outs: what a report draws. ``accepted`` are places in ``selection.found.entries``.
    """

    content: dict[str, Any]
    model: Model
    problem: Problem
    selection: Selection
    judged: Sequence[Holdout]
    accepted: Sequence[int]


def diagnose(
    model: Model,
    recordings: Mapping[str, Mapping[str, Series]],
    holdouts: Mapping[str, Mapping[str, Series]],
    say: Say | None = None,
    without: Collection[str] = (),
    unexplained_nm: float = 0.0,
) -> Diagnosis:
    """Find what physics ``model`` lacks to explain the recordings.

    Without hold-outs the last recording (of several), or the last third (of one), is kept from
    the fit. Effects in ``without`` (ids) are not considered. ``unexplained_nm`` (rms, at the rotor)
    is known to be the model's own fault and no finding. :class:`RecordingError` (a ``ValueError``)
    where a recording lacks what a diagnosis needs, or a channel is not what its name says.
    """
    fitted, kept = split(own_samples(recordings), own_samples(holdouts))
    ready = [(prepared(name, one, unexplained_nm), one) for name, one in fitted.items()]
    spare = [(prepared(name, one, unexplained_nm), one) for name, one in kept.items()]
    every = [one for one, _ in (*ready, *spare)]
    same_load(every)
    check_channels({**recordings, **holdouts}, model)
    load = load_of(every, model) if missing(every) else None
    if load is not None:
        ready = [(with_load(one, model, load), series) for one, series in ready]
        spare = [(with_load(one, model, load), series) for one, series in spare]
        without = {*without, *not_told_apart(load)}
    look = first_look(ready, spare, model, without)
    problem = Problem(look.fitted, look.model, tied=load_knobs(load))
    if np.sum(problem.sliding) < 500:
        raise ValueError("moves for less than 4 s; a diagnosis needs a rotor that slides")
    judged = _holdouts(look, kept)
    if sum(int(np.sum(one.judging(look.model))) for one in judged) < LEAST_JUDGED:
        raise RecordingError(
            look.kept[-1].name, "kept from the fit to judge it, but slides for less than 1 s"
        )
    selection = select(problem, say, without)
    wrong = misread(selection.part, selection, set.intersection(*map(set, fitted.values())))
    if wrong is not None:
        look = look.with_signal(wrong.put_right, wrong.in_model(look.model))
        problem = Problem(look.fitted, look.model, tied=load_knobs(load))
        selection = select(problem, say, without)
        judged = _holdouts(look, kept)
    findings = _borne_out(problem, selection, judged)
    if say:
        say("looking at what is left", 0.9)
    hidden = load is not None and load.form == "arbitrary"  # what is left may be the load
    left = None if hidden else _left(problem, selection, judged)
    if left is not None and findings:
        findings = _beside_unknown(problem, selection, findings)
        left = _left(problem, selection, judged)
    if left is None and not hidden and HOLD in without:
        left = late_torque(problem, selection.found)
    content = look.added_to(_content(problem, selection, findings, left, judged))
    if wrong is not None:
        content = with_misread(content, wrong.finding(model))
    content["findings"] = doubted(content["findings"], load)
    content["fit"]["placebo"] = placebos(problem, selection, findings, judged)
    if look.model is not model or look.put_right or wrong is not None:
        as_read = [
            Holdout(one, series, data)
            for (one, series), data in zip(spare, look.kept_quality, strict=True)
        ]
        content["fit"]["holdout"]["baseline"] = measures(as_read, model, model)
    content["limits"] = [
        *([] if load is None else [load.sentence]),
        *unseen(every),
        *only_part(problem, selection.part),
        *(_only_kept(problem, selection, findings, judged) or _still_left(content)),
        *left_open(content["findings"]),
    ]
    augmented = look.in_model(_augmented(problem, selection.found, findings))
    return Diagnosis(content, augmented, problem, selection, judged, findings)


def _holdouts(look: FirstLook, kept: Mapping[str, Mapping[str, Series]]) -> list[Holdout]:
    return [
        Holdout(one, kept[one.name], data)
        for one, data in zip(look.kept, look.kept_quality, strict=True)
    ]


def _only_kept(
    problem: Problem, selection: Selection, findings: Sequence[int], judged: Sequence[Holdout]
) -> list[str]:
    """What hold-outs show and the fitted recordings, with the findings, do not."""
    after = _augmented(problem, selection.found, findings)
    left = problem.residual(after)[problem.sliding]
    return only_kept(judged, problem.model, after, float(np.mean(left**2)))


def _still_left(content: Mapping[str, Any]) -> list[str]:
    """What an all-clear or an explanation would keep quiet about; ``unknown`` says it itself."""
    clear = content["verdict"] in ("no_mismatch", "explained")
    return still_left(content["fit"]["holdout"]) if clear else []


def _left(problem: Problem, selection: Selection, judged: Sequence[Holdout]) -> Leftover | None:
    """What is left of the fitted recordings, on those themselves or on the hold-outs."""
    test = Problem([one.prepared for one in judged], problem.model)
    found = selection.found
    residual = test.residual(test.with_entries(found.entries, found.own))
    return leftover(problem, found.residual, (test, residual))


def _borne_out(problem: Problem, selection: Selection, judged: Sequence[Holdout]) -> Sequence[int]:
    """Places of the findings; the fit goes on without what the hold-outs do not bear out."""
    entries, visited_m = selection.found.entries, problem.visited_m
    findings = [
        k for k in _held_out(problem, selection, judged) if not winds(entries[k], visited_m)
    ]
    findings = _refitted(problem, selection, findings)
    clear = [k for k in findings if _clear(problem, selection.found, k)]
    findings = _refitted(problem, selection, clear)
    if findings and not _better(problem, selection.found, findings, judged):
        return []
    return findings


def _held_out(problem: Problem, selection: Selection, judged: Sequence[Holdout]) -> list[int]:
    """Places of the entries that improve recordings which were not used to fit them."""
    keep = []
    entries = selection.found.entries
    test = Problem([one.prepared for one in judged], problem.model)
    full = test.residual(test.with_entries(entries, selection.found.own))
    at = knee(full)
    cost = float(np.sum(clipped(full, at) ** 2))
    least = 0.3 * threshold(test, full, FINAL_SHARE)
    for k, entry in enumerate(entries):
        if term_of(entry) not in selection.gains:
            continue
        refitted = selection.without[term_of(entry)]
        without = test.residual(test.with_entries(refitted.entries, refitted.own))
        if float(np.sum(clipped(without, at) ** 2)) - cost > least:
            keep.append(k)
    return keep


def _clear(problem: Problem, found: Fit, k: int) -> bool:
    """Whether an effect of one number is more than that number's 95 % interval is wide.

    Its gain counts samples, as if they were independent; the interval knows that they are not.
    """
    halves = [half for (place, _), half in found.half_width.items() if place == k]
    return len(halves) != 1 or deviation(found.entries[k], problem) > halves[0]


def _refitted(problem: Problem, selection: Selection, findings: Sequence[int]) -> list[int]:
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


def _beside_unknown(problem: Problem, selection: Selection, findings: Sequence[int]) -> list[int]:
    """Without the names that explain less than what no name explains: they are parts of it.

    Whatever is unknown is made up for by what happens to be like it; such names are many, small,
    and wrong. None is left where one unknown curve does better than all of them.
    """
    residual = selection.found.residual
    if alone(problem, selection.null.residual, residual) is not None:
        return _refitted(problem, selection, [])
    names = {k: term_of(selection.found.entries[k]) for k in findings}
    while True:
        residual = selection.found.residual
        cut = clipped(residual, knee(residual))
        least = BESIDE_UNKNOWN * float(np.sum(cut[problem.sliding] ** 2 - 1.0))
        kept = [k for k in findings if selection.gains[names[k]] > least]
        if len(kept) == len(findings):
            return list(findings)
        findings = _refitted(problem, selection, kept)
        names = {k: term_of(selection.found.entries[k]) for k in findings}


def _better(
    problem: Problem, found: Fit, findings: Sequence[int], judged: Sequence[Holdout]
) -> bool:
    """Whether the findings, as a model file would hold them, lower the hold-outs' error."""
    test = Problem([one.prepared for one in judged], problem.model)
    augmented = _augmented(problem, found, findings)
    before, after = test.residual(problem.model), test.residual(augmented)
    at = knee(before)
    return float(np.sum(clipped(after, at) ** 2)) < float(np.sum(clipped(before, at) ** 2))


def _content(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    left: Leftover | None,
    judged: Sequence[Holdout],
) -> dict[str, Any]:
    found = selection.found
    by_gain = sorted(findings, key=lambda k: -selection.gains[term_of(found.entries[k])])
    listed = [_finding(problem, selection, k) for k in by_gain]
    if left is not None:
        listed.append(_unknown(left))
    verdict = {
        (False, False): "no_mismatch",
        (True, False): "explained",
        (True, True): "partly_explained",
        (False, True): "unknown_effect",
    }[bool(findings), left is not None]
    excess = selection.null.residual**2 - (found.residual**2 if findings else 1.0)
    return {
        "schema": SCHEMA,
        "verdict": verdict,
        "findings": listed,
        "time_segments": [
            {"recording": name, "from_s": start, "to_s": end, "share_of_excess": share}
            for name, start, end, share in locate.time_segments(
                problem, np.where(problem.sliding, excess, 0.0)
            )
        ]
        if listed
        else [],
        "location": _location(problem, selection.null.residual) if listed else {},
        "fit": {"holdout": _proof(problem, found, findings, judged)},
    }


def _location(problem: Problem, residual: Floats) -> dict[str, Any]:
    """Cells of one and two coordinates that hold more of the mismatch than of the time."""
    cut = clipped(residual, knee(residual))
    found = regions.cells(problem, np.maximum(cut**2 - 1.0, 0.0))
    return {"sentence": regions.sentence(found), "cells": [cell.content() for cell in found]}


def _proof(
    problem: Problem, found: Fit, findings: Sequence[int], judged: Sequence[Holdout]
) -> dict[str, Any]:
    model = problem.model
    augmented = _augmented(problem, found, findings)
    before = measures(judged, augmented, model)
    return {
        "baseline": before,
        "augmented": measures(judged, augmented, augmented) if findings else before,
        "noise_floor": noise_floor(judged, augmented),
    }


def _augmented(problem: Problem, found: Fit, findings: Sequence[int]) -> Model:
    """The model with the findings; what else was fitted (how a torque is held) goes with them."""
    if not findings:
        return problem.model
    entries = [_entry(plain(found.entries[k])) for k in findings]
    model = problem.with_entries(entries, _entry(found.own))
    late = max(model.delays_s.motor_torque, 0.0)  # a model file holds no negative delay
    return replace(model, delays_s=replace(model.delays_s, motor_torque=late))


def _finding(problem: Problem, selection: Selection, k: int) -> dict[str, Any]:
    found = selection.found
    entry = found.entries[k]
    effect = catalogue()[entry["effect"]]
    gain = selection.gains[term_of(entry)]
    rivals = selection.rivals.get(term_of(entry), [])
    twins = [name for name, part in rivals if part > RIVAL or (1 - part) * gain < RIVAL_GAIN]
    if effect.id in CONSTANTS:  # what presliding says of the difference rests on the bristle's form
        pool = {one.effect.id for one in selection.pool} - {effect.id, *twins}
        twins += [name for name in CONSTANTS if name in pool]
        near = dict(rivals)
        rivals = [(name, max(near.get(name, 0.0), 1.0)) for name in twins]
    others = [e for i, e in enumerate(found.entries) if i != k]
    without = problem.residual(problem.with_entries(others, found.own))
    share = (without - found.residual) ** 2
    sentence, values = effect.wording(entry)
    places = locate.where(problem, np.where(problem.sliding, share, 0.0))
    return {
        "effect": effect.id,
        "kind": str(effect.kind),
        "confidence": _confidence(gain, threshold(problem, found.residual, FINAL_SHARE), rivals),
        "equation": effect.equation,
        "summary": sentence.format(**values),
        "parameters": _parameters(problem, found, k, effect),
        "where": [
            {
                "signal": region.signal,
                "from": region.low,
                "to": region.high,
                "share_of_excess": region.share,
            }
            for region in places
        ],
        "confusable_with": twins,
        "next_experiment": _experiment(effect, twins),
    }


def _parameters(problem: Problem, found: Fit, k: int, effect: Effect) -> dict[str, Any]:
    entry = found.entries[k]
    result = {}
    for parameter in effect.parameters:
        if parameter.name not in entry or parameter.name in _INTERNAL:
            continue
        value = entry[parameter.name]
        if parameter.name == "curve":
            result["curve"] = {"value": value, "unit": parameter.unit, "ci95": None}
            continue
        half = found.half_width.get((k, parameter.name), 0.0)
        if parameter.name == "delay_s":
            half = float(
                np.hypot(half, 1.96 * INSTANT * max(one.interval_s for one in problem.recordings))
            )
        ends = [value - half, value + half]
        result[parameter.name] = {"value": value, "unit": parameter.unit, "ci95": ends}
    return result


def _confidence(gain: float, least: float, rivals: Sequence[tuple[str, float]]) -> float:
    """How sure the name is: how far above the gate, and how far above the next best name."""
    detected = 1.0 - 0.4 * float(np.exp(-(gain / least - 1.0)))
    against = sum(float(np.exp(-max(0.0, (1 - part) * gain) / 50.0)) for _, part in rivals)
    return round(min(SUREST, detected / (1.0 + against)), 3)


def _experiment(effect: Effect, twins: Sequence[str]) -> str:
    if not twins:
        return ""
    known = [f"against {name}: {effect.twins[name]}" for name in twins if name in effect.twins]
    if known:
        return "; ".join(known)
    return (
        f"repeat at other speeds, loads and positions, so that {effect.id} and "
        f"{', '.join(twins)} act at different places"
    )


def _unknown(left: Leftover) -> dict[str, Any]:
    signal, _, direction = left.signal.partition("|")
    moving = {"right": " while turning in positive direction", "left": " in negative direction"}
    size = max((abs(torque) for _, torque, _ in left.curve), default=0.0)
    shape = left.words or (
        f"a torque of up to {size:.3g} Nm at the rotor that follows {signal}"
        f"{moving.get(direction, '')}, strongest from {left.low:.4g} to {left.high:.4g}"
        if left.curve
        else "a torque that follows no measured signal on its own (dynamic, or of two signals)"
    )
    return {
        "effect": "unknown",
        "kind": "structure",
        "confidence": round(min(SUREST, 1.0 - float(np.exp(-left.excess))), 3),
        "equation": "",
        "summary": f"Something is left that no effect of the catalogue explains: {shape}; "
        f"{100 * left.excess:.0f} % more energy than sensor noise.",
        "parameters": {},
        "where": [
            {"signal": signal, "from": left.low, "to": left.high, "share_of_excess": left.share}
        ],
        "curve": [list(point) for point in left.curve],
        "confusable_with": [],
        "next_experiment": "",
    }


def _entry(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: (round(float(f"{value:.6g}"), 12) if isinstance(value, float) else value)
        for key, value in entry.items()
    }
