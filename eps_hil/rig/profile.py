"""Profiles of one quantity over the time of a segment: the terms that a manoeuvre file may add."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, ConfigDict, Field, with_config

Floats = npt.NDArray[np.float64]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]

_STRICT = ConfigDict(extra="forbid")


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Sine:
    """amplitude · sin(2π f t + phase), faded in and out over ``fade_s``."""

    amplitude: Finite
    frequency_hz: Positive
    phase_rad: Finite = 0.0
    fade_s: NotNegative = 0.0

    def values(self, time_s: Floats, duration_s: float, seed: int) -> Floats:
        """Values at ``time_s``, shape (n,)."""
        phase = 2 * np.pi * self.frequency_hz * time_s + self.phase_rad
        return self.amplitude * np.sin(phase) * _fade(time_s, duration_s, self.fade_s)


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Sweep:
    """Sine whose frequency runs linearly from ``from_hz`` to ``to_hz`` over the segment."""

    amplitude: Finite
    from_hz: NotNegative
    to_hz: NotNegative
    fade_s: NotNegative = 0.0

    def values(self, time_s: Floats, duration_s: float, seed: int) -> Floats:
        """Values at ``time_s``, shape (n,)."""
        rate = (self.to_hz - self.from_hz) / duration_s
        phase = 2 * np.pi * (self.from_hz * time_s + 0.5 * rate * time_s**2)
        return self.amplitude * np.sin(phase) * _fade(time_s, duration_s, self.fade_s)


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Multisine:
    """``lines`` sines of equal size between two frequencies, phases drawn from the seed."""

    rms: NotNegative
    from_hz: Positive
    to_hz: Positive
    lines: Annotated[int, Field(ge=1, le=500)] = 20
    fade_s: NotNegative = 0.5

    def values(self, time_s: Floats, duration_s: float, seed: int) -> Floats:
        """Values at ``time_s``, shape (n,)."""
        phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, self.lines)
        frequencies = np.linspace(self.from_hz, self.to_hz, self.lines)
        total: Floats = np.zeros_like(time_s)
        for frequency, phase in zip(frequencies, phases, strict=True):
            total += np.sin(2 * np.pi * frequency * time_s + phase)
        scale = self.rms / float(np.sqrt(0.5 * self.lines))
        return scale * total * _fade(time_s, duration_s, self.fade_s)


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Steps:
    """Levels held for ``hold_s`` each, joined by ramps of ``rise_s``; starts from zero."""

    levels: Annotated[tuple[Finite, ...], Field(min_length=1)]
    hold_s: Positive
    rise_s: Positive = 0.02

    def values(self, time_s: Floats, duration_s: float, seed: int) -> Floats:
        """Values at ``time_s``, shape (n,); the last level is held to the end."""
        at, value = [0.0], [0.0]
        for number, level in enumerate(self.levels):
            start = number * (self.hold_s + self.rise_s)
            at += [start + self.rise_s, start + self.rise_s + self.hold_s]
            value += [level, level]
        return np.interp(time_s, at, value)


Term = Sine | Sweep | Multisine | Steps


def _number(content: Any) -> Any:
    return {"constant": content} if isinstance(content, (int, float)) else content


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class _Profile:
    """Sum of the terms that are given; ``points`` are [time_s, value] pairs joined by lines.

    Two points at one time are a step, from the first to the second.
    """

    constant: Finite = 0.0
    sine: Sine | None = None
    sweep: Sweep | None = None
    multisine: Multisine | None = None
    steps: Steps | None = None
    points: Annotated[tuple[tuple[Finite, Finite], ...], Field(min_length=1)] | None = None

    def values(self, time_s: Floats, duration_s: float, seed: int) -> Floats:
        """Values at ``time_s`` seconds into a segment of ``duration_s``, shape (n,)."""
        total = np.full_like(time_s, self.constant)
        for term in (self.sine, self.sweep, self.multisine, self.steps):
            if term is not None:
                total += term.values(time_s, duration_s, seed)
        if self.points is not None:
            at, value = zip(*sorted(self.points, key=lambda point: point[0]), strict=True)
            total += np.interp(time_s, at, value)
        return total


Profile = Annotated[_Profile, BeforeValidator(_number, json_schema_input_type=_Profile | float)]
"""A number, or a mapping of terms that are added."""

ZERO = _Profile()


def constant(value: float) -> _Profile:
    """A profile that stays at one value."""
    return _Profile(constant=value)


def points(*pairs: tuple[float, float]) -> _Profile:
    """Straight lines between (time_s, value) pairs."""
    return _Profile(points=pairs)


def _fade(time_s: Floats, duration_s: float, fade_s: float) -> Floats:
    if fade_s == 0.0:
        return np.ones_like(time_s)
    edge = np.minimum(time_s, duration_s - time_s) / fade_s
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(edge, 0.0, 1.0))
