"""One experiment on the rig, tick by tick: to its start, its course, to rest; with a guard.

A pure state machine like a programme's conductor: readings in, set-points out. It believes only
what the bus says, and ends at once with zero set-points where that is beyond a limit.
"""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from eps_hil.investigate.experiment import Experiment, start_m
from eps_hil.physics.model import Model
from eps_hil.programme.conductor import TICK_S, Reading, Wanted
from eps_hil.programme.limits import Limits

Floats = npt.NDArray[np.float64]

_POSITION_M, _REST_RAD_S, _HOLD_S = 1e-3, 1.0, 0.15
_APPROACH_GAIN_PER_S, _LONGEST_WAY_S = 4.0, 15.0
_KEEP_GAIN_PER_S, _KEEP_RAD_S = 0.5, 2.0
"""The rack is led back to its course so gently while it moves, and never while it rests."""
_OVERSHOOT = 1.3
"""Of the limits of speed and load, that the rig's own control may overshoot."""


def most_of(limits: Limits) -> Wanted:
    """The largest set-points of any experiment within the limits."""
    return Wanted(limits.speed_rad_s + _KEEP_RAD_S, limits.load_n)


class Phase(StrEnum):
    """Where an experiment is."""

    APPROACH = "to the start"
    COURSE = "running"
    STOP = "stopping"
    DONE = "done"
    FAILED = "does not follow"
    TRIPPED = "beyond a limit"


@dataclass(slots=True)
class Course:
    """Leads the rig through one experiment; :attr:`phase` says how it ended, ``reason`` why."""

    experiment: Experiment
    limits: Limits
    model: Model
    phase: Phase = Phase.APPROACH
    reason: str = ""
    ticks: int = 0
    _speed: Floats = field(init=False)
    _load: Floats = field(init=False)
    _way_m: Floats = field(init=False)
    _in_phase: int = 0
    _held_s: float = 0.0

    def __post_init__(self) -> None:
        self._speed, self._load = self.experiment.course(self.limits)
        way = np.cumsum(self._speed) * TICK_S / self.model.rack_to_rotor_ratio_rad_per_m
        self._way_m = way + start_m(self.experiment, self.limits, self.model)

    @property
    def over(self) -> bool:
        """Whether nothing more will happen."""
        return self.phase in {Phase.DONE, Phase.FAILED, Phase.TRIPPED}

    def step(self, reading: Reading) -> Wanted:
        """Take what was read over the last tick, and say what the rig shall do."""
        self.ticks += 1
        beyond = self._beyond(reading)
        if beyond:
            self.phase, self.reason = Phase.TRIPPED, beyond
        match self.phase:
            case Phase.APPROACH:
                return self._approach(reading)
            case Phase.COURSE:
                return self._along(reading)
            case Phase.STOP:
                still = abs(reading.speed_rad_s) < _REST_RAD_S
                self._held(still, Phase.DONE)
        return Wanted(0.0, 0.0)

    def _approach(self, reading: Reading) -> Wanted:
        start = start_m(self.experiment, self.limits, self.model)
        away = start - reading.position_m
        near = abs(away) < _POSITION_M and abs(reading.speed_rad_s) < _REST_RAD_S
        self._held(near, Phase.COURSE)
        self._in_phase += self.phase is Phase.APPROACH
        if self._in_phase * TICK_S > _LONGEST_WAY_S:
            self.phase = Phase.FAILED
            self.reason = (
                f"the rig does not come to its start: rack at {1e3 * reading.position_m:.3g} mm, "
                f"asked for {1e3 * start:.3g} mm"
            )
        if self.phase is not Phase.APPROACH:
            return Wanted(0.0, 0.0)
        wanted = _APPROACH_GAIN_PER_S * away * self.model.rack_to_rotor_ratio_rad_per_m
        most = self.limits.speed_rad_s
        return Wanted(min(max(wanted, -most), most), 0.0)

    def _along(self, reading: Reading) -> Wanted:
        k, last = self._in_phase, len(self._speed) - 1
        self._in_phase += 1
        if k >= last:
            self.phase = Phase.STOP
            return Wanted(0.0, 0.0)
        speed = float(self._speed[k])
        if speed != 0.0:
            ratio = self.model.rack_to_rotor_ratio_rad_per_m
            back = _KEEP_GAIN_PER_S * (float(self._way_m[k]) - reading.position_m) * ratio
            speed += min(max(back, -_KEEP_RAD_S), _KEEP_RAD_S)
        return Wanted(speed, float(self._load[k]))

    def _beyond(self, reading: Reading) -> str:
        limits = self.limits
        told = (
            ("rack position", 1e3 * reading.position_m, 1e3 * limits.rack_travel_m, "mm"),
            ("rotor speed", reading.speed_rad_s, _OVERSHOOT * limits.speed_rad_s, "rad/s"),
            ("torsion-bar torque", reading.sensor_nm, limits.sensor_torque_nm, "Nm"),
            ("motor torque", reading.motor_nm, limits.motor_torque_nm, "Nm"),
            ("load", reading.force_n, _OVERSHOOT * limits.load_n + 200.0, "N"),
        )
        for what, value, most, unit in told:
            if not abs(value) <= most:  # also NaN
                return f"{what} {value:.4g} {unit}, the limit is {most:.4g} {unit}"
        return ""

    def _held(self, there: bool, then: Phase) -> None:
        self._held_s = self._held_s + TICK_S if there else 0.0
        if self._held_s >= _HOLD_S - 1e-9:
            self.phase, self._in_phase, self._held_s = then, 0, 0.0
