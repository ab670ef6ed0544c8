"""The whole way from recordings to a verdict (CONTRACT 7)."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from eps_hil.diagnosis.accept.as_written import (
    as_the_file_does,
    in_no_file,
    under_any_force,
    under_written_load,
)
from eps_hil.diagnosis.accept.beside_law import ENOUGH
from eps_hil.diagnosis.accept.free_run import disagreement
from eps_hil.diagnosis.accept.holdout_support import (
    augmented_by,
    bristle_of_unknown,
    holdout_support,
    unjudged,
)
from eps_hil.diagnosis.accept.improvement import Judged, improvement, only_if_clear
from eps_hil.diagnosis.accept.measured_ratio import settled
from eps_hil.diagnosis.accept.other_times import (
    gone,
    only_at_one_time,
    or_a_time,
    places_in_time,
)
from eps_hil.diagnosis.accept.placebo import as_lucky, placebos
from eps_hil.diagnosis.accept.proof_of_fit import (
    Holdout,
    beside_a_gap,
    only_kept,
    still_left,
    torque_nrmse,
    worse_force,
)
from eps_hil.diagnosis.accept.standing import price, price_of_one, standing, worse
from eps_hil.diagnosis.attribute.channel_fault import (
    ChannelFault,
    channel_fault,
    with_channel_fault,
)
from eps_hil.diagnosis.attribute.scoring import FORWARD_SHARE, threshold
from eps_hil.diagnosis.attribute.select import Say, Selection
from eps_hil.diagnosis.balance.baseline import HOLD
from eps_hil.diagnosis.balance.excerpt import only_part
from eps_hil.diagnosis.balance.fit import BRISTLE, matters
from eps_hil.diagnosis.balance.late_channel import late_channels
from eps_hil.diagnosis.balance.load import (
    FREE,
    NAMED,
    NUMBERS,
    Load,
    doubted,
    load_knobs,
    load_of,
    may_be_free,
    missing,
    not_told_apart,
    of_lone_torque,
    own_drag,
    with_load,
    wrong_in_friction,
)
from eps_hil.diagnosis.balance.problem import Problem, sliding
from eps_hil.diagnosis.balance.resting import problem_of
from eps_hil.diagnosis.balance.spread import left_open
from eps_hil.diagnosis.balance.still import is_still, of_motor_torque, sentence
from eps_hil.diagnosis.data.channels import channels_in_doubt
from eps_hil.diagnosis.data.held import own_samples
from eps_hil.diagnosis.data.intake import (
    RecordingError,
    measured,
    prepared,
    same_load,
    split,
    unseen,
)
from eps_hil.diagnosis.data.prepare import CLEAR_SIGMA, THIN, Prepared, seen_twice
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.data.size import size_of
from eps_hil.diagnosis.direct.kinematics import small_ratio
from eps_hil.diagnosis.first_look import first_look
from eps_hil.diagnosis.mismatch.between import between_recordings
from eps_hil.diagnosis.mismatch.leftover import how_held, late_torque
from eps_hil.diagnosis.remainder.find import Remainder, with_remainder
from eps_hil.diagnosis.search import (
    Names,
    Searched,
    beside_left,
    left_of,
    likelier,
    modelled,
    put_right,
    searched,
)
from eps_hil.diagnosis.search import holdouts as kept_holdouts
from eps_hil.diagnosis.verdict.content import content_of, without_nan
from eps_hil.diagnosis.verdict.finding import more_masses
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

EMPIRICAL = "empirical"
MOST_LEFT = 0.5
"""Of the hold-outs' energy: what names leave of a force that is no arbitrary one."""
LEFT_BY_LAW = 1.0 - ENOUGH
"""The same, of a law without a name."""
WORTH_A_LOAD = 0.98
"""Of what hold-outs keep without: below this a load is written where there may be none."""
LEAST_SLIDING_S = 4.0
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
    remainder: Remainder | None = None
    """The model of what no name stands for, where there is one."""
    as_read: Sequence[Holdout] = ()
    """The hold-outs as their files have them, where ``judged`` are put right."""
    given: Model | None = None
    """The model file's own with a load that nobody measured, as figures before are made."""
    beside_load: Model | None = None
    """``model`` without a load that nobody measured, which ``problem`` has as its rack force."""
    price: float = np.inf
    """What the hold-outs' residual and the numbers of the written model cost (``standing.py``)."""
    ratio_is_measured: bool = False
    """Whether rotor against rack has shown what the ratio is."""
    elsewhere: Collection[str] = ()
    """Effects that the first look found, by evidence that is not the torque balance's."""


