"""An effect that the second residual shows (``kinematics.py``), and its entry in the JSON."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.entry import around, known, place
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect

Floats = npt.NDArray[np.float64]

LEAST_GAIN = 60.0
"""Least gain (noise variances, on blocks not fitted) of an accepted effect…"""
LEAST_SHARE = 0.1
"""…and least share of what the residual holds above the noise."""


@dataclass(frozen=True)
class Seen:
    """One effect seen in the kinematics: its entry, half widths of 95 % intervals, its gain."""

    entry: dict[str, Any]
    half_width: Mapping[str, float]
    gain: float
    share: float
    where: tuple[tuple[str, float, float, float], ...]


def robust_cost(residual: Floats) -> float:
    """Sum of squares with far ones cut, as an angle that slips a turn would be."""
    return float(np.sum(robust_squares(residual)))


def robust_squares(residual: Floats) -> Floats:
    """The squares that :func:`robust_cost` adds up, (n,)."""
    at = max(5.0, 3.0 * 1.4826 * float(np.median(np.abs(residual))))
    return np.asarray(np.clip(residual, -at, at) ** 2)


def finding(seen: Seen) -> dict[str, Any]:
    """The JSON entry (CONTRACT 7) of an effect seen in the kinematics."""
    effect = catalogue()[seen.entry["effect"]]
    sentence, values = effect.wording({**_defaults(effect), **seen.entry})
    parameters = {
        one.name: around(seen.entry[one.name], seen.half_width.get(one.name, 0.0))
        for one in effect.parameters
        if one.name in seen.entry
    }
    return known(
        effect.id,
        sentence.format(**values),
        parameters,
        round(min(0.99, 1.0 - 0.4 * float(np.exp(1.0 - seen.gain / LEAST_GAIN))), 3),
        "kinematics",
        where=[place(s, low, high, seen.share) for s, low, high, _ in seen.where],
    )


def _defaults(effect: Effect) -> dict[str, Any]:
    return {p.name: p.default for p in effect.parameters if p.default is not None}
