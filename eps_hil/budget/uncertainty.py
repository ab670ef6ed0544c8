"""How uncertain each source is: documented defaults, a YAML file, or an identification's intervals.

Sizes are standard deviations. The defaults are those of a rig that was calibrated once, with care
(docs/howto-error-budget.md says where each comes from).
"""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, with_config

from eps_hil import json_text, yaml_file
from eps_hil.budget.sources import DELAYED, SIGNALS, Group, Source, model_parameters, unit_of
from eps_hil.errors import InputError
from eps_hil.physics.model import Model
from eps_hil.rig.sensors import NOISE_RMS

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Sizes = Mapping[str, NotNegative]

_STRICT = ConfigDict(extra="forbid")
_HALF_WIDTH_95 = 1.96

PERCENT: Mapping[str, float] = {
    "offset_pos_nm": 5.0,
    "offset_neg_nm": 5.0,
    "viscous_pos_nm_s_per_rad": 20.0,
    "viscous_neg_nm_s_per_rad": 20.0,
    "load_pos_nm_per_n": 5.0,
    "load_neg_nm_per_n": 5.0,
    "sigma0_nm_per_rad": 20.0,
    "sigma1_nm_s_per_rad": 30.0,
    "sigma1_speed_rad_s": 30.0,
    "inertia_kg_m2": 3.0,
    "pinion_ratio_rad_per_m": 0.2,
    "rack_to_rotor_ratio_rad_per_m": 0.2,
}
"""Of the model file's numbers, in per cent of their value."""
DELAYS_S = {"motor_torque": 2e-4, "torque_sensor": 5e-4, "motor_speed": 2e-4}
GAINS_PERCENT = {"motor_torque_nm": 1.0, "torque_sensor_nm": 1.0}
OFFSETS = {"motor_torque_nm": 5e-3, "torque_sensor_nm": 0.02}
STEPS = {
    "motor_torque_nm": 1e-3,
    "torque_sensor_nm": 2e-3,
    "motor_speed_rad_s": 0.02,
    "motor_angle_rad": 1e-3,
}
"""Resolution of the signals; with a DBC at hand, its own (``--dbc``)."""
JITTER_S = 5e-5


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Uncertainty:
    """The ``uncertainty:`` block of a YAML file; what is not given keeps its default, 0 is off.

    Model parameters in their own unit (``model``) or in per cent (``percent``); ``delays_s``,
    ``gains_percent``, ``offsets``, ``noise_rms``, ``steps`` and ``periods_s`` by delay or signal.
    """

    model: Sizes = field(default_factory=dict)
    percent: Sizes = field(default_factory=dict)
    delays_s: Sizes = field(default_factory=dict)
    gains_percent: Sizes = field(default_factory=dict)
    offsets: Sizes = field(default_factory=dict)
    noise_rms: Sizes = field(default_factory=dict)
    steps: Sizes = field(default_factory=dict)
    jitter_s: NotNegative = JITTER_S
    periods_s: Sizes = field(default_factory=dict)


def load_uncertainty(path: Path, model: Model) -> Uncertainty:
    """A YAML file with an ``uncertainty:`` block, or the JSON of ``eps-hil identify``.

    :class:`InputError` names file and field of the first mistake.
    """
    if path.suffix.lower() == ".json":
        return _from_identification(path, model)
    given = yaml_file.load(path, Uncertainty, section="uncertainty")
    known: dict[str, set[str]] = {
        "model": set(model_parameters()),
        "percent": set(model_parameters()),
        "delays_s": set(DELAYED),
    }
    for block in ("model", "percent", "delays_s", "gains_percent", "offsets", "noise_rms", "steps",
                  "periods_s"):  # fmt: skip
        allowed = known.get(block, set(SIGNALS))
        for name in getattr(given, block):
            if name not in allowed:
                raise InputError(
                    path, f"uncertainty.{block}.{name}", "is no known name",
                    f"known: {', '.join(sorted(allowed))}",
                )  # fmt: skip
    return given


def _from_identification(path: Path, model: Model) -> Uncertainty:
    try:
        content = json_text.parse(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise InputError(path, "", f"cannot be read as JSON: {error}", "give the file of "
                         "eps-hil identify --json") from None  # fmt: skip
    parameters: dict[str, float] = {}
    delays: dict[str, float] = {}
    offsets: dict[str, float] = {}
    for keys, interval in _intervals(content):
        if keys[-1] in model_parameters():
            parameters[keys[-1]] = _deviation(path, keys, interval)
        elif keys[-1] in DELAYED and "skews_s" not in keys:  # a skew is a difference of two
            delays[keys[-1]] = _deviation(path, keys, interval)
        elif "offsets" in keys and (name := keys[-1].replace("_offset_nm", "_nm")) in OFFSETS:
            offsets[name] = _deviation(path, keys, interval)
    if not parameters and not delays and not offsets:
        raise InputError(
            path, "", "holds no interval (ci95) of a model parameter or delay",
            "give the file of eps-hil identify --json, or a YAML file",
        )  # fmt: skip
    return Uncertainty(model=parameters, delays_s=delays, offsets=offsets)


def _deviation(path: Path, keys: tuple[str, ...], interval: list[Any]) -> float:
    """Of a 95 % interval; :class:`InputError` where its ends are no finite numbers."""
    low, high = (one if isinstance(one, int | float) else math.nan for one in interval)
    if not math.isfinite(high - low):
        problem = f"{json.dumps(interval)} is no interval"
        raise InputError(path, ".".join((*keys, "ci95")), problem, "give two numbers, or null")
    return 0.5 * abs(high - low) / _HALF_WIDTH_95


def _intervals(content: Any, keys: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every ``{"ci95": [low, high]}`` of a JSON tree with the keys that lead to it."""
    if isinstance(content, dict):
        interval = content.get("ci95")
        # a list of named entries says its name inside
        named = content.get("name")
        here = (*keys, named) if isinstance(named, str) else keys
        if here and isinstance(interval, list) and len(interval) == 2:
            yield here, interval
        for key, value in content.items():
            yield from _intervals(value, (*keys, str(key)))
    elif isinstance(content, list):
        for value in content:
            yield from _intervals(value, keys)


def sources(model: Model, given: Uncertainty, angle: bool = True) -> list[Source]:
    """All sources with a size above zero, model parameters in their own unit."""
    percent = {**PERCENT, **given.percent}
    result = []

    def add(name: str, group: Group, size: float, unit: str, random: bool = False) -> None:
        if size > 0.0:
            result.append(Source(name, group, size, unit, random))

    for name, group in model_parameters().items():
        holder = model if group is Group.INERTIA else model.friction
        size = given.model.get(name, percent[name] / 100.0 * getattr(holder, name))
        add(name, group, size, unit_of(name))
    for name, size in {**DELAYS_S, **given.delays_s}.items():
        add(f"delay.{name}", Group.DELAYS, size, "s")
    for name, size in {**GAINS_PERCENT, **given.gains_percent}.items():
        add(f"gain.{name}", Group.SCALE, size / 100.0, "1")
    for name, size in {**OFFSETS, **given.offsets}.items():
        add(f"offset.{name}", Group.SCALE, size, SIGNALS[name])
    for name, unit in SIGNALS.items():
        if name == "motor_angle_rad" and not angle:
            continue
        add(f"noise.{name}", Group.NOISE, {**NOISE_RMS, **given.noise_rms}[name], unit, True)
        add(f"step.{name}", Group.STEPS, {**STEPS, **given.steps}[name], unit, True)
        add(f"jitter.{name}", Group.SAMPLING, given.jitter_s, "s", True)
    return result
