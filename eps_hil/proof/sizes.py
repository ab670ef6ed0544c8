"""The same rig in other sizes: recordings, model file and answer in another machine's numbers.

A machine whose torques are ``torque`` times, whose rotor angles ``angle`` times and whose travel is
``travel`` times those of the rack EPS obeys the same equations (1 to 3, and those of CONTRACT 8)
if every number is scaled by what its unit says. Time stays: clocks, delays and bandwidths are those
of the electronics. Power is ``torque · angle`` times as large everywhere, so a force is that over
``travel``; the pinion's angle stays, and so the torsion bar's torque grows as power does.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from eps_hil.proof.truth import Floats

_SPECIAL = {
    "phase_rad": "",
    "order": "_per_rad",
    "pole_pairs": "_per_rad",
    "belt_ratio": "_rad",
    "inertia_kg_m2": "_nm_per_rad",
    "pinion_ratio_rad_per_m": "_per_m",
    "torque_sensor_nm": "_nm_rad",
    "steering_wheel_angle_rad": "",
    "steering_wheel_speed_rad_s": "",
}
"""Numbers whose unit is not that of the rotor, of the rack or of the motor's torque."""
_OF_SENSOR = ("torque_sensor_offset", "torque_sensor_hysteresis")
"""Effects whose torque is the torsion bar's."""


@dataclass(frozen=True, slots=True)
class Size:
    """Factors to the rack EPS of ``truth.Drive``; 1 changes nothing."""

    torque: float = 1.0
    angle: float = 1.0
    travel: float = 1.0

    def factor(self, name: str) -> float:
        """What a number of that name (with the unit as its suffix) is multiplied by.

        A name that has no unit in it is a ratio, and stays.
        """
        power = self.torque * self.angle
        units = {"nm": self.torque, "rad": self.angle, "m": self.travel, "n": power / self.travel}
        factor, sign = 1.0, 1.0
        for part in _SPECIAL.get(name, f"_{name}").split("_")[1:]:
            unit = part.rstrip("23")
            if part == "per":
                sign = -1.0
            elif unit in units:
                factor *= units[unit] ** (sign * int(part[len(unit) :] or 1))
        return factor

    def columns(self, columns: Mapping[str, Floats]) -> dict[str, Floats]:
        """A recording of that machine, of the same instants."""
        return {name: values * self.factor(name) for name, values in columns.items()}

    def decimals(self, name: str, of_rack: int) -> int:
        """How many a file needs for a column that takes ``of_rack`` on the rack EPS."""
        return max(of_rack + math.ceil(-math.log10(self.factor(name))), 0)

    def parameters(self, effect: str, values: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters (CONTRACT 8) of an effect, a curve's knots among them."""
        more = self.angle if effect in _OF_SENSOR else 1.0
        scaled: dict[str, Any] = {}
        for name, value in values.items():
            if name == "curve":
                scaled[name] = [[x * self.travel, y * self.torque] for x, y in value]
            elif isinstance(value, str):
                scaled[name] = value
            else:
                scaled[name] = value * self.factor(name) * (more if name.endswith("_nm") else 1.0)
        return scaled

    def model(self, model: Mapping[str, Any]) -> dict[str, Any]:
        """The contents of a model file (CONTRACT 4) with every number that has a unit scaled."""
        scaled: dict[str, Any] = {}
        for name, value in model.items():
            if name == "effects":
                scaled[name] = [self.parameters(one["effect"], one) for one in value]
            elif isinstance(value, Mapping):
                scaled[name] = self.model(value)
            else:
                scaled[name] = type(value)(round(value * self.factor(name), 15))
        return scaled


SIZES: Mapping[str, Size] = {
    "": Size(),
    "column": Size(torque=0.4, travel=1.3),
    "axis": Size(torque=40.0, travel=12.0),
    "joint": Size(torque=60.0, angle=1.0 / 60.0, travel=2513.0 / 60.0),
}
"""By name: a column EPS's smaller motor, a machine tool's axis, a robot's joint.

The joint is told at its output: rotor and travel are one angle, torques are the gear's.
"""
