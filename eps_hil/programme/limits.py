"""The ``investigate:`` block of a configuration file: what experiments may ask of the rig."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field, with_config

from eps_hil import yaml_file
from eps_hil.bus.config import block

Share = Annotated[float, Field(gt=0, le=1)]


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class Limits:
    """What no experiment exceeds, neither planned nor, by the bus' own word, while it runs.

    ``rack_travel_m``: either way from the centre; ``speed_rad_s``, ``acceleration_rad_s2``: of the
    rotor; ``load_n``, ``load_rate_n_per_s``: of the linear motor; ``sensor_torque_nm``: of the
    torsion bar; ``motor_torque_nm``: what the EPS motor carries of the load, by the rig's own
    setting. ``matters``: share of the friction level below which an effect is of no interest.
    """

    rack_travel_m: Annotated[float, Field(gt=0, le=0.1)] = 0.05
    speed_rad_s: Annotated[float, Field(gt=1, le=120)] = 40.0
    acceleration_rad_s2: Annotated[float, Field(gt=1, le=200)] = 150.0
    load_n: Annotated[float, Field(ge=0, le=10_000)] = 2000.0
    load_rate_n_per_s: Annotated[float, Field(gt=0, le=4000)] = 4000.0
    sensor_torque_nm: Annotated[float, Field(gt=0, le=30)] = 10.0
    motor_torque_nm: Annotated[float, Field(gt=0, le=10)] = 3.0
    matters: Share = 0.02


def load_limits(path: str | Path) -> Limits:
    """The block, or the defaults where the file has none."""
    content = {"investigate": dict(block(path, "investigate"))}
    return yaml_file.validate(path, content, _Whole).investigate


@with_config(ConfigDict(extra="ignore"))
@dataclass(frozen=True, slots=True)
class _Whole:
    investigate: Limits = field(default_factory=Limits)
