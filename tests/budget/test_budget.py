"""The error budget against closed forms, and its inputs as people write them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.budget.budget import AGREES, PHASES, World, _scores, advice, budget, content
from eps_hil.budget.simulated import simulated_world
from eps_hil.budget.sources import Group, Samples, Source, recorded, wrong_model
from eps_hil.budget.uncertainty import Uncertainty, load_uncertainty, sources
from eps_hil.errors import InputError
from eps_hil.estimation.phases import phases
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import Model
from eps_hil.rig.manoeuvre import load_manoeuvre

ROOT = Path(__file__).parents[2]
MANOEUVRE = """
manoeuvre:
  name: short
  description: four seconds of a fast sine
  segments:
    - duration_s: 4.0
      rack_force_n: {sine: {amplitude: 800.0, frequency_hz: 1.5, fade_s: 0.5}}
      driver: hands_off
      motor: {stiffness_nm_per_rad: 0.03, damping_nm_s_per_rad: 1.0e-3}
"""


@pytest.fixture(scope="module")
def manoeuvre(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("budget") / "short.yaml"
    path.write_text(MANOEUVRE, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def frictionless(reference_model: Model, manoeuvre: Path) -> World:
    """A rig without friction, and an estimator that knows it: everything is linear."""
    f = reference_model.friction
    nothing = dict.fromkeys(("offset_pos_nm", "offset_neg_nm", "load_pos_nm_per_n"), 0.0)
    nothing |= dict.fromkeys(("load_neg_nm_per_n", "sigma1_nm_s_per_rad"), 0.0)
    nothing |= dict.fromkeys(("viscous_pos_nm_s_per_rad", "viscous_neg_nm_s_per_rad"), 0.0)
    model = replace(reference_model, friction=replace(f, **nothing))
    settings = EstimatorSettings(friction_compensation=False, dead_zone=False, limiter=False)
    chain = load_chain(ROOT / "configs" / "reference_chain.yaml")
    return simulated_world(model, settings, chain, load_manoeuvre(manoeuvre), order=1)


def test_a_torque_offset_costs_its_force_at_the_rack(frictionless: World) -> None:
    """F̂ = i_APA (T + δ − J dω/dt): an offset of 5 mNm is 5e-3 · 2513 N, in every phase."""
    source = Source("offset.motor_torque_nm", Group.SCALE, 5e-3, "Nm")
    found = budget(frictionless, [source], draws=4)
    for phase in ("moving", "reversal"):
        assert found.sources[0].alone_n[phase] == pytest.approx(5e-3 * 2513.0, rel=1e-3)


def test_a_wrong_inertia_costs_its_share_of_the_inertial_force(frictionless: World) -> None:
    """Error = i_APA · δJ · dω/dt, taken from the truth at 1 kHz."""
    source = Source("inertia_kg_m2", Group.INERTIA, 1e-5, "kg m2")
    found = budget(frictionless, [source], draws=4)
    acceleration = np.gradient(frictionless.speed_rad_s, 1e-3)
    part = phases(frictionless.speed_rad_s).moving & (frictionless.clean.time_s > 0.5)
    expected = 2513.0 * 1e-5 * np.sqrt(np.mean(acceleration[part] ** 2))
    assert found.sources[0].alone_n["moving"] == pytest.approx(expected, rel=0.05)


def test_where_all_is_linear_the_squares_add_up(frictionless: World) -> None:
    some = [
        Source("offset.motor_torque_nm", Group.SCALE, 5e-3, "Nm"),
        Source("gain.motor_torque_nm", Group.SCALE, 0.02, "1"),
        Source("inertia_kg_m2", Group.INERTIA, 6e-6, "kg m2"),
        Source("delay.motor_speed", Group.DELAYS, 5e-4, "s"),
        Source("noise.motor_speed_rad_s", Group.NOISE, 0.25, "rad/s", random=True),
    ]
    found = budget(frictionless, some, draws=12)
    assert found.root_sum_n["moving"] == pytest.approx(found.total_n["moving"], rel=AGREES)
    assert not found.interacts("moving")
    scale = next(line for line in found.groups if line.name == Group.SCALE.value)
    assert scale.gain_n is not None
    expected = found.total_n["moving"] - np.sqrt(
        max(found.total_n["moving"] ** 2 - scale.alone_n["moving"] ** 2, 0.0)
    )
    assert scale.gain_n["moving"] == pytest.approx(expected, rel=0.3, abs=0.5)


def test_draws_cover_each_source_evenly() -> None:
    scores = _scores(7, 24, 3)
    assert scores.shape == (24, 7)
    assert np.mean(scores**2, axis=0) == pytest.approx(np.ones(7))
    assert np.mean(scores, axis=0) == pytest.approx(np.zeros(7), abs=1e-12)
    assert np.max(np.abs(np.corrcoef(scores.T) - np.eye(7))) < 0.6


@pytest.mark.slow
def test_the_real_thing_ranks_and_advises(reference_model: Model, manoeuvre: Path) -> None:
    chain = load_chain(ROOT / "configs" / "reference_chain.yaml")
    world = simulated_world(reference_model, EstimatorSettings(), chain, load_manoeuvre(manoeuvre))
    todo = sources(reference_model, Uncertainty())
    found = budget(world, todo, draws=4)
    few = [json.dumps(content(budget(world, todo[:4], draws=4))) for _ in range(2)]
    assert few[0] == few[1]
    moving = [line.alone_n["moving"] for line in found.sources]
    assert moving == sorted(moving, reverse=True)
    assert sum(found.share.values()) == pytest.approx(1.0)
    assert found.method_n["moving"] < 15.0 < found.total_n["moving"] < 100.0
    sentences = advice(found)
    assert sentences[0].startswith("moving: ")
    assert all(any(phase in one for one in sentences) for phase in PHASES)


def test_phases_are_one_each() -> None:
    t = np.arange(4000) * 1e-3
    speed = 20 * np.sin(2 * np.pi * t)
    speed[t > 2.5] = 0.0
    parts = phases(speed)
    assert np.all(np.sum(parts, axis=0) == 1)
    assert np.all(parts.reversal[495:550])  # the turn at half a second
    assert np.all(parts.moving[200:300])
    assert np.all(parts.rest[2600:])


def test_recorded_samples_carry_the_errors() -> None:
    n = 2000
    column = np.sin(np.arange(n) * 0.01)
    clean = Samples(
        np.arange(n, dtype=np.float64) / 1e3,
        {"motor_torque_nm": column, "motor_speed_rad_s": column},
    )
    exact = recorded(clean, {}, {}, 0)
    assert np.array_equal(exact["motor_torque_nm"].value, column)
    late = recorded(clean, {"delay.motor_speed": 2e-3, "offset.motor_torque_nm": 0.5}, {}, 0)
    assert late["motor_speed_rad_s"].t_ns[5] == 7_000_000
    assert late["motor_torque_nm"].value == pytest.approx(column + 0.5)
    noisy = recorded(clean, {"noise.motor_torque_nm": 0.1}, {"motor_torque_nm": 0.01}, 0)
    assert len(noisy["motor_torque_nm"].value) == n // 10
    assert np.std(noisy["motor_torque_nm"].value - column[::10]) == pytest.approx(0.1, rel=0.2)
    shaken = recorded(clean, {"jitter.motor_torque_nm": 1e-3}, {}, 0)
    assert np.all(np.diff(shaken["motor_torque_nm"].t_ns) > 0)
    coarse = recorded(clean, {"step.motor_torque_nm": 0.25}, {}, 0)["motor_torque_nm"].value
    assert set(np.unique(coarse * 4 % 1)) == {0.0}


def test_no_number_of_a_model_becomes_impossible(reference_model: Model) -> None:
    wrong = wrong_model(reference_model, {"inertia_kg_m2": -1.0, "offset_pos_nm": 0.01, "x": 1.0})
    assert wrong.inertia_kg_m2 > 0
    assert wrong.friction.offset_pos_nm == pytest.approx(0.066)


def test_sizes_come_from_yaml_and_from_an_identification(
    reference_model: Model, tmp_path: Path
) -> None:
    yaml = tmp_path / "u.yaml"
    yaml.write_text(
        "uncertainty: {percent: {inertia_kg_m2: 10}, noise_rms: {motor_speed_rad_s: 0},"
        " jitter_s: 0}\n",
        encoding="utf-8",
    )
    by_name = {s.name: s for s in sources(reference_model, load_uncertainty(yaml, reference_model))}
    assert by_name["inertia_kg_m2"].size == pytest.approx(2e-5)
    assert "noise.motor_speed_rad_s" not in by_name
    assert not any(s.group is Group.SAMPLING for s in by_name.values())
    result = tmp_path / "identify.json"
    result.write_text(
        json.dumps(
            {
                "parameters": {"inertia_kg_m2": {"value": 2e-4, "ci95": [1.98e-4, 2.02e-4]}},
                "friction": [{"name": "offset_pos_nm", "value": 0.056, "ci95": [0.054, 0.058]}],
                "delays_s": {"motor_speed": {"value": 0.004, "ci95": [0.0039, 0.0041]}},
                "skews_s": {"motor_torque": {"value": 0.003, "ci95": [0.0, 0.1]}},
                "offsets": {"torque_sensor_offset_nm": {"value": 0.1, "ci95": [0.0902, 0.1098]}},
            }
        ),
        encoding="utf-8",
    )
    given = load_uncertainty(result, reference_model)
    assert given.model == pytest.approx(
        {"inertia_kg_m2": 2e-6 / 1.96, "offset_pos_nm": 2e-3 / 1.96}
    )
    assert given.delays_s == pytest.approx({"motor_speed": 1e-4 / 1.96})
    assert given.offsets == pytest.approx({"torque_sensor_nm": 5e-3})


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("u.yaml", "uncertainty: {percent: {inertia: 3}}\n", "inertia"),
        ("u.yaml", "uncertainty: {offsets: {rack_force_n: 3}}\n", "rack_force_n"),
        ("u.yaml", "uncertainty: {percent: {inertia_kg_m2: -3}}\n", "greater than or equal"),
        ("u.json", "{}", "ci95"),
        ("u.json", "{", "JSON"),
        ("u.json", '{"p": {"inertia_kg_m2": {"ci95": [null, 1]}}}', "p.inertia_kg_m2.ci95: "),
        ("u.json", '{"inertia_kg_m2": {"ci95": ["a", 1]}}', "is no interval"),
        ("u.json", '{"delays_s": {"motor_speed": {"ci95": [NaN, 1]}}}', "is no interval"),
        ("u.json", '{"inertia_kg_m2": {"ci95": [0, 1e999]}}', "is no interval"),
    ],
)
def test_wrong_sizes(
    reference_model: Model, tmp_path: Path, name: str, text: str, said: str
) -> None:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        load_uncertainty(path, reference_model)
