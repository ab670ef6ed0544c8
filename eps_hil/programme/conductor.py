"""One cell on the rig, step by step: preload, start position, constant speed, stop.

A pure state machine: readings in, set-points out, 100 times a second of sample time. It believes
only what the bus says that the rig did, gives up with a reason when the rig does not follow, and
ends at once with zero set-points where the rig is beyond what the programme file asks for.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from eps_hil.physics.model import Model
from eps_hil.programme.plan import Plan, PlannedCell, way_m

TICK_S = 0.01
_HOLD_S = 0.15
_PHASE_LIMIT_S = 15.0
_FORCE_SHARE, _FORCE_LEAST_N = 0.02, 15.0
_SPEED_SHARE = 0.1
_POSITION_M = 1e-3
_APPROACH_GAIN_PER_S = 4.0
_APPROACH_RAD_S = 60.0
_REST_RAD_S = 1.0
_OVERSHOOT = 1.5
"""Times the fastest set-point: on its torsion bar the rotor overshoots, by less than this."""
_LOAD_OVERSHOOT, _LOAD_MORE_N = 1.3, 200.0
"""Times the largest preload, and N, that the linear motor's own control may overshoot."""
_FRICTION_OVERSHOOT, _BAR_MORE_NM = 2.0, 2.0
"""Times the model's friction, which the programme is there to find, and Nm."""
_BEYOND_M = 3e-3
"""Over the file's rack_travel_m: a pass may begin there, give or take ``_POSITION_M``."""


class Reading(NamedTuple):
    """Means over the last tick: rotor speed, rack position from its centre, load cell, torques."""

    speed_rad_s: float
    position_m: float
    force_n: float
    sensor_nm: float = 0.0
    motor_nm: float = 0.0


class Wanted(NamedTuple):
    """Set-points of the next tick: rotor speed (the robot's, at the rotor), preload."""

    speed_rad_s: float
    force_n: float


def most_of(plan: Plan) -> Wanted:
    """The largest set-points of a programme, its approaches included."""
    fastest = max(_APPROACH_RAD_S, *plan.speeds_rad_s)
    return Wanted(fastest, max(abs(one) for one in plan.preloads_n))


def bar_limit_nm(plan: Plan, model: Model) -> float:
    """What the torsion bar may carry: as the file says, else load and friction without a motor."""
    if plan.sensor_torque_nm is not None:
        return plan.sensor_torque_nm
    most, known = most_of(plan), model.friction
    offset_nm = max(known.offset_pos_nm, known.offset_neg_nm)
    viscous = max(known.viscous_pos_nm_s_per_rad, known.viscous_neg_nm_s_per_rad)
    by_load = max(known.load_pos_nm_per_n, known.load_neg_nm_per_n)
    level_nm = offset_nm + viscous * most.speed_rad_s + by_load * most.force_n
    load_nm = (_LOAD_OVERSHOOT * most.force_n + _LOAD_MORE_N) / abs(model.pinion_ratio_rad_per_m)
    return load_nm + _FRICTION_OVERSHOOT * level_nm / abs(model.sensor_to_rotor) + _BAR_MORE_NM


class Phase(StrEnum):
    """Where a cell is."""

    APPROACH = "to the start"
    LOAD = "preload"
    SPEED_UP = "speeding up"
    SETTLE = "settling"
    MEASURE = "measuring"
    STOP = "stopping"
    DONE = "done"
    FAILED = "failed"
    TRIPPED = "beyond a limit"


