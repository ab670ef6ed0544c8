"""Error injection: the integrators find both levels at zero load, and only then."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.adaptation.error_injection import (
    ErrorInjection,
    ErrorInjectionSettings,
    ErrorInjectionState,
)
from eps_hil.adaptation.gates import InjectionInputs
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import Delays, Model
from eps_hil.rig.manoeuvre import Driver, Manoeuvre, Motor, Segment
from eps_hil.rig.offline import simulate_recording
from eps_hil.rig.profile import Sine, _Profile

NOTHING = InjectionInputs(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def steered(model: Model, seconds: float = 30.0) -> list[InjectionInputs]:
    """A driver turns the wheel to and fro near the centre, with assist and no rack force."""
    segment = Segment(
        duration_s=seconds,
        driver=Driver(
            angle_rad=_Profile(sine=Sine(amplitude=0.15, frequency_hz=0.6, fade_s=0.5)),
            stiffness_nm_per_rad=30.0,
            damping_nm_s_per_rad=1.0,
        ),
        motor=Motor(assist_nm_per_nm=0.2, damping_nm_s_per_rad=5e-4),
    )
    chain = load_chain(Path(__file__).parents[2] / "configs" / "reference_chain.yaml")
    columns = simulate_recording(model, chain, Manoeuvre("steered", (segment,))).columns
    names = [name for name in InjectionInputs._fields if name != "rack_force_n"]
    table = np.column_stack([columns[name] for name in names]).tolist()
    return [InjectionInputs(**dict(zip(names, row, strict=True))) for row in table]


def run(injection: ErrorInjection, rows: list[InjectionInputs]) -> list[ErrorInjectionState]:
    return [injection.step(k * 1_000_000, row) for k, row in enumerate(rows)]


@pytest.fixture(scope="module")
def rows(reference_model: Model) -> list[InjectionInputs]:
    return steered(reference_model)


WIDE = ErrorInjectionSettings()


@pytest.mark.parametrize("factors", [(0.6, 1.4), (1.4, 0.6)])
@pytest.mark.slow
def test_both_levels_are_found(
    reference_model: Model,
    scaled_levels: Any,
    rows: list[InjectionInputs],
    factors: tuple[float, float],
) -> None:
    injection = ErrorInjection(WIDE, scaled_levels(reference_model, *factors))
    last = run(injection, rows)[-1]
    assert last.levels == pytest.approx((5.6e-2, 1.258e-1), rel=0.03)
    assert last.time_pos_s > 3.0
    assert last.time_neg_s > 3.0
    assert not last.at_limit


def test_an_integrator_runs_only_for_its_own_direction(
    reference_model: Model, scaled_levels: Any, rows: list[InjectionInputs]
) -> None:
    """Speed and bristle agree in sign, and only the integrator of that sign moves."""
    injection = ErrorInjection(WIDE, scaled_levels(reference_model, 0.6, 0.6))
    before = injection.levels
    directions = set()
    for k, row in enumerate(rows):
        state = injection.step(k * 1_000_000, row)
        directions.add(state.direction)
        if state.direction <= 0:
            assert state.levels.positive_nm == before.positive_nm
        if state.direction >= 0:
            assert state.levels.negative_nm == before.negative_nm
        before = state.levels
    assert directions == {-1, 0, 1}


@pytest.mark.parametrize(
    "spoil",
    [
        {"vehicle_speed_m_s": 30.0},
        {"vehicle_speed_m_s": math.nan},
        {"motor_speed_rad_s": math.nan},
        {"torque_sensor_nm": 2.0},
    ],
)
def test_closed_gates_and_bad_values_teach_nothing(
    reference_model: Model, scaled_levels: Any, rows: list[InjectionInputs], spoil: dict[str, float]
) -> None:
    injection = ErrorInjection(WIDE, scaled_levels(reference_model, 0.6, 0.6))
    before = injection.levels
    run(injection, [row._replace(**spoil) for row in rows[:5000]])
    assert injection.levels == before


def test_frozen_means_frozen(
    reference_model: Model, scaled_levels: Any, rows: list[InjectionInputs]
) -> None:
    injection = ErrorInjection(WIDE, scaled_levels(reference_model, 0.6, 0.6))
    injection.frozen = True
    before = injection.levels
    run(injection, rows[:5000])
    assert injection.levels == before
    injection.frozen = False
    run(injection, rows[:5000])
    assert injection.levels != before


def test_the_integrators_stay_within_their_limits(
    reference_model: Model, rows: list[InjectionInputs]
) -> None:
    injection = ErrorInjection(ErrorInjectionSettings(gain_per_s=50.0), reference_model)
    wild = [row._replace(motor_torque_nm=10.0 * row.motor_torque_nm) for row in rows[:8000]]
    last = run(injection, wild)[-1]
    assert last.at_limit
    f = reference_model.friction
    assert last.levels.positive_nm <= 3.0 * f.offset_pos_nm
    assert last.levels.negative_nm <= 3.0 * f.offset_neg_nm


def test_a_jump_of_time_is_no_acceleration(
    reference_model: Model, rows: list[InjectionInputs]
) -> None:
    injection = ErrorInjection(WIDE, reference_model)
    run(injection, rows[:3000])
    before = injection.levels
    state = injection.step(10**12, rows[3500])
    assert state.direction == 0
    assert injection.levels == before


def swung(model: Model, frequency_hz: float, seconds: float = 12.0) -> list[InjectionInputs]:
    """The rotor to and fro by 8 rad without any load; its torque by eq. 1 and 2, step by step."""
    f, dt, z, found = model.friction, 1e-3, 0.0, []
    rng = np.random.default_rng(2)
    way = 2.0 * math.pi * frequency_hz
    for k in range(round(seconds / dt)):
        angle, speed = 8.0 * math.sin(way * k * dt), 8.0 * way * math.cos(way * k * dt)
        forth = (f.offset_pos_nm, f.viscous_pos_nm_s_per_rad)
        back = (f.offset_neg_nm, f.viscous_neg_nm_s_per_rad)
        offset, viscous = forth if speed >= 0.0 else back
        level = offset + viscous * abs(speed)
        end = math.copysign(level / f.sigma0_nm_per_rad, speed)
        z = end + (z - end) * math.exp(-abs(speed) * f.sigma0_nm_per_rad * dt / level)
        torque = model.inertia_kg_m2 * -way * way * angle + f.sigma0_nm_per_rad * z
        noisy = torque + 4e-3 * rng.standard_normal(), speed + 0.25 * rng.standard_normal()
        place = angle / model.rack_to_rotor_ratio_rad_per_m
        found.append(InjectionInputs(*noisy, 0.0, angle, place, 0.0, 0.0, 0.0))
    return found


@pytest.mark.parametrize("frequency_hz", [0.5, 2.0])
def test_a_quick_motion_moves_no_level(reference_model: Model, frequency_hz: float) -> None:
    """The torque was not as late as the smoothed speed: both levels too low, by 41 % at 2 Hz."""
    at_once = replace(reference_model, delays_s=Delays())
    last = run(ErrorInjection(WIDE, at_once), swung(at_once, frequency_hz))[-1]
    assert last.time_pos_s > 3.0
    assert last.levels == pytest.approx((5.6e-2, 1.258e-1), rel=0.04)


def test_a_torsion_bar_that_is_lost_stops_the_integrators(reference_model: Model) -> None:
    """It was taken as no torque, and the driver's one became friction that is missing."""
    rows = swung(replace(reference_model, delays_s=Delays()), 1.0, 6.0)
    held = [row._replace(torque_sensor_nm=1.0) for row in rows]
    lost = [row._replace(torque_sensor_nm=math.nan) for row in rows]
    injection = ErrorInjection(WIDE, replace(reference_model, delays_s=Delays()))
    before = run(injection, held[:3000])[-1]
    for k, row in enumerate(lost[3000:], 3000):
        after = injection.step(k * 1_000_000, row)
    assert after.levels == pytest.approx(before.levels, abs=1e-3)
