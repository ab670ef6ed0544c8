"""A calibration in the model file: only two numbers change, the history grows, reset leads back."""

import re
from pathlib import Path

import pytest
import yaml

from eps_hil.adaptation.unknown_force import Shift
from eps_hil.errors import EpsHilError, InputError
from eps_hil.physics.model import load_model
from eps_hil.service.calibrated_model import CalibratedModel, Levels, widened

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "configs" / "reference_rig.yaml"
NEW = Levels(0.06, 0.12, (0.059, 0.061), (0.118, 0.122))


def written(path: Path, text: str) -> CalibratedModel:
    path.write_text(text)
    return CalibratedModel(path)


def test_only_the_levels_change_and_the_history_says_why(tmp_path: Path) -> None:
    out = tmp_path / "m.yaml"
    text = CalibratedModel(REFERENCE).calibrated(NEW, {"method": "torque_injection"})
    old_lines, lines = REFERENCE.read_text().splitlines(), text.splitlines()
    changed = [k for k, line in enumerate(old_lines) if lines[k] != line]
    assert len(changed) == 2, "comments and all else as they were"
    model = written(out, text)
    assert model.present == Levels(0.06, 0.12)
    assert load_model(out).friction.offset_pos_nm == 0.06
    (entry,) = model.history
    assert entry["before"] == {"offset_pos_nm": 0.056, "offset_neg_nm": 0.1258}
    assert entry["after"]["pos_ci95_nm"] == [0.059, 0.061]
    assert entry["method"] == "torque_injection"


def test_a_second_one_and_the_way_back(tmp_path: Path) -> None:
    first = CalibratedModel(REFERENCE).calibrated(NEW, {"method": "a"})
    model = written(tmp_path / "m.yaml", first)
    model = written(tmp_path / "m.yaml", model.calibrated(Levels(0.07, 0.13), {"method": "b"}))
    assert [entry["method"] for entry in model.history] == ["a", "b"]
    assert model.history[1]["before"] == {"offset_pos_nm": 0.06, "offset_neg_nm": 0.12}
    model = written(tmp_path / "m.yaml", model.reset({"method": "reset"}))
    assert model.present == Levels(0.056, 0.1258)
    assert [entry["method"] for entry in model.history] == ["a", "b", "reset"]
    assert yaml.safe_load((tmp_path / "m.yaml").read_text())["model"]["inertia_kg_m2"] == 2.0e-4


@pytest.mark.parametrize("flow", [False, True])
def test_what_stands_after_the_history_stays(tmp_path: Path, flow: bool) -> None:
    first = yaml.safe_load(CalibratedModel(REFERENCE).calibrated(NEW, {"method": "a"}))
    history = yaml.safe_dump(first["calibrations"], default_flow_style=flow, width=999)
    block = f"calibrations: {history}" if flow else f"calibrations:\n{history}"
    tail = "\n# what the plant says\nplant:\n  name: north   # of two\n"
    model = written(tmp_path / "m.yaml", REFERENCE.read_text() + block + tail)
    text = model.calibrated(Levels(0.07, 0.13), {"method": "b"})
    assert tail in text
    assert text.count("calibrations:") == 1
    again = written(tmp_path / "m.yaml", text)
    assert [entry["method"] for entry in again.history] == ["a", "b"]


def test_calibrations_of_the_output_are_not_lost(tmp_path: Path) -> None:
    """The configuration still named the first model: yesterday's calibration was replaced."""
    out, source = tmp_path / "m.yaml", CalibratedModel(REFERENCE)
    source.try_writing(out)
    first = written(out, source.calibrated(NEW, {"method": "a"}))
    with pytest.raises(InputError, match=r"m\.yaml: calibrations: holds calibrations that .* not"):
        source.try_writing(out)
    first.try_writing(out)
    out.write_text(REFERENCE.read_text())
    first.try_writing(out)


def test_nothing_to_reset() -> None:
    with pytest.raises(InputError, match="no calibration that could be reset"):
        CalibratedModel(REFERENCE).reset({})


@pytest.mark.parametrize(
    ("levels", "within"),
    [
        (Levels(0.0559 * 1.5, 0.1258), True),
        (Levels(0.0561 * 1.5, 0.1258), False),
        (Levels(0.056, 0.1258 * 0.49), False),
        (Levels(0.056, 0.1258 * 0.51), True),
        (Levels(float("nan"), 0.1258), False),
    ],
)
def test_the_sanity_band(levels: Levels, within: bool) -> None:
    model = CalibratedModel(REFERENCE)
    assert model.check(levels, 0.5, insist=True) is within
    if within:
        assert model.check(levels, 0.5)
    else:
        with pytest.raises(EpsHilError, match="more than 50% from the last accepted"):
            model.check(levels, 0.5)


def test_a_file_that_cannot_be_changed_line_by_line_is_refused(tmp_path: Path) -> None:
    text = REFERENCE.read_text()
    content = yaml.safe_load(text)
    path = tmp_path / "m.yaml"
    path.write_text(yaml.safe_dump(content, default_flow_style=True))
    with pytest.raises(InputError, match="not on one line of its own"):
        CalibratedModel(path).calibrated(NEW, {})


def test_levels_that_moved_apart_are_told_as_a_force() -> None:
    model = CalibratedModel(REFERENCE)
    apart = Levels(0.072, 0.1101)
    assert model.unknown_force_n(apart, 2513.0) == pytest.approx(40.0, abs=1.0)
    assert model.unknown_force_n(Levels(0.07, 0.157), 2513.0) == 0.0, "25 % more both ways"
    seen = model.unknown_force_n(apart, 2513.0, Shift(0.015, 0.001))
    assert seen == pytest.approx(40.0, abs=1.0), "presliding saw it too"
    assert model.unknown_force_n(apart, 2513.0, Shift(0.001, 0.001)) == 0.0, "it saw none"


def test_an_interval_is_widened_to_what_the_level_would_be_without_the_force() -> None:
    wide = widened(Levels(0.072, 0.110, (0.071, 0.073), (0.109, 0.111)), 0.016)
    assert wide.pos_ci95_nm == pytest.approx((0.055, 0.073))
    assert wide.neg_ci95_nm == pytest.approx((0.109, 0.127))


@pytest.mark.parametrize(
    "effect",
    [
        "{effect: coulomb_level, scale: 1.4}",
        "{effect: friction_asymmetry, half_difference_nm: 0.02}",
    ],
)
def test_levels_are_written_so_that_the_models_effects_make_what_was_measured(
    tmp_path: Path, effect: str
) -> None:
    """A rig that is as its model: a calibration finds what is in use, and changes nothing."""
    text = re.sub("^  effects:.*$", f"  effects: [{effect}]", REFERENCE.read_text(), flags=re.M)
    model = written(tmp_path / "m.yaml", text)
    used = model.in_use
    assert used != model.present
    pos, neg = used.offset_pos_nm, used.offset_neg_nm
    measured = Levels(1.1 * pos, neg, (pos, 1.2 * pos))
    assert model.check(measured, 0.5)
    assert model.unknown_force_n(used, 2513.0) == 0.0
    after = written(tmp_path / "m.yaml", model.calibrated(measured, {"method": "a"}))
    assert after.in_use.offset_pos_nm == pytest.approx(1.1 * pos, rel=1e-5)
    assert after.in_use.offset_neg_nm == pytest.approx(neg, rel=1e-5)
    low, high = after.history[0]["after"]["pos_ci95_nm"]
    assert low == pytest.approx(model.present.offset_pos_nm, rel=1e-5)
    assert low < after.present.offset_pos_nm < high
