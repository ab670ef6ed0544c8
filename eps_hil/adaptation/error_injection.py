"""Error injection (PAPER fig. 13): let driver and motor move the rack, and integrate the error.

With the rack force taken as zero (same gates as torque injection), the torque into the system less
J ω̇ must be the friction. What the friction model is short of it, times a gain, goes into an
integrator per direction; only while the speed and the bristle agree in sign, because in a small
movement the hysteresis says nothing of the level. No I/O, no clock; nothing is applied by itself.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

from pydantic import ConfigDict, Field, with_config

from eps_hil.adaptation.aligned import Aligned
from eps_hil.adaptation.gates import (
    Gates,
    GateSettings,
    GateState,
    InjectionInputs,
    NotNegative,
    Positive,
)
from eps_hil.estimation.levels import FrictionLevels
from eps_hil.physics.friction import bristle_step, friction_law, friction_torque_nm, static_level_nm
from eps_hil.physics.model import Model

_GAP_S = 0.02
_CLEAR_LAGS = 3.0
"""Lags of the speed's filter before and after a reversal in which its friction is still mixed."""


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class ErrorInjectionSettings:
    """Settings of :class:`ErrorInjection`; torques and speeds at the rotor."""

    gain_per_s: Positive = 2.0
    """g_k: the error's time constant is 1/g_k of sliding time."""
    least_factor: Annotated[float, Field(gt=0, le=1)] = 0.3
    most_factor: Annotated[float, Field(ge=1)] = 3.0
    """Limits of both integrators, as multiples of the model's k0±."""
    speed_rad_s: NotNegative = 1.0
    """Slower than this (smoothed) the sign of the speed is not known."""
    bristle_share: Annotated[float, Field(ge=0, lt=1)] = 0.9
    """Share of its limit to which the bristle must be bent; 0: only the signs count, as in the
    paper (it then learns from presliding too, where the level does not show)."""
    speed_filter_s: Positive = 0.01
    gates: GateSettings = field(default_factory=GateSettings)


class ErrorInjectionState(NamedTuple):
    """Levels as they stand; ``direction`` (+1, −1, 0) tells which integrator is running.

    ``error_nm`` is the torque that the friction model is short of (0 where nothing runs);
    ``time_pos_s`` and ``time_neg_s`` are how long each integrator has run in all.
    """

    levels: FrictionLevels
    direction: int
    error_nm: float
    time_pos_s: float
    time_neg_s: float
    at_limit: bool


class ErrorInjection:
    """The integrators at work: :meth:`step` per sample at 1 kHz of sample time.

    ``frozen`` True stops both integrators (the bristle is followed on).
    """

    def __init__(self, settings: ErrorInjectionSettings, model: Model) -> None:
        self.settings, self.frozen = settings, False
        f = model.friction
        self._model, self._law = model, friction_law(f)
        self._k0 = {1: f.offset_pos_nm, -1: f.offset_neg_nm}
        self._bounds = {
            sign: (settings.least_factor * k0, settings.most_factor * k0)
            for sign, k0 in self._k0.items()
        }
        self._time_s = {1: 0.0, -1: 0.0}
        self._gates = Gates(settings.gates, model)
        self._aligned = Aligned(model)
        self._t_ns: int | None = None
        self._bristle_rad = 0.0
        self._speed_rad_s = self._drive_nm = math.nan

    @property
    def gates(self) -> tuple[GateState, ...]:
        """All gates as of the newest sample."""
        return self._gates.states

    @property
    def levels(self) -> FrictionLevels:
        """k0± as adapted so far."""
        return FrictionLevels(self._k0[1], self._k0[-1])

    def step(self, t_ns: int, inputs: InjectionInputs) -> ErrorInjectionState:
        """Take the newest values, reported by sample time ``t_ns``."""
        before, self._t_ns = self._t_ns, t_ns
        dt_s = 0.0 if before is None else (t_ns - before) * 1e-9
        self._gates.update(max(dt_s, 0.0), inputs)
        if not 0.0 < dt_s <= _GAP_S:
            self._aligned.clear()
            self._restart()
            self._aligned.push(t_ns, inputs)
            return self._state(0, 0.0)
        self._aligned.push(t_ns, inputs)
        _, now = self._aligned.read(t_ns)
        drive = now.motor_torque_nm + self._model.sensor_to_rotor * now.torque_sensor_nm
        if not (math.isfinite(now.motor_speed_rad_s) and math.isfinite(drive)):
            self._restart()
            return self._state(0, 0.0)
        return self._integrate(dt_s, now.motor_speed_rad_s, drive)

    def _restart(self) -> None:
        self._bristle_rad, self._speed_rad_s, self._drive_nm = 0.0, math.nan, math.nan

    def _integrate(self, dt_s: float, speed_rad_s: float, drive_nm: float) -> ErrorInjectionState:
        acceleration, speed, drive = self._filtered(dt_s, speed_rad_s, drive_nm)
        sign = 1 if speed >= 0.0 else -1
        own = self._law.offset_pos_nm if sign > 0 else self._law.offset_neg_nm
        level = static_level_nm(speed, 0.0, self._law) + self._k0[sign] - own
        sigma0 = self._law.sigma0_nm_per_rad
        moving = speed if abs(speed) > self.settings.speed_rad_s else 0.0
        travel = moving * dt_s
        self._bristle_rad = bristle_step(self._bristle_rad, travel, abs(travel), level, sigma0)
        bent = sign * self._bristle_rad * sigma0 / level
        enabled = moving != 0.0 and bent > 0.0 and bent >= self.settings.bristle_share
        mixed_s = _CLEAR_LAGS * self.settings.speed_filter_s
        enabled = enabled and abs(speed) > mixed_s * abs(acceleration)
        if self.frozen or not enabled or not self._gates.met:
            return self._state(0, 0.0)
        friction = friction_torque_nm(self._bristle_rad, speed, level, self._law)
        error = sign * (drive - self._model.inertia_kg_m2 * acceleration - friction)
        low, high = self._bounds[sign]
        moved = self._k0[sign] + self.settings.gain_per_s * error * dt_s
        self._k0[sign] = min(max(moved, low), high)
        self._time_s[sign] += dt_s
        return self._state(sign, error)

    def _filtered(self, dt_s: float, speed: float, drive_nm: float) -> tuple[float, float, float]:
        """Acceleration, speed and driving torque (Nm, at the rotor), all of one low-pass.

        Of a torque that is not as late as the speed, each half stroke would lose its change of
        momentum within the lag: both levels too low (41 % at 2 Hz and 8 rad).
        """
        before = self._speed_rad_s
        if not math.isfinite(before):
            before, self._drive_nm = speed, drive_nm
        share = -math.expm1(-dt_s / self.settings.speed_filter_s)
        self._speed_rad_s = before + share * (speed - before)
        drive_before = self._drive_nm
        self._drive_nm += share * (drive_nm - self._drive_nm)
        drive = 0.5 * (drive_before + self._drive_nm)  # the acceleration is of between the two
        return (self._speed_rad_s - before) / dt_s, self._speed_rad_s, drive

    def _state(self, direction: int, error_nm: float) -> ErrorInjectionState:
        at_limit = any(self._k0[sign] in self._bounds[sign] for sign in (1, -1))
        forth, back = self._time_s[1], self._time_s[-1]
        return ErrorInjectionState(self.levels, direction, error_nm, forth, back, at_limit)
