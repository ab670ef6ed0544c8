"""The gates of the seed paper: only while they are met may the rack force be taken as zero.

Low vehicle speed, straight driving (lateral acceleration, yaw rate), hardly any torsion-bar torque,
steering centred; and the load cell, where a rig has one. Each is judged by itself and shown with
its value and limit. A signal that is missing (NaN) meets no gate, unless the configuration says
that this rig does not have it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

from pydantic import ConfigDict, Field, with_config

from eps_hil.physics.model import Model

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
SLOWEST_FILTER_S = 1.0
"""The torque guard's longest patience (ceiling of ``heartbeat_timeout_s`` and ``…_frozen_s``)."""

_STRICT = ConfigDict(extra="forbid")


class InjectionInputs(NamedTuple):
    """The newest reported values at one sample instant; NaN where there is none.

    ``rack_position_m`` may be left out where ``motor_angle_rad`` is there: the gate then takes the
    position from the angle. ``rack_force_n`` is the rig's load cell.
    """

    motor_torque_nm: float
    motor_speed_rad_s: float
    torque_sensor_nm: float = math.nan
    motor_angle_rad: float = math.nan
    rack_position_m: float = math.nan
    vehicle_speed_m_s: float = math.nan
    lateral_acceleration_m_s2: float = math.nan
    yaw_rate_rad_s: float = math.nan
    rack_force_n: float = math.nan


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class GateLimit:
    """|value − centre| must stay below ``limit`` (in the signal's unit).

    ``absent``: this rig has no such signal, so its silence does not count as not met; once the
    signal has come after all, it is judged, and missed when it goes. ``filter_s``:
    time constant of a low-pass before the comparison, for a signal as noisy as its limit; at most
    1 s, the longest that the torque guard waits for any sign of life: a slower gate would find a
    car that turns, or a hand, when the ramp is over.
    """

    limit: Positive
    absent: bool = False
    filter_s: Annotated[float, Field(ge=0, le=SLOWEST_FILTER_S)] = 0.0
    centre: Annotated[float, Field(allow_inf_nan=False)] = 0.0


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class GateSettings:
    """Limits of all gates; the first four are the seed paper's figures."""

    vehicle_speed_m_s: GateLimit = field(default_factory=lambda: GateLimit(20.0))
    lateral_acceleration_m_s2: GateLimit = field(
        default_factory=lambda: GateLimit(0.05, filter_s=0.3)
    )
    torque_sensor_nm: GateLimit = field(default_factory=lambda: GateLimit(1.0))
    yaw_rate_rad_s: GateLimit = field(default_factory=lambda: GateLimit(0.01, filter_s=0.1))
    rack_position_m: GateLimit = field(default_factory=lambda: GateLimit(0.005))
    rack_force_n: GateLimit = field(
        default_factory=lambda: GateLimit(20.0, absent=True, filter_s=0.05)
    )


class GateState(NamedTuple):
    """One gate as a person sees it: what is compared with what, and whether it holds.

    ``value`` is NaN where the signal is missing.
    """

    name: str
    value: float
    limit: float
    unit: str
    met: bool


_UNITS = {
    "vehicle_speed_m_s": "m/s",
    "lateral_acceleration_m_s2": "m/s^2",
    "yaw_rate_rad_s": "rad/s",
    "torque_sensor_nm": "Nm",
    "rack_position_m": "m",
    "rack_force_n": "N",
}
GATES = tuple(_UNITS)
"""Names of the gates, in the order in which they are shown."""


class Gates:
    """The gates at work: :meth:`update` once per sample, then read :attr:`states`."""

    def __init__(self, settings: GateSettings, model: Model) -> None:
        self._limits: Mapping[str, GateLimit] = {name: getattr(settings, name) for name in GATES}
        self._ratio = model.rack_to_rotor_ratio_rad_per_m
        self._filtered = dict.fromkeys(GATES, math.nan)
        self._seen: set[str] = set()
        self.states: tuple[GateState, ...] = tuple(self._state(name, math.nan) for name in GATES)

    @property
    def met(self) -> bool:
        """Whether every gate holds."""
        return all(state.met for state in self.states)

    @property
    def closed(self) -> tuple[str, ...]:
        """Names of the gates that do not hold."""
        return tuple(state.name for state in self.states if not state.met)

    def update(self, dt_s: float, inputs: InjectionInputs) -> tuple[GateState, ...]:
        """Take the values of the sample ``dt_s`` after the one before."""
        position = inputs.rack_position_m
        if math.isnan(position):
            position = inputs.motor_angle_rad / self._ratio
        values = (
            inputs.vehicle_speed_m_s,
            inputs.lateral_acceleration_m_s2,
            inputs.yaw_rate_rad_s,
            inputs.torque_sensor_nm,
            position,
            inputs.rack_force_n,
        )
        self.states = tuple(
            [
                self._state(name, self._low_pass(name, value, dt_s))
                for name, value in zip(GATES, values, strict=True)
            ]
        )
        return self.states

    def _low_pass(self, name: str, value: float, dt_s: float) -> float:
        """The filtered value; a missing sample is missing at once, and the filter starts anew."""
        tau_s, before = self._limits[name].filter_s, self._filtered[name]
        if tau_s > 0.0 and math.isfinite(before) and math.isfinite(value):
            value = before + (value - before) * -math.expm1(-dt_s / tau_s)
        self._filtered[name] = value
        return value

    def _state(self, name: str, value: float) -> GateState:
        gate = self._limits[name]
        if math.isnan(value):
            met = gate.absent and name not in self._seen
        else:
            self._seen.add(name)
            met = abs(value - gate.centre) < gate.limit
        return GateState(name, value, gate.limit, _UNITS[name], met)
