"""The diagnosis under a load that was measured, or is taken to be one."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.as_friction import as_friction
from eps_hil.diagnosis.accept.as_written import (
    as_the_file_does,
    in_no_file,
)
from eps_hil.diagnosis.accept.free_run import disagreement
from eps_hil.diagnosis.accept.holdout_support import (
    augmented_by,
    bristle_of_unknown,
    holdout_support,
    unjudged,
)
from eps_hil.diagnosis.accept.improvement import Judged, improvement
from eps_hil.diagnosis.accept.measured_ratio import settled
from eps_hil.diagnosis.accept.only_kept import OnlyKept, only_kept, with_only_kept
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
    still_left,
    worse_force,
)
from eps_hil.diagnosis.accept.standing import price, price_of_one, standing, worse
from eps_hil.diagnosis.attribute.channel_fault import (
    ChannelFault,
    channel_fault,
    with_channel_fault,
)
from eps_hil.diagnosis.attribute.select import Say, Selection
from eps_hil.diagnosis.balance.baseline import HOLD
from eps_hil.diagnosis.balance.excerpt import only_part
from eps_hil.diagnosis.balance.fit import BRISTLE
from eps_hil.diagnosis.balance.load import (
    Load,
    doubted,
    load_knobs,
    not_told_apart,
    of_lone_torque,
    with_load,
)
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.balance.resting import problem_of
from eps_hil.diagnosis.balance.spread import left_open
from eps_hil.diagnosis.balance.still import is_still, of_motor_torque, sentence
from eps_hil.diagnosis.data.intake import (
    RecordingError,
    unseen,
)
from eps_hil.diagnosis.data.prepare import CLEAR_SIGMA, THIN, Prepared
from eps_hil.diagnosis.direct.at_rest import turns_otherwise
from eps_hil.diagnosis.direct.kinematics import small_ratio, where_friction_acts
from eps_hil.diagnosis.first_look import FirstLook, first_look
from eps_hil.diagnosis.mismatch.between import between_recordings
from eps_hil.diagnosis.mismatch.leftover import how_held, late_torque
from eps_hil.diagnosis.remainder.find import Remainder, with_remainder
from eps_hil.diagnosis.search import (
    Names,
    Searched,
    beside_left,
    cheapest,
    left_of,
    likelier,
    modelled,
    put_right,
    searched,
)
from eps_hil.diagnosis.search import holdouts as kept_holdouts
from eps_hil.diagnosis.verdict.content import content_of, without_nan
from eps_hil.diagnosis.verdict.finding import more_masses
from eps_hil.diagnosis.verdict.order import most_first
from eps_hil.physics.model import Model
from eps_hil.series import Series

EMPIRICAL, UNKNOWN = "empirical", "unknown"
_TURNING = {BRISTLE, UNKNOWN}
"""Findings that may tell of rest and presliding."""

LEAST_SLIDING_S = 4.0
_AS_WELL = "Hold-outs cannot tell what is found from another explanation"

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
    shown: Collection[str] = ()
    """Effects for which it had that evidence, whether it found them or not."""


Read = Sequence[tuple[Prepared, Mapping[str, Series]]]
"""Recordings, prepared and as they were read."""


@dataclass(frozen=True)
class Asked:
    """What is to be explained: ``fitted`` and ``kept`` recordings, by ``model``.

    ``without``: effects (ids) that are not considered.
    """

    model: Model
    fitted: Read
    kept: Read
    say: Say | None
    without: Collection[str]

    @property
    def learnt(self) -> list[Prepared]:
        """The recordings to fit alone: what is fitted to a hold-out cannot be judged on it."""
        return [one for one, _ in self.fitted]

    @property
    def every(self) -> list[Prepared]:
        """All recordings."""
        return [one for one, _ in (*self.fitted, *self.kept)]

    def beside(self, load: Load) -> "Asked":
        """The same, of recordings with that load as their rack force."""
        fitted, kept = (
            [(with_load(one, self.model, load), series) for one, series in read]
            for read in (self.fitted, self.kept)
        )
        hidden = {*not_told_apart(load), *of_lone_torque(self.learnt)}
        return replace(self, fitted=fitted, kept=kept, without={*self.without, *hidden})


def slides(recordings: Sequence[Prepared], samples: npt.NDArray[np.bool_]) -> None:
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


def under(load: Load | None, asked: Asked) -> Diagnosis:
    """The diagnosis where a load that nobody measured is taken to be ``load``.

    Of a channel that is wrong and physics that is left out, what hold-outs are better off with.
    """
    return begun(load, asked).told()


def begun(load: Load | None, asked: Asked) -> "Begun":
    """The same as far as the ordinary search for names, which is a small part of it."""
    bare = asked

    def again(more: Collection[str]) -> Diagnosis:
        return under(load, replace(bare, without=more))

    if load is not None:
        asked = asked.beside(load)
    model, say = asked.model, asked.say
    kept = {one.name: series for one, series in asked.kept}
    look = first_look(asked.fitted, asked.kept, model, bare.without, asked.without)
    problem = problem_of(look.fitted, look.model, load_knobs(load))
    slides(look.fitted, problem.sliding)
    untold = of_motor_torque(problem) if is_still(look.fitted) else []
    if untold:
        asked = replace(asked, without={*asked.without, *untold, EMPIRICAL})
    judged = kept_holdouts(look, kept)
    if sum(int(np.sum(one.judging(look.model))) for one in judged) < LEAST_JUDGED:
        raise RecordingError(
            look.kept[-1].name, "kept from the fit to judge it, but slides for less than 1 s"
        )
    look, problem, selection = searched(look, problem, load_knobs(load), judged, say, asked.without)
    return Begun(_Case(load, asked, again, untold), (look, problem, selection, judged), kept)


@dataclass(frozen=True)
class Begun:
    """A diagnosis whose search is done, and whose remainder is not modelled yet."""

    case: "_Case"
    given: Searched
    kept: Mapping[str, Mapping[str, Series]]

    @property
    def names(self) -> set[str]:
        """What the search found."""
        return {str(one["effect"]) for one in self.given[2].found.entries}

    def told(self) -> Diagnosis:
        """All of it."""
        case, given = self.case, self.given
        load, asked, selection = case.load, case.asked, given[2]
        measured = set.intersection(*(set(series) for _, series in asked.fitted))
        wrong = channel_fault(selection.part, selection, measured, asked.without)
        right = wrong and put_right(
            wrong, given, load_knobs(load), asked.say, asked.without, self.kept
        )
        if not right:
            return _told(case, given)
        fault, so_found = right
        return likelier(
            given,
            so_found,
            lambda one: _told(case, one, fault if one is so_found else None),
            _beside,
        )


def _beside(best: Diagnosis, other: Diagnosis) -> Diagnosis:
    """With what else explains the recordings as well."""
    there = [one["summary"] for one in best.content["findings"]]
    more = [one["summary"] for one in other.content["findings"] if one["summary"] not in there]
    sentence = f"{_AS_WELL}: {' And: '.join(more)}"
    return replace(best, content={**best.content, "limits": [*best.content["limits"], sentence]})


@dataclass(frozen=True)
class _Case:
    """What a diagnosis is made of; ``again``: the same, without some effects (ids).

    ``untold``: those of which a motor torque that never changes says nothing.
    """

    load: Load | None
    asked: Asked
    again: Callable[[Collection[str]], Diagnosis]
    untold: Sequence[str] = ()


def _told(case: _Case, searched_for: Searched, wrong: ChannelFault | None = None) -> Diagnosis:
    """What is said of a selection, once what is left beside it is modelled."""
    look, problem, selection, judged = searched_for
    load, model, say, without = case.load, case.asked.model, case.asked.say, case.asked.without
    others = load_knobs(load)
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
        now = cheapest(
            problem,
            first,
            modelled(problem, now, first, judged, look, force, others, say),
            judged,
            others,
            say,
        )
        selection, findings, left, extra = now.as_told
    places = places_in_time(problem, selection.found, findings, judged)
    placebo = placebos(now.weighed, now.told, findings, judged)
    unfounded = set(gone(places))
    if load is not None:
        # a load that nobody measured leaves what no noise's threshold knows of; with a load cell a
        # small number of the file's that is off gains no more than the luckiest placebo beside it
        unfounded |= set(as_lucky(placebo, now.weighed, now.told, findings, judged))
    if unfounded:
        return case.again({*without, *unfounded})
    if extra is not None:
        extra = as_friction(problem, problem.over([one.prepared for one in judged]), extra)
    written = with_remainder(augmented_by(problem, selection.found, findings, others), extra)
    beside_load = augmented_by(problem, selection.found, findings) if extra is None else written
    if worse(problem, beside_load, judged):
        extra, findings, written = None, [], problem.model
    final = load is None or load.form == "free"  # else judged again once the load is written
    shown = look.put_right_in_no_file or wrong is not None
    ready_to_write = look.in_model(written)
    put_right = look.model is not model or look.put_right or look.entries or wrong is not None
    as_read = _as_read(case, look) if put_right else []
    simulated = final and (shown or not as_read)  # else they are simulated as they were read
    content = look.added_to(
        content_of(problem, selection, findings, left, judged, extra, written, simulated=simulated)
    )
    if wrong is not None:
        content = with_channel_fault(content, wrong.finding(model))
    content["findings"] = most_first(
        or_a_time(doubted(content["findings"], load), places, without),
        as_read or judged,
        model,
        ready_to_write,
    )
    shown_there = _only_kept(problem, selection, findings, judged)
    told_there = [] if hidden else shown_there  # what is left may be the load
    content = with_only_kept(content, told_there, problem, written, without)
    content["fit"]["placebo"] = placebo if findings else []
    if as_read:
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
    said = {str(one["effect"]) for one in content["findings"]}
    content["limits"] = [
        *([] if load is None else [load.sentence(look.shown)]),
        *unseen(case.asked.every),
        *([sentence(case.untold)] if case.untold else []),
        *look.remarks,
        *look.notes,
        *only_part(problem, selection.part),
        *_not_explained(
            content,
            [one.sentence() for one in shown_there],
            [] if left is not None or hidden else how_held(problem, selection.found),
        ),
        *between_recordings([*look.fitted, *(one.prepared for one in judged)], written),
        *([] if hidden else turns_otherwise(problem, judged, written, named=bool(said & _TURNING))),
        *beside_a_gap(judged, problem.model),
        *in_no_file(content["fit"]["holdout"]),
        *unjudged(now.told.found, findings, judged, now.weighed),
        *worse_force(content["fit"]["holdout"]),
        *disagreement(content["fit"]["holdout"], as_read or judged, model, ready_to_write),
        *only_at_one_time({one: places[one] for one in places if findings}),
        *left_open(content["findings"], problem.size),
        *more_masses(content["findings"], ready_to_write),
        *small_ratio(content),
        *where_friction_acts(content),
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
        shown=look.shown,
    )


def _as_read(case: _Case, look: FirstLook) -> list[Holdout]:
    """The hold-outs as their files have them, without what the first look put right."""
    return [
        Holdout(one.changed(barred=right.barred), series, data)
        for (one, series), right, data in zip(
            case.asked.kept, look.kept, look.kept_quality, strict=True
        )
    ]


def _only_kept(
    problem: Problem, selection: Selection, findings: Sequence[int], judged: Sequence[Holdout]
) -> list[OnlyKept]:
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
