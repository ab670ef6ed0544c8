"""Torque injection (PAPER fig. 14): ramp until the rack moves, both ways, and read off k0±.

One call of :meth:`TorqueInjection.step` per sample at 1 kHz of *sample* time; what it returns is a
wish, which the torque guard may refuse. No I/O, no clock of its own. Signs: CONTRACT 1 (positive
motor torque turns towards positive speed; k0+ belongs to ω ≥ 0).
"""

import math
from collections.abc import Generator
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from eps_hil.adaptation.gates import Gates, GateState, InjectionInputs
from eps_hil.adaptation.injection_result import InjectionResult, Repetition, Seen, result_of
from eps_hil.adaptation.injection_settings import InjectionSettings
from eps_hil.adaptation.slide import SlideLevel
from eps_hil.adaptation.slide_record import SlideRecord
from eps_hil.physics.model import Model

_NS = 1e-9
_REST_FILTER_S = 0.02
_SPEED_SAMPLES = 5
_SENSOR_GUARD = 0.9
"""Share of the torsion-bar gate at which a ramp ends by itself, before the gate would open."""
_STUCK_SHARE = 0.1
_AGAINST = "the rotor turns against the torque: a sign is wrong"


class Phase(StrEnum):
    """Where an injection is; ``active`` phases want the override, all others leave it alone."""

    WAITING = "waiting"
    """Not every gate is met yet."""
    REST = "rest"
    """Zero torque until the rotor rests."""
    RAMP = "ramp"
    SLIDE = "slide"
    """Broken away; the speed is held for a stretch."""
    RETURN = "return"
    """Torque back to zero."""
    ABORTING = "aborting"
    """Something opened a gate; torque to zero, fast."""
    ABORTED = "aborted"
    DONE = "done"

    @property
    def active(self) -> bool:
        """Whether the override must be engaged (with whatever torque, zero included)."""
        return self in _ACTIVE

    @property
    def over(self) -> bool:
        """Whether nothing will happen any more."""
        return self in {Phase.ABORTED, Phase.DONE}


_ACTIVE = frozenset({Phase.REST, Phase.RAMP, Phase.SLIDE, Phase.RETURN, Phase.ABORTING})


class InjectionCommand(NamedTuple):
    """What shall be asked of the motor in this millisecond.

    ``active``: engage the override with ``torque_nm``; not active: release it (torque 0).
    ``direction`` +1, −1 or 0; ``repetition`` counts from 1, of ``repetitions`` good ones wanted.
    ``reason`` says why an injection waits or ended; empty while all is well.
    """

    torque_nm: float
    phase: Phase
    active: bool
    direction: int
    repetition: int
    repetitions: int
    reason: str


@dataclass(slots=True)
class _Filters:
    """Smoothed signals of the newest sample."""

    speed_rad_s: float = math.nan
    recent: tuple[float, ...] = ()
    sensor_nm: float = math.nan

    def update(self, dt_s: float, inputs: InjectionInputs) -> None:
        share = -math.expm1(-dt_s / _REST_FILTER_S)
        self.recent = (*self.recent[1 - _SPEED_SAMPLES :], inputs.motor_speed_rad_s)
        self.speed_rad_s = _smoothed(self.speed_rad_s, inputs.motor_speed_rad_s, share)
        self.sensor_nm = _smoothed(self.sensor_nm, inputs.torque_sensor_nm, share)

    @property
    def quick_rad_s(self) -> float:
        return sum(self.recent) / len(self.recent)


def _smoothed(before: float, value: float, share: float) -> float:
    return before + share * (value - before) if math.isfinite(before) else value


