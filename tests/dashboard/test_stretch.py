"""The process that diagnoses a stretch, on a recording of a plant that the model does not have."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eps_hil.dashboard.order import PAGE, RESULT, SAMPLES, Order
from eps_hil.dashboard.stretch import work

ROOT = Path(__file__).parents[2]
T0_NS = 1_790_000_000_000_000_000


def ordered(folder: Path, **more: Any) -> tuple[list[Mapping[str, Any]], Path]:
    told: list[Mapping[str, Any]] = []
    model = str(ROOT / "configs" / "reference_rig.yaml")
    whole = {"begin_ns": 0, "end_ns": 2**62}
    work(Order("rig", model=model, folder=str(folder), **(whole | more)), told.append)
    return told, folder


@pytest.mark.slow
def test_a_spring_is_found_where_it_acts(other_rig: ModuleType, tmp_path: Path) -> None:
    plant = other_rig.Effects({other_rig.SPRING: 0.004})
    columns = other_rig.record(plant, "sweep", 1, seconds=24.0)
    t_ns = T0_NS + np.round(columns.pop("time_s") * 1e9).astype(np.int64)
    samples = {name: value for name, value in columns.items()}
    np.savez(tmp_path / SAMPLES, **samples, **{f"{name}|t_ns": t_ns for name in samples})
    told, folder = ordered(tmp_path)
    assert told[-1] == {"done": True}
    parts = [one["part"] for one in told if "part" in one]
    assert len(parts) > 3
    found = json.loads((folder / RESULT).read_text())
    assert [one["effect"] for one in found["findings"]] == ["unmodelled_spring"]
    (spring,) = found["findings"]
    assert "±" in spring["values"][0]["text"]
    assert "N" in spring["size"]
    gain = {one["name"]: one for one in found["gain"]}
    assert gain["torque_nrmse"]["after"] < 0.5 * gain["torque_nrmse"]["before"]
    before, after = (
        np.sqrt(np.mean([cell[2] ** 2 for cell in found["map"][name]]))
        for name in ("before", "after")
    )
    assert after < 0.5 * before
    times = [t - T0_NS * 1e-9 for t, _ in found["strip"]["after"]]
    assert 0.0 <= times[0] < 4.0
    assert 20.0 < times[-1] < 24.0, "what was kept from the fit is in it"
    assert "<script" in (folder / PAGE).read_text()


def test_what_is_wrong_is_told_in_one_line(tmp_path: Path) -> None:
    t_ns = T0_NS + np.arange(9_000, dtype=np.int64) * 1_000_000
    samples: dict[str, Any] = {"motor_torque_nm": np.ones(9_000), "motor_torque_nm|t_ns": t_ns}
    np.savez(tmp_path / SAMPLES, **samples)
    told, folder = ordered(tmp_path)
    assert "motor_angle" in told[-1]["error"]
    assert "\n" not in told[-1]["error"]
    assert not (folder / RESULT).exists()


def test_a_stretch_inside_a_hole_of_the_recording(tmp_path: Path) -> None:
    """As where the bus was away for a while."""
    recording = tmp_path / "r.csv"
    recording.write_text(
        "time_s,motor_torque_nm,motor_speed_rad_s\n"
        "0.0,0.1,1.0\n0.001,0.1,1.0\n60.0,0.1,1.0\n60.001,0.1,1.0\n"
    )
    told, _ = ordered(tmp_path, recording=str(recording), begin_ns=10**10, end_ns=4 * 10**10)
    assert told[-1] == {"error": "nothing was recorded in this stretch"}
