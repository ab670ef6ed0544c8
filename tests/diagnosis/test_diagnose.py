"""The diagnosis on rigs whose missing physics is known, written in code of their own."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.diagnosis.diagnose import Diagnosis, diagnose
from eps_hil.physics.effects.catalogue import values_of
from eps_hil.physics.model import Model, load_model

MODEL = str(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")

pytestmark = pytest.mark.slow


def run(
    record: Callable[..., Any], model: Model, plant: Mapping[int, float], **words: Any
) -> Diagnosis:
    kept = record(plant, ("weave",), seed=2, **words)
    return diagnose(model, record(plant, **words), kept)


def names(result: Diagnosis) -> list[str]:
    return [finding["effect"] for finding in result.content["findings"]]


def value(result: Diagnosis, parameter: str) -> float:
    found = result.content["findings"][0]["parameters"][parameter]["value"]
    assert isinstance(found, float)
    return found


def improves(result: Diagnosis) -> None:
    proof = result.content["fit"]["holdout"]
    assert proof["augmented"]["torque_nrmse"] < 1.15 * proof["noise_floor"]["torque_nrmse"]
    assert proof["augmented"]["torque_nrmse"] < proof["baseline"]["torque_nrmse"]
    assert proof["augmented"]["speed_fit_percent"] > proof["baseline"]["speed_fit_percent"]
    assert proof["augmented"]["rack_force_rmse_n"] < proof["baseline"]["rack_force_rmse_n"]


@pytest.mark.parametrize("noise", [1.0, 3.0])
def test_nothing_missing_is_no_mismatch(
    record: Callable[..., Any], reference_model: Model, noise: float
) -> None:
    result = run(record, reference_model, {}, noise=noise)
    assert result.content["verdict"] == "no_mismatch"
    assert result.content["findings"] == []
    assert result.model == reference_model


def test_stribeck(record: Callable[..., Any], reference_model: Model, other_rig: Any) -> None:
    result = run(record, reference_model, {other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0})
    assert result.content["verdict"] == "explained"
    assert names(result) == ["stribeck"]
    assert value(result, "level_nm") == pytest.approx(0.03, rel=0.15)
    assert value(result, "speed_rad_s") == pytest.approx(10.0, rel=0.15)
    improves(result)


def test_a_place_with_more_friction_is_located(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    plant = {other_rig.POSF: 0.03, other_rig.POSC: 0.002, other_rig.POSW: 0.003}
    result = run(record, reference_model, plant)
    assert names(result) == ["position_dependent_friction"]
    region = result.content["findings"][0]["where"][0]
    assert region["signal"] == "rack_position_m"
    assert -0.004 < region["from"] < 0.002 < region["to"] < 0.008
    assert region["share_of_excess"] > 0.8
    improves(result)


def test_a_weak_effect_under_a_strong_one(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    plant = {other_rig.VISC: 4e-4, other_rig.SCREW: 0.004, other_rig.SCREW_P: 0.5}
    result = run(record, reference_model, plant)
    assert set(names(result)) == {"viscous_friction", "screw_ripple"}
    assert names(result)[0] == "viscous_friction"


def test_a_wrong_parameter_is_a_parameter(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    result = run(record, reference_model, {other_rig.INERTIA: 2.2e-4})
    assert names(result) == ["inertia"]
    assert result.content["findings"][0]["kind"] == "parameter"
    assert value(result, "scale") == pytest.approx(1.1, rel=0.03)


def test_a_late_sensor_is_an_instrument(record: Callable[..., Any], reference_model: Model) -> None:
    result = run(record, reference_model, {}, speed_late_s=2e-3)
    assert names(result) == ["speed_sensor_delay"]
    assert value(result, "delay_s") == pytest.approx(2e-3, rel=0.15)


def test_twins_are_named_with_what_would_tell_them_apart(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    result = run(record, reference_model, {other_rig.EM_OFF: 0.01})
    finding = result.content["findings"][0]
    family = {"motor_torque_offset", "torque_sensor_offset", "friction_asymmetry"}
    assert {finding["effect"], *finding["confusable_with"]} == family
    assert finding["confidence"] < 0.6
    assert finding["next_experiment"]


def test_the_same_recordings_give_the_same_words(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    plant = {other_rig.QUAD: 3e-6}
    first, second = (run(record, reference_model, plant).content for _ in range(2))
    assert json.dumps(first) == json.dumps(second)


def test_from_files_to_a_better_rack_force(
    tmp_path: Path,
    record: Callable[..., Any],
    other_rig: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """diagnose --write-model, then estimate with it: the loop that the user asked for."""
    files: dict[str, list[str]] = {}
    plant = {other_rig.STRIB: 0.04, other_rig.STRIB_W: 12.0}
    for role, seed in (("train", 1), ("holdout", 2)):
        for name, series in record(plant, ("weave", "slow"), seed=seed).items():
            path = tmp_path / f"{name}.csv"
            columns = {"time_s": next(iter(series.values())).t_ns * 1e-9}
            columns |= {key: one.value for key, one in series.items()}
            np.savetxt(
                path,
                np.column_stack(list(columns.values())),
                delimiter=",",
                header=",".join(columns),
                comments="",
                fmt="%.9g",
            )
            files.setdefault(role, []).append(str(path))
    out, better = tmp_path / "d.json", tmp_path / "better.yaml"
    words = ["diagnose", "--model", MODEL, "--recording", *files["train"]]
    words += ["--holdout", *files["holdout"], "--json", str(out), "--write-model", str(better)]
    assert main(words) == 0
    content = json.loads(out.read_text(encoding="utf-8"))
    assert content["schema"] == "eps-hil/diagnosis/1"
    assert [finding["effect"] for finding in content["findings"]] == ["stribeck"]
    model = load_model(better)
    assert values_of(model.effects[0], model)[0].id == "stribeck"
    assert "Stribeck" in capsys.readouterr().out
    errors, held = [], files["holdout"][0]
    for chosen in (MODEL, str(better)):
        summary = tmp_path / "e.json"
        assert main(["estimate", held, "--model", chosen, "--json", str(summary)]) == 0
        (one,) = json.loads(summary.read_text(encoding="utf-8"))["recordings"]
        errors.append(one["rack_force_error_n"]["rms_moving"])
    assert errors[1] < 0.5 * errors[0]


def test_without_a_load_cell_it_says_so(
    tmp_path: Path, record: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    (series,) = record({}, ("weave",), seconds=4.0).values()
    path = tmp_path / "bare.csv"
    names_ = ("motor_torque_nm", "motor_speed_rad_s")
    columns = [series[name].value for name in names_]
    t = series["motor_torque_nm"].t_ns * 1e-9
    np.savetxt(
        path, np.column_stack([t, *columns]), delimiter=",",
        header=",".join(("time_s", *names_)), comments="", fmt="%.9g",
    )  # fmt: skip
    assert main(["diagnose", "--model", MODEL, "--recording", str(path)]) == 2
    err = capsys.readouterr().err
    assert "rack_force_n" in err
    assert err.count("\n") == 1


def test_an_effect_that_is_not_to_be_considered_is_neither_found_nor_a_rival(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    plant = {other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0}
    result = diagnose(
        reference_model,
        record(plant),
        record(plant, ("weave",), seed=2),
        without=("stribeck", "motor_torque_delay"),
    )
    said = {"stribeck", "motor_torque_delay"}
    assert not said & set(names(result))
    assert not said & {t for one in result.content["findings"] for t in one["confusable_with"]}
    assert result.content["verdict"] != "no_mismatch"


def test_an_effect_to_leave_out_must_exist(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.csv"
    file.write_text("time_s,motor_torque_nm\n0,0\n")
    given = ["diagnose", "--model", MODEL, "--recording", str(file)]
    assert main([*given, "--without-effect", "stribek"]) == 2
    assert "did you mean 'stribeck'?" in capsys.readouterr().err
