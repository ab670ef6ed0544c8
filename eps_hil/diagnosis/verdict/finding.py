"""A finding as the JSON has it (CONTRACT 7): name, numbers, place, how sure, what else it is."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eps_hil.diagnosis.attribute.numbers import CONSTANTS
from eps_hil.diagnosis.attribute.scoring import FINAL_SHARE, threshold
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.baseline import HOLD
from eps_hil.diagnosis.balance.fit import Fit
from eps_hil.diagnosis.balance.probes import bounds, neutral_value
from eps_hil.diagnosis.balance.problem import Problem, term_of
from eps_hil.diagnosis.balance.turning import ends_of, in_words
from eps_hil.diagnosis.data.entry import place
from eps_hil.diagnosis.data.entry import unknown as unknown_entry
from eps_hil.diagnosis.mismatch import locate
from eps_hil.diagnosis.mismatch.leftover import Leftover
from eps_hil.physics.effects.catalogue import catalogue, joint_of
from eps_hil.physics.effects.effect import Effect
from eps_hil.physics.model import Model

RIVAL = 0.97
"""Reaching this share of a finding's gain makes another effect its confusable twin…"""
RIVAL_GAIN = 60.0
"""…and so does missing it by less than this many noise variances."""
SUREST = 0.95
"""No name is surer, set on development cases; docs/proof.md says how many such were right."""
INSTANT = 0.1
"""Of a sampling interval: deviation of what a delay means, when nobody knows at which instant of
its interval a value was taken, how the controller held it and how its filters shaped it."""
SLOW_SAMPLES_S = 2e-3
"""Between samples: half of a shorter step is below what is named (``least`` of the delay)."""
_AT_THE_END = 0.5
"""No name is surer whose scale ended at the bound of the search, or whose number is not clear."""
_CLEAR = 1.5
"""Half widths of its interval that a number has to be away from none: three deviations."""
_HARDLY = " Its interval comes near to none of it: longer recordings would tell."
_FARTHER = (
    " So far it was looked for: more is asked for, or something else that this stands in for. Look "
    "at the signal's unit and scale first."
)
_FOLLOWS = 0.25
"""Of what is left: a curve that holds less is no description of it."""
_INTERNAL = ("belt_ratio", "pole_pairs", "harmonic")


def finding(problem: Problem, selection: Selection, k: int) -> dict[str, Any]:
    """The entry at place ``k`` of the fit that was accepted."""
    found = selection.found
    entry = found.entries[k]
    effect = catalogue()[entry["effect"]]
    gain = selection.gains[term_of(entry)]
    rivals = selection.rivals.get(term_of(entry), [])
    twins = [name for name, part in rivals if part > RIVAL or (1 - part) * gain < RIVAL_GAIN]
    ruled_out = selection.settled - selection.possible
    twins = [name for name in twins if name not in ruled_out]
    if effect.id in CONSTANTS:  # what presliding says of the difference rests on the bristle's form
        pool = {one.effect.id for one in selection.pool} - {effect.id, *twins, *ruled_out}
        twins += [name for name in CONSTANTS if name in pool]
        near = dict(rivals)
        rivals = [(name, max(near.get(name, 0.0), 1.0)) for name in twins]
    least = selection.least.get(term_of(entry))
    if least is None:
        least = threshold(problem, found.residual, FINAL_SHARE)
    others = [e for i, e in enumerate(found.entries) if i != k]
    without = problem.residual(problem.with_entries(others, found.own))
    share = (without - found.residual) ** 2
    sentence, values = effect.wording(entry)
    places = locate.where(problem, np.where(problem.sliding, share, 0.0), effect.over_time)
    parameters = _parameters(problem, found, k, effect)
    held = ""
    if effect.id == HOLD:
        held = as_held(
            parameters["delay_s"]["ci95"], max(one.interval_s for one in problem.recordings)
        )
    sure = _confidence(gain, least, rivals)
    if _at_the_end(effect, entry, problem):
        sure, held = min(sure, _AT_THE_END), f"{held}{_FARTHER}"
    if _hardly_there(effect, parameters, problem):
        sure, held = min(sure, _AT_THE_END), f"{held}{_HARDLY}"
    turning = in_words(problem, found, k, selection.without.get(term_of(entry)), RIVAL)
    return {
        "effect": effect.id,
        "kind": str(effect.kind),
        "confidence": sure,
        "equation": effect.equation,
        "summary": sentence.format(**values) + held + turning,
        "parameters": parameters,
        "where": [
            place(region.signal, region.low, region.high, region.share, region.occupancy)
            for region in places
        ],
        "confusable_with": twins,
        "next_experiment": _experiment(effect, twins),
    }


