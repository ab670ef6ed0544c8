"""A change of a number that the model has as well is told by the whole number."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest

from eps_hil.diagnosis.in_numbers import (
    Moved,
    anew,
    in_words,
    moved,
    ratio,
    shift_in_words,
    shifted,
)
from eps_hil.physics.model import Model

Entries = Sequence[Mapping[str, Any]]


def entry(effect: str, **values: float) -> dict[str, Any]:
    return {"effect": effect, **values}


def told(model: Model, first: Entries, second: Entries) -> list[Moved]:
    there, here = (replace(model, effects=tuple(one)) for one in (first, second))
    return moved(str(second[0]["effect"]), there, here, second[len(first) :] or second)


def test_a_level_below_the_files_that_rises_is_higher(reference_model: Model) -> None:
    """0.8 times the file's, then 1.1 times that: less is off, and the friction is higher."""
    first = [entry("coulomb_level", scale=0.8)]
    found = told(reference_model, first, [*first, entry("coulomb_level", scale=1.1)])
    assert ratio(found) == pytest.approx(1.1)
    assert [one.name for one in found] == ["offset_pos_nm", "offset_neg_nm"]
    assert found[0].first == pytest.approx(0.8 * reference_model.friction.offset_pos_nm)
    assert found[0].second == pytest.approx(0.88 * reference_model.friction.offset_pos_nm)
    assert {one.unit for one in found} == {"Nm"}


@pytest.mark.parametrize("part", [-0.4, 0.4])
def test_drag_is_counted_with_the_models_own(part: float, reference_model: Model) -> None:
    """A drag for each direction: what is added to both is no factor of both."""
    name, friction = "coefficient_nm_s_per_rad", reference_model.friction
    own = friction.viscous_pos_nm_s_per_rad, friction.viscous_neg_nm_s_per_rad
    first = part * min(own)
    had = [entry("viscous_friction", **{name: first})]
    found = told(reference_model, had, [*had, entry("viscous_friction", **{name: 1e-4})])
    assert [one.name for one in found] == ["viscous_pos_nm_s_per_rad", "viscous_neg_nm_s_per_rad"]
    assert [one.first for one in found] == pytest.approx([one + first for one in own])
    assert [one.second for one in found] == pytest.approx([one + first + 1e-4 for one in own])
    assert {one.unit for one in found} == {"Nm s/rad"}
    assert ratio(found) is None


def test_an_effect_that_both_have_once_is_told_by_its_own_numbers() -> None:
    first, second = (
        [entry("belt_compliance", stiffness_nm_per_rad=value)] for value in (40.0, 15.0)
    )
    (found,) = anew("belt_compliance", first, second)
    assert (found.name, found.first, found.second) == ("stiffness_nm_per_rad", 40.0, 15.0)
    assert anew("belt_compliance", first, [*second, *second]) == []
    assert anew("unknown", first, second) == []


def test_gains_act_one_after_the_other(reference_model: Model) -> None:
    first = [entry("motor_torque_gain", gain=0.95)]
    (found,) = told(reference_model, first, [*first, entry("motor_torque_gain", gain=1.02)])
    assert [found.first, found.second] == pytest.approx([0.95, 0.969])
    assert ratio([found]) == pytest.approx(1.02)
    assert in_words([found.content()]) == "gain 0.95 → 0.969"


def test_a_delay_that_comes_has_no_ratio_and_one_that_grows_has(reference_model: Model) -> None:
    bare = replace(reference_model, delays_s=replace(reference_model.delays_s, motor_speed=0.0))
    late = entry("speed_sensor_delay", delay_s=2e-3)
    (came,) = told(bare, [], [late])
    assert ratio([came]) is None
    assert in_words([came.content()]) == "delays_s.motor_speed 0 → 0.002 s"
    (grew,) = told(bare, [late], [late, entry("speed_sensor_delay", delay_s=1e-3)])
    assert ratio([grew]) == pytest.approx(1.5)


def test_an_asymmetry_moves_two_levels_apart(reference_model: Model) -> None:
    found = told(reference_model, [], [entry("friction_asymmetry", half_difference_nm=0.01)])
    up, down = (one.second - one.first for one in found)
    assert [up, down] == pytest.approx([0.01, -0.01])
    assert ratio(found) is None


def test_what_the_model_has_no_number_for_has_none(reference_model: Model) -> None:
    stribeck = entry("stribeck", level_nm=0.03, speed_rad_s=5.0)
    assert told(reference_model, [], [stribeck]) == []
    curve = entry("position_torque") | {"curve": [[-0.05, 0.01], [0.05, 0.0]]}
    assert told(reference_model, [curve], [curve]) == []
    assert moved("unknown", reference_model, reference_model, [{"effect": "empirical"}]) == []
    assert ratio([]) is None


def cogging(amplitude_nm: float, phase_rad: float, order: float = 24.0) -> dict[str, Any]:
    name, values = "cogging_torque", {"amplitude_nm": amplitude_nm, "phase_rad": phase_rad}
    return entry(name, **values, order=order)


def test_a_ripple_that_begins_elsewhere_is_shifted() -> None:
    """The difference of two sines of 0.01 Nm, 1 rad apart, is one of 2·0.01·sin(0.5) Nm."""
    other, had = cogging(0.02, 0.1, 12.0), cogging(0.01, 0.3)
    difference = cogging(0.02 * math.sin(0.5), 0.3 + 0.5 + math.pi / 2)
    amplitude, phase = shifted("cogging_torque", [had, other], [had, other, difference])
    assert (amplitude.name, phase.name) == ("amplitude_nm", "phase_rad")
    assert [amplitude.first, amplitude.second] == pytest.approx([0.01, 0.01])
    assert [phase.first, phase.second] == pytest.approx([0.3, 1.3])


@pytest.mark.parametrize(
    ("name", "first", "second"),
    [
        ("cogging_torque", [cogging(0.01, 0.3)], [cogging(0.013, 1.3)]),  # stronger, too
        ("cogging_torque", [cogging(0.01, 0.3)], [cogging(0.01, 1.3, 12.0)]),  # another order
        ("cogging_torque", [], [cogging(0.01, 1.3)]),
        ("stribeck", [entry("stribeck")], [entry("stribeck")]),
        ("unknown", [entry("unknown")], [entry("unknown")]),
    ],
)
def test_only_a_ripple_of_one_order_and_strength_is(
    name: str, first: Entries, second: Entries
) -> None:
    assert shifted(name, first, second) == []


def test_a_shift_is_said_as_an_angle_of_the_rotor() -> None:
    """From 3.1 to -3.0 rad is on by 0.18, and sin(order·φ + phase) begins earlier."""
    numbers = [
        {"name": "amplitude_nm", "before": 0.05, "after": 0.0493, "unit": "Nm"},
        {"name": "phase_rad", "before": 3.1, "after": -3.0, "unit": "rad"},
    ]
    said = shift_in_words("cogging_torque", numbers, 12.0)
    assert "as strong as in the first state (0.0493 Nm) begins earlier" in said
    assert "moved by 0.183 rad, which is 0.875° of the rotor" in said
    numbers[1]["after"] = 3.0
    said = shift_in_words("screw_ripple", numbers, None)
    assert "begins later: its phase has moved by 0.1 rad." in said
