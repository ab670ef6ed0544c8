"""One diagnosis (CONTRACT 7) against one opened answer: what was right, missed, or made up."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eps_hil.proof.effects import ALIENS
from eps_hil.proof.plans import UNMEASURED
from eps_hil.proof.truth import Drive

UNKNOWN = "unknown"
_TO_ROTOR = Drive().pinion_rad_per_m / Drive().rack_rad_per_m
UNNAMED_LOADS = ("scrub",)
"""Loads for which the catalogue has no name: who calls what they leave unknown is right."""
_CANCELLED = 0.1
_TO_90 = 1.644854 / 1.959964
_NEUTRAL = {"gain": 1.0, "scale": 1.0}
"""Values at which a parameter changes nothing; errors are taken relative to what lies beyond."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter of a rightly named effect: relative error, and whether ci95 holds the truth.

    ``covered_90``: the same of a 90 % interval, which is ci95 about its middle, 1.645/1.960 times
    as wide (as for a normal distribution).
    """

    effect: str
    parameter: str
    relative_error: float
    covered: bool | None
    covered_90: bool | None = None


@dataclass(frozen=True, slots=True)
class Judgement:
    """What a diagnosis of one case was worth.

    ``named``: hidden effects that are findings by their own name; ``in_set``: hidden effects in
    the reported set (findings and what they are confusable with); ``invented``: findings that are
    neither hidden, nor tolerated, nor say that they may be confused with something hidden, nor a
    known twin of it. ``stated``: (confidence, was it right) of each finding. ``naive_…``: what the
    methods of ``naive`` named in the same case. ``told_hidden``: hidden effects of which ``limits``
    says that a load hides them; ``group``: rate, size or load in the kinds that vary one of them.
    """

    id: str
    kind: str
    form: str
    decoy: str
    level: float
    truths: tuple[str, ...]
    answered: bool
    verdict: str
    first: str
    named: tuple[str, ...]
    in_set: tuple[str, ...]
    invented: tuple[str, ...]
    said_unknown: bool
    estimates: tuple[Estimate, ...]
    stated: tuple[tuple[float, bool], ...]
    naive_err: tuple[str, ...] = ()
    naive_stlsq: tuple[str, ...] = ()
    twin: str = ""
    twin_in_set: bool = False
    told_hidden: tuple[str, ...] = ()
    group: str = ""

    @property
    def right_first(self) -> bool:
        """Whether the first finding names what is hidden (of several: the one of ``level``)."""
        return bool(self.truths) and self.first == self.truths[-1]

    @property
    def clean(self) -> bool:
        """Nothing made up, nor an unknown effect claimed, but where the load is one."""
        unknown = self.said_unknown and self.group not in UNNAMED_LOADS
        return self.answered and not self.invented and not unknown

    @property
    def all_in_set(self) -> bool:
        """Whether everything hidden is in the reported set."""
        return set(self.in_set) == set(self.truths)


def failed(j: Judgement) -> bool:
    """Whether a case is not as it should be; what is asked depends on its kind.

    With hardly any excitation silence is right, and where it is said that a load hides the effect;
    of twins both names are.
    """
    if not j.answered or j.invented:
        return True
    if not j.truths:
        return not j.clean
    if j.kind in ("aliens", "missing", "nameless"):
        return not j.said_unknown
    if j.kind in ("pairs", "triples", "beside"):
        return not {one for one in j.truths if one not in ALIENS} <= set(j.named)
    if j.kind == "twins":
        return not (j.all_in_set and j.twin_in_set)
    silent = j.kind == "poor" or (j.kind in UNMEASURED and bool(j.told_hidden))
    return not (silent or j.right_first)


def judge(id: str, answer: Mapping[str, Any], diagnosis: Mapping[str, Any] | None) -> Judgement:
    """Judge one case; ``diagnosis`` None means that none was handed in, which is a miss."""
    hidden, concealment = answer["effects"], answer.get("concealment", {})
    truths = tuple(str(one["effect"]) for one in hidden)
    findings: Sequence[Mapping[str, Any]] = diagnosis.get("findings", []) if diagnosis else []
    limits: Sequence[str] = diagnosis.get("limits", []) if diagnosis else []
    declined = [re.findall(r"\w+(?=[\w, ]* cannot be told)", one) for one in limits]
    verdict = str(diagnosis.get("verdict", "")) if diagnosis else ""
    tolerated = {*answer["tolerated"], *_form_of_presliding(answer, findings)} - set(truths)
    counted = [one for one in findings if one["effect"] not in tolerated]
    named = [one for one in counted if one["effect"] != UNKNOWN]
    reported = {one["effect"] for one in findings}
    reported |= {other for one in findings for other in one.get("confusable_with", [])}
    twins = {twin for one in hidden for twin in one["twins"]}
    excused = set(truths) | twins
    invented = [
        str(one["effect"])
        for one in named
        if one["effect"] not in excused and not set(truths) & set(one.get("confusable_with", []))
    ]
    return Judgement(
        id=id,
        kind=str(answer["kind"]),
        form=str(answer["form"]),
        decoy=str(answer["decoy"]),
        level=float(hidden[-1]["wanted"]) if hidden else 0.0,
        truths=truths,
        answered=diagnosis is not None,
        verdict=verdict,
        first=str(named[0]["effect"]) if named else "",
        named=tuple(t for t in truths if any(one["effect"] == t for one in named)),
        in_set=tuple(t for t in truths if t in reported),
        invented=tuple(invented),
        said_unknown=verdict == "unknown_effect" or UNKNOWN in reported,
        estimates=tuple(_estimates(hidden, findings)),
        stated=tuple(
            (float(one["confidence"]), one["effect"] in truths)
            for one in named
            if one.get("confidence") is not None
        ),
        naive_err=tuple(concealment.get("naive_err", ())),
        naive_stlsq=tuple(concealment.get("naive_stlsq", ())),
        twin=str(answer.get("twin", "")),
        twin_in_set=answer.get("twin") in reported,
        told_hidden=tuple(t for t in truths if any(t in one for one in declined)),
        group=_group(answer),
    )


def _group(answer: Mapping[str, Any]) -> str:
    kind = answer["kind"]
    if kind == "rates":
        return f"{1000 // int(answer['every'])} Hz"
    return str(answer.get({"sizes": "size", "loads": "load"}.get(kind, ""), ""))


def _form_of_presliding(
    answer: Mapping[str, Any], findings: Sequence[Mapping[str, Any]]
) -> set[str]:
    """Names that say, together, how this plant reverses; neither right nor wrong on a full plant.

    Maxwell-slip elements with unequal limits f and −b are the same as elements with the limits
    ±(f + b)/2 and a constant (f − b)/2 beside them, in every history; LuGre's bristle with unequal
    levels is not. So a friction asymmetry and an offset that cancel while sliding are true of it.
    """
    if answer["form"] != "full":
        return set()
    asymmetry = _value(findings, "friction_asymmetry", "half_difference_nm")
    to_rotor = float(answer.get("pinion_per_rotor", _TO_ROTOR))
    offsets = {
        "motor_torque_offset": _value(findings, "motor_torque_offset", "offset_nm"),
        "torque_sensor_offset": -to_rotor * _value(findings, "torque_sensor_offset", "offset_nm"),
    }
    if asymmetry and abs(asymmetry - sum(offsets.values())) < _CANCELLED * abs(asymmetry):
        return {"friction_asymmetry", *(name for name, value in offsets.items() if value)}
    return set()


def _value(findings: Sequence[Mapping[str, Any]], effect: str, parameter: str) -> float:
    for one in findings:
        if one["effect"] == effect:
            return float(one.get("parameters", {}).get(parameter, {}).get("value", 0.0))
    return 0.0


def _estimates(
    hidden: Sequence[Mapping[str, Any]], findings: Sequence[Mapping[str, Any]]
) -> list[Estimate]:
    estimates = []
    for truth in hidden:
        found = next((one for one in findings if one["effect"] == truth["effect"]), None)
        if found is None:
            continue
        for name, true in truth["parameters"].items():
            stated = found.get("parameters", {}).get(name)
            if isinstance(stated, Mapping) and isinstance(stated.get("value"), int | float):
                estimates.append(_estimate(truth["effect"], name, float(true), stated))
    return estimates


def _estimate(effect: str, name: str, true: float, stated: Mapping[str, Any]) -> Estimate:
    value, interval = float(stated["value"]), stated.get("ci95")
    low, high = (float(interval[0]), float(interval[1])) if interval else (math.nan, math.nan)
    if name == "phase_rad":  # all that matters of a phase is where on the circle it is
        turns = 2 * math.pi * round((value - true) / (2 * math.pi))
        value, low, high = value - turns, low - turns, high - turns
        scale = math.pi
    else:
        neutral = 0.0 if effect == "rack_ratio" else _NEUTRAL.get(name, 0.0)
        scale = max(abs(true - neutral), 1e-12)
    error = (value - true) / scale
    if not interval:
        return Estimate(effect, name, error, None)
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * _TO_90
    in_90 = middle - half <= true <= middle + half
    return Estimate(effect, name, error, bool(low <= true <= high), bool(in_90))
