"""Somebody else's simulator against recordings: ``other_rig.py`` is both here, never our model."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.diagnosis.against import diagnose_against
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model, load_model
from eps_hil.series import Series

MODEL = str(Path(__file__).parents[3] / "configs" / "reference_rig.yaml")
MANOEUVRES = ("sweep", "weave")
SECONDS = 12.0

pytestmark = pytest.mark.slow


def theirs(rig: Any) -> dict[int, float]:
    """Coulomb and viscous friction, the same both ways, with numbers that no model file has."""
    return {
        rig.K0P: 0.09, rig.K0N: 0.09, rig.KWP: 2e-4, rig.KWN: 2e-4, rig.KRP: 5e-5, rig.KRN: 5e-5,
    }  # fmt: skip


def traces(
    record: Callable[..., Any], plant: Mapping[int, float], *names: str, start_s: float = 40.0
) -> dict[str, dict[str, Series]]:
    """What a simulator writes: physical instants, no noise, 500 Hz, a clock of its own."""
    made = record(
        plant, MANOEUVRES, noise=0.0, speed_late_s=-4e-3, torque_late_s=1e-3, seconds=SECONDS
    )
    kept = names or tuple(next(iter(made.values())))
    return {
        f"sim_{name}": {
            key: Series(one.t_ns[700::2] + round(start_s * 1e9), one.value[700::2])
            for key, one in series.items()
            if key in kept
        }
        for name, series in made.items()
    }


def run(
    record: Callable[..., Any],
    model: Model,
    plant: Mapping[int, float],
    simulated: Mapping[str, Mapping[str, Series]],
) -> Diagnosis:
    recordings = record(plant, MANOEUVRES, seconds=SECONDS)
    kept = record(plant, ("weave",), seed=2, seconds=SECONDS)
    return diagnose_against(simulated, model, recordings, kept)


def test_what_the_simulator_lacks_is_named(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """Other parameters than the model file's are the simulator's own, and no finding."""
    rig = theirs(other_rig)
    real = {**rig, other_rig.STRIB: 0.04, other_rig.STRIB_W: 10.0}
    result = run(record, reference_model, real, traces(record, rig))
    (finding,) = result.content["findings"]
    assert finding["effect"] == "stribeck"
    assert finding["parameters"]["level_nm"]["value"] == pytest.approx(0.04, rel=0.15)
    about = result.content["simulation"]
    assert about["timing"] == "physical instants"
    moved = about["parameters"]
    for name, value in (("offset_pos_nm", 0.09), ("viscous_neg_nm_s_per_rad", 2e-4)):
        assert moved[name]["value"] == pytest.approx(value, rel=0.05)
    for one in about["traces"]:
        assert one["recording"] == one["file"].removeprefix("sim_")
        assert one["offset_s"] == pytest.approx(0.7, abs=2e-3)


def test_what_both_hold_is_no_finding(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    both = {**theirs(other_rig), other_rig.STRIB: 0.04, other_rig.STRIB_W: 10.0}
    result = run(record, reference_model, both, traces(record, both))
    assert result.content["verdict"] == "no_mismatch"


def test_a_simulator_driven_by_the_recordings_may_write_the_motion_only(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """Rack force and torsion-bar torque are the recording's; so is the caveat."""
    rig = theirs(other_rig)
    real = {**rig, other_rig.VISC: 4e-4}
    kept = ("motor_speed_rad_s", "motor_angle_rad", "motor_torque_nm")
    result = run(record, reference_model, real, traces(record, rig, *kept, start_s=0.0))
    assert result.content["findings"][0]["effect"] == "viscous_friction"
    lent = result.content["simulation"]["traces"][0]["taken_from_recording"]
    assert lent == ["torque_sensor_nm", "rack_force_n"]


def test_the_command(
    tmp_path: Path,
    record: Callable[..., Any],
    other_rig: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A tool's own column names and units, through the mapping."""
    rig = theirs(other_rig)
    real = {**rig, other_rig.K0P: 0.11, other_rig.K0N: 0.11}
    words = ["diagnose", "--model", MODEL, "--recording"]
    for name, series in record(real, MANOEUVRES, seconds=SECONDS).items():
        words.append(_write(tmp_path / f"{name}.csv", series, {}))
    words += ["--simulation"]
    for name, series in traces(record, rig).items():
        words.append(_write(tmp_path / f"{name}.csv", series, {"motor_speed_rad_s": "n_rpm"}))
    mapping = tmp_path / "columns.yaml"
    lines = ["time: {column: time_s}", "signals:"]
    lines += ["  motor_speed_rad_s: {column: n_rpm, scale: 0.10471975511965977}"]
    lines += [
        f"  {n}: {{column: {n}}}" for n in ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")
    ]
    mapping.write_text("\n".join(lines), encoding="utf-8")
    out, better = tmp_path / "d.json", tmp_path / "better.yaml"
    words += ["--simulation-signals", str(mapping), "--json", str(out)]
    assert main([*words, "--write-model", str(better)]) == 0
    content = json.loads(out.read_text(encoding="utf-8"))
    assert [finding["effect"] for finding in content["findings"]] == ["coulomb_level"]
    assert content["findings"][0]["parameters"]["scale"]["value"] == pytest.approx(1.22, rel=0.05)
    said = capsys.readouterr().out
    assert "offset_pos_nm" in said
    assert "the simulator's own numbers and 1 effect written to" in said
    # the rig: what the simulator says of it, and what that lacks
    rig_file = load_model(better)
    level = rig_file.friction.offset_pos_nm * rig_file.effects[0]["scale"]
    assert level == pytest.approx(0.11, rel=0.05)
    assert rig_file.friction.viscous_pos_nm_s_per_rad == pytest.approx(2e-4, rel=0.1)


def _write(path: Path, series: Mapping[str, Series], renamed: Mapping[str, str]) -> str:
    columns = {"time_s": next(iter(series.values())).t_ns * 1e-9}
    for name, one in series.items():
        rpm = 60 / (2 * np.pi) if name in renamed else 1.0
        columns[renamed.get(name, name)] = one.value * rpm
    np.savetxt(
        path, np.column_stack(list(columns.values())), delimiter=",",
        header=",".join(columns), comments="", fmt="%.9g",
    )  # fmt: skip
    return str(path)
