"""Cases hold what their answers say, at the strength that they say, and give nothing away."""

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from eps_hil.proof import manoeuvres
from eps_hil.proof.cases import Case, make
from eps_hil.proof.effects import ALIENS, CATALOGUED, drawn_sign, find
from eps_hil.proof.model_file import model_yaml
from eps_hil.proof.plans import DECOYS, KINDS, LEVELS, Plan, plans
from eps_hil.proof.seal import open_answers
from eps_hil.proof.sensors import SENSORS
from eps_hil.proof.strength import strength
from eps_hil.proof.truth import Drive, Hidden, one_mass
from eps_hil.proof.world import World
from eps_hil.proof.write import main

ROOT = Path(__file__).parents[2]
COLUMNS = {
    "time_s",
    "motor_torque_nm",
    "torque_sensor_nm",
    "motor_speed_rad_s",
    "motor_angle_rad",
    "rack_force_n",
    "rack_position_m",
}


def test_a_single_has_the_strength_that_it_was_to_have(stribeck_case: Case) -> None:
    (told,) = stribeck_case.answer["effects"]
    assert told["effect"] == "stribeck"
    assert told["effect_to_noise"] == pytest.approx(0.6, rel=0.06)
    assert told["reached"]
    assert stribeck_case.answer["total_to_noise"] == pytest.approx(0.6, rel=0.1)


def test_a_decoy_holds_nothing(decoy_case: Case) -> None:
    assert decoy_case.answer["effects"] == []
    assert decoy_case.answer["total_to_noise"] < 0.1


def test_recordings_are_canonical_and_long_enough(stribeck_case: Case) -> None:
    train = [stribeck_case.recordings[name] for name in ("train_1", "train_2")]
    assert 60 <= sum(float(one["time_s"][-1]) for one in train) <= 95
    for one in stribeck_case.recordings.values():
        assert set(one) == COLUMNS
        assert np.diff(one["time_s"]).max() == pytest.approx(1e-3)
        assert all(np.isfinite(column).all() for column in one.values())


def test_training_and_holdout_are_different_drives(stribeck_case: Case) -> None:
    for a, b in itertools.combinations(stribeck_case.recordings.values(), 2):
        n = min(len(a["rack_force_n"]), len(b["rack_force_n"]))
        assert abs(np.corrcoef(a["rack_force_n"][:n], b["rack_force_n"][:n])[0, 1]) < 0.9


def test_values_lie_on_the_steps_of_the_bus(decoy_case: Case) -> None:
    for name in COLUMNS - {"time_s"}:
        steps = decoy_case.recordings["train_1"][name] / SENSORS[name].step
        assert np.abs(steps - np.round(steps)).max() < 0.02


def test_speed_and_torque_are_as_late_as_the_model_file_says(decoy_case: Case) -> None:
    """The position is prompt: the angle must be its image, 4 ms later."""
    one = decoy_case.recordings["train_1"]
    image = one["rack_position_m"] * Drive().rack_rad_per_m
    errors = [
        float(np.std(one["motor_angle_rad"][lag:] - image[: len(image) - lag])) for lag in range(8)
    ]
    assert int(np.argmin(errors)) == 4


NOISE_NM = 5e-3


@pytest.fixture(scope="module")
def drive_of_all() -> tuple[np.ndarray, dict[str, Any]]:
    """A drive that shows every effect, and the generator's state behind it."""
    rng = np.random.default_rng(3)
    parts = [manoeuvres.weave(rng, 5.0), manoeuvres.dwell(rng, 6.0), manoeuvres.sweep(rng, 6.0)]
    program = np.concatenate([*parts, manoeuvres.constant_speed(rng, 6.0)])
    return program, dict(rng.bit_generator.state)


def test_nothing_hidden_is_not_seen(drive_of_all: tuple[np.ndarray, dict[str, Any]]) -> None:
    bare = _clean(World(True), drive_of_all[0])
    assert strength(Drive(), [bare], NOISE_NM).raw_ratio < 0.2


@pytest.mark.parametrize("name", [*CATALOGUED, *ALIENS])
def test_every_effect_can_be_seen_in_the_torque_balance(
    drive_of_all: tuple[np.ndarray, dict[str, Any]], name: str
) -> None:
    """At a strength worth the name, each changes what the nominal model leaves over."""
    (program, state), effect, rng = drive_of_all, find(name), np.random.default_rng(3)
    rng.bit_generator.state = state
    value = drawn_sign(effect, rng) * min(4 * effect.start, effect.limit)
    seen = _clean(effect.apply(World(True), value, effect.draw(rng)), program)
    assert strength(Drive(), [seen], NOISE_NM).raw_ratio > 0.5


def _clean(world: World, program: np.ndarray) -> dict[str, np.ndarray]:
    from eps_hil.proof.sensors import reported

    return reported(world.run(program), world.instruments)


def test_effects_are_those_of_the_contract() -> None:
    text = (ROOT / "docs" / "reference-effects.md").read_text()
    catalogue = set(re.findall(r"^\*\*.+\*\* `(\w+)`:", text, re.MULTILINE))
    assert set(CATALOGUED) <= catalogue
    assert catalogue - set(CATALOGUED) == {"clock_drift", "dropped_frames", "empirical"}
    assert not set(ALIENS) & catalogue


