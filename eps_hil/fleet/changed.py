"""What has changed in one unit, as rows: each number before and after, with its 95 % interval.

A finding's parameters are of the state in which it was seen, against the other one: of what only
that state has, or of the difference. Here every number is told from the first state to the second.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from operator import add, mul, sub
from typing import Any

from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Probe

Content = Mapping[str, Any]
Ends = tuple[float | None, float | None]
NOTHING, UNDECIDED = "nothing", "undecided"
"""``change`` of a row without a finding: no difference, or an effect that one state alone shows."""
_NO_ENDS: Ends = (None, None)
_SAME = 1e-2
"""Of a number's step: a parameter that gives it within this is what has moved it."""
_NEAR = 0.2
"""Of an effect's size: a parameter that comes as near to what ``size_after`` says made it so."""

Makes = Callable[[float, float], float]
"""How a parameter makes a number of the state that was looked at out of the other's."""


def rows_of(content: Content) -> list[dict[str, Any]]:
    """A row for each number of each change; one for what has none, and where nothing has changed.

    Of the JSON of ``eps-hil changes``. ``change``: what a finding's ``change.is`` says, or
    ``nothing``, or ``undecided``. ``before`` and ``after``: the number of the first and of the
    second state in units ``si``, None where it is not known; their ``_low`` and ``_high``: the end
    points of the 95 % interval, of the state that the finding is of. ``size_after``: times what it
    was. ``holdout_gain``: share of the hold-outs' mean square residual that goes with the changes.
    """
    gain = content["fit"].get("improvement", {}).get("torque_residual") or {}
    low, high = _ends(gain.get("ci95"))
    common = {
        "seen_in": content["seen_in"],
        "holdout_gain": gain.get("share"), "holdout_gain_low": low, "holdout_gain_high": high,
    }  # fmt: skip
    rows = []
    for one in content["findings"]:
        head = {
            "change": one["change"]["is"],
            "effect": one["effect"],
            "confidence": one["confidence"],
            "size_after": one["change"]["size_after"],
            "confusable_with": ", ".join(one.get("confusable_with", ())),
        }
        numbers = _numbers(one, content["seen_in"]) or [_number("", "")]
        rows += [{**head, **number, **common} for number in numbers]
    bare = {"confidence": None, "size_after": None, "confusable_with": ""}
    rows += [
        {"change": UNDECIDED, "effect": name, **bare, **_number("", ""), **common}
        for name in content["undecided"]
    ]
    if not rows:
        rows = [{"change": NOTHING, "effect": "", **bare, **_number("", ""), **common}]
    return rows


def values_of(
    content: Content, rows: Sequence[Mapping[str, Any]]
) -> list[tuple[str, float, str, Ends]]:
    """For the population, quantity, value, unit and interval: each change's confidence and steps
    (second state less first), and what the second state's hold-outs leave.
    """
    found: list[tuple[str, float, str, Ends]] = [
        (one["effect"], one["confidence"], "confidence", _NO_ENDS) for one in content["findings"]
    ]
    for row in rows:
        if row["before"] is None or row["after"] is None:
            continue
        ends = (_less(row["after_low"], row["before"]), _less(row["after_high"], row["before"]))
        if ends == _NO_ENDS:
            ends = (_less(row["after"], row["before_high"]), _less(row["after"], row["before_low"]))
        step = row["after"] - row["before"]
        found.append((f"{row['effect']}.{row['parameter']}", step, row["si"], ends))
    holdout = content["fit"]["holdout"]
    for figures, name in (("baseline", "as_before"), ("augmented", "with_changes")):
        left = holdout.get(figures, {}).get("torque_nrmse")
        if left is not None:
            found.append((f"torque_nrmse_{name}", left, "", _NO_ENDS))
    return found


def _numbers(finding: Mapping[str, Any], seen_in: str) -> list[dict[str, Any]]:
    """Numbers of the rig that the change moves; else the effect's own parameters."""
    change, effect = finding["change"], finding["effect"]
    parameters = {
        name: one
        for name, one in finding.get("parameters", {}).items()
        if isinstance(one.get("value"), int | float)
    }
    if change["numbers"]:
        return [_moved(one, parameters, effect, seen_in) for one in change["numbers"]]
    return [
        _amount(finding, name, one, seen_in) if name == _amount_of(effect)
        else _shape(name, one, change, seen_in)
        for name, one in parameters.items()
    ]  # fmt: skip


