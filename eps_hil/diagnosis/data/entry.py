"""A finding as the JSON has it (CONTRACT 7)."""

from collections.abc import Mapping, Sequence
from typing import Any

from eps_hil.physics.effects.catalogue import catalogue

Ends = tuple[float, float, float]
"""Value, and the ends of its 95 % interval."""


def known(
    effect: str,
    summary: str,
    parameters: Mapping[str, Ends],
    confidence: float,
    seen_in: str,
    *,
    where: Sequence[Mapping[str, Any]] = (),
    signal: str = "",
) -> dict[str, Any]:
    """An effect of the catalogue that something else than the balance shows; no name beside it.

    ``signal``: the one it is of, where the effect may be of several.
    """
    told = catalogue()[effect]
    units = {one.name: one.unit for one in told.parameters}
    return {
        "effect": told.id,
        "kind": str(told.kind),
        "confidence": confidence,
        "equation": told.equation,
        "summary": summary,
        "parameters": {
            name: {"value": value, "unit": units[name], "ci95": [low, high]}
            for name, (value, low, high) in parameters.items()
        },
        "where": [dict(one) for one in where],
        "confusable_with": [],
        "next_experiment": "",
        **({"signal": signal} if signal else {}),
        "seen_in": seen_in,
    }


def unknown(
    summary: str,
    confidence: float,
    where: Sequence[Mapping[str, Any]],
    curve: Sequence[Sequence[float]] = (),
    *,
    kind: str = "structure",
    seen_in: str = "",
) -> dict[str, Any]:
    """What no effect of the catalogue stands for."""
    return {
        "effect": "unknown",
        "kind": kind,
        "confidence": confidence,
        "equation": "",
        "summary": summary,
        "parameters": {},
        "where": [dict(one) for one in where],
        "curve": [list(point) for point in curve],
        "confusable_with": [],
        "next_experiment": "",
        **({"seen_in": seen_in} if seen_in else {}),
    }


def also(one: dict[str, Any], other: str, settle: str) -> None:
    """Say of a finding that it may be the effect ``other``, which the experiment ``settle`` tells.

    As likely as what it is called: half as sure.
    """
    if other in one["confusable_with"]:
        return
    one["confusable_with"] = [*one["confusable_with"], other]
    one["confidence"] = round(0.5 * float(one["confidence"]), 3)
    told = f"against {other}: {settle}"
    one["next_experiment"] = "; ".join(filter(None, [one["next_experiment"], told]))


def place(
    signal: str, low: float, high: float, share: float, time: float | None = None
) -> dict[str, Any]:
    """A stretch of a signal, the share of the mismatch's excess that is there, and of the time."""
    told = {"signal": signal, "from": low, "to": high, "share_of_excess": share}
    return told if time is None else {**told, "share_of_time": round(time, 4)}


def around(value: float, half: float) -> Ends:
    """A value with an interval that is as wide on both sides."""
    return value, value - half, value + half
