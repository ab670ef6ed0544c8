"""A channel is called wrong only where that holds in each half of a recording by itself."""

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.identification import plausibility
from eps_hil.identification.state import State
from eps_hil.physics.model import Model

N = 2000
FRICTION_NM, SPEED_RAD_S = 0.2, 10.0


def rows(sensor_nm: np.ndarray, friction_nm: np.ndarray, sign: float) -> plausibility._Rows:
    """A rotor that slides to and fro; what the torsion bar gives (at the rotor), times ``sign``."""
    rng = np.random.default_rng(3)
    way = np.where(np.arange(N) // 100 % 2, 1.0, -1.0)
    motor = friction_nm * way - sensor_nm + rng.normal(0.0, 1e-3, N)
    one = np.ones(N)
    motion = np.column_stack([0.0 * one, way, one, -one, SPEED_RAD_S * way])
    return plausibility._Rows(
        np.array([motor, sign * sensor_nm, 0.0 * one]), motion, way, np.cumsum(way) * 1e-3
    )


def judged(one: plausibility._Rows, model: Model) -> float:
    tried = plausibility._everything(State(model))
    return plausibility._check("r.csv", [one], tried, model.inertia_kg_m2, np.inf)


def test_a_torque_that_fell_as_the_friction_did_is_not_turned_round(reference_model: Model) -> None:
    """With the wrong sign it would explain that the friction fell; in no half does it explain more.

    (Issue 19: hardly excited recordings of a drive that warmed up were refused by chance.)
    """
    first = np.arange(N) < N // 2
    way = np.where(np.arange(N) // 100 % 2, 1.0, -1.0)
    fallen = rows(
        np.where(first, 0.02, 0.0) * way, np.where(first, 1.2, 1.0) * FRICTION_NM, sign=1.0
    )
    turned = plausibility._Rows(
        fallen.torques * np.array([[1.0], [-1.0], [1.0]]),
        fallen.motion,
        fallen.direction,
        fallen.place,
    )
    left = [
        plausibility._left([one], plausibility._everything(State(reference_model))[0], 1e-4)[0]
        for one in (fallen, turned)
    ]
    assert left[1] < 0.5 * left[0]
    assert judged(fallen, reference_model) == pytest.approx(left[0])


def test_a_torque_of_the_wrong_sign_is_named_in_both_halves(reference_model: Model) -> None:
    swings = 0.3 * np.sin(np.arange(N) / 70.0)
    one = rows(swings, np.full(N, FRICTION_NM), sign=-1.0)
    with pytest.raises(InputError, match="torque_sensor_nm has the wrong sign"):
        judged(one, reference_model)
