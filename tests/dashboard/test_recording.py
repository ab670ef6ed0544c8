"""A recording as the page's store."""

from pathlib import Path

import numpy as np
import pytest

from eps_hil.dashboard.recording import store_of
from eps_hil.dashboard.traces import ESTIMATE, SPEED
from eps_hil.service.config import load_config

from .test_verb import CONFIG


def test_a_page_begins_with_the_first_value(tmp_path: Path) -> None:
    """Estimates of a service that waited for its rig stand as empty cells before anything moves."""
    (tmp_path / "c.yaml").write_text(CONFIG)
    rows = ["time_s,motor_speed_rad_s,rack_force_estimate_n"]
    for k in range(500):
        speed = "" if k < 200 else f"{np.sin(k / 50):.4f}"
        force = "" if k < 220 or 300 <= k < 310 else f"{k}"
        rows.append(f"{k * 1e-2:.2f},{speed},{force}")
    (tmp_path / "r.csv").write_text("\n".join(rows) + "\n")
    store, _ = store_of(tmp_path / "r.csv", load_config(tmp_path / "c.yaml"))
    assert store.oldest_ns == pytest.approx(2.0e9, abs=1e7)
    assert np.isnan(store.tracks[ESTIMATE].value).sum() == 10  # a gap later on stays one
    assert len(store.tracks[SPEED].value) == 300
