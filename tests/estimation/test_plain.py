"""Interpreted, the estimator gives the bits that its compiled code gives."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from eps_hil.estimation.batch import estimate
from eps_hil.physics.model import load_model
from eps_hil.series import Series

NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
STRIBECK = [{"effect": "stribeck", "level_nm": 0.04, "speed_rad_s": 8.0}]
PROGRAM = """
import sys
import numpy as np
from eps_hil import compiled
from eps_hil.series import Series
from eps_hil.physics.model import load_model
assert compiled.interpret()
from eps_hil.estimation.batch import estimate
from eps_hil.estimation.lanes import run
assert not hasattr(run, "overloads"), "it is compiled"
read = np.load(sys.argv[2])
names = [name for name in read if name.endswith(("nm", "rad_s", "rad"))]
found = estimate({n: Series(read["t_" + n], read[n]) for n in names if n[:2] != "t_"},
                 load_model(sys.argv[1]))
np.savez(sys.argv[3], t=found.t_ns, force=found.rack_force_n, friction=found.friction_torque_nm,
         reason=found.reason)
"""


def spoiled() -> dict[str, Series]:
    """A rotor that swings and rests; holes, NaN, a jump of the clock, a spike, a frozen torque."""
    rng = np.random.default_rng(3)
    n = 3_000
    t = np.arange(n) * 1e-3
    speed = 15.0 * np.sin(2 * np.pi * 0.7 * t) * (np.sin(2 * np.pi * 0.35 * t) > -0.3)
    values = (
        0.4 * np.sin(2 * np.pi * 0.7 * t) + rng.normal(0, 5e-3, n),
        0.8 * np.sin(2 * np.pi * 0.7 * t) + rng.normal(0, 5e-3, n),
        speed + rng.normal(0, 0.3, n),
        np.cumsum(speed) * 1e-3 + rng.normal(0, 1e-3, n),
    )
    values[0][600:604] += 1.5
    values[0][1900:2100] = values[0][1900]
    values[1][900] = np.nan
    stamps = np.arange(n, dtype=np.int64) * 1_000_000
    stamps[1300:] += 14_000_000
    stamps[2300:] += 3_000_000_000
    series = {}
    for k, (name, value) in enumerate(zip(NAMES, values, strict=True)):
        kept = np.ones(n, bool)
        kept[400 + 300 * k : 409 + 300 * k] = False
        kept &= (np.arange(n) % 2 == 0) | (k != 1)
        series[name] = Series(stamps[kept], value[kept])
    return series


@pytest.mark.slow
@pytest.mark.parametrize("effects", [[], STRIBECK])
def test_same_bits_as_compiled(tmp_path: Path, effects: list[dict[str, float | str]]) -> None:
    path = Path(__file__).parents[2] / "configs" / "reference_rig.yaml"
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content["model"]["effects"] = effects
    model = tmp_path / "model.yaml"
    model.write_text(yaml.safe_dump(content), encoding="utf-8")
    series = spoiled()
    np.savez(
        tmp_path / "read.npz",
        **{f"t_{name}": one.t_ns for name, one in series.items()},  # type: ignore[arg-type]
        **{name: one.value for name, one in series.items()},  # type: ignore[arg-type]
    )
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_DISABLE_JIT"}
    subprocess.run(
        [sys.executable, "-c", PROGRAM, model, tmp_path / "read.npz", tmp_path / "out.npz"],
        check=True, env=environment,
    )  # fmt: skip
    compiled, plain = estimate(series, load_model(model)), np.load(tmp_path / "out.npz")
    assert len(set(compiled.reason.tolist())) > 8  # much happened
    assert plain["t"].tolist() == compiled.t_ns.tolist()
    assert plain["reason"].tolist() == compiled.reason.tolist()
    np.testing.assert_array_equal(plain["force"], compiled.rack_force_n)
    np.testing.assert_array_equal(plain["friction"], compiled.friction_torque_nm)