def diagnose(
    model: Model,
    recordings: Mapping[str, Mapping[str, Series]],
    holdouts: Mapping[str, Mapping[str, Series]],
    say: Say | None = None,
    without: Collection[str] = (),
    unexplained_nm: float = 0.0,
    *,
    trust_channels: bool = False,
    began_s: Mapping[str, float] = MappingProxyType({}),
) -> Diagnosis:
    """Find what physics ``model`` lacks to explain the recordings.

    Without hold-outs the last recording (of several), or the last third (of one), is kept from
    the fit. Effects in ``without`` (ids) are not considered. ``unexplained_nm`` (rms, at the rotor)
    is known to be the model's own fault and no finding. ``began_s``: how long after its rig each
    recording (or hold-out) began, where they are parts of one run: what warms up goes on.
    :class:`RecordingError` (a ``ValueError``) where a recording lacks what a diagnosis needs, or a
    channel is not what its name says; with ``trust_channels`` the latter is only said in
    ``limits``.
    """
    # Matrices here have a few dozen columns: BLAS threads only wait for one another.
    with threadpool_limits(limits=1, user_api="blas"):
        recordings, holdouts = measured(recordings), measured(holdouts)
        fitted, kept = split(own_samples(recordings), own_samples(holdouts))
        series = [*fitted.items(), *kept.items()]
        every = each(
            lambda one: prepared(one[0], one[1], unexplained_nm, {} if holdouts else recordings),
            series,
        )
        every = seen_twice(every)
        size, among = size_of(every, model), len(every)
        every = [
            one.changed(size=size, among=among, begins_s=began_s.get(one.name, one.begins_s))
            for one in every
        ]
        ready = list(zip(every[: len(fitted)], fitted.values(), strict=True))
        spare = list(zip(every[len(fitted) :], kept.values(), strict=True))
        same_load(every)
        doubts = channels_in_doubt({**recordings, **holdouts}, model, trust_channels)
        if not missing(every):
            doubts += late_channels(every, model, trusted=trust_channels)
        found = _found(model, ready, spare, say, without)
        content = only_if_clear(found.content, found.elsewhere)
        return replace(found, content={**content, "limits": [*doubts, *content["limits"]]})


def _found(
    model: Model,
    ready: Sequence[tuple[Prepared, Mapping[str, Series]]],
    spare: Sequence[tuple[Prepared, Mapping[str, Series]]],
    say: Say | None,
    without: Collection[str],
) -> Diagnosis:
    """The diagnosis under the load that fits best, where nobody measured one."""
    every = [one for one, _ in (*ready, *spare)]
    learnt = [one for one, _ in ready]  # a hold-out that the load was fitted to judges nothing
    _slides(learnt, np.concatenate([sliding(one, model) for one in learnt]))
    if not missing(every):
        return _under(None, model, ready, spare, say, without)
    load = load_of(learnt, model)
    beside = load.beside_own_drag(model)
    told = _under_load(replace(load, drag_nm_s_per_rad=0.0), beside, ready, spare, say, without)
    said = own_drag(model, told.model)
    return replace(told, content={**told.content, "limits": [*said, *told.content["limits"]]})


def _under_load(
    load: Load,
    model: Model,
    ready: Sequence[tuple[Prepared, Mapping[str, Series]]],
    spare: Sequence[tuple[Prepared, Mapping[str, Series]]],
    say: Say | None,
    without: Collection[str],
) -> Diagnosis:
    """Under the load that follows from the one that fits beside nothing else; or none, with names.

    Numbers that stand for a load hold whatever follows the motion as it does. Where they leave
    nothing to find, there may be no load, and names cost less of the hold-outs (``standing.py``),
    it is the rig's own: a load that is written has three numbers, and one that is not leaves what
    they held.
    """
    told = _under_likely_load(load, model, ready, spare, say, without)
    every = [one for one, _ in (*ready, *spare)]
    silent = all(one["effect"] in told.elsewhere for one in told.content["findings"])
    if load.form == "arbitrary" or not silent or not may_be_free(load, every, model):
        return told
    named = _under(NAMED, model, ready, spare, say, without)
    if not named.content["findings"]:
        return told
    written = told.beside_load is not None and told.beside_load != told.model
    cost = told.price + written * NUMBERS * price_of_one(told.problem, told.judged)
    return named if named.price < cost else told


