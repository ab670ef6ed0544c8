"""The model file's own numbers from one recording: what is no missing physics is not to look so."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.axis.emps import ARM_M
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

_FRICTION = (
    "offset_pos_nm",
    "offset_neg_nm",
    "viscous_pos_nm_s_per_rad",
    "viscous_neg_nm_s_per_rad",
    "sigma0_nm_per_rad",
)
_OUTLIER_N = 1.0
"""Residuals beyond this count linearly: they are what the structure cannot follow."""


def identify(prepared: Prepared, model: Model) -> Model:
    """Inertia, both directions' offset and viscous friction, and bristle, by least squares.

    A skew of the motor torque is fitted beside them, unless ``model`` has one among its effects,
    so that it does not bend them; it is left to the diagnosis to find.
    """
    from scipy.optimize import least_squares

    skewed = any(entry["effect"] == "motor_torque_delay" for entry in model.effects)

    def left(x: Floats) -> Floats:
        trial = _with(model, x)
        if not skewed:
            trial = replace(trial, effects=(*trial.effects, _skew(x)))
        return np.asarray(prepared.residual(trial)[0] / ARM_M)

    start = np.zeros(len(_FRICTION) + 2)
    found = least_squares(
        left, start, loss="soft_l1", f_scale=_OUTLIER_N, diff_step=1e-3, x_scale=0.1
    )
    return _with(model, found.x)


def _with(model: Model, x: Floats) -> Model:
    """Every number times exp(x): positive whatever a step of the fit may be."""
    scale = np.exp(np.clip(x, -3.0, 3.0))
    numbers = {
        name: float(getattr(model.friction, name) * scale[k + 1])
        for k, name in enumerate(_FRICTION)
    }
    return replace(
        model,
        inertia_kg_m2=float(model.inertia_kg_m2 * scale[0]),
        friction=replace(model.friction, **numbers),
    )


def _skew(x: Floats) -> Mapping[str, Any]:
    return {"effect": "motor_torque_delay", "delay_s": float(np.clip(1e-2 * x[-1], -0.02, 0.02))}


def axis_numbers(model: Model) -> dict[str, float]:
    """The identified numbers in units of the axis."""
    friction = model.friction
    return {
        "mass_kg": model.inertia_kg_m2 / ARM_M**2,
        "coulomb_pos_n": friction.offset_pos_nm / ARM_M,
        "coulomb_neg_n": friction.offset_neg_nm / ARM_M,
        "viscous_pos_n_s_per_m": friction.viscous_pos_nm_s_per_rad / ARM_M**2,
        "viscous_neg_n_s_per_m": friction.viscous_neg_nm_s_per_rad / ARM_M**2,
        "bristle_n_per_m": friction.sigma0_nm_per_rad / ARM_M**2,
    }
