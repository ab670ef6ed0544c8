"""The service's configuration file as one frozen value (docs/reference-config.md)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, with_config

from eps_hil.bus.config import NAME, BusSetup, load_as
from eps_hil.bus.e2e import E2eProfile
from eps_hil.errors import InputError
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.service.adaptation_config import AdaptationConfig
from eps_hil.service.limits import Limits

Seconds = Annotated[float, Field(gt=0, le=60, allow_inf_nan=False)]
VERDICT = "EPSHIL_Verdict"
_STRICT = ConfigDict(extra="forbid")


def _off(value: object) -> object:
    """YAML 1.1 reads a bare ``off`` as false."""
    return "off" if value is False else value


Realtime = Annotated[
    Literal["auto", "require", "off"],
    BeforeValidator(_off, json_schema_input_type=Literal["auto", "require", "off", False]),
]


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class PublishConfig:
    """What the service may send. With ``enabled: false`` it sends nothing at all.

    ``message``, ``verdict_message`` and ``health_message`` name messages of the DBC (null: no such
    frames; a database that has no ``EPSHIL_Verdict`` gets none either). ``listen_first_s``: how
    long to listen for another transmitter of these ids before sending the first frame.
    """

    enabled: bool = True
    message: NAME = "EPSHIL_Estimate"
    verdict_message: NAME | None = VERDICT
    verdict_period_s: Seconds = 0.01
    health_message: NAME | None = "EPSHIL_Health"
    health_period_s: Seconds = 0.1
    listen_first_s: Annotated[float, Field(ge=0, le=10)] = 0.25


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class RuntimeConfig:
    """How the process runs.

    ``realtime``: ``auto`` takes real-time priority and locked memory where permitted,
    ``require`` ends without, ``off`` never asks. ``no_input_after_s``: silence of the sync frame
    after which status "no input" is published, every ``no_input_period_s``. ``reconnect_s``:
    pause between attempts to open a lost bus again (``bus.reconnect``). ``start_wait_s``: for how
    long the estimate is settling after a start amid traffic (with ``plausibility`` on): a torque
    that was wrong or late before then shows it only where it ends.
    """

    realtime: Realtime = "auto"
    priority: Annotated[int, Field(ge=1, le=98)] = 20
    no_input_after_s: Seconds = 0.02
    no_input_period_s: Seconds = 0.01
    reconnect_s: Seconds = 1.0
    start_wait_s: Annotated[float, Field(ge=0, le=60)] = 0.75


@with_config(_STRICT)
@dataclass(frozen=True, slots=True, kw_only=True)
class OverrideConfig:
    """The torque override. A file without this block can never command a torque.

    ``limits``: see :class:`~eps_hil.service.limits.Limits`, all of them. ``command_message``
    carries ``torque_signal`` (in the DBC's unit times ``torque_scale`` = Nm at the rotor;
    ``torque_unit``: that unit where the DBC has no unit of torque, ``other`` where
    ``torque_scale`` shall be taken as it stands) and ``request_signal`` (``enable_value``,
    ``release_value``). ``status_message`` (null: the ECU has none) says by ``status_signal`` =
    ``status_active`` that the ECU obeys. ``state_message`` publishes the state machine (null: it
    does not). ``e2e``: an AUTOSAR profile for the command where the ECU wants one; without it
    counter and CRC are the DBC's.
    """

    limits: Limits
    command_message: NAME = "EPSHIL_TorqueOverride"
    torque_signal: NAME = "RequestedMotorTorque"
    torque_scale: Annotated[float, Field(allow_inf_nan=False)] = 1.0
    torque_unit: NAME | None = None
    request_signal: NAME = "OverrideRequest"
    enable_value: int = 1
    release_value: int = 0
    status_message: NAME | None = "EPS_OverrideStatus"
    status_signal: NAME = "OverrideState"
    status_active: int = 1
    state_message: NAME | None = "EPSHIL_OverrideState"
    e2e: E2eProfile | None = None


@with_config(_STRICT)
@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceConfig(BusSetup):
    """The whole file; verbs check the blocks that are theirs: rig, calibration, investigate."""

    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    publish: PublishConfig = field(default_factory=PublishConfig)
    service: RuntimeConfig = field(default_factory=RuntimeConfig)
    adaptation: AdaptationConfig | None = None
    override: OverrideConfig | None = None
    calibration: Mapping[str, Any] | None = None
    rig: Mapping[str, Any] | None = None
    investigate: Mapping[str, Any] | None = None

    @property
    def sends(self) -> tuple[str, ...]:
        """Names of the messages that the service publishes."""
        if not self.publish.enabled:
            return ()
        published = self.publish
        names = [published.message, published.verdict_message, published.health_message]
        if self.adaptation is not None:
            names += [self.adaptation.message, self.adaptation.suggestion_message]
        return tuple(name for name in names if name is not None)


def load_config(path: str | Path) -> ServiceConfig:
    """Read and check a configuration file; :class:`InputError` names line and field."""
    config = load_as(path, ServiceConfig)
    publish = config.publish
    named = (publish.message, publish.verdict_message, publish.health_message)
    given = [name for name in named if name is not None]
    if len(set(given)) < len(given):
        raise InputError(
            path, "publish", "two of message, verdict_message and health_message are the same",
            "name a message for each",
        )  # fmt: skip
    return config


def config_schema() -> dict[str, Any]:
    """The JSON schema of the file, for editors that complete and check while typing."""
    return TypeAdapter(ServiceConfig).json_schema()
