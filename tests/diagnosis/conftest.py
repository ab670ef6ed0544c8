"""Recordings of a rig of other code whose missing physics is known."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.physics.model import Delays, Model
from eps_hil.series import Series

Recordings = Mapping[str, Mapping[str, Series]]


@pytest.fixture(scope="session")
def record(other_rig: ModuleType) -> Callable[..., Recordings]:
    """``record(plant, manoeuvres, seed, **sensors)`` -> recordings by name."""

    def make(
        plant: Mapping[int, float],
        manoeuvres: tuple[str, ...] = ("sweep", "weave", "slow"),
        seed: int = 1,
        noise: float = 1.0,
        seconds: float = 15.0,
        **sensors: Any,
    ) -> Recordings:
        made = {}
        for k, manoeuvre in enumerate(manoeuvres):
            columns = other_rig.record(
                other_rig.Effects(plant, **sensors), manoeuvre, 100 * seed + k, noise, seconds
            )
            t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
            made[f"{manoeuvre}_{seed}"] = {
                name: Series(t_ns, values) for name, values in columns.items() if name != "time_s"
            }
        return made

    return make


@pytest.fixture
def fitted_and_kept(
    record: Callable[..., Recordings], reference_model: Model
) -> Callable[[Mapping[int, float]], tuple[Problem, list[Holdout]]]:
    """Two recordings of a plant as a problem of the reference model, one more to judge by."""

    def make(plant: Mapping[int, float]) -> tuple[Problem, list[Holdout]]:
        fitted, kept = (
            [(prepare(name, one), one) for name, one in record(plant, programme, seed).items()]
            for programme, seed in ((("sweep", "weave"), 1), (("weave",), 2))
        )
        return Problem([one for one, _ in fitted], reference_model), [Holdout(*one) for one in kept]

    return make


@pytest.fixture(scope="session")
def problem(
    record: Callable[..., Recordings], reference_model: Model, other_rig: ModuleType
) -> Problem:
    """Recordings of a rig with a Stribeck effect, against a model without one."""
    plant = {other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0}
    recordings = record(plant, ("sweep", "weave"), seconds=12.0)
    return Problem([prepare(name, one) for name, one in recordings.items()], reference_model)


@pytest.fixture
def pushed(
    closed_loop_rig: ModuleType, reference_model: Model
) -> tuple[Any, Model, dict[str, dict[str, Series]]]:
    """A rig under a push that hardly changes, a model whose numbers are off, three recordings."""
    rig = closed_loop_rig.Rig(
        inertia=7.1e-5, level_pos=0.199, level_neg=0.235, drag=1.3e-4, grows=2.7e-4,
        stiffness=18.0, ratio=400.0, push=170.0, swing_rad=10.5, speed_loop=True,
    )  # fmt: skip
    friction = replace(
        reference_model.friction,
        offset_pos_nm=0.224, offset_neg_nm=0.264, load_pos_nm_per_n=1.7e-4,
        load_neg_nm_per_n=1.7e-4, viscous_pos_nm_s_per_rad=1.4e-4,
        viscous_neg_nm_s_per_rad=1.4e-4, sigma0_nm_per_rad=15.0, sigma1_nm_s_per_rad=0.0,
    )  # fmt: skip
    model = replace(reference_model, inertia_kg_m2=8.3e-5, rack_to_rotor_ratio_rad_per_m=400.0,
                    friction=friction, delays_s=Delays(), effects=())  # fmt: skip
    made = {}
    for seed in (1, 2, 3):
        columns = closed_loop_rig.record(rig, seed, 20.0, (1e-3, 0.03, 3e-4, 0.5))
        t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
        columns.pop("motor_angle_rad")
        made[str(seed)] = {name: Series(t_ns, one) for name, one in columns.items()}
    return rig, model, made
