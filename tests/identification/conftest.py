"""Recordings of the truth plant (``eps_hil.proof``), which shares no code with what is tested."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.truth import Drive
from eps_hil.proof.world import Instruments, World
from eps_hil.series import Series

Recordings = dict[str, dict[str, Series]]
SPEED_LATE_S, TORQUE_LATE_S = 0.0052, 0.0007
TRUE = Drive(
    inertia_kg_m2=2.15e-4,
    k0_pos=0.075,
    k0_neg=0.085,
    kw_pos=3.0e-4,
    kw_neg=1.5e-4,
    kr_pos=3.5e-5,
    kr_neg=5.6e-5,
    sigma0=5.5,
    sigma1=0.09,
)
"""Off the reference rig's model file by up to two fifths."""


@pytest.fixture(scope="session")
def true() -> Drive:
    return TRUE


@pytest.fixture(scope="session")
def record() -> Callable[..., Recordings]:
    """``record({"sweep": 20.0}, simple=True, seed=1)`` -> recordings by name of manoeuvre."""

    def make(
        what: Mapping[str, float], simple: bool = True, seed: int = 1, **instruments: Any
    ) -> Recordings:
        rng = np.random.default_rng(seed)
        world = World(simple=simple, drive=TRUE)
        made: Recordings = {}
        for name, seconds in what.items():
            truth = world.run(getattr(manoeuvres, name)(rng, seconds))
            late_s = SPEED_LATE_S - sensors.SPEED_LATE_S
            i = Instruments(speed_late_s=late_s, **instruments)
            clean = sensors.reported(truth, i)
            clean["motor_torque_nm"] = sensors.late(truth["motor_torque_nm"], TORQUE_LATE_S)
            columns = sensors.measured(clean, i, rng)
            t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
            made[name] = {key: Series(t_ns, v) for key, v in columns.items() if key != "time_s"}
        return made

    return make


@pytest.fixture(scope="session")
def programme(record: Callable[..., Recordings]) -> Recordings:
    """Constant speeds under preloads, a sweep and slow reversals: 85 s."""
    return record({"constant_speed": 45.0, "sweep": 20.0, "slow_reversals": 20.0})
