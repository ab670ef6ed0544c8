"""The estimator by hand in C, which benchmarks/batch_estimator.py measures against."""

import importlib.util
import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate
from eps_hil.physics.model import load_model

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    path = ROOT / "benchmarks" / "batch_estimator.py"
    spec = importlib.util.spec_from_file_location("batch_estimator", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_same_estimate_by_hand(benchmark: ModuleType, tmp_path: Path) -> None:
    model = load_model(ROOT / "configs" / "reference_rig.yaml")
    series = benchmark.recording(model, 12.0)
    ours = estimate(series, model)
    t, force, friction = benchmark.peer(benchmark.built(tmp_path), model, series)()
    assert ours.valid.sum() > 11_000
    where = np.searchsorted(t, ours.t_ns[ours.valid])
    assert np.array_equal(t[where], ours.t_ns[ours.valid])
    assert np.abs(force[where] - ours.rack_force_n[ours.valid]).max() < 1e-9
    assert np.abs(friction[where] - ours.friction_torque_nm[ours.valid]).max() < 1e-12
