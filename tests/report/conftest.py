"""Diagnoses that pages are drawn from."""

from collections.abc import Callable

import numpy as np
import pytest

from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model
from eps_hil.proof import sensors
from eps_hil.proof.programmes import programme
from eps_hil.proof.world import World
from eps_hil.series import Series


@pytest.fixture(scope="session")
def diagnosed_world(reference_model: Model) -> Callable[[World], Diagnosis]:
    """A diagnosis of a world of the proof's plant, driven through its training programme."""

    def at(rig: World) -> Diagnosis:
        rng = np.random.default_rng(8)
        made = {}
        for name, program in zip("abk", programme("training", rng), strict=True):
            clean = sensors.reported(rig.run(program), rig.instruments)
            columns = sensors.measured(clean, rig.instruments, rng)
            t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
            made[name] = {key: Series(t_ns, value) for key, value in columns.items()}
        return diagnose(reference_model, {k: made[k] for k in "ab"}, {"k": made["k"]})

    return at
