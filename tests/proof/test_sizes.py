"""A machine of another size obeys the same equations with its own numbers."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from eps_hil.physics.model import load_model
from eps_hil.proof.cases import make
from eps_hil.proof.model_file import model_yaml
from eps_hil.proof.plans import Plan
from eps_hil.proof.sensors import SENSORS
from eps_hil.proof.sizes import SIZES, Size
from eps_hil.proof.strength import residual
from eps_hil.proof.truth import Drive, Floats
from eps_hil.proof.write import write_case

OTHER = Size(torque=3.0, angle=0.25, travel=7.0)


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("motor_torque_nm", 3.0),
        ("motor_speed_rad_s", 0.25),
        ("rack_position_m", 7.0),
        ("rack_force_n", 3.0 * 0.25 / 7.0),
        ("torque_sensor_nm", 3.0 * 0.25),
        ("steering_wheel_angle_rad", 1.0),
        ("time_s", 1.0),
        ("inertia_kg_m2", 3.0 / 0.25),
        ("rack_to_rotor_ratio_rad_per_m", 0.25 / 7.0),
        ("pinion_ratio_rad_per_m", 1.0 / 7.0),
        ("load_pos_nm_per_n", 3.0 / (3.0 * 0.25 / 7.0)),
        ("coefficient_nm_s2_per_rad2", 3.0 / 0.25**2),
        ("curvature_per_nm2", 1.0 / 9.0),
        ("phase_rad", 1.0),
        ("order", 4.0),
        ("delay_s", 1.0),
        ("scale", 1.0),
    ],
)
def test_a_number_is_scaled_by_its_unit(name: str, factor: float) -> None:
    assert OTHER.factor(name) == pytest.approx(factor)


def _recording() -> dict[str, Floats]:
    t = np.arange(2000) * 1e-3
    rng = np.random.default_rng(3)
    swing = {name: 10 * s.rms * np.sin(7 * t + rng.uniform(0, 6)) for name, s in SENSORS.items()}
    return {"time_s": t, **swing}


@pytest.mark.parametrize("size", [OTHER, *SIZES.values()])
def test_the_torque_balance_of_the_other_machine_is_the_same_times_its_torque(size: Size) -> None:
    columns = _recording()
    model = yaml.safe_load(model_yaml(Drive(), (), size))["model"]
    friction = model["friction"]
    laws = [
        friction[f"{what}_{way}_{unit}"]
        for what, unit in (("offset", "nm"), ("viscous", "nm_s_per_rad"), ("load", "nm_per_n"))
        for way in ("pos", "neg")
    ]
    ratios = ("pinion_ratio_rad_per_m", "rack_to_rotor_ratio_rad_per_m")
    body = [model[name] for name in ("inertia_kg_m2", *ratios, "belt_ratio", "pole_pairs")]
    bristle = ("sigma0_nm_per_rad", "sigma1_nm_s_per_rad", "sigma1_speed_rad_s")
    drive = Drive._make([*body, *laws, *(friction[name] for name in bristle)])
    other = residual(drive, size.columns(columns))
    assert np.allclose(other, size.torque * residual(Drive(), columns), rtol=1e-9, atol=1e-12)


def test_nothing_is_another_machine_without_a_size() -> None:
    columns = _recording()
    assert all(np.array_equal(SIZES[""].columns(columns)[name], columns[name]) for name in columns)
    assert model_yaml(Drive(), (), SIZES[""]) == model_yaml(Drive())


@pytest.mark.slow
def test_a_case_of_a_joint_is_written_with_the_digits_that_it_needs(tmp_path: Path) -> None:
    plan = Plan("sizes", 5, (("backlash", 1.5),), simple=True, size="joint", every=2)
    case = make(plan)
    write_case(tmp_path / "one", case)
    model = load_model(tmp_path / "one" / "model.yaml")
    assert model.rack_to_rotor_ratio_rad_per_m == pytest.approx(1.0)
    told = np.genfromtxt(tmp_path / "one" / "holdout.csv", delimiter=",", names=True)
    truth = case.recordings["holdout"]
    assert np.diff(told["time_s"]).max() == pytest.approx(2e-3)
    assert len(truth["time_s"]) == len(told)
    assert len(case.force_n) == 2 * len(told)  # of every millisecond, whatever is recorded
    for name, sensor in SENSORS.items():
        if name in truth:
            step = sensor.step * SIZES["joint"].factor(name)
            assert np.abs(told[name] - truth[name]).max() <= step
    # the gap is told as the rotor's angle, which is the joint's
    (effect,) = case.answer["effects"]
    twist = truth["motor_angle_rad"] - truth["rack_position_m"]
    assert 0.5 * effect["parameters"]["gap_rad"] < np.ptp(twist)