def _under_likely_load(
    load: Load,
    model: Model,
    ready: Sequence[tuple[Prepared, Mapping[str, Series]]],
    spare: Sequence[tuple[Prepared, Mapping[str, Series]]],
    say: Say | None,
    without: Collection[str],
) -> Diagnosis:
    """The same from the ``load`` that fits beside nothing else, and what follows from there."""
    every = [one for one, _ in (*ready, *spare)]
    learnt = [one for one, _ in ready]

    def under(load: Load) -> Diagnosis:
        return _under(load, load.beside_own_drag(model), ready, spare, say, without)

    base = load.in_model(model)
    if load.form == "arbitrary":
        loose = may_be_free(load, every, model)
        return _under_any(load, under, model, learnt, loose=loose)
    first = under(load)
    if not first.content["findings"]:
        return _with_load(first, load, _as_told(load, first, learnt), base)
    better = load_of(learnt, first.model)  # beside the friction that was found it is another one
    fitted = load
    if better.form == "spring":
        if wrong_in_friction(load, better, every, model):
            first, fitted = under(better), better
            better = replace(better, drag_nm_s_per_rad=0.0)  # it is in what was found by now
        load = _as_told(better, first, learnt)
    if may_be_free(better, every, model):
        free = under(FREE)  # friction that grows with a load that is none looks like many things
        if _price(free) < _price(first):
            return _with_what_follows(free, model, learnt)
    told = _with_load(first, fitted, load, base)
    if not _worse_under_load(told):
        return told
    own = fitted.beside_own_drag(model)
    bare = _under(fitted, own, ready, spare, say, catalogue())
    return _with_load(bare, fitted, load, base)


def _under_any(
    load: Load,
    under: Callable[[Load], Diagnosis],
    model: Model,
    learnt: Sequence[Prepared],
    *,
    loose: bool,
) -> Diagnosis:
    """The diagnosis under a force that may be arbitrary, and explain whatever there is.

    As one that follows the motion (``loose``: or none), where that is believed.
    """
    form = replace(FREE if loose else load.followed(), doubtful=True)
    told = _refitted(under(form), form, form.in_model(model), learnt)
    if told.content["verdict"] == "explained":
        return told
    if _follows(told, held=not loose and load.stiffness_n_per_m < 0.0):
        return told
    ripples = under(load)
    return replace(ripples, content=under_any_force(ripples.content))


def _worse_under_load(told: Diagnosis) -> bool:
    """Whether hold-outs are worse by the written file, whose load was fitted beside what was found.

    Then what was found had only taken over what the load does.
    """
    figures = told.content["fit"]["holdout"]
    before, after = (figures[one]["torque_nrmse"] for one in ("baseline", "augmented"))
    return bool(told.content["findings"] and after > before)


def _slides(recordings: Sequence[Prepared], samples: npt.NDArray[np.bool_]) -> None:
    """:class:`RecordingError` where too few samples show a rotor that slides."""
    seconds = 1e-3 * THIN * float(np.sum(samples))
    if seconds >= LEAST_SLIDING_S:
        return
    hides = max(CLEAR_SIGMA * one.speed_noise_rad_s for one in recordings)
    raise RecordingError(
        recordings[0].name,
        f"its rotor slides for {seconds:.1f} s that can be told from noise (a speed beyond "
        f"{hides:.2g} rad/s, away from reversals); a diagnosis needs {LEAST_SLIDING_S:g} s: move "
        "farther or longer, or record speed or angle in finer steps",
    )


def _follows(told: Diagnosis, *, held: bool) -> bool:
    """Whether names explain most of the hold-outs' energy: that is no arbitrary force.

    A law without a name has to explain nearly all of it: in manoeuvres that are somewhat alike, a
    part of any force follows the motion somehow. And all of it does where the drive is ``held``: a
    motor that holds a place against any force gives way as a spring of negative stiffness.
    """
    named = any(one["effect"] != "unknown" for one in told.content["findings"])
    if held and not named:
        return False
    before, after = (
        told.content["fit"]["holdout"][one]["torque_nrmse"] for one in ("baseline", "augmented")
    )
    return bool(after**2 < (MOST_LEFT if named else LEFT_BY_LAW) * before**2)