def _moved(
    number: Mapping[str, Any], parameters: Mapping[str, Any], effect: str, seen_in: str
) -> dict[str, Any]:
    """A number that both states have. Its interval is the parameter's, where that makes it."""
    base, told = number[_other(seen_in)], number[seen_in]
    ends = _NO_ENDS
    name = number["name"] if number["name"] in parameters else _amount_of(effect)
    one = parameters.get(name or "", {})
    if one.get("ci95"):
        whole = (_itself,) if name == number["name"] else ()
        for makes in (*whole, mul, _share, add, sub):
            if abs(makes(base, one["value"]) - told) <= _SAME * abs(told - base):
                ends = _through(makes, base, one["ci95"])
                break
    row = _number(number["name"], number["unit"])
    return row | {"before": number["before"], "after": number["after"]} | _of(seen_in, ends)


def _amount(
    finding: Mapping[str, Any], name: str, one: Mapping[str, Any], seen_in: str
) -> dict[str, Any]:
    """How much there is of an effect."""
    row, probe = _number(name, one.get("unit", "")), _probe_of(finding["effect"])
    if finding["change"]["is"] in ("new", "gone"):
        none = 0.0 if probe is None else probe.neutral
        return row | _come_or_gone(finding["change"]["is"], none, one, seen_in)
    turns = probe is not None and probe.phase is not None
    return row | _sized(name, one, finding["change"], seen_in, turns=turns)


def _come_or_gone(is_: str, none: float, one: Mapping[str, Any], seen_in: str) -> dict[str, Any]:
    """An effect that one state has; ``none``: its amount where it is not."""
    value, ci95, known = one["value"], _ends(one.get("ci95")), _other(seen_in)
    if is_ == {"after": "new", "before": "gone"}[seen_in]:  # in the state that was looked at
        return {known: _finite(none), seen_in: value} | _of(seen_in, ci95)
    if none != 0.0:
        return {}
    # what was found takes back what the other state has
    return {seen_in: 0.0, known: -value} | _of(known, _through(sub, 0.0, ci95))


def _sized(
    name: str, one: Mapping[str, Any], change: Mapping[str, Any], seen_in: str, *, turns: bool
) -> dict[str, Any]:
    """An effect that both states have. ``turns``: with a phase, so that amounts do not add up."""
    size, had = change["size_after"], [entry.get(name) for entry in change["before"]]
    if not had or (turns and len(had) > 1) or not all(isinstance(x, int | float) for x in had):
        return {}
    before = math.fsum(had)
    if size is None:
        return {"before": before}
    told = {"before": before, "after": before * size}
    base, far, value = told[_other(seen_in)], told[seen_in], one["value"]
    ways = (_itself, add, sub) if turns else (_itself, add)
    makes = min(ways, key=lambda way: abs(way(base, value) - far))
    if abs(makes(base, value) - far) > _NEAR * max(abs(base), abs(far)):
        return told
    ends = _through(makes, base, _ends(one.get("ci95")))
    return told | {seen_in: makes(base, value)} | _of(seen_in, ends)


def _shape(
    name: str, one: Mapping[str, Any], change: Mapping[str, Any], seen_in: str
) -> dict[str, Any]:
    """Where or how an effect acts: no amount, which would be none without it."""
    row = _number(name, one.get("unit", ""))
    if change["is"] in ("new", "gone"):
        has = "after" if change["is"] == "new" else "before"
        return row | {has: one["value"]} | _of(has, _ends(one.get("ci95")))
    had = {entry.get(name) for entry in change["before"]}
    (only,) = had if len(had) == 1 else (None,)
    return row | {"before": only if isinstance(only, int | float) else None}


def _amount_of(effect: str) -> str | None:
    """The parameter that says how much there is of an effect; None where none does.

    Of one that no probe looks for (a gap, a drift): its only one.
    """
    known = catalogue().get(effect)
    if known is None:
        return None
    if known.probe is not None:
        return known.probe.amplitude
    names = [one.name for one in known.parameters]
    return names[0] if len(names) == 1 else None


def _probe_of(effect: str) -> Probe | None:
    known = catalogue().get(effect)
    return None if known is None else known.probe


def _number(name: str, si: str) -> dict[str, Any]:
    states = {
        f"{state}{end}": None for state in ("before", "after") for end in ("", "_low", "_high")
    }
    return {"parameter": name, **states, "si": si}


def _of(state: str, ends: Ends) -> dict[str, float | None]:
    return {f"{state}_low": ends[0], f"{state}_high": ends[1]}


def _itself(_base: float, value: float) -> float:
    return value


def _share(base: float, value: float) -> float:
    return base * (1.0 + value)


def _through(makes: Makes, base: float, ci95: Sequence[float | None]) -> Ends:
    low, high = (None if end is None else makes(base, end) for end in ci95)
    turned = makes(base, 1.0) < makes(base, 0.0)
    return (high, low) if turned else (low, high)


def _ends(ci95: Sequence[float | None] | None) -> Ends:
    low, high = ci95 or _NO_ENDS
    return low, high


def _less(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else one - other


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _other(state: str) -> str:
    return "before" if state == "after" else "after"
