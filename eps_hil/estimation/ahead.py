"""Compile the estimator for whoever comes next: ``python -m eps_hil.estimation.ahead``.

Done by one process at a time, at low priority; a second one ends at once.
"""

import contextlib
import fcntl
import os

import numpy as np

from eps_hil import compiled
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.stream import SIGNALS, Lanes, StreamEstimator
from eps_hil.examples import CONFIGS
from eps_hil.physics.model import load_model


def main() -> None:
    """The batch run first, then what a live service calls."""
    if compiled.FOLDER is None:
        return
    with (compiled.FOLDER / "ahead.lock").open("w") as lock, contextlib.suppress(BlockingIOError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.nice(5)
        model = load_model(CONFIGS / "reference_rig.yaml")
        stream = StreamEstimator(model, EstimatorSettings(), dict.fromkeys(SIGNALS, 1e-3))
        sample = np.zeros(1, np.int64)
        stream.run(Lanes(sample, np.zeros(1), np.zeros(6, np.int64), np.array([1, 0, 0, 0, 0, 1])))
        stream.warm_up()


if __name__ == "__main__":
    main()
