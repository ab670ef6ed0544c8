"""What differs between two states of one rig: recordings before, recordings after (issue 24).

Both are diagnosed by themselves. What was found in the one that needs less is what the other is
judged against (``one_way.py``): what only that has is found more surely than what it lacks, which
would be an effect of another sign, out of a law that holds both it and what stays. Names that only
the other's own diagnosis has are changes. With any other answer the question is turned round: a
change shows both ways, and is told in the way that explains both states at the least price.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from eps_hil.diagnosis.accept.improvement import only_if_clear
from eps_hil.diagnosis.accept.proof_of_fit import CLEARLY, measures
from eps_hil.diagnosis.attribute.select import Say
from eps_hil.diagnosis.beside_shared import alike, beside_shared, gain
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.direct.already import MEASURED_WHOLE
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.diagnosis.in_numbers import in_words as numbers_in_words
from eps_hil.diagnosis.in_numbers import shift_in_words
from eps_hil.diagnosis.one_way import UNKNOWN, Finding, OneWay, Recordings, against, part
from eps_hil.diagnosis.verdict.content import without_nan
from eps_hil.diagnosis.verdict.whom import against as said_against
from eps_hil.physics.model import Model

_TURNED = {
    "new": "gone",
    "gone": "new",
    "stronger": "weaker",
    "weaker": "stronger",
    "higher": "lower",
    "lower": "higher",
}
_SIZED = ("stronger", "weaker", "higher", "lower")
_AS_MUCH = (
    "what has no name is left in both states, and no more of it in the second: that is no change"
)
_OF_FIRST = "In the first state, against the second: "
_ONE_WAY_ONLY = (
    "{}: found in one state beside what the other has, not the other way round: whether it has "
    "changed is not decided. Figures and models of both states are as each was diagnosed, with it"
)
_ONE_STATE_ONLY = (
    "something without a name is left in the {} state's recordings alone, and is not clear against "
    "what the other has: whether it has changed is not decided. Record both states in the same "
    "manoeuvres, for longer"
)


@dataclass(frozen=True)
class Changes:
    """``before``: the diagnosis of the first state. ``after``: what differs, and its evidence.

    ``after.content`` is the JSON (CONTRACT 7); its findings hold ``change`` and it has the keys
    ``before``, ``seen_in`` and ``undecided``: effects that may have changed, or not. ``model``: the
    second state's.
    """

    before: Diagnosis
    after: Diagnosis
    model: Model


def changes(model: Model, before: Recordings, after: Recordings, say: Say | None = None) -> Changes:
    """Find what the rig does in ``after`` and not in ``before``, and the other way round.

    Of each state the last recording, or the last third of a single one, is kept from the fit.
    :class:`RecordingError` as for a diagnosis.
    """
    first = diagnose(model, before, {}, part(say, 0.0, 0.2, "before"))
    second = diagnose(model, after, {}, part(say, 0.2, 0.2, "after"))
    return _with_undecided(_between(first, second, model, before, after, say), first, second)


def _between(
    first: Diagnosis,
    second: Diagnosis,
    model: Model,
    before: Recordings,
    after: Recordings,
    say: Say | None,
) -> Changes:
    """What differs, of two states that are diagnosed."""
    unknown = [UNKNOWN in _every(one) for one in (first, second)]
    came, went = (one & MEASURED_WHOLE.keys() for one in _apart(first, second))
    shared = all(unknown) and alike(first, second)
    if shared and not came and not went:
        return _beside_shared(first, second, model, before, say)
    ways = {"before": (first, after, second), "after": (second, before, first)}
    word, turned = _simpler_first(first, second)

    def way(known: str, start: float) -> OneWay:
        told, other, alone = ways[known]
        return against(told, known, other, part(say, start, 0.3, known), (model, alone))

    def told(one: OneWay, names: Collection[str]) -> Changes:
        if one.word == "before":
            return _forward(one, names, model, before)
        return _backward(one, names, first, model, before)

    if shared:  # a gap or a soft belt is measured by itself, beside whatever both states share
        return told(way("before", 0.4), came) if came else told(way("after", 0.4), went)
    one = way(word, 0.4)
    found, alone = _names(one), _own(ways[turned][0]) - _own(ways[word][0])
    whole = (_own(ways[word][0]) - _own(ways[turned][0])) & MEASURED_WHOLE.keys()
    if found <= alone and not whole:
        return told(one, found)
    other = way(turned, 0.7)
    back = _names(other)
    if found and back:
        unknown = [UNKNOWN in names for names in (found, back)]
        better = unknown[0] if unknown[0] != unknown[1] else other.price < one.price
        return told(other, back) if better else told(one, found)
    if back:
        return told(other, back & (_own(ways[word][0]) - _own(ways[turned][0])))
    return told(one, found & alone)


def _with_undecided(found: Changes, first: Diagnosis, second: Diagnosis) -> Changes:
    """Said, too, where one state alone leaves something unnamed that is told as no change."""
    content = found.after.content
    there = [UNKNOWN in _every(one) for one in (first, second)]
    told = {one["effect"] for one in content["findings"]} | set(content["undecided"])
    if there[0] == there[1] or UNKNOWN in told:
        return found
    limit = _ONE_STATE_ONLY.format("first" if there[0] else "second")
    content = {
        **content,
        "undecided": [*content["undecided"], UNKNOWN],
        "limits": [limit, *content["limits"]],
    }
    return replace(found, after=replace(found.after, content=content))


def _beside_shared(
    first: Diagnosis, second: Diagnosis, model: Model, before: Recordings, say: Say | None
) -> Changes:
    """Of what has come and what has gone both are tried; told is the way whose names one state's
    own diagnosis has too, and the other's has not. Where both or neither are so, what gains more.

    By the gain alone, what takes back a name that only the known state has would always win.
    """
    came = beside_shared(first, "before", second, part(say, 0.4, 0.3, "before"))
    went = beside_shared(second, "after", first, part(say, 0.7, 0.3, "after"))
    new, gone = _apart(first, second)
    ranks = [
        (bool(names & own), bool(names), gain(one))
        for one, names, own in ((came, _names(came), new), (went, _names(went), gone))
    ]
    if ranks[1] > ranks[0] and ranks[1][1]:
        return _backward(went, _names(went), first, model, before)
    return _forward(came, _names(came), model, before)


def _simpler_first(first: Diagnosis, second: Diagnosis) -> tuple[str, str]:
    """The state that needs less to explain it, and the other: what only that one has is found
    more surely than what it lacks.
    """
    there, here = (len(one.content["findings"]) for one in (first, second))
    return ("before", "after") if there <= here else ("after", "before")


def _apart(first: Diagnosis, second: Diagnosis) -> tuple[set[str], set[str]]:
    """Names of the second state's own diagnosis alone, and of the first one's."""
    there, here = _own(first), _own(second)
    return here - there, there - here


def _own(told: Diagnosis) -> set[str]:
    return _every(told) - {UNKNOWN}


def _every(told: Diagnosis) -> set[str]:
    return {str(one["effect"]) for one in told.content["findings"]}


def _names(way: OneWay) -> set[str]:
    return {str(one["effect"]) for _, one in way.told()}


def _forward(way: OneWay, names: Collection[str], model: Model, before: Recordings) -> Changes:
    """As the second state's diagnosis against the first one tells it."""
    told = [{**one, "change": way.change(k)} for k, one in way.told() if one["effect"] in names]
    content = _content(way, told, way.known, model, before)
    content["fit"]["holdout"]["baseline"] = way.figures
    return Changes(way.known, replace(way.other, content=content), way.other.model)


