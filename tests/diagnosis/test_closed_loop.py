"""A rig of other code, under its own controller, that lacks nothing."""

from collections.abc import Mapping
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.reference import torque_is_referenced
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Delays, Friction, Model
from eps_hil.series import Series

pytestmark = pytest.mark.slow

NOISE = (6e-4, 0.015, 1.5e-4, 0.9)


def series(columns: Mapping[str, Any], *left_out: str, every: int = 1) -> dict[str, Series]:
    t_ns = np.round(columns["time_s"][::every] * 1e9).astype(np.int64)
    return {
        name: Series(t_ns, np.asarray(one[::every]))
        for name, one in columns.items()
        if name not in ("time_s", *left_out)
    }


def model_of(rig: Any, reference: Model, **other: float) -> Model:
    """What a file with the rig's own numbers says, but for ``other`` ones."""
    friction = Friction(rig.level_pos, rig.level_neg, rig.drag, rig.drag, rig.grows, rig.grows,
                        rig.stiffness, 0.0, 0.75)  # fmt: skip
    return replace(
        reference,
        inertia_kg_m2=rig.inertia,
        rack_to_rotor_ratio_rad_per_m=rig.ratio,
        friction=replace(friction, **other),
        delays_s=Delays(),
        effects=(),
    )


def told(
    rig: Any, model: Model, closed_loop_rig: ModuleType, *left_out: str, noise: Any = NOISE
) -> Diagnosis:
    """Of two recordings of 20 s, judged by one of 16 s."""
    one, two, kept = (
        series(closed_loop_rig.record(rig, seed, seconds, noise), *left_out)
        for seed, seconds in ((1, 20.0), (2, 20.0), (3, 16.0))
    )
    return diagnose(model, {"one": one, "two": two}, {"kept": kept})


@pytest.mark.parametrize("speed_loop", [True, False])
def test_a_held_torque_against_a_stiff_spring_is_no_drag(
    closed_loop_rig: ModuleType, reference_model: Model, speed_loop: bool
) -> None:
    """What sampling leaves of 3 Nm is more than the sensors' noise, and follows the motion."""
    rig = closed_loop_rig.Rig(
        2.5e-4, 0.106, 0.085, 2e-4, 2.9e-4, 9.9, 350.0, 1.9e4, 0.0, 50.0, speed_loop
    )
    found = told(rig, model_of(rig, reference_model), closed_loop_rig, "motor_angle_rad")
    assert found.content["verdict"] == "no_mismatch"
    assert found.problem.hidden > 0.5 * np.sum(found.problem.sliding)


def test_a_stiffer_bristle_that_no_angle_shows_is_no_other_friction(
    closed_loop_rig: ModuleType, reference_model: Model
) -> None:
    rig = closed_loop_rig.Rig(
        7.2e-5, 0.198, 0.158, 5e-4, 2.9e-4, 10.5, 350.0, 4.8e4, 0.0, 18.0, False
    )
    model = model_of(
        rig, reference_model, sigma0_nm_per_rad=6.8, offset_pos_nm=0.188, offset_neg_nm=0.15
    )
    noise = (2e-3, 0.05, 5e-4, 3.0)
    found = told(rig, model, closed_loop_rig, "motor_angle_rad", noise=noise)
    names = {one["effect"] for one in found.content["findings"]}
    assert "coulomb_level" in names
    assert names <= {"coulomb_level", "friction_asymmetry"}
    assert found.model.friction.sigma0_nm_per_rad == 6.8


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_a_weight_on_a_joint_is_a_load(
    closed_loop_rig: ModuleType, reference_model: Model, share: float
) -> None:
    """Of 4 Nm, on a joint that swings by a quarter of a turn; friction a fifth off is friction."""
    rig = closed_loop_rig.Rig(0.05, 0.3, 0.3, 0.15, 0.0, 40.0, 2513.0, 0.0, 4.0, 1.3, False)
    levels = dict.fromkeys(("offset_pos_nm", "offset_neg_nm"), share * 0.3)
    model = model_of(rig, reference_model, **levels)
    noise = (5e-3, 2e-3, 1e-4, 1.0)
    found = told(rig, model, closed_loop_rig, "rack_force_n", noise=noise)
    names = [one["effect"] for one in found.content["findings"]]
    assert names == ([] if share == 1.0 else ["coulomb_level"])
    (weight,) = (one for one in found.model.effects if one["effect"] == "empirical")
    assert weight["size"] == pytest.approx(4.0, rel=0.01)
    assert weight["phase_1"] == pytest.approx(0.4, abs=0.01)
    assert any("weight of 4 Nm" in one for one in found.content["limits"])
    figures = found.content["fit"]["holdout"]
    assert figures["augmented"]["torque_nrmse"] < 1.1 * figures["noise_floor"]["torque_nrmse"]


def test_under_a_constant_push_no_channel_has_a_gain(
    closed_loop_rig: ModuleType, reference_model: Model
) -> None:
    """The motor's torque is inertia, friction and a constant: levels that are off were its gain.

    Rig 7 of ``benchmarks/nothing_missing.py --seed 601``.
    """
    rig = closed_loop_rig.Rig(
        8.86e-5, 0.0586, 0.0563, 2.37e-4, 1.97e-4, 1.394, 1014.5, push=65.8, swing_rad=28.9,
        speed_loop=False,
    )  # fmt: skip
    model = replace(
        model_of(
            rig,
            reference_model,
            offset_pos_nm=0.65 * rig.level_pos,
            offset_neg_nm=0.65 * rig.level_neg,
            load_pos_nm_per_n=0.66 * rig.grows,
            load_neg_nm_per_n=0.66 * rig.grows,
        ),
        inertia_kg_m2=1.1 * rig.inertia,
    )
    found = told(rig, model, closed_loop_rig, noise=(1.7e-4, 0.032, 6.9e-4, 0.5))
    names = {one["effect"] for one in found.content["findings"]}
    assert {"coulomb_level", "inertia"} <= names
    assert not names & {"motor_torque_gain", "rack_ratio", "torque_sensor_gain", "unknown"}
    assert not torque_is_referenced(found.problem)


def test_less_drag_and_a_softer_bristle_are_no_delay(
    closed_loop_rig: ModuleType, reference_model: Model
) -> None:
    """Against a spring a torque that comes earlier is a drag. Rig 6 of the same seed."""
    rig = closed_loop_rig.Rig(
        5.81e-5, 0.1534, 0.1536, 4.09e-4, 1.18e-4, 2.991, 527.05, 5371.0, swing_rad=24.7
    )
    model = replace(
        model_of(
            rig,
            reference_model,
            offset_pos_nm=1.38 * rig.level_pos,
            offset_neg_nm=1.38 * rig.level_neg,
            viscous_pos_nm_s_per_rad=1.175 * rig.drag,
            viscous_neg_nm_s_per_rad=1.175 * rig.drag,
            load_pos_nm_per_n=0.674 * rig.grows,
            load_neg_nm_per_n=0.674 * rig.grows,
            sigma0_nm_per_rad=1.159 * rig.stiffness,
        ),
        inertia_kg_m2=0.665 * rig.inertia,
    )
    found = told(rig, model, closed_loop_rig, noise=(4.5e-4, 0.0179, 3.9e-4, 0.5))
    assert {one["effect"] for one in found.content["findings"]} == {
        "coulomb_level",
        "inertia",
        "load_dependent_friction",
        "presliding_hysteresis",
        "viscous_friction",
    }
