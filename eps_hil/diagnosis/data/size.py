"""How large a machine is beside the drive that thresholds and starting shapes were written for.

Every threshold, bound or starting value of the diagnosis that has a unit of torque, angle or place
is that of a steering drive of ordinary size. A drive that turns, pushes or travels far more or less
(an axis, a joint, a motor behind a notional gear, a rack in other units) has its own, in proportion
to its recordings, so that saying the same motion in other units changes no verdict.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from eps_hil.physics.effects.effect import Effect, Parameter, Slot
from eps_hil.physics.model import Model

if TYPE_CHECKING:
    from eps_hil.diagnosis.data.prepare import Prepared

Floats = npt.NDArray[np.float64]

SPEED_RAD_S, TORQUE_NM, PLACE_M = 25.0, 0.25, 0.005
"""Root mean squares of an ordinary drive's recordings: rotor speed, the largest torque at the
rotor, the rack about its mean."""
AS_ORDINARY = 3.0
"""Factor within which a drive counts as of ordinary size: manoeuvres differ by as much."""


@dataclass(frozen=True, slots=True)
class Size:
    """Angles and torques at the rotor, and places of the rack, beside those of an ordinary drive.

    Times are the same for all.
    """

    angle: float = 1.0
    torque: float = 1.0
    place: float = 1.0

    @property
    def power(self) -> float:
        """Also of torques at the column, whose angles are the same for all."""
        return self.angle * self.torque

    def of(self, parameter: Parameter, effect: Effect) -> float:
        """What the ordinary drive's value of an effect's parameter is multiplied with."""
        factor = 1.0
        at_column = effect.slot is Slot.SENSOR
        for unit, power in parameter.dimensions.items():
            size = {
                "Nm": self.power if at_column else self.torque,
                "rad": self.angle,
                "m": self.place,
                "N": self.power / self.place,
            }[unit]
            factor *= size**power
        return factor

    def bounds(self, parameter: Parameter, effect: Effect) -> tuple[float, float]:
        """Between which values a parameter is looked for."""
        factor = self.of(parameter, effect)
        return factor * parameter.lower, factor * parameter.upper


ORDINARY = Size()


def size_of(recordings: Sequence["Prepared"], model: Model) -> Size:
    """The size of a machine by all its recordings; ordinary where nothing moves."""
    ratio = model.rack_to_rotor_ratio_rad_per_m

    def rms(signal: Callable[["Prepared"], Floats | None]) -> float:
        found = [values for one in recordings if (values := signal(one)) is not None]
        return float(np.sqrt(np.mean(np.concatenate(found) ** 2))) if found else 0.0

    def raw(name: str, factor: float = 1.0) -> Callable[["Prepared"], Floats | None]:
        return lambda one: factor * one.raw[name] if name in one.raw else None

    def place(one: "Prepared") -> Floats | None:
        if "rack_position_m" in one.raw:
            x = one.raw["rack_position_m"]
        elif "motor_angle_rad" in one.raw:
            x = one.raw["motor_angle_rad"] / ratio
        else:
            return None
        return np.asarray(x - np.mean(x))

    torques = (
        rms(raw("motor_torque_nm")),
        rms(raw("torque_sensor_nm", model.sensor_to_rotor)),
        rms(raw("rack_force_n", 1.0 / ratio)),
    )
    return Size(
        _beside(rms(raw("motor_speed_rad_s")), SPEED_RAD_S),
        _beside(max(torques), TORQUE_NM),
        _beside(rms(place), PLACE_M),
    )


def _beside(found: float, ordinary: float) -> float:
    beside = found / ordinary
    if not np.isfinite(beside) or beside <= 0.0 or 1 / AS_ORDINARY <= beside <= AS_ORDINARY:
        return 1.0
    return beside
