"""What a diagnosis reports of hold-outs is what the model file that it writes does with them."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from eps_hil.diagnosis.accept.proof_of_fit import Holdout, measures
from eps_hil.diagnosis.data.intake import prepared
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.estimation import batch
from eps_hil.estimation.score import score
from eps_hil.physics.forward import forward
from eps_hil.physics.model import Model, dump_model, load_model
from eps_hil.proof import sensors
from eps_hil.proof.cases import make
from eps_hil.proof.manoeuvres import column
from eps_hil.proof.plans import Plan
from eps_hil.proof.programmes import programme
from eps_hil.proof.truth import Floats
from eps_hil.proof.world import World
from eps_hil.report.diagnosis_page import render
from eps_hil.series import Series

Recordings = Mapping[str, Mapping[str, Series]]

KINDS = {
    "a name": Plan("singles", 21, (("stribeck", 1.5),), simple=True),
    "two names": Plan("pairs", 22, (("cogging_torque", 3.0), ("quadratic_drag", 1.5)), simple=True),
    "a law": Plan("nameless", 23, (("alien_eddy_brake", 3.0),)),
    "memory": Plan("nameless", 24, (("alien_bushing", 3.0),)),
    "a map": Plan("nameless", 12, (("late_iron_loss", 3.0),)),
    "a curve": Plan("singles", 25, (("position_torque", 3.0),), simple=True,
                    withheld=("position_torque", "position_dependent_friction")),
    "a late signal": Plan("singles", 26, (("speed_sensor_delay", 3.0),), simple=True),
    "a loss like a load cell's gain": Plan("nameless", 27, (("late_nut_loss", 3.0),)),
    "a loss while braking": Plan("nameless", 28, (("late_braking_loss", 3.0),)),
}  # fmt: skip
JOINTS = {
    "a belt": Plan("singles", 29, (("belt_compliance", 3.0),)),
    "play": Plan("singles", 30, (("backlash", 3.0),)),
    "a sensor's play": Plan("singles", 31, (("torque_sensor_hysteresis", 3.0),)),
}
QUIET = Plan("decoys", 32, (), decoy="nothing")


def recordings_of(plan: Plan) -> tuple[Recordings, Recordings]:
    case = make(plan)
    every = {name: series_of(columns) for name, columns in case.recordings.items()}
    return every, {"holdout": every.pop("holdout")}


def series_of(columns: Mapping[str, Floats]) -> dict[str, Series]:
    t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
    return {name: Series(t_ns, values) for name, values in columns.items() if name != "time_s"}


def written(result: Diagnosis, folder: Path) -> Model:
    path = folder / "augmented.yaml"
    path.write_text(dump_model(result.model), encoding="utf-8")
    return load_model(path)


def says_no_nan(result: Diagnosis) -> None:
    """Neither the file nor what the page says (its plots' data: tests/report)."""
    json.dumps(result.content, allow_nan=False)
    page = re.sub(r"<(script|style)\b.*?</\1>", "", render(result, "rig.yaml"), flags=re.DOTALL)
    page = re.sub(r"data:[^\"')]*", "", page)
    assert "</table>" in page
    assert not re.findall(r".{40}\b(?:nan|inf)\b.{40}", page, re.IGNORECASE)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_reported_is_what_was_written(
    kind: str, reference_model: Model, tmp_path: Path
) -> None:
    plan = KINDS[kind]
    fitted, kept = recordings_of(plan)
    result = diagnose(reference_model, fitted, kept, without=plan.withheld)
    model, told = written(result, tmp_path), result.content["fit"]["holdout"]
    assert result.model.effects, "nothing was found: this case holds nothing to write"
    says_no_nan(result)
    raw = Holdout(prepared("holdout", kept["holdout"], 0.0), kept["holdout"])
    again = measures([raw], model, model)
    for name in ("torque_nrmse", "speed_fit_percent"):
        assert again[name] == pytest.approx(told["augmented"][name], rel=0.02), name
    force = score(batch.estimate(dict(kept["holdout"]), model), kept["holdout"], model)
    if force is None:
        assert told["augmented"]["rack_force_rmse_n"] is None
    else:
        assert force.rmse_moving_n == pytest.approx(
            told["augmented"]["rack_force_rmse_n"], rel=0.01
        )
    for name, value in told["augmented"]["free_run"].items():
        assert again["free_run"][name] == pytest.approx(value, rel=0.02), name


def as_simulated_and_estimated(
    result: Diagnosis, kept: Mapping[str, Series], folder: Path
) -> dict[str, Any]:
    """The written file on the raw hold-out gives the figures that are reported."""
    model, told = written(result, folder), result.content["fit"]["holdout"]["augmented"]
    says_no_nan(result)
    again = measures([Holdout(prepared("holdout", kept, 0.0), kept)], model, model)
    assert again["speed_fit_percent"] == pytest.approx(told["speed_fit_percent"], rel=0.02)
    for name, value in told["free_run"].items():
        assert again["free_run"][name] == pytest.approx(value, rel=0.02), name
    force = score(batch.estimate(dict(kept), model), kept, model)
    assert force is not None
    assert force.rmse_moving_n == pytest.approx(told["rack_force_rmse_n"], rel=0.01)
    return again


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", JOINTS)
def test_a_joint_acts_in_the_figures_as_it_is_written(
    kind: str, reference_model: Model, tmp_path: Path
) -> None:
    """In simulation and estimate; a torque balance of one mass holds none."""
    fitted, kept = recordings_of(JOINTS[kind])
    result = diagnose(reference_model, fitted, kept)
    assert JOINTS[kind].wanted[0][0] in [one["effect"] for one in result.model.effects]
    as_simulated_and_estimated(result, kept["holdout"], tmp_path)


def reads_more(recordings: Recordings) -> Recordings:
    """With a load cell that reads 4 % too much."""
    return {
        name: {**one, "rack_force_n": Series(force.t_ns, 1.04 * force.value)}
        for name, one in recordings.items()
        for force in [one["rack_force_n"]]
    }


def is_adrift(recordings: Recordings) -> Recordings:
    """With a load cell on a clock of its own, 200 ppm slow."""
    out = {}
    for name, one in recordings.items():
        force = one["rack_force_n"]
        late_ns = np.round(2e-4 * (force.t_ns - force.t_ns[0])).astype(np.int64)
        out[name] = {**one, "rack_force_n": Series(force.t_ns + late_ns, force.value)}
    return out


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("wrong", [reads_more, is_adrift])
def test_a_channel_that_no_file_puts_right_is_not_put_right_in_the_figures(
    wrong: Callable[[Recordings], Recordings], reference_model: Model, tmp_path: Path
) -> None:
    fitted, kept = (wrong(one) for one in recordings_of(QUIET))
    result = diagnose(reference_model, fitted, kept)
    told = result.content["fit"]["holdout"]
    assert result.content["findings"][0]["kind"] == "instrument"
    assert "empirical" not in [one["effect"] for one in result.model.effects]
    again = as_simulated_and_estimated(result, kept["holdout"], tmp_path)
    assert again["torque_nrmse"] == pytest.approx(told["augmented"]["torque_nrmse"], rel=0.02)
    assert told["put_right"]["torque_nrmse"] < 0.8 * told["augmented"]["torque_nrmse"]
    assert any("which no model file does" in one for one in result.content["limits"])


class Unmeasured(NamedTuple):
    """A load that nobody measured (SI at the rack), with what is hidden beside it."""

    hidden: Mapping[str, float]
    stiffness: float = 0.0
    damping: float = 0.0
    constant: float = 0.0
    manoeuvre: str = "free_rack"


MORE_FRICTION = {"coulomb_scale": 1.2}
LOADS = {
    "none": Unmeasured({"quadratic": 5e-5}),
    "spring and damper": Unmeasured(MORE_FRICTION, 4e4, 300.0),
    "mostly damper": Unmeasured(MORE_FRICTION, 1e4, 4000.0),
    "gravity": Unmeasured(MORE_FRICTION, 0.0, 0.0, 150.0),
    "spring and weight": Unmeasured(MORE_FRICTION, 3e4, 300.0, 1500.0),
    "spring, and nothing missing": Unmeasured({}, 4e4, 300.0),
    "spring, beside a law": Unmeasured({"alien_eddy_nm": 0.06}, 4e4, 300.0),
}


def without_load_cell(load: Unmeasured) -> list[dict[str, Series]]:
    """Two recordings and a hold-out of a rig of the model's form."""
    rng, rig = np.random.default_rng(6), World(simple=True)
    rig = replace(rig, hidden=rig.hidden._replace(**load.hidden))
    made = []
    for program in programme(load.manoeuvre, rng):
        if load.manoeuvre == "free_rack":
            program[:, column("rig_n_per_m")] = load.stiffness
            program[:, column("rig_n_s_per_m")] = load.damping
            program[:, column("force_n")] += load.constant
        clean = sensors.reported(rig.run(program), rig.instruments)
        columns = sensors.measured(clean, rig.instruments, rng)
        columns.pop("rack_force_n")
        made.append(series_of(columns))
    return made


def simulated(model: Model, series: Mapping[str, Series]) -> dict[str, float]:
    """``free_run`` of CONTRACT 7 by what ``eps-hil simulate`` runs."""
    run, found = forward(model, series, physical=True), {}
    for name in ("motor_speed_rad_s", "motor_angle_rad"):
        late_ns, one = round(1e9 * model.delays_s.of(name)), series[name]
        measured = np.interp(run.t_ns + late_ns, one.t_ns, one.value)
        error = run.columns[name] - measured
        found[name] = float(np.sqrt(np.mean(error**2)))
    return found


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", LOADS)
def test_a_load_that_nobody_measured_acts_in_the_figures_as_it_is_written(
    kind: str, reference_model: Model, tmp_path: Path
) -> None:
    first, second, kept = without_load_cell(LOADS[kind])
    result = diagnose(reference_model, {"a": first, "b": second}, {"kept": kept})
    model, told = written(result, tmp_path), result.content["fit"]["holdout"]["augmented"]
    assert model.effects, "neither a finding nor a load was written"
    says_no_nan(result)
    again = measures([Holdout(prepared("kept", kept, 0.0), kept)], model, model)
    for name in ("torque_nrmse", "speed_fit_percent"):
        assert again[name] == pytest.approx(told[name], rel=0.02), name
    for name, value in told["free_run"].items():
        assert again["free_run"][name] == pytest.approx(value, rel=0.02), name
    run = simulated(model, kept)
    assert run["motor_angle_rad"] == pytest.approx(told["free_run"]["angle_rmse_rad"], rel=0.15)
    assert np.isfinite(batch.estimate(dict(kept), model).rack_force_n).any()


@pytest.mark.slow
def test_a_force_of_any_form_drives_no_simulation(reference_model: Model) -> None:
    """No file holds it: figures of a run that it would have driven do not exist."""
    first, second, kept = without_load_cell(Unmeasured({"screw_nm": 0.012}, manoeuvre="training"))
    told = diagnose(reference_model, {"a": first, "b": second}, {"kept": kept}).content
    holdout = told["fit"]["holdout"]
    for one in ("baseline", "augmented"):
        assert holdout[one]["speed_fit_percent"] is None
        assert holdout[one]["free_run"] == {"speed_rmse_rad_s": None, "angle_rmse_rad": None}
    assert holdout["augmented"]["torque_nrmse"] < holdout["baseline"]["torque_nrmse"]
