"""Experiments keep what the configuration allows, whatever it allows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.investigate.experiment import TICK_S, Experiment, Kind, menu, start_m, within
from eps_hil.physics.model import load_model
from eps_hil.programme.limits import Limits, load_limits

MODEL = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")


@pytest.mark.parametrize(
    "limits",
    [
        Limits(),
        Limits(rack_travel_m=0.01, speed_rad_s=15.0, load_n=500.0),
        Limits(load_n=0.0, acceleration_rad_s2=20.0),
        Limits(load_rate_n_per_s=500.0),
    ],
)
def test_every_course_keeps_travel_speed_load_and_their_rates(limits: Limits) -> None:
    experiments = menu(limits, MODEL)
    assert {Kind.PASSES, Kind.SINE, Kind.RESTS} <= {one.kind for one in experiments}
    for one in experiments:
        speed, load = one.course(limits)
        way = start_m(one, limits, MODEL) + np.cumsum(speed) * TICK_S / 2513.0
        assert np.max(np.abs(way)) <= limits.rack_travel_m
        assert np.max(np.abs(speed)) <= limits.speed_rad_s
        assert np.max(np.abs(np.diff(speed))) <= limits.acceleration_rad_s2 * TICK_S + 1e-9
        assert np.max(np.abs(load)) <= limits.load_n
        assert np.max(np.abs(np.diff(load))) <= limits.load_rate_n_per_s * TICK_S + 1e-9
        assert speed[0] == load[0] == 0.0
        assert abs(load[-1]) < 1e-9


def test_names_of_experiments_are_names_of_files_and_of_one_each() -> None:
    names = [one.name for one in menu(Limits(), MODEL)]
    assert len(set(names)) == len(names)
    assert all(set(name) <= set("abcdefghijklmnopqrstuvwxyzN0123456789_.-HZz/") for name in names)
    assert not any("/" in name for name in names)


def test_a_course_beyond_the_travel_is_none() -> None:
    far = Experiment(Kind.SINE, 40.0, frequency_hz=0.01)
    assert not within(far, Limits(), MODEL)
    assert within(replace(far, frequency_hz=0.5), Limits(), MODEL)


def test_limits_come_from_the_configuration(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("bus: {}\ninvestigate: {speed_rad_s: 12.5, load_n: 0}\n")
    assert load_limits(path) == Limits(speed_rad_s=12.5, load_n=0.0)
    path.write_text("bus: {}\n")
    assert load_limits(path) == Limits()
    path.write_text("investigate: {speed_rad_s: 500}\n")
    with pytest.raises(InputError, match=r"investigate\.speed_rad_s"):
        load_limits(path)
    path.write_text("investigate: {speed: 5}\n")
    with pytest.raises(InputError, match="is not a known field"):
        load_limits(path)
