"""Compile the estimator for whoever comes next: ``python -m eps_hil.estimation.ahead``.

Done by one process at a time, at low priority; a second one ends at once.
"""

import contextlib
import fcntl
import os
from dataclasses import replace
from typing import Any

import numpy as np

from eps_hil import compiled
from eps_hil.estimation.batch import lanes
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.stream import SIGNALS, StreamEstimator
from eps_hil.examples import CONFIGS
from eps_hil.physics.model import load_model
from eps_hil.series import Series


def main() -> None:
    """The batch run first, then what a live service calls, then the run with added effects."""
    if compiled.FOLDER is None:
        return
    with (compiled.FOLDER / "ahead.lock").open("w") as lock, contextlib.suppress(BlockingIOError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.nice(5)
        model = load_model(CONFIGS / "reference_rig.yaml")
        effect: dict[str, Any] = {"effect": "viscous_friction", "coefficient_nm_s_per_rad": 1e-4}
        once = Series(np.arange(2), np.zeros(2))
        drive = dict.fromkeys(("motor_torque_nm", "motor_speed_rad_s"), once)
        for rig in (model, replace(model, effects=(effect,))):
            stream = StreamEstimator(rig, EstimatorSettings(), dict.fromkeys(SIGNALS, 1e-3))
            stream.run(lanes(drive))
            if rig is model:
                stream.warm_up()


if __name__ == "__main__":
    main()
