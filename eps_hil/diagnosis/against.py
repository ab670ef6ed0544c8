"""Recordings against somebody's simulator: what they hold and its traces lack, and the other way
round (CONTRACT 6)."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from eps_hil.diagnosis.accept.improvement import Judged, improvement, only_if_clear
from eps_hil.diagnosis.accept.proof_of_fit import measures
from eps_hil.diagnosis.attribute.select import Say
from eps_hil.diagnosis.balance.baseline import STIFFNESS
from eps_hil.diagnosis.balance.load import missing
from eps_hil.diagnosis.data.channels import channels_in_doubt
from eps_hil.diagnosis.data.intake import check_rates, measured, split
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.diagnosis.simulator.differences import (
    NUMBERS,
    Asked,
    Surplus,
    asked,
    numbers,
    without,
)
from eps_hil.diagnosis.simulator.simulation import Simulated, explain, silent_on
from eps_hil.diagnosis.simulator.traces import Signals
from eps_hil.diagnosis.verdict.content import without_nan
from eps_hil.diagnosis.verdict.whom import against as said_against
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

_SURE = 0.95


def diagnose_against(
    traces: Mapping[str, Signals],
    model: Model,
    recordings: Mapping[str, Signals],
    holdouts: Mapping[str, Signals],
    say: Say | None = None,
    without_effects: Collection[str] = (),
    *,
    trust_channels: bool = False,
) -> Diagnosis:
    """The diagnosis with somebody's simulator in the place of our model.

    ``model`` holds what is known of the rig (inertia, ratios, delays, friction). ``content`` gets
    the key ``simulation``: how the traces were aligned, the parameters that explain them, caveats,
    and ``differences`` in both directions. What the simulator has and the rig lacks is a finding
    too (``direction``). The "baseline" of the proof is the simulator as we reduced it.
    """
    every = {**recordings, **holdouts}
    check_rates(every)
    channels_in_doubt(every, model, trust_channels)  # which the diagnosis says
    simulated = explain(traces, every, model, _part(say, 0.0, 0.4))
    if say:
        say("looking for what the simulator has too many", 0.4)
    fitted, kept = (
        [prepare(name, one) for name, one in some.items()]
        for some in split(measured(recordings), measured(holdouts))
    )
    told = Asked()
    if not missing([*fitted, *kept]):
        effects = simulated.content["effects"]
        told = asked(fitted, kept, simulated.model, effects, simulated.problem)
    extra = told.surplus
    base = without(simulated.model, extra)
    result = diagnose(
        base,
        recordings,
        holdouts,
        _part(say, 0.5, 1.0),
        without_effects,
        simulated.unexplained_nm,
        trust_channels=trust_channels,
    )
    content = _with_surplus(result, simulated.model, extra)
    content["findings"] = said_against(content["findings"], "the simulator")
    caveats = [*simulated.content["caveats"], *_silent(result, simulated)]
    content["simulation"] = {
        **simulated.content,
        "caveats": caveats,
        "differences": _differences(result, base, told, fitted, simulated.content),
    }
    return replace(result, content=without_nan(content))


def _with_surplus(result: Diagnosis, simulator: Model, extra: Sequence[Surplus]) -> dict[str, Any]:
    """The content with what is too many as findings, and figures of the simulator as it is."""
    content = dict(result.content)
    if not extra:
        return content
    content["findings"] = [*(_finding(one) for one in extra), *content["findings"]]
    if all(one["effect"] != "unknown" for one in content["findings"]):
        content["verdict"] = "explained"
    before = measures(result.as_read or result.judged, result.model, simulator)
    holdout = {**content["fit"]["holdout"], "baseline": before}
    shown = result.as_read or result.judged
    better = improvement(
        Judged(shown, simulator), Judged(shown, result.model), simulator, result.model
    )
    content["fit"] = {**content["fit"], "holdout": holdout, "improvement": better}
    return only_if_clear(content, result.elsewhere)


def _finding(one: Surplus) -> dict[str, Any]:
    told, effect = one.content(), catalogue()[one.entry["effect"]]
    parameters = {
        p.name: {
            "value": one.entry[p.name],
            "unit": p.unit,
            "ci95": one.ci95 if p.name == one.amplitude else None,
        }
        for p in effect.parameters
        if p.name in one.entry
    }
    return {
        "effect": effect.id,
        "kind": effect.kind.value,
        "direction": "simulator_only",
        "confidence": _SURE,
        "equation": effect.equation,
        "summary": told["summary"],
        "parameters": parameters,
        "where": [],
        "confusable_with": [],
        "next_experiment": "",
    }


def _differences(
    result: Diagnosis,
    base: Model,
    told: Asked,
    fitted: Sequence[Prepared],
    simulator: Mapping[str, Any],
) -> dict[str, Any]:
    """Both directions, with sizes; ``same``: effects of the ``simulator`` (of the JSON) that the
    recordings were asked for and have, too; ``undecided``: those of which they do not tell.
    """
    findings = result.content["findings"]
    differ = (
        numbers(fitted, base, result.model, findings, simulator["parameters"]) if findings else []
    )
    apart = {one["name"].split(".")[0] for one in differ}
    apart |= {str(one.entry["effect"]) for one in told.surplus}
    mine = [str(one["effect"]) for one in base.effects]
    effects = [str(one["effect"]) for one in simulator["effects"]]
    return {
        "simulator_only": [one.content() for one in told.surplus],
        "rig_only": [
            {"effect": one["effect"], "parameters": one.get("parameters", {})}
            for one in result.content["findings"]
            if one["effect"] not in (*mine, *NUMBERS, "unknown")
            and not _lacks(one, base)
            and one["kind"] == "structure"
            and "direction" not in one
        ],
        "numbers": differ,
        "same": [one for one in told.had if one not in apart],
        "undecided": [one for one in effects if one not in (*apart, *told.had)],
    }


def _lacks(finding: Mapping[str, Any], base: Model) -> bool:
    """Whether it is less of the simulator's presliding that the rig has."""
    stiffness = finding["parameters"].get(STIFFNESS)
    return stiffness is not None and stiffness["value"] > base.friction.sigma0_nm_per_rad


def _silent(result: Diagnosis, simulated: Simulated) -> list[str]:
    entries = [result.selection.found.entries[k] for k in result.accepted]
    return [
        f"the traces do not move in a way that would show {entry['effect']}: the recordings hold "
        "it; whether the simulator does, these traces cannot tell"
        for entry in entries
        if silent_on(simulated, entry)
    ]


def _part(say: Say | None, start: float, end: float) -> Say | None:
    if say is None:
        return None
    return lambda what, part: say(what, start + part * (end - start))
