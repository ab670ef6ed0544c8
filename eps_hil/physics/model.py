"""The model file (CONTRACT 4) as one frozen dataclass, and back."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BeforeValidator, ConfigDict, Field, with_config
from pydantic_core import PydanticCustomError

from eps_hil import yaml_file
from eps_hil.errors import InputError


def _number(value: Any) -> Any:
    """YAML's yes, on and true are no numbers, though Python takes them for 1."""
    if isinstance(value, bool):
        raise PydanticCustomError("number", "a number was expected, not true or false")
    return value


_A_NUMBER = BeforeValidator(_number)
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False), _A_NUMBER]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False), _A_NUMBER]
Delay = Annotated[float, Field(ge=0, lt=0.5, allow_inf_nan=False), _A_NUMBER]

_STRICT = ConfigDict(extra="forbid")


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Delays:
    """How late each signal is reported, in seconds, against the physical instant.

    The angle comes from the same sensor as the speed unless it has a delay of its own.
    """

    motor_speed: Delay = 0.0
    motor_torque: Delay = 0.0
    torque_sensor: Delay = 0.0
    rack_force: Delay = 0.0
    motor_angle: Delay | None = None

    def of(self, signal: str) -> float:
        """Delay of a canonical signal in seconds; 0 for one without an entry."""
        return {
            "motor_speed_rad_s": self.motor_speed,
            "motor_angle_rad": (self.motor_speed if self.motor_angle is None else self.motor_angle),
            "motor_torque_nm": self.motor_torque,
            "torque_sensor_nm": self.torque_sensor,
            "rack_force_n": self.rack_force,
        }.get(signal, 0.0)


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Friction:
    """LuGre bristle with the load-dependent, asymmetric static level of eq. 3, at the rotor."""

    offset_pos_nm: NotNegative
    offset_neg_nm: NotNegative
    viscous_pos_nm_s_per_rad: NotNegative
    viscous_neg_nm_s_per_rad: NotNegative
    load_pos_nm_per_n: NotNegative
    load_neg_nm_per_n: NotNegative
    sigma0_nm_per_rad: Positive
    sigma1_nm_s_per_rad: NotNegative
    sigma1_speed_rad_s: Positive


@with_config(ConfigDict(extra="ignore"))
@dataclass(frozen=True, slots=True)
class Model:
    """One rig: rotor-side inertia, ratios, signal delays, friction, added effects.

    ``inertia_kg_m2`` is J_1m of eq. 1b; ``pinion_ratio_rad_per_m`` is i_pi;
    ``rack_to_rotor_ratio_rad_per_m`` is i_APA; ``belt_ratio`` is i_be (rotor turns per ball-nut
    turn). Further keys may stand beside these in the file and are left alone.
    """

    inertia_kg_m2: Positive
    pinion_ratio_rad_per_m: Positive
    rack_to_rotor_ratio_rad_per_m: Positive
    friction: Friction
    belt_ratio: Positive = 1.0
    pole_pairs: Annotated[int, Field(gt=0)] = 4
    delays_s: Delays = field(default_factory=Delays)
    effects: tuple[Mapping[str, Any], ...] = ()

    @classmethod
    def load(cls, path: str | Path) -> "Model":
        """Read a model file, as :func:`load_model`."""
        return load_model(path)

    def save(self, path: str | Path) -> None:
        """Write it as a model file."""
        Path(path).write_text(dump_model(self), encoding="utf-8")

    @property
    def sensor_to_rotor(self) -> float:
        """i_pi / i_APA: rotor torque per torsion-bar torque (eq. 1a)."""
        return self.pinion_ratio_rad_per_m / self.rack_to_rotor_ratio_rad_per_m


def load_model(path: str | Path, *, rig: bool = False) -> Model:
    """Read a model file; :class:`InputError` names line and field of the first mistake.

    ``rig``: of a simulated rig, which may also have effects on what it reports.
    """
    model = yaml_file.load(path, Model, section="model")
    if model.effects:
        from eps_hil.physics.effects.catalogue import values_of

        for k, entry in enumerate(model.effects):
            try:
                values_of(entry, model, rig=rig)
            except ValueError as error:
                place = f"model.effects[{k}]"
                raise InputError(path, place, str(error), "see docs/reference-effects.md") from None
    return model


def dump_model(model: Model) -> str:
    """The model as the text of a model file (the inverse of :func:`load_model`)."""
    content = asdict(model)
    content["effects"] = [dict(effect) for effect in model.effects]
    content["delays_s"] = {k: v for k, v in content["delays_s"].items() if v is not None}
    return yaml.safe_dump({"model": content}, sort_keys=False)
