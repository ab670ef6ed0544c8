"""What differs between two states of one rig: recordings before, recordings after (issue 24).

The recordings before are diagnosed first, and what was found there is what those after are judged
against (``one_way.py``). Where that shows something, the question is turned round: the state after
is diagnosed by itself, and the recordings before against it. What is gone is a plain finding there,
which it is not the other way: an effect of another sign, out of a law that holds both it and what
stays. A change shows both ways; it is told in the way that explains both states at the least price.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from eps_hil.diagnosis.accept.proof_of_fit import measures
from eps_hil.diagnosis.attribute.select import Say
from eps_hil.diagnosis.diagnose import Diagnosis, diagnose
from eps_hil.diagnosis.direct.already import MEASURED_WHOLE
from eps_hil.diagnosis.one_way import UNKNOWN, Finding, OneWay, Recordings, against, part
from eps_hil.diagnosis.verdict.content import without_nan
from eps_hil.physics.model import Model

_TURNED = {"new": "gone", "gone": "new", "stronger": "weaker", "weaker": "stronger"}
_AS_MUCH = (
    "what has no name is left in both states, and no more of it in the second: that is no change"
)
_ONE_WAY_ONLY = (
    "{}: found in one state beside what the other has, not the other way round: that is no change"
)


@dataclass(frozen=True)
class Changes:
    """``before``: the diagnosis of the first state. ``after``: what differs, and its evidence.

    ``after.content`` is the JSON (CONTRACT 7); its findings hold ``change`` and it has the keys
    ``before`` and ``seen_in``. ``model``: the second state's.
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
    forward = against(first, "before", after, part(say, 0.2, 0.3, "after"))
    whole = {one["effect"] for one in first.content["findings"]} & MEASURED_WHOLE.keys()
    told = _names(forward)
    if not told and not whole:
        return _forward(forward, told, model, before)
    second = diagnose(model, after, {}, part(say, 0.5, 0.2, "after"))
    backward = against(second, "after", before, part(say, 0.7, 0.3, "before"))
    turned = _names(backward)
    if told and turned:
        unknown = [UNKNOWN in names for names in (told, turned)]
        better = unknown[0] if unknown[0] != unknown[1] else backward.price < forward.price
        if better:
            return _backward(backward, turned, first, model, before)
        return _forward(forward, told, model, before)
    if turned:
        return _backward(backward, turned & MEASURED_WHOLE.keys(), first, model, before)
    own = {one["effect"] for one in second.content["findings"]} - {UNKNOWN}
    alone = own - {one["effect"] for one in first.content["findings"]}
    return _forward(forward, told & alone, model, before)


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
        "size_after": 1.0 / size if size and is_ in ("stronger", "weaker") else None,
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
    content["findings"] = list(told)
    content["seen_in"] = "after" if way.word == "before" else "before"
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
    return content


def in_words(change: Mapping[str, Any]) -> str:
    """``gone``, ``new``, ``stronger: 1.4 times what it was`` of a finding's ``change``."""
    size = change["size_after"]
    if size is None or change["is"] in ("gone", "new"):
        return str(change["is"])
    if size < 0.0:
        return "other sign than before"
    return f"{change['is']}: {size:.3g} times what it was"
