"""The model file: what it holds, what it refuses, and that it goes round."""

from pathlib import Path

import pytest

from eps_hil.errors import InputError
from eps_hil.physics.model import Delays, Model, dump_model, load_model

REFERENCE = Path(__file__).parents[2] / "configs" / "reference_rig.yaml"


def test_reference_rig_is_table_2() -> None:
    model = load_model(REFERENCE)
    assert model.friction.offset_pos_nm == 5.600e-2
    assert model.friction.load_neg_nm_per_n == 4.345e-5
    assert model.delays_s == Delays(motor_speed=0.004, motor_torque=0.001)
    assert model.sensor_to_rotor == pytest.approx(125.7 / 2513.0)


def test_goes_round(tmp_path: Path) -> None:
    model = load_model(REFERENCE)
    copy = tmp_path / "m.yaml"
    copy.write_text(dump_model(model), encoding="utf-8")
    assert load_model(copy) == model


def test_further_keys_may_stand_beside(tmp_path: Path) -> None:
    text = REFERENCE.read_text(encoding="utf-8")
    copy = tmp_path / "m.yaml"
    copy.write_text(text.replace("model:\n", "model:\n  rig_name: bench 3\n"), encoding="utf-8")
    assert load_model(copy) == load_model(REFERENCE)


def test_angle_is_as_late_as_the_speed_unless_told_otherwise() -> None:
    assert Delays(motor_speed=0.004).of("motor_angle_rad") == 0.004
    assert Delays(motor_speed=0.004, motor_angle=0.0).of("motor_angle_rad") == 0.0
    assert Delays().of("vehicle_speed_m_s") == 0.0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("inertia_kg_m2: 2.0e-4", "inertia_kg_m2: -1", ("line 4", "inertia_kg_m2", "greater")),
        ("inertia_kg_m2: 2.0e-4", "inertia_kg_m2: .nan", ("inertia_kg_m2", "finite")),
        ("inertia_kg_m2: 2.0e-4", "inertia_kg_m2: yes", ("line 4", "number", "true or false")),
        ("  pinion_ratio_rad_per_m: 125.7 ", "  # ", ("pinion_ratio_rad_per_m", "missing")),
        ("sigma0_nm_per_rad", "sigma_0", ("sigma_0", "not a known field")),
        ("motor_speed: 0.004", "motor_speed: soon", ("delays_s.motor_speed", "soon")),
        ("model:", "modell:", ("model", "section is missing")),
        ("effects: []", "effects: [", ("line", "YAML")),
        ("effects: []", "effects: [{effect: stribek}]", ("effects[0]", "mean 'stribeck'")),
        ("effects: []", "effects: [{effect: stribeck}]", ("stribeck needs level_nm",)),
    ],
)
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, said: tuple[str, ...]) -> None:
    text = REFERENCE.read_text(encoding="utf-8")
    assert old in text
    copy = tmp_path / "broken.yaml"
    copy.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_model(copy)
    message = str(caught.value)
    assert "\n" not in message
    assert "broken.yaml" in message
    for word in said:
        assert word in message


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"- 1\n- 2\n", b"just text"])
def test_what_is_no_model_file(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "m.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"m\.yaml"):
        load_model(path)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_model(tmp_path / "none.yaml")
    with pytest.raises(InputError, match="folder"):
        load_model(tmp_path)


def test_a_model_needs_only_what_it_cannot_guess() -> None:
    friction = load_model(REFERENCE).friction
    bare = Model(2e-4, 125.7, 2513.0, friction)
    assert bare.delays_s == Delays()
    assert bare.effects == ()


@pytest.mark.parametrize(
    ("beside", "said"),
    [
        ("effects: []", "effects: stands beside 'model:', where it has no effect; indent it below"),
        ("effect: []", "effect: stands beside 'model:', where it has no effect"),
        ("inertia_kg_m2: 1.0", "as inertia_kg_m2"),
    ],
)
def test_a_field_that_is_not_indented_is_refused(tmp_path: Path, beside: str, said: str) -> None:
    path = tmp_path / "m.yaml"
    text = REFERENCE.read_text()
    path.write_text(f"{text}{beside}\n")
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert said in str(caught.value)
    assert f"line {len(text.splitlines()) + 1}, " in str(caught.value)


def test_other_blocks_may_stand_beside_the_model(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    text = REFERENCE.read_text()
    path.write_text(f"{text}friction_map: []\nprovenance: {{by: me}}\n")
    assert load_model(path) == load_model(REFERENCE)


def test_a_misspelt_block_is_named(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text("modle:\n  inertia_kg_m2: 1.0\n")
    with pytest.raises(InputError, match=r"section is missing; rename 'modle:' to 'model:'"):
        load_model(path)