def _backward(
    way: OneWay, names: Collection[str], first: Diagnosis, model: Model, before: Recordings
) -> Changes:
    """As the first state's diagnosis against the second one tells it, turned round.

    Figures stay those of the second state's hold-outs.
    """
    told = [{**one, "change": _turned(way, k)} for k, one in way.told() if one["effect"] in names]
    content = _content(way, told, first, model, before)
    figures = dict(way.known.content["fit"]["holdout"])
    judged = way.known.as_read or way.known.judged
    figures["baseline"] = measures(judged, way.known.problem.model, way.other.model)
    content["fit"]["holdout"] = figures
    content = without_nan(content)
    return Changes(first, replace(way.other, content=content), way.known.model)


def _turned(way: OneWay, k: int) -> dict[str, Any]:
    """The change of finding ``k`` as the step from the first state to the second."""
    told = way.change(k)
    size, name = told["size_after"], way.findings[k]["effect"]
    is_ = _TURNED.get(told["is"], told["is"])
    had = [dict(one) for one in way.other.model.effects if one["effect"] == name]
    return {
        **told,
        "is": is_,
        "before": [] if is_ == "new" else had,
        "size_after": 1.0 / size if size and is_ in _SIZED else None,
        "numbers": [
            {**one, "before": one["after"], "after": one["before"]} for one in told["numbers"]
        ],
    }


