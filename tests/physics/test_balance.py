"""The torque balance as compiled code out of the disk cache."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from eps_hil.physics.balance import Motion, residual_nm
from eps_hil.physics.model import load_model

_MODEL = Path(__file__).parents[2] / "configs" / "reference_rig.yaml"
_AGAIN = """
import sys
import subprocess
import os
from pathlib import Path

import numpy as np
import pytest
from dataclasses import replace
from eps_hil.physics.balance import Motion, residual_nm
from eps_hil.physics.model import load_model

model = load_model({model!r})
effects = tuple(
    {{"effect": name, key: value}}
    for name, key, value in (
        ("motor_torque_gain", "gain", 1.1),
        ("torque_sensor_gain", "gain", 0.9),
        ("viscous_friction", "coefficient_nm_s_per_rad", 1e-4),
    )
)
n = np.linspace(0.0, 1.0, 50)
residual_nm(replace(model, effects=effects), Motion(*([n] * 10)))
"""


def test_read_only_arrays_are_as_good() -> None:
    """As pandas gives them; what is given is not changed."""
    model = load_model(_MODEL)
    given = np.linspace(0.0, 1.0, 50)
    expected = residual_nm(model, Motion(*([given] * 10)))
    locked = given.copy()
    locked.setflags(write=False)
    found = residual_nm(model, Motion(*([locked] * 10)))
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(locked, np.linspace(0.0, 1.0, 50))


@pytest.mark.slow
def test_a_second_process_compiles_nothing(tmp_path: Path) -> None:
    """Closures are compiled anew in every process that calls them from Python: seconds each."""
    code = _AGAIN.format(model=str(_MODEL))
    more = {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_DEBUG_CACHE": "1"}
    said = [
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, **more},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for _ in range(2)
    ]
    assert "data saved" in said[0]
    assert "data loaded" in said[1]
    assert "data saved" not in said[1]
