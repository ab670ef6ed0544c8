"""Findings in the order of what they are worth, whichever evidence they rest on.

A gap is measured by rotor against rack, an offset by a sensor with nothing on it, a drag by the
torque balance. In common they have what hold-outs, as their files have them, would leave more of
the torque balance if the written model were without the one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.balance.problem import clipped, knee
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

UNKNOWN = "unknown"


def most_first(
    findings: Sequence[Mapping[str, Any]],
    holdouts: Sequence[Holdout],
    common: Model,
    written: Model,
) -> list[Mapping[str, Any]]:
    """The findings, those first without which ``holdouts`` would leave most; what is unknown last.

    ``common`` says which samples slide. What no model holds (lost frames) is worth nothing there;
    outliers, as at a stop that only a hold-out meets, count as the most that noise makes.
    """
    known = [one for one in findings if one["effect"] != UNKNOWN]
    if len(known) < 2:
        return list(findings)
    at = knee(_left(holdouts, common, written))

    def lost(name: str) -> float:
        return float(np.sum(clipped(_left(holdouts, common, _without(written, name)), at) ** 2))

    worth = {name: lost(name) for name in {str(one["effect"]) for one in known}}
    known.sort(key=lambda one: worth[str(one["effect"])], reverse=True)
    return [*known, *(one for one in findings if one["effect"] == UNKNOWN)]


def _without(model: Model, name: str) -> Model:
    return replace(model, effects=tuple(one for one in model.effects if one["effect"] != name))


def _left(holdouts: Sequence[Holdout], common: Model, model: Model) -> Floats:
    """What the balance leaves while sliding, in noise deviations under ``common``."""
    return np.concatenate(
        [
            one.prepared.left_over(model)[one.judging(common)] / one.prepared.floor_nm(common)
            for one in holdouts
        ]
    )
