"""Reversal adaptation over recordings: the same as on line, any rate, holes, missing signals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from eps_hil.adaptation.offline import adapt
from eps_hil.adaptation.reversal import ReversalAdaptation, ReversalSettings
from eps_hil.cli.main import app
from eps_hil.physics.model import Model, dump_model
from eps_hil.series import Series

TRUE = (5.6e-2, 1.258e-1)
NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")


def series_of(truth: Any, *names: str) -> dict[str, Series]:
    t_ns = np.round(truth.columns["time_s"] * 1e9).astype(np.int64) + 1_700_000_000 * 10**9
    return {name: Series(t_ns, truth.columns[name]) for name in names}


@pytest.mark.parametrize("names", [NAMES, NAMES[:3], (*NAMES[:2], NAMES[3])])
def test_a_rig_recording_gives_both_levels(
    reference_model: Model, scaled_levels: Any, sweep_truth: Any, names: tuple[str, ...]
) -> None:
    """With angle and speed, or one of them; at half the rate for the load cell."""
    series = series_of(sweep_truth, *names, "rack_force_n")
    cell = series["rack_force_n"]
    series["rack_force_n"] = Series(cell.t_ns[::2], cell.value[::2])
    adaptation = ReversalAdaptation(ReversalSettings(), scaled_levels(reference_model, 0.6, 1.4))
    states = adapt(series, reference_model, adaptation)
    assert len(states) >= 5
    assert states[-1].asymmetry_known
    assert states[-1].levels == pytest.approx(TRUE, rel=0.03)


@pytest.mark.parametrize("name", ["motor_torque_nm", "torque_sensor_nm"])
def test_a_hole_begins_a_new_stretch(reference_model: Model, sweep_truth: Any, name: str) -> None:
    """A torsion-bar torque that was lost was none: the driver's became missing friction."""
    series = series_of(sweep_truth, *NAMES, "rack_force_n")
    one = series[name]
    keep = (np.arange(len(one.t_ns)) % 5000) > 100
    series[name] = Series(one.t_ns[keep], one.value[keep])
    adaptation = ReversalAdaptation(ReversalSettings(), reference_model)
    assert adapt(series, reference_model, adaptation) == []


@pytest.mark.parametrize("missing", ["motor_torque_nm", "motor_speed_rad_s"])
def test_what_is_needed_is_named(reference_model: Model, sweep_truth: Any, missing: str) -> None:
    series = series_of(sweep_truth, *(name for name in NAMES[:3] if name != missing))
    adaptation = ReversalAdaptation(ReversalSettings(), reference_model)
    with pytest.raises(ValueError, match=missing):
        adapt(series, reference_model, adaptation)


def test_the_verb_says_what_it_saw_and_what_not(
    reference_model: Model, scaled_levels: Any, sweep_truth: Any, tmp_path: Path
) -> None:
    model, recording, out = (tmp_path / name for name in ("model.yaml", "rig.csv", "levels.json"))
    model.write_text(dump_model(scaled_levels(reference_model, 0.7, 0.7)), encoding="utf-8")
    names = ("time_s", *NAMES, "rack_force_n")
    table = np.column_stack([sweep_truth.columns[name] for name in names])[8000:28_000]
    np.savetxt(recording, table, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    command = ["calibrate", "reversals", str(recording), "--model", str(model)]
    told = CliRunner().invoke(app, [*command, "--json", str(out)])
    assert told.exit_code == 0, told.output
    assert "the model's to" in told.output
    content = json.loads(out.read_text(encoding="utf-8"))
    assert content["offset_pos_nm"] == pytest.approx(TRUE[0], rel=0.03)
    assert content["sum_nm"] == pytest.approx(sum(TRUE), rel=0.02)
    blind = CliRunner().invoke(app, [*command, "--without-load-cell"])
    assert blind.exit_code == 0, blind.output
    assert "k0+ and k0- apart were not seen" in blind.output
    assert "not sure yet" in blind.output
