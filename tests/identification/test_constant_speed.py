"""Friction read off constant-speed passes: eq. 1d in the mean, eq. 3 by least squares, the map."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.identification.constant_speed import (
    Cell,
    cells_of,
    enough,
    fitted,
    measured_map,
    reading,
)
from eps_hil.physics.chain import HAND_ANGLE, INPUTS, LOAD_FORCE
from eps_hil.physics.friction import friction_law, static_level_nm
from eps_hil.physics.model import load_model

MODEL = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")


class TestReading:
    def columns(self, friction_nm: float, acceleration: float = 0.0) -> dict[str, np.ndarray]:
        """One second of eq. 1d, solved for the motor torque, at 20 rad/s and 1500 N."""
        time_s = np.arange(1000) / 1000.0
        sensor, force = 0.8 + 0.1 * np.sin(2 * np.pi * 10 * time_s), np.full(1000, 1500.0)
        torque = (
            friction_nm
            + force / MODEL.rack_to_rotor_ratio_rad_per_m
            + MODEL.inertia_kg_m2 * acceleration
            - MODEL.sensor_to_rotor * sensor
        )
        return {
            "motor_torque_nm": torque,
            "torque_sensor_nm": sensor,
            "motor_speed_rad_s": 20.0 + acceleration * (time_s - 0.4995),
            "rack_force_n": force,
        }

    @pytest.mark.parametrize("acceleration", [0.0, 5.0, -50.0])
    def test_eq_1d_solved_for_the_friction(self, acceleration: float) -> None:
        one = reading(20.0, 1500.0, self.columns(0.139, acceleration), 0.999, MODEL)
        assert one.friction_nm == pytest.approx(0.139, abs=1e-9)
        assert one.speed_rad_s == pytest.approx(20.0)
        assert one.load_n == 1500.0

    def test_signals_may_have_rates_of_their_own(self) -> None:
        columns = self.columns(0.139)
        columns["rack_force_n"] = columns["rack_force_n"][::10]
        one = reading(20.0, 1500.0, columns, 0.999, MODEL)
        assert one.friction_nm == pytest.approx(0.139, abs=1e-9)

    def test_the_inertia_is_the_one_with_effects(self) -> None:
        heavy = replace(MODEL, effects=({"effect": "inertia", "scale": 2.0},))
        columns = self.columns(0.139, 50.0)
        columns["motor_torque_nm"] = columns["motor_torque_nm"] + 2e-4 * 50.0
        assert reading(20.0, 1500.0, columns, 0.999, heavy).friction_nm == pytest.approx(0.139)

    def test_passes_are_cut_by_the_set_points(self) -> None:
        """Two passes, 2 s each, with a second between them; only what is settled counts."""
        rate = np.concatenate([np.zeros(500), np.full(2000, 1.0), np.zeros(1000),
                               np.full(2000, -1.0), np.zeros(500)])  # fmt: skip
        table = np.zeros((len(rate) + 1, INPUTS))
        table[:, HAND_ANGLE] = np.concatenate([[0.0], np.cumsum(rate)]) / 1000.0
        table[:, LOAD_FORCE] = 700.0
        ratio = MODEL.rack_to_rotor_ratio_rad_per_m / MODEL.pinion_ratio_rad_per_m
        time_s = np.arange(len(rate)) / 1000.0
        columns = {
            "time_s": time_s,
            "motor_torque_nm": 0.1 * np.sign(rate) + 700.0 / MODEL.rack_to_rotor_ratio_rad_per_m,
            "torque_sensor_nm": np.zeros(len(rate)),
            "motor_speed_rad_s": rate * ratio,
            "rack_force_n": np.full(len(rate), 700.0),
        }
        found = cells_of(columns, table, MODEL, 0.5)
        assert [round(cell.set_speed_rad_s, 2) for cell in found] == [19.99, -19.99]
        assert [cell.friction_nm for cell in found] == pytest.approx([0.1, -0.1])
        assert cells_of(columns, table, MODEL, 1.9) == []


class TestFrictionCells:
    LAW = friction_law(MODEL.friction)

    def cells(self, scatter: float = 0.0) -> list[Cell]:
        random = np.random.default_rng(1)
        return [
            Cell(speed, load, speed, load,
                 math.copysign(static_level_nm(speed, load, self.LAW), speed)
                 + scatter * random.standard_normal())
            for speed in (-40.0, -10.0, -2.0, 2.0, 10.0, 40.0)
            for load in (0.0, 1000.0, 3000.0)
            for _ in range(4)
        ]  # fmt: skip

    def test_eq_3_comes_back(self) -> None:
        friction, widths = fitted(self.cells(), MODEL.friction)
        for name in widths:
            assert getattr(friction, name) == pytest.approx(getattr(MODEL.friction, name))

    def test_friction_that_falls_with_speed_keeps_its_level(self) -> None:
        """The slope was cut to zero, and the offset stayed at what it is with the slope."""
        speeds = [cell.speed_rad_s for cell in self.cells()]
        falling = [
            replace(cell, friction_nm=math.copysign(0.1 - 1e-3 * abs(speed), speed))
            for cell, speed in zip(self.cells(), speeds, strict=True)
        ]
        friction, _ = fitted(falling, MODEL.friction)
        mean = float(np.mean([abs(cell.friction_nm) for cell in falling]))
        assert friction.viscous_pos_nm_s_per_rad == friction.viscous_neg_nm_s_per_rad == 0.0
        assert friction.offset_pos_nm == pytest.approx(mean)
        assert friction.offset_neg_nm == pytest.approx(mean)

    def test_three_cells_have_no_error_of_their_own(self) -> None:
        """They fit exactly: the half width was 2e-15 Nm; two on a diagonal ended in a traceback."""
        forth = [cell for cell in self.cells(1e-3)[::4] if cell.speed_rad_s > 2.0]
        assert enough(forth)
        assert not enough([forth[k] for k in (0, 1, 3)])
        assert not enough([forth[0], forth[4]])
        assert not enough([forth[0], forth[4]] * 4)
        assert enough([forth[k] for k in (0, 1, 3, 4)])

    def test_intervals_grow_with_scatter(self) -> None:
        friction, widths = fitted(self.cells(1e-3), MODEL.friction)
        for name, width in widths.items():
            away = getattr(friction, name) - getattr(MODEL.friction, name)
            assert 0.0 < abs(away) < 2.0 * width

    def test_the_map_interpolates_and_ends_where_it_was_measured(self) -> None:
        found = measured_map(self.cells())
        speed = np.array([20.0, -20.0, 400.0, 2.0])
        load = np.array([500.0, 500.0, -1000.0, 9000.0])
        at = [(20.0, 500.0), (-20.0, 500.0), (40.0, 1000.0), (2.0, 3000.0)]
        want = [static_level_nm(v, f, self.LAW) for v, f in at]
        assert found.level(speed, load) == pytest.approx(want)