def _hardly_there(effect: Effect, parameters: Mapping[str, Any], problem: Problem) -> bool:
    """Whether the interval of what makes an effect comes near to none of it."""
    probe = effect.probe
    told = None if probe is None else parameters.get(probe.amplitude)
    if probe is None or told is None or told["ci95"] is None:
        return False
    half = 0.5 * (told["ci95"][1] - told["ci95"][0])
    return bool(abs(told["value"] - neutral_value(probe, problem.model)) < _CLEAR * half)


def _at_the_end(effect: Effect, entry: Mapping[str, Any], problem: Problem) -> bool:
    """Whether a scale ended where the search for it ends: the data ask for more, and do not get it.

    Of other numbers that may be as it is: what is narrow, early or fast has a bound of its own.
    """
    probe = effect.probe
    if probe is None or probe.neutral != 1.0:
        return False
    scale = next(one for one in effect.parameters if one.name == probe.amplitude)
    return entry[scale.name] in bounds(effect, scale, problem)


def as_held(delay_s: Sequence[float], interval_s: float) -> str:
    """What is said of a delay whose interval holds half a step of slow samples; else nothing."""
    if interval_s <= SLOW_SAMPLES_S or not delay_s[0] < 0.5 * interval_s < delay_s[1]:
        return ""
    return (
        f" Half a sampling interval is {0.5 * interval_s:.2g} s: so late is a torque that is held "
        "between samples, whatever the drive does; record faster to tell the two apart."
    )


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
        ends = ends_of(entry, parameter.name, half, problem)
        if parameter.closed:
            ends = [max(ends[0], parameter.lower), min(ends[1], parameter.upper)]
        result[parameter.name] = {"value": value, "unit": parameter.unit, "ci95": ends}
    return result


def _confidence(gain: float, least: float, rivals: Sequence[tuple[str, float]]) -> float:
    """How sure the name is: how far above the gate, and how far above the next best name."""
    detected = max(1.0 - 0.4 * float(np.exp(-(gain / least - 1.0))), 0.0)
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


def unknown(left: Leftover) -> dict[str, Any]:
    """What no effect of the catalogue explains, with its curve."""
    signal, _, direction = left.signal.partition("|")
    moving = {"right": " while turning in positive direction", "left": " in negative direction"}
    size = max((abs(torque) for _, torque, _ in left.curve), default=0.0)
    part = left.share * (1.0 + left.excess) / left.excess
    over = f"{signal}{moving.get(direction, '')}"
    if left.words:
        shape = left.words
    elif not left.curve or part < _FOLLOWS:
        shape = "a torque that follows no measured signal on its own (dynamic, or of two signals)"
        if left.curve:
            shape += f"; over {over} its mean is up to {size:.3g} Nm, {100 * part:.0f} % of it"
    else:
        shape = (
            f"a torque of up to {size:.3g} Nm at the rotor that follows {over}, strongest from "
            f"{left.low:.4g} to {left.high:.4g}"
        )
    return unknown_entry(
        f"The residual holds something that no effect of the catalogue explains: {shape}; "
        f"{100 * left.excess:.0f} % more energy than sensor noise.",
        round(min(SUREST, 1.0 - float(np.exp(-left.excess))), 3),
        [place(signal, left.low, left.high, left.share)],
        left.curve,
    )


def more_masses(findings: Sequence[Mapping[str, Any]], written: Model) -> list[str]:
    """Where something is unknown beside an elastic joint: that it may be a further mass."""
    if joint_of(written) is None or all(one["effect"] != "unknown" for one in findings):
        return []
    return [
        "The model is two masses with a joint. A rig of more, with road wheels that swing on their "
        "tie rods, leaves what no effect of the catalogue is; a multisine and eps-hil "
        "frequency-response --masses 2 --masses 5 show whether that is so."
    ]
