"""Findings as the contract's JSON has them."""

import json

import pytest

from eps_hil.diagnosis.data.entry import around, known, place, unknown

KEYS = {
    "effect",
    "kind",
    "confidence",
    "equation",
    "summary",
    "parameters",
    "where",
    "confusable_with",
    "next_experiment",
}
"""CONTRACT 7."""


def test_a_known_effect_brings_its_kind_equation_and_units() -> None:
    one = known("clock_drift", "It drifts.", {"ppm": around(80.0, 3.0)}, 0.9, "here", signal="x")
    assert one.keys() >= KEYS
    assert one["kind"] == "instrument"
    assert one["parameters"] == {"ppm": {"value": 80.0, "unit": "1e-6", "ci95": [77.0, 83.0]}}
    assert one["signal"] == "x"
    assert json.loads(json.dumps(one)) == one
    assert "signal" not in known("clock_drift", "", {}, 0.9, "here")


def test_what_is_unknown_has_a_curve_and_a_place() -> None:
    where = place("rack_position_m", -0.01, 0.02, 0.4)
    one = unknown("Something.", 0.95, [where], [(0.0, 1.0, 0.1)], seen_in="kinematics")
    assert one.keys() >= KEYS
    assert (one["effect"], one["kind"]) == ("unknown", "structure")
    assert one["where"] == [where]
    assert one["curve"] == [[0.0, 1.0, 0.1]]
    assert "seen_in" not in unknown("Something.", 0.95, [])


def test_an_effect_or_a_number_of_another_name_is_a_mistake() -> None:
    with pytest.raises(KeyError):
        known("clockdrift", "", {}, 0.9, "here")
    with pytest.raises(KeyError):
        known("clock_drift", "", {"gain": (1.0, 1.0, 1.0)}, 0.9, "here")