@dataclass(slots=True)
class Conductor:
    """Leads the rig through one cell; :attr:`phase` says how it ended, ``reason`` why."""

    cell: PlannedCell
    plan: Plan
    model: Model
    phase: Phase = Phase.APPROACH
    reason: str = ""
    _in_phase_s: float = 0.0
    _held_s: float = 0.0
    _first_m: float | None = None

    @property
    def over(self) -> bool:
        """Whether nothing more will happen."""
        return self.phase in {Phase.DONE, Phase.FAILED, Phase.TRIPPED}

    @property
    def start_m(self) -> float:
        """Where the pass begins: half its way before the centre."""
        half = 0.5 * way_m(self.plan, self.cell.speed_rad_s, self.model)
        return -math.copysign(half, self.cell.speed_rad_s)

    def step(self, reading: Reading) -> Wanted:
        """Take what was read over the last tick, and say what the rig shall do."""
        self._in_phase_s += TICK_S
        beyond = self._beyond(reading)
        if beyond:
            self.reason = beyond
            self._enter(Phase.TRIPPED)
        match self.phase:
            case Phase.APPROACH:
                self._held(abs(reading.position_m - self.start_m) < _POSITION_M, Phase.LOAD)
            case Phase.LOAD:
                near = abs(reading.force_n - self.cell.preload_n) < self._force_band_n
                still = abs(reading.speed_rad_s) < _REST_RAD_S
                self._held(near and still, Phase.SPEED_UP)
            case Phase.SPEED_UP:
                away = abs(reading.speed_rad_s - self.cell.speed_rad_s)
                self._held(away < self._speed_band, Phase.SETTLE, 0.03)
            case Phase.SETTLE:
                self._after(self.plan.settling_s(self.cell.speed_rad_s), Phase.MEASURE)
            case Phase.MEASURE:
                self._after(self.plan.run_s, Phase.STOP)
            case Phase.STOP:
                self._held(abs(reading.speed_rad_s) < _REST_RAD_S, Phase.DONE, 0.05)
            case _:
                pass
        own_s = self.plan.run_s + self.plan.settling_s(self.cell.speed_rad_s)
        if not self.over and self._in_phase_s > _PHASE_LIMIT_S + own_s:
            self._fail(reading)
        return self._wanted(reading)

    def _beyond(self, reading: Reading) -> str:
        travel_m = self.plan.rack_travel_m
        if self._first_m is None:
            self._first_m = reading.position_m
        if self.phase is Phase.APPROACH:  # from wherever the rack was left, but no further out
            travel_m = max(travel_m, abs(self._first_m))
        most, bar_nm = most_of(self.plan), bar_limit_nm(self.plan, self.model)
        load_n = _LOAD_OVERSHOOT * most.force_n + _LOAD_MORE_N
        told = (
            ("rack position", 1e3 * reading.position_m, 1e3 * (travel_m + _BEYOND_M), "mm"),
            ("rotor speed", reading.speed_rad_s, _OVERSHOOT * most.speed_rad_s, "rad/s"),
            ("load", reading.force_n, load_n, "N"),
            ("torsion-bar torque", reading.sensor_nm, bar_nm, "Nm"),
        )
        for what, value, limit, unit in told:
            if not abs(value) <= limit:  # also NaN
                return f"{what} {value:.4g} {unit}, the limit is {limit:.4g} {unit}"
        return ""

    @property
    def _force_band_n(self) -> float:
        return max(_FORCE_LEAST_N, _FORCE_SHARE * abs(self.cell.preload_n))

    @property
    def _speed_band(self) -> float:
        return max(_REST_RAD_S, _SPEED_SHARE * abs(self.cell.speed_rad_s))

    def _wanted(self, reading: Reading) -> Wanted:
        match self.phase:
            case Phase.APPROACH:
                # Without load: the approach may be long, and the robot then has nothing to hold.
                ratio = self.model.rack_to_rotor_ratio_rad_per_m
                speed = _APPROACH_GAIN_PER_S * (self.start_m - reading.position_m) * ratio
                return Wanted(min(max(speed, -_APPROACH_RAD_S), _APPROACH_RAD_S), 0.0)
            case Phase.SPEED_UP | Phase.SETTLE | Phase.MEASURE:
                return Wanted(self.cell.speed_rad_s, self.cell.preload_n)
            case Phase.LOAD | Phase.STOP:
                return Wanted(0.0, self.cell.preload_n)
            case _:
                return Wanted(0.0, 0.0)

    def _held(self, there: bool, then: Phase, hold_s: float = _HOLD_S) -> None:
        self._held_s = self._held_s + TICK_S if there else 0.0
        if self._held_s >= hold_s - 1e-9:
            self._enter(then)

    def _after(self, seconds: float, then: Phase) -> None:
        if self._in_phase_s >= seconds - 1e-9:
            self._enter(then)

    def _fail(self, reading: Reading) -> None:
        self.reason = (
            f"the rig does not follow ({self.phase.value}): speed {reading.speed_rad_s:.3g} rad/s, "
            f"rack {1e3 * reading.position_m:.3g} mm, force {reading.force_n:.4g} N, asked for "
            f"{self.cell.speed_rad_s:g} rad/s at {self.cell.preload_n:g} N"
        )
        self._enter(Phase.FAILED)

    def _enter(self, phase: Phase) -> None:
        self.phase, self._in_phase_s, self._held_s = phase, 0.0, 0.0
