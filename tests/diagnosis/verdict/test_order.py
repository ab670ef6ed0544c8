"""Findings stand in the order of what hold-outs lose without them."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.verdict.order import most_first
from eps_hil.physics.model import Model


@pytest.mark.parametrize("turned", [False, True])
def test_what_matters_most_is_first_whatever_found_it(
    fitted_and_kept: Callable[[Mapping[int, float]], tuple[Problem, list[Holdout]]],
    reference_model: Model,
    other_rig: ModuleType,
    turned: bool,
) -> None:
    _, kept = fitted_and_kept({other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0})
    entries: list[dict[str, Any]] = [
        {"effect": "motor_torque_offset", "offset_nm": 1e-4},
        {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 10.0},
    ]
    written = replace(reference_model, effects=tuple(entries))
    names = ["unknown", "sample_loss", "motor_torque_offset", "stribeck"]
    findings = [{"effect": one} for one in (names[::-1] if turned else names)]
    told = [one["effect"] for one in most_first(findings, kept, reference_model, written)]
    assert told[0] == "stribeck"
    assert told[-1] == "unknown"
    assert sorted(told) == sorted(names)


def test_one_finding_is_as_it_was(reference_model: Model) -> None:
    findings = [{"effect": "stribeck"}, {"effect": "unknown"}]
    assert most_first(findings, [], reference_model, reference_model) == findings
