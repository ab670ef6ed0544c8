"""A recording's inputs through the model, reported as the rig's sensors would report them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import rack_position_m, simulate
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]


class InputMissingError(Exception):
    """The recording lacks what drives the model."""


@dataclass(frozen=True, slots=True)
class Forward:
    """Simulated canonical columns at stamps ``t_ns``, all shape (n,); ``notes`` for the user."""

    t_ns: Stamps
    columns: Mapping[str, Floats]
    notes: tuple[str, ...]


def forward(model: Model, series: Mapping[str, Series], *, physical: bool = False) -> Forward:
    """Simulate the 1-mass model under recorded motor torque, torsion-bar torque and rack force.

    Inputs are first put back to their physical instants by the model file's delays. The results
    are given at the motor torque's stamps: as reported (late by their own delays), or with
    ``physical`` as they are at that instant. The run starts at the recorded speed and angle.
    """
    if "motor_torque_nm" not in series:
        raise InputMissingError("a simulation needs motor_torque_nm")
    notes = [
        f"no {name}: taken as zero"
        for name in ("torque_sensor_nm", "rack_force_n")
        if name not in series
    ]
    t_ns = series["motor_torque_nm"].t_ns
    model = with_model_effects(model)
    motor, sensor, force = (
        _physical(series, name, t_ns, model)
        for name in ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")
    )
    seconds = (t_ns - t_ns[0]) * 1e-9
    motion = simulate(
        model,
        seconds,
        motor,
        sensor,
        force,
        speed_rad_s=float(_physical(series, "motor_speed_rad_s", t_ns[:1], model)[0]),
        angle_rad=float(_physical(series, "motor_angle_rad", t_ns[:1], model)[0]),
    )
    columns = {
        "motor_torque_nm": motor,
        "torque_sensor_nm": sensor,
        "motor_speed_rad_s": motion.speed_rad_s,
        "motor_angle_rad": motion.angle_rad,
        "rack_force_n": force,
        "rack_position_m": rack_position_m(model, motion.rack_rad),
        "friction_torque_nm": motion.friction_torque_nm,
    }
    if not physical:
        columns = {
            name: np.interp(seconds - model.delays_s.of(name), seconds, column)
            for name, column in columns.items()
        }
    return Forward(t_ns, columns, tuple(notes))


def _physical(series: Mapping[str, Series], name: str, t_ns: Stamps, model: Model) -> Floats:
    """A signal's values at physical instants ``t_ns``; zero where it was not recorded."""
    if name not in series:
        return np.zeros(len(t_ns))
    one = series[name]
    good = np.isfinite(one.value)
    if not good.any():
        return np.zeros(len(t_ns))
    late = round(model.delays_s.of(name) * 1e9)
    origin = one.t_ns[0]
    return np.asarray(np.interp(t_ns + late - origin, one.t_ns[good] - origin, one.value[good]))