class TorqueInjection:
    """One calibration run; it ends :attr:`Phase.DONE` or ABORTED and does not start again.

    ``model`` gives inertia, delays, presliding and the speed and load terms; its k0± are only what
    the result is later compared with by whoever takes it.
    """

    def __init__(self, settings: InjectionSettings, model: Model) -> None:
        self.settings, self.model = settings, model
        self.phase = Phase.WAITING
        self.reason = "waiting for the first sample"
        self.result: InjectionResult | None = None
        self._gates = Gates(settings.gates, model)
        self._filters = _Filters()
        self._record = SlideRecord(model)
        self._evaluation: Generator[None, None, SlideLevel | None] | None = None
        self._found: list[Repetition] = []
        self._t_ns: int | None = None
        self._now_ns: int | None = None
        self._since_s = self._held_s = self._torque_nm = self._integral_nm = 0.0
        self._direction = -1
        self._failures = 0
        self._sensor_rest_nm = self._way_rad = self._detection_nm = 0.0
        self._seen: Seen = "speed"

    @property
    def gates(self) -> tuple[GateState, ...]:
        """All gates with value, limit and whether they are met, as of the newest sample."""
        return self._gates.states

    @property
    def repetitions(self) -> tuple[Repetition, ...]:
        """What was found so far."""
        return tuple(self._found)

    def abort(self, reason: str) -> None:
        """End the run from outside (operator, guard): torque to zero by the next steps."""
        if not self.phase.over and self.phase is not Phase.ABORTING:
            self.reason = reason
            self._enter(Phase.ABORTING if self.phase.active else Phase.ABORTED)

    def step(
        self, t_ns: int, inputs: InjectionInputs, now_ns: int | None = None
    ) -> InjectionCommand:
        """Take the newest values, reported by sample time ``t_ns``, and say what to ask for.

        ``now_ns``: a steady clock of the caller's (ns; None: there is none but sample time). By it
        a torque is lowered after an abort, for sample time may stand still.
        """
        before, self._t_ns = self._t_ns, t_ns
        dt_s = 1e-3 if before is None else (t_ns - before) * _NS
        passed_s = 0.0
        if now_ns is not None and self._now_ns is not None:
            passed_s = (now_ns - self._now_ns) * _NS
        self._now_ns = now_ns
        self._gates.update(max(dt_s, 0.0), inputs)
        if self.phase.over:
            return self._command()
        bad = self._bad(dt_s, inputs)
        if bad:
            self._on_bad(bad)
        else:
            self._filters.update(dt_s, inputs)
            self._record.add(t_ns, inputs)
        self._since_s += max(dt_s, 0.0)
        if self.phase is Phase.ABORTING:
            self._lower(max(dt_s, passed_s), self.settings.abort_nm_per_s)
            if self._torque_nm == 0.0:
                self._enter(Phase.ABORTED)
        elif not bad:
            self._advance(dt_s)
        return self._command()

    def _bad(self, dt_s: float, inputs: InjectionInputs) -> str:
        """Why nothing may be injected on this sample; empty where all is well."""
        if not 0.0 < dt_s <= self.settings.gap_s:
            return f"sample time went on by {dt_s * 1e3:.0f} ms"
        if not (math.isfinite(inputs.motor_speed_rad_s) and math.isfinite(inputs.motor_torque_nm)):
            return "motor speed or motor torque is missing"
        if not self._gates.met:
            return "gate open: " + ", ".join(self._gates.closed)
        return ""

    def _on_bad(self, why: str) -> None:
        if self.phase is Phase.WAITING:
            self.reason, self._held_s = why, 0.0
        else:
            self.abort(why)

    def _advance(self, dt_s: float) -> None:
        match self.phase:
            case Phase.WAITING:
                self._wait(dt_s)
            case Phase.REST:
                self._rest(dt_s)
            case Phase.RAMP:
                self._ramp(dt_s)
            case Phase.SLIDE:
                self._slide(dt_s)
            case _:
                self._return(dt_s)

    def _wait(self, dt_s: float) -> None:
        self._held_s += dt_s
        self.reason = "gates met, holding"
        if self._held_s >= self.settings.gates_hold_s:
            self.reason = ""
            self._enter(Phase.REST)

    def _rest(self, dt_s: float) -> None:
        resting = abs(self._filters.speed_rad_s) < self.settings.rest_speed_rad_s
        self._held_s = self._held_s + dt_s if resting else 0.0
        if self._held_s >= self.settings.rest_s:
            sensor = self._filters.sensor_nm
            self._sensor_rest_nm = sensor if math.isfinite(sensor) else 0.0
            self._direction = self._next_direction()
            self._record.begin(self._direction)
            self._enter(Phase.RAMP)
        elif self._since_s > self.settings.rest_timeout_s:
            self.abort(f"the rotor does not rest ({self._filters.speed_rad_s:.2f} rad/s)")

    def _ramp(self, dt_s: float) -> None:
        s = self.settings
        self._torque_nm = min(self._torque_nm + s.ramp_nm_per_s * dt_s, s.max_torque_nm)
        seen = self._break_away()
        if self._against():
            self.abort(_AGAINST)
        elif seen is not None:
            self._seen = seen
            self._detection_nm = self._record.torque_now_nm
            self._integral_nm = self._torque_nm
            self._way_rad = self._record.travel_now_rad
            self._enter(Phase.SLIDE if seen == "speed" and s.slide_rad > 0 else Phase.RETURN)
        elif self._torque_nm >= s.max_torque_nm:
            self._failed(f"no break-away up to {s.max_torque_nm:g} Nm")

    def _break_away(self) -> Seen | None:
        """How the end of the ramp shows, if it does."""
        s = self.settings
        if self._direction * self._filters.quick_rad_s > s.breakaway_speed_rad_s:
            return "speed"
        return "driver_torque" if self._driver_holds() else None

    def _against(self) -> bool:
        """Whether the rotor broke away the other way, where a ramp would drive it on and on."""
        speed_rad_s = self._direction * self._filters.quick_rad_s
        return speed_rad_s < -self.settings.breakaway_speed_rad_s

    def _driver_holds(self) -> bool:
        """Whether the hand takes up the torque: eq. 1a has it oppose the motor."""
        sensor, s = self._filters.sensor_nm, self.settings
        if not math.isfinite(sensor):
            return False
        change = abs(sensor - self._sensor_rest_nm)
        gate = _SENSOR_GUARD * s.gates.torque_sensor_nm.limit
        return change > s.driver_torque_change_nm or abs(sensor) > gate

    def _slide(self, dt_s: float) -> None:
        """Hold the speed with a critically damped PI law, so that the rotor slides for a while."""
        s = self.settings
        error = s.breakaway_speed_rad_s - self._direction * self._filters.quick_rad_s
        stiff = s.slide_bandwidth_rad_s * self.model.inertia_kg_m2
        self._integral_nm += 0.25 * s.slide_bandwidth_rad_s * stiff * error * dt_s
        self._integral_nm = min(max(self._integral_nm, 0.0), s.max_torque_nm)
        self._torque_nm = min(max(self._integral_nm + stiff * error, 0.0), s.max_torque_nm)
        far = self._record.travel_now_rad - self._way_rad >= s.slide_rad
        if self._against():
            self.abort(_AGAINST)
        elif far or self._driver_holds() or self._since_s > s.slide_timeout_s:
            self._enter(Phase.RETURN)

    def _return(self, dt_s: float) -> None:
        """Torque down; meanwhile the slide is evaluated, a piece at each step.

        At once it would take longer than a step has, and a command would be late.
        """
        self._lower(dt_s, self.settings.return_nm_per_s)
        slow = _STUCK_SHARE * self.settings.breakaway_speed_rad_s
        stuck = self._direction * self._filters.quick_rad_s < slow
        if self._record.running and (stuck or self._torque_nm == 0.0):
            self._evaluation = self._record.level(self._detection_nm, self._direction > 0)
        if self._evaluation is not None:
            try:
                next(self._evaluation)
            except StopIteration as end:
                self._evaluation = None
                self._evaluated(end.value)
        elif self._torque_nm == 0.0:
            self._enter(Phase.REST)

    def _lower(self, dt_s: float, rate: float) -> None:
        self._torque_nm = max(self._torque_nm - rate * max(dt_s, 0.0), 0.0)

    def _evaluated(self, level: SlideLevel | None) -> None:
        """Level of the slide that ended."""
        if level is None:
            self._failed("the rotor did not slide")
            return
        self._found.append(
            Repetition(
                number=len(self._found) + 1,
                direction=self._direction,
                offset_nm=level.offset_nm,
                standard_error_nm=level.standard_error_nm,
                detection_nm=self._detection_nm,
                seen=self._seen,
                lengths=level.lengths,
                travel_rad=level.travel_rad,
                drift_nm_per_rad=level.drift_nm_per_rad,
                drift_error_nm_per_rad=level.drift_error_nm_per_rad,
                form_nm=level.form_nm,
                bent_rad=level.bent_rad,
            )
        )

    def _failed(self, why: str) -> None:
        self._record.end()
        self._failures += 1
        self.reason = why
        if self._failures > self.settings.failures_allowed:
            self.abort(f"{why}, {self._failures} times")
        else:
            self._enter(Phase.RETURN)

    def _enter(self, phase: Phase) -> None:
        if phase is Phase.REST and self._complete():
            phase = Phase.DONE
            self.reason = ""
            self.result = result_of(self._found, self.settings.outlier_share, self.model)
        if phase is Phase.ABORTED:
            self._torque_nm = 0.0
        self.phase, self._since_s, self._held_s = phase, 0.0, 0.0

    def _complete(self) -> bool:
        return min(self._count(1), self._count(-1)) >= self.settings.repetitions

    def _count(self, direction: int) -> int:
        return sum(one.direction == direction for one in self._found)

    def _next_direction(self) -> int:
        """The one with fewer slides so far; else not the last one, so that the rack stays."""
        forth, back = self._count(1), self._count(-1)
        return -self._direction if forth == back else (1 if forth < back else -1)

    def _command(self) -> InjectionCommand:
        active = self.phase.active
        return InjectionCommand(
            torque_nm=self._direction * self._torque_nm if active else 0.0,
            phase=self.phase,
            active=active,
            direction=self._direction if active else 0,
            repetition=len(self._found) + (self.phase is not Phase.DONE),
            repetitions=2 * self.settings.repetitions,
            reason=self.reason,
        )
