"""Calibrations of the friction levels as sources of an override session, and their settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field, with_config

from eps_hil import yaml_file
from eps_hil.adaptation.error_injection import (
    ErrorInjection,
    ErrorInjectionSettings,
    ErrorInjectionState,
)
from eps_hil.adaptation.gates import Gates, GateState
from eps_hil.adaptation.injection_settings import InjectionSettings
from eps_hil.adaptation.torque_injection import InjectionCommand, Phase, TorqueInjection
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.service.adaptation_config import SANITY_BAND
from eps_hil.service.config import ServiceConfig
from eps_hil.service.online_methods import newest

_STRICT = ConfigDict(extra="forbid")


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class CalibrationSettings:
    """The ``calibration:`` block.

    ``sanity_band``: new levels further than this share from the last accepted ones are refused
    unless the operator insists. ``error_sliding_s``: how long each of the error injection's
    integrators must have run before its level is believed. ``silence_s``: a bus without sync
    frames for so long ends a calibration.
    """

    torque_injection: InjectionSettings = field(default_factory=InjectionSettings)
    error_injection: ErrorInjectionSettings = field(default_factory=ErrorInjectionSettings)
    sanity_band: Annotated[float, Field(gt=0, le=1)] = SANITY_BAND
    error_sliding_s: Annotated[float, Field(gt=0, le=600)] = 5.0
    silence_s: Annotated[float, Field(gt=0, le=600)] = 10.0


@with_config(ConfigDict(extra="ignore"))
@dataclass(frozen=True, slots=True)
class _Whole:
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)


def calibration_settings(config: ServiceConfig, file: str | Path) -> CalibrationSettings:
    """The block of a configuration; :class:`InputError` names line and field of a mistake."""
    given = {} if config.calibration is None else {"calibration": dict(config.calibration)}
    return yaml_file.validate(file, given, _Whole).calibration


class TorqueInjectionSource:
    """Torque injection as a source of torque: until it is engaged, only its gates are watched."""

    def __init__(self, settings: InjectionSettings, model: Model) -> None:
        model = with_model_effects(model)
        self.injection = TorqueInjection(settings, model)
        self.command: InjectionCommand | None = None
        """What it last asked for; None before it was engaged."""
        self._gates, self._t_ns = Gates(settings.gates, model), 0

    @property
    def gates(self) -> tuple[GateState, ...]:
        """Every gate with value, limit and whether it is met."""
        return self._gates.states if self.command is None else self.injection.gates

    @property
    def over(self) -> bool:
        """Whether it is done or has given up."""
        return self.injection.phase.over

    @property
    def aborted(self) -> str:
        """Why it gave up; empty where it did not."""
        return self.injection.reason if self.injection.phase is Phase.ABORTED else ""

    def step(
        self, t_ns: int, values: Mapping[str, float], *, engaged: bool, now_ns: int
    ) -> float | None:
        """See :class:`~eps_hil.service.override_core.Source`."""
        inputs = newest(values)
        if not engaged and self.command is None:
            since_s = (t_ns - self._t_ns) * 1e-9 if self._t_ns else 0.0
            self._gates.update(min(max(since_s, 0.0), 1.0), inputs)
            self._t_ns = t_ns
            return None
        self.command = self.injection.step(t_ns, inputs, now_ns)
        return self.command.torque_nm if self.command.active else None


class ErrorInjectionSource:
    """Error injection listens: driver and ECU move the rack, no torque is ever asked for."""

    def __init__(self, settings: CalibrationSettings, model: Model) -> None:
        self.injection = ErrorInjection(settings.error_injection, with_model_effects(model))
        self.state: ErrorInjectionState | None = None
        self._sliding_s = settings.error_sliding_s

    @property
    def gates(self) -> tuple[GateState, ...]:
        """Every gate with value, limit and whether it is met."""
        return self.injection.gates

    @property
    def over(self) -> bool:
        """Whether both directions have slid for long enough."""
        state = self.state
        if state is None:
            return False
        return min(state.time_pos_s, state.time_neg_s) >= self._sliding_s

    def step(self, t_ns: int, values: Mapping[str, float], *, engaged: bool = False) -> None:
        """Take the newest values."""
        self.state = self.injection.step(t_ns, newest(values))