def _as_told(load: Load, told: Diagnosis, learnt: Sequence[Prepared]) -> Load:
    """The load that is written beside what was found: with all that its damper had to hold there.

    A level of friction that it could not be told from has no name, and would be in neither.
    """
    again = load_of(learnt, told.model, level=False)
    return again if again.form == "spring" else load


def _with_what_follows(told: Diagnosis, model: Model, learnt: Sequence[Prepared]) -> Diagnosis:
    """Of a free rack: with the spring, damper and constant that stay in the balance, if they do.

    They are free in its fits, and have no name: a drag that is off would be nowhere else.
    """
    load = load_of(learnt, told.model, level=False)
    grows = told.model.friction.load_pos_nm_per_n + told.model.friction.load_neg_nm_per_n
    if load.form != "spring" or grows > 0.0:
        return told
    without, beside = (
        torque_nrmse(told.judged, model, one) for one in (told.model, load.in_model(told.model))
    )
    return _with_load(told, FREE, load, model) if beside < WORTH_A_LOAD * without else told


def _refitted(told: Diagnosis, form: Load, base: Model, learnt: Sequence[Prepared]) -> Diagnosis:
    """With the load in the model, a spring as it is beside what was found."""
    better = load_of(learnt, told.model, level=False) if form.form == "spring" else form
    better = replace(better, doubtful=True) if better.form == "spring" else form
    return _with_load(told, form, better, base)


def _with_load(told: Diagnosis, fitted: Load, load: Load, base: Model) -> Diagnosis:
    """With ``load`` in the model in place of the one ``fitted`` beside it, and with its figures.

    ``base``: the given model with the load that was fitted beside nothing else.
    """
    written = load.in_model(told.model)
    content = under_written_load(told.content, told.judged, told.as_read, base, written)
    content["limits"] = [
        load.sentence if one == fitted.sentence else one for one in content["limits"]
    ]
    content = without_nan(content)
    return replace(told, model=written, content=content, given=base, beside_load=told.model)


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
    """The diagnosis where a load that nobody measured is taken to be ``load``.

    Of a channel that is wrong and physics that is left out, what hold-outs are better off with.
    """
    kept = {one.name: series for one, series in spare}

    def again(more: Collection[str]) -> Diagnosis:
        return _under(load, model, bare[0], bare[1], say, more)

    bare = ready, spare
    if load is not None:
        alone = of_lone_torque([one for one, _ in ready])
        ready = [(with_load(one, model, load), series) for one, series in ready]
        spare = [(with_load(one, model, load), series) for one, series in spare]
        without = {*without, *not_told_apart(load), *alone}
    look = first_look(ready, spare, model, without)
    problem = problem_of(look.fitted, look.model, load_knobs(load))
    _slides(look.fitted, problem.sliding)
    untold = of_motor_torque(problem) if is_still(look.fitted) else []
    if untold:
        without = {*without, *untold, EMPIRICAL}
    judged = kept_holdouts(look, kept)
    if sum(int(np.sum(one.judging(look.model))) for one in judged) < LEAST_JUDGED:
        raise RecordingError(
            look.kept[-1].name, "kept from the fit to judge it, but slides for less than 1 s"
        )
    look, problem, selection = searched(look, problem, load_knobs(load), judged, say, without)
    measured = set.intersection(*(set(series) for _, series in ready))
    case = _Case(load, model, ready, spare, say, without, again, untold)
    given = look, problem, selection, judged
    wrong = channel_fault(selection.part, selection, measured, without)
    right = wrong and put_right(wrong, given, load_knobs(load), say, without, kept)
    if not right:
        return _told(case, given)
    fault, so_found = right
    return likelier(
        given, so_found, lambda one: _told(case, one, fault if one is so_found else None)
    )


@dataclass(frozen=True)
class _Case:
    """What a diagnosis is made of; ``again``: the same, without some effects (ids).

    ``untold``: those of which a motor torque that never changes says nothing.
    """

    load: Load | None
    model: Model
    ready: Sequence[tuple[Prepared, Mapping[str, Series]]]
    spare: Sequence[tuple[Prepared, Mapping[str, Series]]]
    say: Say | None
    without: Collection[str]
    again: Callable[[Collection[str]], Diagnosis]
    untold: Sequence[str] = ()