def _content(
    way: OneWay,
    told: Sequence[Finding],
    first: Diagnosis,
    given: Model,
    before: Recordings,
) -> dict[str, Any]:
    """The JSON with what is ``told``, and what was before."""
    content = dict(way.other.content)
    names = {one["effect"] for one in told}
    one_way = sorted({str(one["effect"]) for _, one in way.told()} - names)
    if len(told) < len(way.findings):
        named = bool(names - {UNKNOWN})
        content["verdict"] = {
            (False, False): "no_mismatch",
            (True, False): "explained",
            (True, True): "partly_explained",
            (False, True): "unknown_effect",
        }[named, UNKNOWN in names]
    if way.word == "before":
        content["findings"] = said_against(told, "the first state", verb="was")
    else:
        content["findings"] = said_against(told, "the second state", _OF_FIRST)
    content["findings"] = [_shift_said(one) for one in content["findings"]]
    content["seen_in"] = "after" if way.word == "before" else "before"
    content["undecided"] = one_way
    content["limits"] = [
        *way.limits,
        *([_AS_MUCH] if way.as_much_unknown() else []),
        *(_ONE_WAY_ONLY.format(one) for one in one_way),
        *content["limits"],
    ]
    content["fit"] = {**content["fit"], "holdout": dict(content["fit"]["holdout"])}
    content["before"] = {
        "recordings": list(before),
        "verdict": first.content["verdict"],
        "findings": first.content["findings"],
        "limits": first.content["limits"],
        "effects_given": [dict(one) for one in given.effects],
    }
    return only_if_clear(content, way.other.elsewhere)


def _shift_said(one: Finding) -> Finding:
    """Of a ripple that begins elsewhere the sentence of the difference would tell another size."""
    if one["change"]["is"] != "shifted":
        return one
    order = one["parameters"].get("order", {}).get("value")
    said = shift_in_words(str(one["effect"]), one["change"]["numbers"], order)
    return {**one, "summary": said}


def in_words(change: Mapping[str, Any]) -> str:
    """As :func:`in_short`, and the numbers of both states."""
    said, numbers = in_short(change), numbers_in_words(change["numbers"])
    return f"{said} ({numbers})" if numbers else said


def in_short(change: Mapping[str, Any]) -> str:
    """``gone``, ``new``, ``stronger: 1.4 times as much`` of a finding's ``change``."""
    size = change["size_after"]
    if size is None or change["is"] in ("gone", "new"):
        return str(change["is"])
    return "other sign than before" if size < 0.0 else f"{change['is']}: {size:.3g} times as much"


def what_would_show(content: Mapping[str, Any]) -> str:
    """What a change would have to be to be seen, by what the second state's hold-outs leave."""
    holdout = content["fit"]["holdout"]
    left, noise = (holdout.get(one, {}).get("torque_nrmse") for one in ("augmented", "noise_floor"))
    if not left or not noise or left < CLEARLY * noise:
        return "these recordings could show"
    return f"stands out of the residual, which is {left / noise:.2g} times the sensors' noise"
