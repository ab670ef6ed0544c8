"""The ``rig:`` block of a configuration file, checked; the rest of the file is bus/config.py's."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, with_config

from eps_hil import yaml_file
from eps_hil.bus.config import BusSetup, block, load_bus_setup, resolved
from eps_hil.examples import CONFIGS
from eps_hil.physics.chain_parameters import ChainParameters, load_chain
from eps_hil.physics.model import Model, load_model
from eps_hil.rig.manoeuvre import Manoeuvre, load_manoeuvre
from eps_hil.rig.reported import split
from eps_hil.rig.sensors import SensorSettings

REFERENCE_CHAIN = CONFIGS / "reference_chain.yaml"


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class RigConfig:
    """What the simulated rig does.

    ``manoeuvre``: a name of configs/manoeuvres, or a file (relative to the configuration file);
    ``loop``: over and over; ``chain``: file of the masses and springs; ``order``: 1 to 5 masses;
    ``model``: the model file that the *rig* obeys, effects included, where it shall differ from
    the one that the service believes in; ``override_timeout_s``: the ECU lets go of a torque
    override by itself after this time without a good command; ``command_timeout_s``: the rig
    brings commanded speed and preload to zero after this time without a good command;
    ``motor_share``: which share of a commanded preload the EPS motor carries (no command says it);
    ``realtime``: ask for SCHED_FIFO.
    """

    manoeuvre: str = "demo"
    loop: bool = False
    chain: Path = REFERENCE_CHAIN
    order: Annotated[int, Field(ge=1, le=5)] = 5
    model: Path | None = None
    seed: Annotated[int, Field(ge=0)] = 0
    sensors: SensorSettings = field(default_factory=SensorSettings)
    override_timeout_s: Annotated[float, Field(ge=0.002, le=1.0)] = 0.02
    command_timeout_s: Annotated[float, Field(ge=0.02, le=1.0)] = 0.1
    motor_share: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0
    motor_temperature_degc: float = 35.0
    realtime: bool = True


@dataclass(frozen=True, slots=True)
class RigSetup:
    """Everything that a rig process needs, read and checked."""

    bus: BusSetup
    rig: RigConfig
    model: Model
    chain: ChainParameters
    manoeuvre: Manoeuvre
    reported: tuple[Mapping[str, Any], ...] = ()
    """Effects on what the rig reports: values by parameter, "effect" and "signal"."""


def load_rig_setup(path: str | Path, manoeuvre: str | None = None) -> RigSetup:
    """Read a configuration file with all files it names; ``manoeuvre`` overrules the file's.

    :class:`~eps_hil.errors.InputError` names file and field of the first mistake.
    """
    bus = load_bus_setup(path)
    rig = yaml_file.validate(path, {"rig": dict(block(path, "rig"))}, _Whole).rig
    chosen = manoeuvre
    if chosen is None:
        is_file = Path(rig.manoeuvre).suffix in {".yaml", ".yml"}
        chosen = str(resolved(path, rig.manoeuvre)) if is_file else rig.manoeuvre
    model_file = bus.model if rig.model is None else resolved(path, rig.model)
    chain = load_chain(resolved(path, rig.chain))
    model, reported = split(model_file, load_model(model_file, rig=True), chain, rig.order)
    return RigSetup(
        bus=bus,
        rig=rig,
        model=model,
        chain=chain,
        manoeuvre=load_manoeuvre(chosen),
        reported=reported,
    )


@with_config(ConfigDict(extra="ignore"))
@dataclass(frozen=True, slots=True)
class _Whole:
    rig: RigConfig
