"""docs/howto-add-an-effect.md does what it says: its file works in a copy of the package."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "howto-add-an-effect.md"

CHECK = """
import dataclasses, math
import numpy as np
import yaml
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.attribute.select import select
from eps_hil.physics.balance import residual_nm
from eps_hil.physics.effects import added
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Instant
from eps_hil.physics.model import Delays, load_model
from eps_hil.series import Series

(entry,) = yaml.safe_load(open("entry.yaml"))["effects"]
plain = dataclasses.replace(load_model("rig.yaml"), delays_s=Delays())
true = dataclasses.replace(plain, effects=(entry,))
table = added.added(true)
for speed in (-60.0, -3.0, 0.0, 25.0, 100.0):
    got = added.torque_nm(table, Instant(0, speed, 0, 0, 0, 0, 0, 0, 1.0), 0.1)
    relative = speed / 25.0
    assert math.isclose(got, 0.1 + 0.04 * 2 * relative / (1 + relative**2)), (speed, got)

t = np.arange(0.0, 20.0, 1e-3)
t_ns = np.round(t * 1e9).astype(np.int64)
rng = np.random.default_rng(0)
recordings = []
for k in range(2):
    waves = [(60.0, 0.31 + 0.1 * k), (40.0, 0.83), (15.0, 1.9)]
    clean = {
        "motor_torque_nm": np.zeros(len(t)),
        "rack_force_n": 400.0 * np.sin(2 * np.pi * 0.23 * t),
        "motor_speed_rad_s": sum(a * np.sin(2 * np.pi * f * t + k) for a, f in waves),
    }
    one = prepare(str(k), {n: Series(t_ns, v) for n, v in clean.items()})
    # the motor torque that this motion takes on a rig with the effect
    clean["motor_torque_nm"] = -residual_nm(true, one.motion(true))[0]
    sigma = {"motor_torque_nm": 3e-3, "motor_speed_rad_s": 0.2, "rack_force_n": 4.0}
    noisy = {n: Series(t_ns, v + sigma[n] * rng.standard_normal(len(t))) for n, v in clean.items()}
    recordings.append(prepare(str(k), noisy))
found = select(Problem(recordings, plain)).found.entries
(brake,) = [one for one in found if one["effect"] == "eddy_brake"]
assert abs(brake["peak_nm"] - 0.04) < 0.004, found
sentence, values = catalogue()["eddy_brake"].wording(brake)
assert sentence.format(**values).startswith("Eddy currents brake")
"""


def block(language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    return found.group(1)


@pytest.mark.slow
def test_the_worked_example_works(tmp_path: Path) -> None:
    shutil.copytree(
        ROOT / "eps_hil", tmp_path / "eps_hil", ignore=shutil.ignore_patterns("__pycache__")
    )
    effect = tmp_path / "eps_hil" / "physics" / "effects" / "eddy_brake.py"
    effect.write_text(block("python"), encoding="utf-8")
    (tmp_path / "entry.yaml").write_text(block("yaml"), encoding="utf-8")
    shutil.copy(ROOT / "configs" / "reference_rig.yaml", tmp_path / "rig.yaml")
    (tmp_path / "check.py").write_text(CHECK, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "check.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
