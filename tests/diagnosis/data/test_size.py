"""How large a machine is, and what that makes of thresholds, bounds and starting shapes."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from eps_hil.diagnosis.balance.probes import bounds, probe_step, shapes_of
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.data.size import ORDINARY, Size, size_of
from eps_hil.diagnosis.direct.rotor_and_rack import least_compliance
from eps_hil.physics.effects.catalogue import catalogue, values_of
from eps_hil.physics.model import Model


@pytest.fixture(scope="module")
def one(record: Callable[..., Any]) -> Prepared:
    ((name, series),) = record({}, ("weave",), seconds=10.0).items()
    return prepare(name, series)


def behind(one: Prepared, gear: float) -> Prepared:
    factor = {"motor_torque_nm": 1 / gear, "motor_speed_rad_s": gear, "motor_angle_rad": gear}
    raw = {name: factor.get(name, 1.0) * values for name, values in one.raw.items()}
    return one.changed(raw=raw)


def test_a_steering_drive_is_of_ordinary_size(one: Prepared, reference_model: Model) -> None:
    assert size_of([one], reference_model) == ORDINARY


def test_a_gear_is_a_size(one: Prepared, reference_model: Model) -> None:
    ratio = reference_model.rack_to_rotor_ratio_rad_per_m
    near, far = (
        size_of(
            [behind(one, gear)],
            replace(reference_model, rack_to_rotor_ratio_rad_per_m=gear * ratio),
        )
        for gear in (20.0, 400.0)
    )
    assert far.angle == pytest.approx(20.0 * near.angle)
    assert far.torque == pytest.approx(near.torque / 20.0)
    assert far.place == near.place == 1.0
    assert far.power == pytest.approx(near.power)


def test_bounds_shapes_and_steps_go_with_it(one: Prepared, reference_model: Model) -> None:
    size = Size(angle=20.0, torque=0.05, place=3.0)
    plain, other = (Problem([one.changed(size=of)], reference_model) for of in (ORDINARY, size))
    stribeck, spring = (catalogue()[name] for name in ("stribeck", "unmodelled_spring"))
    stiffness, _ = spring.parameters
    assert bounds(spring, stiffness, plain) == (-0.1, 0.1)
    assert bounds(spring, stiffness, other) == pytest.approx((-0.00025, 0.00025))
    assert probe_step(spring, other) == pytest.approx(probe_step(spring, plain) * 0.05 / 20.0)
    assert [shape["speed_rad_s"] for shape in shapes_of(stribeck, other)] == pytest.approx(
        [20.0 * shape["speed_rad_s"] for shape in shapes_of(stribeck, plain)]
    )
    phase = next(p for p in catalogue()["cogging_torque"].parameters if p.name == "phase_rad")
    assert size.of(phase, catalogue()["cogging_torque"]) == 1.0
    (offset,) = catalogue()["torque_sensor_offset"].parameters
    assert size.of(offset, catalogue()["torque_sensor_offset"]) == pytest.approx(1.0)


def test_a_model_file_may_be_of_any_machine(reference_model: Model) -> None:
    for entry in (
        {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 40.0},
        {"effect": "cogging_torque", "amplitude_nm": 12.0, "order": 300.0, "phase_rad": 0.0},
        {"effect": "end_stop", "position_m": 1.4, "stiffness_n_per_m": 1e5},
    ):
        values = values_of(entry, reference_model)[1]
        assert {**values, **entry} == {"effect": entry["effect"], **values}
    with pytest.raises(ValueError, match="expected 0 rad or more"):
        values_of({"effect": "backlash", "gap_rad": -1.0}, reference_model)


def test_a_belt_is_stiff_beside_the_inertia_behind_it(reference_model: Model) -> None:
    heavy = replace(reference_model, inertia_kg_m2=100.0 * reference_model.inertia_kg_m2)
    assert least_compliance(heavy) == pytest.approx(least_compliance(reference_model) / 100.0)
