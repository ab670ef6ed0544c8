"""The whole way from recordings to a verdict (CONTRACT 7)."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.borne_out import (
    augmented_by,
    beside_unknown,
    borne_out,
    bristle_of_unknown,
    unjudged,
)
from eps_hil.diagnosis.accept.measured_ratio import settled
from eps_hil.diagnosis.accept.placebo import placebos
from eps_hil.diagnosis.accept.proof_of_fit import (
    Holdout,
    beside_a_gap,
    measures,
    noise_floor,
    only_kept,
    still_left,
    worse_force,
)
from eps_hil.diagnosis.attribute.misread import Misread, misread, refined, with_misread
from eps_hil.diagnosis.attribute.scoring import FORWARD_SHARE, threshold
from eps_hil.diagnosis.attribute.select import Say, Selection, select
from eps_hil.diagnosis.balance.baseline import HOLD
from eps_hil.diagnosis.balance.excerpt import only_part
from eps_hil.diagnosis.balance.fit import BRISTLE, Fit, matters
from eps_hil.diagnosis.balance.load import (
    FREE,
    Load,
    doubted,
    load_knobs,
    load_of,
    may_be_free,
    missing,
    not_told_apart,
    with_load,
    wrong_in_friction,
)
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee, term_of
from eps_hil.diagnosis.balance.spread import left_open
from eps_hil.diagnosis.data.channels import check_channels
from eps_hil.diagnosis.data.held import own_samples
from eps_hil.diagnosis.data.intake import (
    RecordingError,
    prepared,
    same_load,
    split,
    unseen,
)
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.direct.kinematics import small_ratio
from eps_hil.diagnosis.direct.reversals import borne_out as reversals_agree
from eps_hil.diagnosis.direct.reversals import bristle
from eps_hil.diagnosis.direct.zero_reading import ZeroReadings
from eps_hil.diagnosis.first_look import FirstLook, first_look
from eps_hil.diagnosis.mismatch import locate, regions
from eps_hil.diagnosis.mismatch.leftover import Leftover, how_held, late_torque, leftover
from eps_hil.diagnosis.verdict.finding import finding, unknown
from eps_hil.physics.model import Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

SCHEMA = "eps-hil/diagnosis/1"
LEAST_JUDGED = 125
"""Sliding samples (of 8 ms) that hold-outs need to judge anything: 1 s."""


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
    series = [*fitted.items(), *kept.items()]
    every = each(
        lambda one: prepared(one[0], one[1], unexplained_nm, {} if holdouts else recordings), series
    )
    ready = list(zip(every[: len(fitted)], fitted.values(), strict=True))
    spare = list(zip(every[len(fitted) :], kept.values(), strict=True))
    same_load(every)
    check_channels({**recordings, **holdouts}, model)
    load = load_of(every, model) if missing(every) else None

    def under(load: Load | None) -> Diagnosis:
        return _under(load, model, ready, spare, say, without)

    first = under(load)
    if load is None or (load.form == "spring" and not first.content["findings"]):
        return first
    if load.form == "spring":  # beside the friction that was found it is another one
        better = load_of(every, first.model)
        if better.form == "spring" and wrong_in_friction(load, better, every, model):
            first = under(better)
        if not may_be_free(better, every, model):
            return first
    free = under(FREE)  # friction that grows with a load that is none looks like many things
    if load.form == "arbitrary":  # which explains whatever there is
        return free if free.content["verdict"] == "explained" else first
    return min((first, free), key=_price)


def _price(told: Diagnosis) -> float:
    """What is left, and what counts as a gain for each name that it took."""
    found, part = told.selection.searched, told.selection.part
    names = sum(matters(entry, part) for entry in found.entries)
    return found.cost + names * threshold(part, found.residual, FORWARD_SHARE)


def _under(
    load: Load | None,
    model: Model,
    ready: Sequence[tuple[Prepared, Mapping[str, Series]]],
    spare: Sequence[tuple[Prepared, Mapping[str, Series]]],
    say: Say | None,
    without: Collection[str],
) -> Diagnosis:
    """The diagnosis where a load that nobody measured is taken to be ``load``."""
    every = [one for one, _ in (*ready, *spare)]
    kept = {one.name: series for one, series in spare}
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
    look, problem, selection = _searched(look, problem, load_knobs(load), judged, say, without)
    wrong = misread(
        selection.part, selection, set.intersection(*(set(series) for _, series in ready)), without
    )
    if wrong is not None:
        given, tied = look, load_knobs(load)
        look, problem, selection = _beside(wrong, given, tied, say, without)
        better = refined(wrong, selection.part, selection)
        if better is not wrong:
            wrong = better
            look, problem, selection = _beside(wrong, given, tied, say, without)
        judged = _holdouts(look, kept)
    findings, force = settled(
        problem, selection, borne_out(problem, selection, judged), look.ratio_is_measured
    )
    if say:
        say("looking at what is left", 0.9)
    hidden = load is not None and load.form == "arbitrary"  # what is left may be the load
    left = None if hidden else force or _left(problem, selection, judged)
    if left is not None and findings:
        findings = beside_unknown(problem, selection, findings)
        left = force or _left(problem, selection, judged)
    if left is not None and BRISTLE not in without and bristle_of_unknown(problem, selection.found):
        return _under(load, model, ready, spare, say, {*without, BRISTLE})
    if left is None and not hidden and HOLD in without:
        left = late_torque(problem, selection.found)
    content = look.added_to(_content(problem, selection, findings, left, judged))
    if wrong is not None:
        content = with_misread(content, wrong.finding(model))
    content["findings"] = doubted(content["findings"], load)
    content["fit"]["placebo"] = placebos(problem, selection, findings, judged)
    if look.model is not model or look.put_right or wrong is not None:
        as_read = [
            Holdout(one.changed(barred=put_right.barred), series, data)
            for (one, series), put_right, data in zip(
                spare, look.kept, look.kept_quality, strict=True
            )
        ]
        content["fit"]["holdout"]["baseline"] = measures(as_read, model, model)
    content["limits"] = [
        *([] if load is None else [load.sentence]),
        *unseen(every),
        *look.remarks,
        *only_part(problem, selection.part),
        *_not_explained(
            content,
            _only_kept(problem, selection, findings, judged),
            [] if left is not None or hidden else how_held(problem, selection.found),
        ),
        *beside_a_gap(judged, problem.model),
        *unjudged(selection.found, findings, judged, problem.model),
        *worse_force(content["fit"]["holdout"]),
        *left_open(content["findings"]),
        *small_ratio(content),
    ]
    others = load_knobs(load)
    augmented = look.in_model(augmented_by(problem, selection.found, findings, others))
    return Diagnosis(content, augmented, problem, selection, judged, findings)


def _searched(
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
        problem = Problem(look.fitted, look.model, tied=tied)
        selection = _selected(problem, look, say, without)
    asked = BRISTLE not in without and not tied  # a load that nobody measured moves the levels
    seen = bristle(selection.part, selection.searched) if asked else None
    if seen is None:
        return look, problem, selection
    named = any(entry["effect"] == BRISTLE for entry in selection.found.entries)
    off = seen.off and reversals_agree(seen, problem, selection.found, judged)
    if off:
        look = look.with_bristle(seen)
        problem = Problem(look.fitted, look.model, tied=tied)
    if off or named:
        selection = _selected(problem, look, say, {*without, BRISTLE})
    return look, problem, selection


def _beside(
    wrong: Misread,
    look: FirstLook,
    tied: Mapping[str, float],
    say: Say | None,
    without: Collection[str],
) -> tuple[FirstLook, Problem, Selection]:
    """What is found once a signal that nobody has a name for is put right."""
    right = look.with_signal(wrong.put_right, wrong.in_model(look.model))
    problem = Problem(right.fitted, right.model, tied=tied)
    seen = {one["effect"] for one in right.findings} & {BRISTLE}
    return right, problem, _selected(problem, right, say, {*without, *seen})


def _selected(
    problem: Problem, look: FirstLook, say: Say | None, without: Collection[str]
) -> Selection:
    """Effects that the balance shows, its constant as sensors with nothing on them have settled."""
    selection = select(problem, say, without, look.zero.settled)
    selection.possible = frozenset(look.zero.possible)
    return selection


def _holdouts(look: FirstLook, kept: Mapping[str, Mapping[str, Series]]) -> list[Holdout]:
    return [
        Holdout(one, kept[one.name], data)
        for one, data in zip(look.kept, look.kept_quality, strict=True)
    ]


def _only_kept(
    problem: Problem, selection: Selection, findings: Sequence[int], judged: Sequence[Holdout]
) -> list[str]:
    """What hold-outs show and the fitted recordings, with the findings, do not."""
    after = augmented_by(problem, selection.found, findings)
    left = problem.residual(after)[problem.sliding]
    return only_kept(judged, problem.model, after, float(np.mean(left**2)))


def _not_explained(
    content: Mapping[str, Any], kept: Sequence[str], held: Sequence[str]
) -> list[str]:
    """What an all-clear or an explanation would keep quiet about; ``unknown`` says it itself.

    What only hold-outs show (``kept``) says more than that there is something. So does how a torque
    is ``held``, where no finding takes it into the model.
    """
    silent = ("explained",) if held else ("no_mismatch", "explained")
    said = kept or (still_left(content["fit"]["holdout"]) if content["verdict"] in silent else [])
    return [*said, *held]


def _left(problem: Problem, selection: Selection, judged: Sequence[Holdout]) -> Leftover | None:
    """What is left of the fitted recordings, on those themselves or on the hold-outs."""
    test = Problem([one.prepared for one in judged], problem.model)
    found = selection.found
    residual = test.residual(test.with_entries(found.entries, found.own))
    return leftover(problem, found.residual, (test, residual))


def _content(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    left: Leftover | None,
    judged: Sequence[Holdout],
) -> dict[str, Any]:
    found = selection.found
    by_gain = sorted(findings, key=lambda k: -selection.gains[term_of(found.entries[k])])
    listed = [finding(problem, selection, k) for k in by_gain]
    if left is not None:
        listed.append(unknown(left))
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
    augmented = augmented_by(problem, found, findings)
    models = [model, augmented] if findings else [model]
    told = each(lambda one: measures(judged, augmented, one), models)
    return {
        "baseline": told[0],
        "augmented": told[-1],
        "noise_floor": noise_floor(judged, augmented),
    }
