"""Experiments that a rig can be led through, each of a few numbers, and the menu within limits.

An experiment is a course of rotor speed and preload, 100 set-points a second, that begins and ends
at rest without load at the rack's centre.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.physics.model import Model
from eps_hil.programme.limits import Limits

Floats = npt.NDArray[np.float64]

TICK_S = 0.01
_RAMP_S = 0.3
_PASS_S = 1.5
_TRAVEL_SHARE = 0.9
"""Of the travel that a course may take: the rest is for what the rig does not follow exactly."""
_SINE_S, _REST_TURN_S = 12.0, 1.6


class Kind(StrEnum):
    """What an experiment does."""

    PASSES = "passes"
    """Both ways at one speed under one load, twice."""
    SINE = "sine"
    """Speed as a sine, under one load."""
    LOAD_SINE = "load_sine"
    """Speed as a sine, the load as another, faster one."""
    RESTS = "rests"
    """Rests, each ended by a slow turn the other way."""


@dataclass(frozen=True, slots=True)
class Experiment:
    """``speed_rad_s`` and ``load_n`` are levels or amplitudes; what a kind has not is zero."""

    kind: Kind
    speed_rad_s: float
    load_n: float = 0.0
    frequency_hz: float = 0.0
    load_frequency_hz: float = 0.0
    rest_s: float = 0.0

    @property
    def name(self) -> str:
        """Of its files."""
        parts = [self.kind.value, f"{self.speed_rad_s:.3g}rad_s", f"{self.load_n:.4g}N"]
        parts += [f"{self.frequency_hz:.2g}Hz"] if self.frequency_hz else []
        parts += [f"load_{self.load_frequency_hz:.2g}Hz"] if self.load_frequency_hz else []
        parts += [f"rest_{self.rest_s:g}s"] if self.rest_s else []
        return "_".join(parts)

    @property
    def words(self) -> str:
        """For people."""
        load = f"under {self.load_n:.0f} N" if self.load_n else "without load"
        match self.kind:
            case Kind.PASSES:
                return f"passes both ways at {self.speed_rad_s:.3g} rad/s {load}"
            case Kind.SINE:
                return f"{self._sine} {load}"
            case Kind.LOAD_SINE:
                of_load = f"{self.load_n:.0f} N at {self.load_frequency_hz:.2g} Hz"
                return f"{self._sine}, load as one of {of_load}"
            case _:
                return (
                    f"rests of {self.rest_s:g} s, each ended by a turn at {self.speed_rad_s:.3g} "
                    f"rad/s {load}"
                )

    @property
    def _sine(self) -> str:
        return f"speed as a sine of {self.speed_rad_s:.3g} rad/s at {self.frequency_hz:.2g} Hz"

    def content(self) -> dict[str, Any]:
        """JSON-ready."""
        return {**asdict(self), "kind": self.kind.value}

    def course(self, limits: Limits) -> tuple[Floats, Floats]:
        """Rotor speed (rad/s) and preload (N) of every tick."""
        speed, load = self._bare()
        ramp = round(max(_RAMP_S, 1.2 * abs(self.load_n) / limits.load_rate_n_per_s) / TICK_S)
        up = np.linspace(0.0, load[0], ramp)
        down = np.linspace(load[-1], 0.0, ramp)
        still = np.zeros(ramp)
        speed = np.concatenate([still, speed, still])
        return _slewed(speed, limits), np.concatenate([up, load, down])

    def duration_s(self, limits: Limits) -> float:
        """Of the course, without the way to its start."""
        return len(self.course(limits)[0]) * TICK_S

    def _bare(self) -> tuple[Floats, Floats]:
        v = self.speed_rad_s
        match self.kind:
            case Kind.PASSES:
                n = round(_PASS_S / TICK_S)
                quarter = np.full(n, v)
                speed = np.concatenate([quarter, -quarter, -quarter, quarter] * 2)
                return speed, np.full(len(speed), self.load_n)
            case Kind.RESTS:
                n, wait = round(_REST_TURN_S / TICK_S), np.zeros(round(self.rest_s / TICK_S))
                out, back = np.full(n, v), np.full(n, -v)
                turns = max(1, round(_SINE_S / (2.0 * (self.rest_s + _REST_TURN_S))))
                speed = np.concatenate([wait, out, wait, back] * turns)
                return speed, np.full(len(speed), self.load_n)
            case _:
                cycles = max(2, round(_SINE_S * self.frequency_hz))
                n = round(cycles / self.frequency_hz / TICK_S)
                time_s = TICK_S * np.arange(n)
                speed = v * np.sin(2.0 * math.pi * self.frequency_hz * time_s)
                if self.kind is Kind.SINE:
                    return speed, np.full(n, self.load_n)
                return speed, self.load_n * np.sin(2.0 * math.pi * self.load_frequency_hz * time_s)


def within(experiment: Experiment, limits: Limits, model: Model) -> bool:
    """Whether its course keeps travel, speed, load and their rates, as it is planned."""
    speed, load = experiment.course(limits)
    way = np.cumsum(speed) * TICK_S / model.rack_to_rotor_ratio_rad_per_m
    way -= _middle(way)
    return bool(
        np.max(np.abs(speed)) <= limits.speed_rad_s
        and np.max(np.abs(load)) <= limits.load_n
        and np.max(np.abs(np.diff(load))) <= limits.load_rate_n_per_s * TICK_S
        and np.max(np.abs(way)) <= _TRAVEL_SHARE * limits.rack_travel_m
    )


def start_m(experiment: Experiment, limits: Limits, model: Model) -> float:
    """Where the rack begins, so that the course lies about its centre."""
    way = np.cumsum(experiment.course(limits)[0]) * TICK_S / model.rack_to_rotor_ratio_rad_per_m
    return -_middle(way)


def menu(limits: Limits, model: Model) -> list[Experiment]:
    """Every experiment that the limits allow."""
    return [one for one in _all(limits, model) if within(one, limits, model)]


def _all(limits: Limits, model: Model) -> Iterator[Experiment]:
    top, load = limits.speed_rad_s, limits.load_n
    loads = [0.0] if load == 0.0 else [0.0, load, -load]
    for share in (0.05, 0.25, 1.0):
        for level in loads:
            yield Experiment(Kind.PASSES, share * top, level)
    whole_hz = top / (
        2.0 * math.pi * 0.85 * limits.rack_travel_m * model.rack_to_rotor_ratio_rad_per_m
    )
    for share, hz in ((1.0, whole_hz), (1.0, 0.25), (0.5, 0.5), (0.5, 1.0), (0.25, 0.25)):
        for level in loads:
            yield Experiment(Kind.SINE, share * top, level, hz)
    for share, hz, of_load in ((1.0, whole_hz, 0.25), (0.5, 0.5, 0.3), (0.25, 0.25, 0.29)):
        if load:
            yield Experiment(Kind.LOAD_SINE, share * top, load, hz, of_load)
    for rest in (0.3, 1.0, 3.0):
        yield Experiment(Kind.RESTS, 0.1 * top, 0.0, rest_s=rest)


def _middle(way: Floats) -> float:
    return 0.5 * (float(np.max(way)) + float(np.min(way)))


def _slewed(speed: Floats, limits: Limits) -> Floats:
    """The course as fast as the acceleration allows, with the same way in the end."""
    most = limits.acceleration_rad_s2 * TICK_S
    found, now = np.empty(len(speed)), 0.0
    for k, wanted in enumerate(speed):
        now += min(max(wanted - now, -most), most)
        found[k] = now
    return found
