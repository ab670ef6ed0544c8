"""A recording as the page's store."""

import math
from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.dashboard.recording import store_of
from eps_hil.dashboard.traces import ESTIMATE, FRICTION, SPEED
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
