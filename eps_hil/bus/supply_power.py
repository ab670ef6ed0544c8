"""Motor torque from the power that a steering module draws: where no phase current is on the bus.

Many production cars publish the module's *supply* current. It has no sign, it is nearly zero in
a stalled motor, and a torque constant makes nothing of it. Its power does, while the wheel turns:

    efficiency · (U·I − standby) = T · ω

which says nothing near ω = 0, where the power is all losses. There an assist law, rotor torque
in proportion to the torsion-bar torque, bridges the reversal. The two are joined by least squares:

    T = (P·ω + ω_b² · g · T_sen) / (ω² + ω_b²)

Far above the blend speed ω_b this is P/ω, at rest it is g·T_sen. An energy balance, not a
measurement of torque: good for the size and shape of a rack force, not for a calibration.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import ConfigDict, Field, with_config

from eps_hil.bus.message_decoder import Sample

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]

CURRENT, VOLTAGE = "supply_current_a", "supply_voltage_v"
"""Under these names the decoder reads what the torque is made of."""

_REMEMBERED = 256
_Point = tuple[int, float]


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class SupplyPower:
    """How the torque follows from the supply: the block ``supply_power`` of a mapping.

    ``message`` carries both ``current`` (A) and ``voltage`` (V). ``assist_gain`` is rotor torque
    per torsion-bar torque (Nm/Nm). ``lag_s``: how far the current runs behind torque and angle;
    the torque so found speaks of that earlier instant, so the model file's
    ``delays_s.motor_torque`` must be the same.
    """

    message: str
    current: str
    voltage: str
    assist_gain: Positive
    blend_speed_rad_s: Positive
    efficiency: Annotated[float, Field(gt=0, le=1)] = 1.0
    standby_w: NotNegative = 0.0
    lag_s: Annotated[float, Field(ge=0, lt=0.2)] = 0.0
    window_s: Annotated[float, Field(gt=0, le=0.1)] = 0.03

    def torque_nm(self, power_w: float, speed_rad_s: float, sensor_nm: float) -> float:
        """Rotor torque in Nm for supply power, rotor speed and torsion-bar torque of one instant.

        What the motor gives back to the supply has lost on its way out instead of on its way in.
        """
        net = power_w - self.standby_w
        shaft = net * self.efficiency if net > 0 else net / self.efficiency
        weight = self.blend_speed_rad_s * self.blend_speed_rad_s
        return (shaft * speed_rad_s + weight * self.assist_gain * sensor_nm) / (
            speed_rad_s * speed_rad_s + weight
        )


class SupplyPowerTorque:
    """Remembers the last angles and torsion-bar torques, and pairs each power with its instant."""

    def __init__(self, law: SupplyPower) -> None:
        self.law = law
        self._lag_ns = round(law.lag_s * 1e9)
        self._half_ns = round(law.window_s * 0.5e9)
        self._angle: deque[_Point] = deque(maxlen=_REMEMBERED)
        self._sensor: deque[_Point] = deque(maxlen=_REMEMBERED)

    def replace(self, samples: Sequence[Sample]) -> list[Sample]:
        """The samples of one frame, with the motor torque in place of current and voltage."""
        kept: list[Sample] = []
        supply: dict[str, float] = {}
        stamp = 0
        for sample in samples:
            if sample.signal in (CURRENT, VOLTAGE):
                supply[sample.signal], stamp = sample.value, sample.t_ns
                continue
            kept.append(sample)
            if sample.signal == "motor_angle_rad":
                self.see_angle(sample.t_ns, sample.value)
            elif sample.signal == "torque_sensor_nm":
                self.see_sensor(sample.t_ns, sample.value)
        if supply:
            value = self.torque_nm(
                stamp, supply.get(CURRENT, math.nan), supply.get(VOLTAGE, math.nan)
            )
            if value is not None:
                kept.append(Sample("motor_torque_nm", stamp, value))
        return kept

    def see_angle(self, t_ns: int, angle_rad: float) -> None:
        """A sample of the rotor angle."""
        _remember(self._angle, t_ns, angle_rad)

    def see_sensor(self, t_ns: int, torque_nm: float) -> None:
        """A sample of the torsion-bar torque."""
        _remember(self._sensor, t_ns, torque_nm)

    def torque_nm(self, t_ns: int, current_a: float, voltage_v: float) -> float | None:
        """Rotor torque in Nm at ``t_ns − lag``; None until angle and sensor reach around it.

        Only samples already seen are used, so live and replay agree. NaN where an input was bad.
        """
        at = t_ns - self._lag_ns
        # The newest angle may be younger than the window allows: then the window moves, not waits.
        half = self._half_ns
        newest = self._angle[-1][0] if self._angle else at
        end = min(at + half, newest)
        later, earlier = _value_at(self._angle, end), _value_at(self._angle, end - 2 * half)
        sensor = _value_at(self._sensor, at)
        if later is None or earlier is None or sensor is None:
            return None
        speed = (later - earlier) / (2e-9 * half)
        return self.law.torque_nm(current_a * voltage_v, speed, sensor)


def _remember(points: deque[_Point], t_ns: int, value: float) -> None:
    """Append; a stamp that does not come after the last begins anew."""
    if points and t_ns <= points[-1][0]:
        points.clear()
    points.append((t_ns, value))


def _value_at(points: deque[_Point], t_ns: int) -> float | None:
    """Straight line between the samples around ``t_ns``; None outside what is remembered."""
    after: _Point | None = None
    for t, value in reversed(points):
        if t == t_ns:
            return float(value)
        if t < t_ns:
            if after is None:
                return None
            return float(value + (after[1] - value) * ((t_ns - t) / (after[0] - t)))
        after = (t, value)
    return None
