"""A recording as the page's store."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.dashboard import recording
from eps_hil.dashboard.recording import balance_of_recording, store_of
from eps_hil.dashboard.traces import BALANCE, ESTIMATE, FRICTION, SPEED
from eps_hil.physics.model import load_model
from eps_hil.series import Series
from eps_hil.service.config import load_config
from eps_hil.service.core import Status

from .test_verb import CONFIG, ROOT

MS = 1_000_000


def test_a_page_begins_with_the_first_value(tmp_path: Path) -> None:
    """A service that waits for its rig publishes estimates without a value before it moves."""
    (tmp_path / "c.yaml").write_text(CONFIG)
    database = load_database([ROOT / "dbc" / "eps_rig.dbc"])
    estimate, motor = (FrameEncoder(database, m) for m in ("EPSHIL_Estimate", "EPS_MotorState"))
    lines = []
    for k in range(5000):
        known = k >= 3000 and not 4000 <= k < 4010
        force, status = (100.0, Status.VALID) if known else (math.nan, Status.INVALID)
        told = {
            "RackForceEstimate": force,
            "FrictionTorque": 0.01 * force,
            "EstimateStatus": status,
        }
        frames = [(0x120, estimate.encode(told | {"EstimateReason": 0, "EstimateAge": 22.0}))]
        if k >= 3000:
            speed = math.sin(1e-2 * k)
            frames.append((0x100, motor.encode({"MotorSpeed": speed, "MotorAngle": 0.0})))
        lines += [f"({1000 + k * 1e-3:.6f}) can0 {i:03X}#{d.hex().upper()}" for i, d in frames]
    (tmp_path / "bus.log").write_text("\n".join(lines) + "\n")
    store, _ = store_of(tmp_path / "bus.log", load_config(tmp_path / "c.yaml"))
    assert store.oldest_ns == pytest.approx(1003e9, abs=30 * MS)
    assert len(store.tracks[SPEED].t_ns) == 2000
    for name in (ESTIMATE, FRICTION):
        assert np.isnan(store.tracks[name].value).sum() == 10  # a gap later on stays one


def test_an_estimate_that_a_table_calls_invalid_is_a_gap(tmp_path: Path) -> None:
    """It was drawn as a good one, 800 N off."""
    (tmp_path / "c.yaml").write_text(CONFIG)
    rows = ["time_s,motor_speed_rad_s,rack_force_n,rack_force_estimate_n,friction_torque_nm,valid"]
    for k in range(3000):
        valid = 1000 <= k < 2000 or k >= 2100
        rows.append(
            f"{k * 1e-3:.3f},{math.sin(k * 1e-2):.4f},100,{100 if valid else 900},0.1,{valid:d}"
        )
    (tmp_path / "estimates.csv").write_text("\n".join(rows) + "\n")
    store, _ = store_of(tmp_path / "estimates.csv", load_config(tmp_path / "c.yaml"))
    for name, value in ((ESTIMATE, 100.0), (FRICTION, 0.1)):
        track = store.tracks[name]
        assert np.nanmax(track.value) == pytest.approx(value)
        since_ms = track.t_ns // MS
        there = np.isfinite(track.value)
        assert np.array_equal(since_ms[there], [*range(1000, 2000), *range(2100, 3000)])
        assert not np.any(there[(since_ms >= 2000) & (since_ms < 2100)])


def test_a_clock_that_jumps_by_decades_makes_no_pieces_of_them(
    weave_truth: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """50 years are 26 million pieces, each looked at: the page never came."""
    model = load_model(ROOT / "configs" / "reference_rig.yaml")
    names = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "rack_force_n")
    columns = {name: np.asarray(weave_truth.columns[name])[:8000] for name in names}
    since_ns = np.arange(8000, dtype=np.int64) * MS
    alone = {name: Series(since_ns, value) for name, value in columns.items()}
    apart_ns = 60 * 10**9 * (50 * 365 * 1440)
    both = {
        name: Series(np.concatenate([since_ns, since_ns + apart_ns]), np.tile(value, 2))
        for name, value in columns.items()
    }
    cuts: list[int] = []
    between = recording._between

    def counted(one: Series, *of: int) -> Series:
        cuts.append(1)
        return between(one, *of)

    monkeypatch.setattr(recording, "_between", counted)
    (at_ns, left_n), (both_ns, both_n) = (
        balance_of_recording(one, model)[BALANCE] for one in (alone, both)
    )
    assert len(cuts) == (1 + 2) * len(names)
    assert len(at_ns) > 900
    assert np.array_equal(both_ns, np.concatenate([at_ns, at_ns + apart_ns]))
    np.testing.assert_allclose(both_n, np.tile(left_n, 2), equal_nan=True)