def test_nothing_is_hidden_by_default() -> None:
    assert model_yaml(Drive()) == model_yaml(World(True).drive)
    program = manoeuvres.weave(np.random.default_rng(1), 2.0)
    truth = World(True).run(program)
    same = World(True, hidden=Hidden()).run(program)
    assert np.array_equal(truth["motor_speed_rad_s"], same["motor_speed_rad_s"])
    assert one_mass(Drive()).inertia.sum() == pytest.approx(2.0e-4)


def test_the_model_file_is_the_reference_rig() -> None:
    reference = yaml.safe_load((ROOT / "configs" / "reference_rig.yaml").read_text())
    assert yaml.safe_load(model_yaml(Drive())) == reference


@pytest.mark.parametrize("kind", KINDS)
def test_plans_are_reproducible_and_proof_never_meets_development(kind: str) -> None:
    again = [list(plans(kind, 3, 12)) for _ in range(2)]
    assert again[0] == again[1]
    development = {plan.seed for seed in range(1, 50) for plan in plans(kind, seed, 60)}
    proof = {plan.seed for seed in range(1, 50) for plan in plans(kind, seed, 60, proof=True)}
    assert not development & proof


def test_each_effect_comes_at_each_level() -> None:
    n = len(CATALOGUED)
    met = {plan.wanted[0] for plan in plans("singles", 1, 3 * n)}
    assert met == set(itertools.product(CATALOGUED, LEVELS))
    assert {plan.decoy for plan in plans("decoys", 1, 20)} == set(DECOYS)


def test_pairs_mask_a_weak_effect_with_a_stranger_five_times_as_strong() -> None:
    for plan in plans("pairs", 1, 40):
        (strong, much), (weak, little) = plan.wanted
        assert much == pytest.approx(5 * little)
        assert not find(strong).free  # a refit of the baseline would unmask the weak one
        assert strong not in find(weak).twins
        assert weak not in find(strong).twins


@pytest.mark.slow
def test_a_case_can_be_made_again() -> None:
    plan = Plan("poor", 4, (), decoy="noise_x3", simple=True, programme="poor")
    one, again = make(plan), make(plan)
    assert again.answer == one.answer
    for name, columns in again.recordings.items():
        for signal, values in columns.items():
            assert np.array_equal(values, one.recordings[name][signal])


def test_the_written_folder_gives_nothing_away(
    decoy_case: Case,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Plan] = []

    def made(plan: Plan) -> Case:
        asked.append(plan)
        return decoy_case

    monkeypatch.setattr("eps_hil.proof.write.make", made)
    out = tmp_path / "cases"
    arguments = [str(out), "--kind", "decoys", "--seed", "2", "--count", "1", "--simple"]
    assert main(arguments) == 0
    assert asked == list(plans("decoys", 2, 1, simple=True))
    said = capsys.readouterr().out
    cases = open_answers(out / "answers.json")
    assert len(cases) == 1
    assert (out / "answers.json.sha256").read_text().strip() in said
    for id in cases:
        files = {path.name for path in (out / id).iterdir()}
        assert files == {"train_1.csv", "train_2.csv", "holdout.csv", "model.yaml"}
        assert (out / id / "model.yaml").read_text() == model_yaml(Drive())
        header = (out / id / "train_1.csv").read_text().splitlines()[0]
        assert set(header.split(",")) == COLUMNS
    assert main(arguments) == 2


@pytest.mark.slow
def test_a_holdout_shows_what_it_is_to_judge() -> None:
    case = make(Plan("singles", 5017, (("end_stop", 0.6),), simple=True))
    (told,) = case.answer["effects"]
    reach = np.abs(case.recordings["holdout"]["rack_position_m"]).max()
    assert reach > told["parameters"]["position_m"]
    assert case.answer["holdout_to_noise"] > 0.1


@pytest.mark.slow
def test_a_stop_is_met_in_the_recordings_that_are_to_show_it() -> None:
    """Seen on a development seed: a stop placed on the simple plant, which the full one missed."""
    case = make(Plan("singles", 105019, (("end_stop", 0.6),)))
    (told,) = case.answer["effects"]
    stop = told["parameters"]["position_m"]
    farthest = [
        np.abs(case.recordings[one]["rack_position_m"]).max() for one in ("train_1", "train_2")
    ]
    assert max(farthest) > stop
    assert told["effect_to_noise"] == pytest.approx(0.6, rel=0.1)


@pytest.mark.slow
def test_a_loop_that_runs_away_is_no_case() -> None:
    """A torque 20 ms late would drive the rotor out of its controller's hands."""
    late = [one for one in plans("poor", 73, 27) if one.wanted[0][0] == "motor_torque_delay"]
    case = make(late[0])
    for columns in case.recordings.values():
        assert np.max(np.abs(columns["motor_speed_rad_s"])) < 1e3
    (told,) = case.answer["effects"]
    assert told["parameters"]["delay_s"] < 0.015
    assert not told["reached"]
    assert told["effect_to_noise"] < 0.5
