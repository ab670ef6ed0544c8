"""The diagnosis on rigs whose missing physics is known, written in code of their own."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.effects.catalogue import values_of
from eps_hil.physics.model import Model, load_model
from eps_hil.series import Series

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


def with_holes(series: Mapping[str, Series]) -> dict[str, Series]:
    """Each of three signals without good samples for 0.4 to 1 s, at other times."""
    holed = dict(series)
    for name, first, last in (
        ("motor_torque_nm", 2500, 2900),
        ("motor_speed_rad_s", 5000, 5600),
        ("rack_force_n", 8000, 9000),
    ):
        values = series[name].value.copy()
        values[first:last] = np.nan
        holed[name] = Series(series[name].t_ns, values)
    return holed


def with_held_force(series: Mapping[str, Series]) -> dict[str, Series]:
    """A load cell of 100 Hz that fills every row."""
    force = series["rack_force_n"]
    rows = np.arange(len(force.t_ns)) // 10 * 10
    return {**series, "rack_force_n": Series(force.t_ns, force.value[rows])}


@pytest.mark.parametrize("change", [with_holes, with_held_force])
@pytest.mark.parametrize("level", [0.0, 0.03])
def test_how_recordings_were_written_is_no_physics(
    record: Callable[..., Any],
    reference_model: Model,
    change: Callable[[Mapping[str, Series]], dict[str, Series]],
    other_rig: Any,
    level: float,
) -> None:
    plant = {other_rig.STRIB: level, other_rig.STRIB_W: 10.0}
    fitted = {name: change(one) for name, one in record(plant).items()}
    kept = {name: change(one) for name, one in record(plant, ("weave",), seed=2).items()}
    result = diagnose(reference_model, fitted, kept)
    assert names(result) == (["stribeck"] if level else [])
    proof = result.content["fit"]["holdout"]
    assert proof["augmented"]["torque_nrmse"] < 1.15 * proof["noise_floor"]["torque_nrmse"]


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


def without_load_cell(recordings: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: {key: one for key, one in series.items() if key != "rack_force_n"}
        for name, series in recordings.items()
    }


def test_without_a_load_cell_a_free_rack_is_enough(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """A load of known form joins the baseline (DIAGNOSIS 7); what it hides is said."""
    plant = {other_rig.STRIB: 0.04, other_rig.STRIB_W: 8.0}
    made = without_load_cell(record(plant, ("free", "free2"), seconds=20.0))
    kept = without_load_cell(record(plant, ("free",), seed=2))
    result = diagnose(reference_model, made, kept)
    assert names(result) == ["stribeck"]
    assert value(result, "level_nm") == pytest.approx(0.04, rel=0.15)
    load, *held = result.content["limits"]
    assert "viscous_friction" in load
    assert all("is no finding" in one for one in held)  # how a torque acts between samples


def test_missing_physics_is_no_arbitrary_force(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """A torque that acts 25 ms late, with nothing on the rack, leaves far more than noise.

    How late is known to a tenth: under a motor that holds as a spring does, a part of it looks like
    the damper of a load.
    """
    words = {"torque_late_s": 0.025, "seconds": 20.0}
    made = without_load_cell(record({}, ("free", "free2"), **words))
    kept = without_load_cell(record({}, ("free",), seed=2, **words))
    result = diagnose(reference_model, made, kept)
    assert "motor_torque_delay" in names(result)
    (late,) = (f for f in result.content["findings"] if f["effect"] == "motor_torque_delay")
    assert late["parameters"]["delay_s"]["value"] == pytest.approx(0.025, rel=0.1)
    proof = result.content["fit"]["holdout"]
    assert proof["augmented"]["torque_nrmse"] < 0.5 * proof["baseline"]["torque_nrmse"]


def test_an_unmeasured_force_of_no_form_leaves_only_ripples(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    plant = {other_rig.COG: 0.015, other_rig.COG_N: 6.0, other_rig.VISC: 5e-4}
    made = without_load_cell(record(plant))
    kept = without_load_cell(record(plant, ("weave",), seed=2))
    result = diagnose(reference_model, made, kept)
    assert names(result) == ["cogging_torque"]
    assert value(result, "amplitude_nm") == pytest.approx(0.015, rel=0.15)
    assert value(result, "order") == pytest.approx(6.0, abs=0.02)
    assert "only ripples (" in result.content["limits"][0]


def beside_timing(result: Diagnosis) -> list[str]:
    """Limits, but for one that these recordings have: their torque is held for a sample."""
    held = [one for one in result.content["limits"] if one.startswith("The motor's torque acts 0.")]
    assert len(held) <= 1
    return [one for one in result.content["limits"] if one not in held]


def test_what_only_the_hold_out_shows_is_said(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """A stop that no fitted recording touches: nothing can be named, and that is no all-clear."""
    stop = {other_rig.STOP_X: 0.004, other_rig.STOP_K: 2e5}
    kept = record(stop, ("weave",), seed=2)
    result = diagnose(reference_model, record({}), kept)
    assert "end_stop" not in names(result)
    (limit,) = beside_timing(result)
    assert limit.startswith("weave_2 leaves ")
    assert "most of it at" in limit
    same = run(record, reference_model, {other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0})
    assert beside_timing(same) == []


def test_what_no_hold_out_can_judge_is_named_if_the_fitted_show_it_beyond_doubt(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """A stop at 12 mm that the hold-out stays away from; then one that knows of none there."""
    stop = {other_rig.STOP_X: 0.012, other_rig.STOP_K: 2e5}
    made = record(stop, ("sweep", "weave", "slow"))
    away = record(stop, ("sweep",), seed=2)
    result = diagnose(reference_model, made, away)
    assert names(result) == ["end_stop"]
    assert value(result, "position_m") == pytest.approx(0.012, rel=0.01)
    (limit,) = beside_timing(result)
    assert limit.startswith("The hold-outs never come where end_stop acts")
    against = record({}, ("weave",), seed=2)
    assert "end_stop" not in names(diagnose(reference_model, made, against))


@pytest.mark.parametrize("second_nm", [0.005, 0.015])
def test_every_order_of_cogging_is_a_finding_of_its_own(
    record: Callable[..., Any], reference_model: Model, other_rig: Any, second_nm: float
) -> None:
    """A motor has several; the weak one under the skirts of the strong, or both alike."""
    plant = {
        other_rig.COG: 0.015,
        other_rig.COG_N: 6.0,
        other_rig.COG_P: 0.4,
        other_rig.COG2: second_nm,
        other_rig.COG2_N: 12.0,
        other_rig.COG2_P: -1.0,
    }
    result = run(record, reference_model, plant)
    assert result.content["verdict"] == "explained"
    found = {
        round(one["parameters"]["order"]["value"]): one["parameters"]
        for one in result.content["findings"]
    }
    assert names(result) == ["cogging_torque"] * 2
    for order, amplitude_nm, phase_rad in ((6, 0.015, 0.4), (12, second_nm, -1.0)):
        assert found[order]["amplitude_nm"]["value"] == pytest.approx(amplitude_nm, rel=0.1)
        assert found[order]["order"]["value"] == pytest.approx(order, abs=0.02)
        assert found[order]["phase_rad"]["value"] == pytest.approx(phase_rad, abs=0.15)
    orders = [one["order"] for one in result.model.effects]
    assert sorted(round(order) for order in orders) == [6, 12]
    gains = [one["gain"] for one in result.content["fit"]["placebo"]]
    assert all(gain > 100.0 for gain in gains)
    improves(result)


def test_several_numbers_off_are_those_numbers_and_no_more(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """A common factor on all torques must not pay, though it makes every noise smaller."""
    base, off = other_rig._BASE, other_rig
    plant = {
        off.INERTIA: 1.09 * base[off.INERTIA],
        off.K0P: 1.23 * base[off.K0P],
        off.K0N: 1.23 * base[off.K0N],
        off.KRP: base[off.KRP] + 3.4e-5,
        off.KRN: base[off.KRN] + 3.4e-5,
    }
    result = run(record, reference_model, plant)
    found = {one["effect"]: one["parameters"] for one in result.content["findings"]}
    assert set(found) == {"inertia", "coulomb_level", "load_dependent_friction"}
    assert found["inertia"]["scale"]["value"] == pytest.approx(1.09, abs=0.01)
    assert found["coulomb_level"]["scale"]["value"] == pytest.approx(1.23, abs=0.023)
    improves(result)


def test_a_torque_sensor_is_not_needed_where_nobody_steers(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """And the speed may be had from the angle alone."""
    plant = {other_rig.QUAD: 4e-6, other_rig.HAND: 0.0}
    made, kept = (
        {
            name: {
                key: one
                for key, one in series.items()
                if key not in ("torque_sensor_nm", "motor_speed_rad_s", "rack_position_m")
            }
            for name, series in record(plant, seed=seed).items()
        }
        for seed in (1, 2)
    )
    result = diagnose(reference_model, made, kept)
    assert names(result) == ["quadratic_drag"]
    assert value(result, "coefficient_nm_s2_per_rad2") == pytest.approx(4e-6, rel=0.1)


def test_what_the_catalogue_lacks_is_unknown(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """An eddy-current brake: rises, then falls with speed, as no entry does."""
    plant = {other_rig.EDDY: 0.05, other_rig.EDDY_W: 15.0}
    result = run(record, reference_model, plant)
    assert result.content["verdict"] in ("unknown_effect", "partly_explained")
    assert "unknown" in names(result)


def test_a_known_effect_stands_beside_an_unknown_one(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """The brake has four times the noise, the cogging under it less than the noise."""
    plant = {
        other_rig.EDDY: 0.06, other_rig.EDDY_W: 20.0, other_rig.COG: 0.006, other_rig.COG_N: 8,
    }  # fmt: skip
    result = run(record, reference_model, plant)
    assert names(result) == ["cogging_torque", "unknown"]
    assert result.content["verdict"] == "partly_explained"
    found = result.content["findings"][0]["parameters"]
    low, high = found["amplitude_nm"]["ci95"]
    assert low <= 0.006 <= high
    assert found["order"]["value"] == pytest.approx(8.0, abs=0.02)
    # The brake has no name, and is modelled all the same.
    assert [one["effect"] for one in result.model.effects] == ["cogging_torque", "empirical"]


def test_what_is_not_to_be_considered_is_not_named_in_any_way(
    record: Callable[..., Any], reference_model: Model
) -> None:
    from dataclasses import replace

    delays = replace(reference_model.delays_s, motor_torque=0.003)
    model = replace(reference_model, delays_s=delays)
    kept, recordings = record({}, ("weave",), seed=2), record({})
    assert "motor_torque_delay" in names(diagnose(model, recordings, kept))
    withheld = ("motor_torque_delay", "speed_sensor_delay")
    assert not set(names(diagnose(model, recordings, kept, without=withheld))) & set(withheld)