def _told(case: _Case, searched_for: Searched, wrong: ChannelFault | None = None) -> Diagnosis:
    """What is said of a selection, once what is left beside it is modelled."""
    look, problem, selection, judged = searched_for
    load, model, spare, say, without = case.load, case.model, case.spare, case.say, case.without
    others = load_knobs(load)
    every = [one for one, _ in (*case.ready, *spare)]
    findings, force = settled(
        problem, selection, holdout_support(problem, selection, judged), look.ratio_is_measured
    )
    findings = standing(problem, selection, findings, judged)
    if say:
        say("examining the residual", 0.9)
    hidden = load is not None and load.form == "arbitrary"  # what is left may be the load
    now = first = Names(
        problem,
        selection,
        selection,
        findings,
        None if hidden else force or left_of(problem, selection, judged),
    )
    if now.left is not None:
        now = beside_left(problem, selection, judged, look, force)
    selection, findings, left, extra = now.as_told
    if left is not None and BRISTLE not in without and bristle_of_unknown(problem, selection.found):
        return case.again({*without, BRISTLE})
    if left is None and not hidden and HOLD in without:
        left = late_torque(problem, selection.found)
    if left is not None and (force is not None or not left.words) and EMPIRICAL not in without:
        now = modelled(problem, now, first, judged, look, force, others, say)
        selection, findings, left, extra = now.as_told
    places = places_in_time(problem, selection.found, findings, judged)
    placebo = placebos(now.weighed, now.told, findings, judged)
    unfounded = {*gone(places), *as_lucky(placebo, now.weighed, now.told, findings, judged)}
    if unfounded:
        return case.again({*without, *unfounded})
    written = with_remainder(augmented_by(problem, selection.found, findings, others), extra)
    beside_load = augmented_by(problem, selection.found, findings) if extra is None else written
    if worse(problem, beside_load, judged):
        extra, findings, written = None, [], problem.model
    final = load is None or load.form == "free"  # else judged again once the load is written
    content = look.added_to(
        content_of(problem, selection, findings, left, judged, extra, written, simulated=final)
    )
    if wrong is not None:
        content = with_channel_fault(content, wrong.finding(model))
    content["findings"] = or_a_time(doubted(content["findings"], load), places, without)
    content["fit"]["placebo"] = placebo if findings else []
    as_read: list[Holdout] = []
    ready_to_write = look.in_model(written)
    if look.model is not model or look.put_right or look.entries or wrong is not None:
        as_read = [
            Holdout(one.changed(barred=right.barred), series, data)
            for (one, series), right, data in zip(spare, look.kept, look.kept_quality, strict=True)
        ]
        shown = look.put_right_in_no_file or wrong is not None
        content["fit"]["holdout"] = as_the_file_does(
            content["fit"]["holdout"],
            as_read,
            model,
            ready_to_write,
            balance=shown,
            simulated=final,
        )
    content["fit"]["improvement"] = improvement(
        Judged(as_read or judged, model if as_read else problem.model),
        Judged(judged, written),
        model,
        ready_to_write,
    )
    content["limits"] = [
        *([] if load is None else [load.sentence]),
        *unseen(every),
        *([sentence(case.untold)] if case.untold else []),
        *look.remarks,
        *look.notes,
        *only_part(problem, selection.part),
        *_not_explained(
            content,
            _only_kept(problem, selection, findings, judged),
            [] if left is not None or hidden else how_held(problem, selection.found),
        ),
        *between_recordings([*look.fitted, *(one.prepared for one in judged)], written),
        *beside_a_gap(judged, problem.model),
        *in_no_file(content["fit"]["holdout"]),
        *unjudged(now.told.found, findings, judged, now.weighed),
        *worse_force(content["fit"]["holdout"]),
        *disagreement(content["fit"]["holdout"], as_read or judged, model, ready_to_write),
        *only_at_one_time({one: places[one] for one in places if findings}),
        *left_open(content["findings"], problem.size),
        *more_masses(content["findings"], ready_to_write),
        *small_ratio(content),
    ]
    return Diagnosis(
        without_nan(content),
        ready_to_write,
        problem,
        selection,
        judged,
        findings,
        extra,
        as_read,
        price=price(problem, selection, findings, judged, written, extra)
        + (wrong is not None) * price_of_one(problem, judged),
        ratio_is_measured=look.ratio_is_measured,
        elsewhere=[str(one["effect"]) for one in look.findings],
    )


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
