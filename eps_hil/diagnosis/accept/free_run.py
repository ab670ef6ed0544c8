"""Simulation of whole hold-outs from their first state: what a balance forgives, this adds up.

A constant of a few mNm is nothing in the torque balance and metres in a free run (issue 20).
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.physics.balance import Motion as Measured
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.friction import friction_law, static_level_nm
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import Motion as Simulated
from eps_hil.physics.simulate import simulate

if TYPE_CHECKING:
    from eps_hil.diagnosis.accept.proof_of_fit import Holdout

Floats = npt.NDArray[np.float64]

_FIGURES = (("speed_rmse_rad_s", "speed", "rad/s"), ("angle_rmse_rad", "angle", "rad"))
_WORSE = 1.05
"""Times the error that it was, from which a worse free run is said."""


def free_run(holdouts: "Sequence[Holdout]", model: Model) -> dict[str, float | None]:
    """``speed_rmse_rad_s`` and ``angle_rmse_rad`` over all hold-outs (CONTRACT 7); null: none.

    Driven by the recorded torques and rack force; nothing else is fed back.
    """
    pairs = each(lambda one: _errors(one, model), holdouts)
    speed, angle = (np.concatenate([np.zeros(0), *(p[k] for p in pairs)]) for k in (0, 1))
    return {"speed_rmse_rad_s": _rms(speed), "angle_rmse_rad": _rms(angle)}


def worse_free_run(told: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """A sentence where hold-outs (``fit.holdout``) simulated freely end further off than before."""
    runs = [told[one].get("free_run", {}) for one in ("baseline", "augmented")]
    further = [
        f"{words} {after:.3g} {unit} off, {before:.3g} {unit} without"
        for name, words, unit in _FIGURES
        for before, after in [tuple(run.get(name) for run in runs)]
        if before is not None and after is not None and after > _WORSE * before
    ]
    balance = [told[one]["torque_nrmse"] for one in ("baseline", "augmented")]
    if not further or not balance[1] < balance[0]:
        return []
    return [
        "Balance and free run disagree: the torque balance is better with the findings, but a "
        f"simulation of the whole hold-outs is not ({'; '.join(further)}). Nothing holds a free "
        "run, so it adds up what stays small in the balance, a constant first of all."
    ]


def simulated(motion: Measured, model: Model, part: slice) -> Simulated:
    """``part`` of a recording simulated freely from its first measured state.

    The bristle begins as it is while sliding at the measured speed.
    """
    model = with_model_effects(model)
    law, speed = friction_law(model.friction), float(motion.speed_rad_s[part][0])
    level = static_level_nm(speed, float(motion.rack_force_n[part][0]), law)
    return simulate(
        model,
        motion.time_s[part],
        motion.motor_torque_nm[part],
        motion.torque_sensor_nm[part],
        motion.rack_force_n[part],
        speed_rad_s=speed,
        angle_rad=float(motion.angle_rad[part][0]),
        bristle_rad=float(np.sign(speed) * level / law.sigma0_nm_per_rad),
    )


def _errors(one: "Holdout", model: Model) -> tuple[Floats, Floats]:
    motion = one.prepared.motion(with_model_effects(model))
    run = simulated(motion, model, slice(None))
    bad = np.zeros(len(motion.time_s), bool)
    if one.quality is not None:
        bad = one.quality.bad_at(motion.time_s)
    return (
        np.asarray((run.speed_rad_s - motion.speed_rad_s)[~bad]),
        np.asarray((run.angle_rad - motion.angle_rad)[~bad]),
    )


def _rms(error: Floats) -> float | None:
    found = float(np.sqrt(np.mean(error**2))) if len(error) else np.inf
    return found if np.isfinite(found) else None
