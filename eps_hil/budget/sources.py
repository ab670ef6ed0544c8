"""Sources of error, one by one: what each does to the model file or to the recorded samples.

A source has a size (one standard deviation) in its own unit. Errors of the model file are put into
the model that the *estimator* believes in; everything else is done to the samples of a simulated
rig, on their way from the physical value to the recording.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from eps_hil.physics.model import Friction, Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]


class Group(StrEnum):
    """Sources that one job on the rig would put right together."""

    LEVELS = "friction levels"
    BRISTLE = "bristle"
    INERTIA = "inertia and ratios"
    DELAYS = "delays"
    SCALE = "gains and offsets"
    NOISE = "sensor noise"
    STEPS = "quantisation"
    SAMPLING = "sampling and jitter"


JOBS: Mapping[Group, str] = {
    Group.LEVELS: "identify the friction map (constant speeds under preload)",
    Group.BRISTLE: "identify the bristle (slow reversals, small motion)",
    Group.INERTIA: "identify the inertia, check the ratios",
    Group.DELAYS: "identify the delays between speed, torque and torsion bar",
    Group.SCALE: "calibrate motor torque and torsion bar (gain and zero)",
    Group.NOISE: "quieter sensors, or a slower observer (eps-hil tune)",
    Group.STEPS: "a finer resolution in the DBC",
    Group.SAMPLING: "stamps at the source, faster frames",
}
"""What an engineer would do about a group."""

_BRISTLE = ("sigma0_nm_per_rad", "sigma1_nm_s_per_rad", "sigma1_speed_rad_s")
_DRIVE = {
    "inertia_kg_m2": "kg m2",
    "pinion_ratio_rad_per_m": "rad/m",
    "rack_to_rotor_ratio_rad_per_m": "rad/m",
}
SIGNALS = {
    "motor_torque_nm": "Nm",
    "torque_sensor_nm": "Nm",
    "motor_speed_rad_s": "rad/s",
    "motor_angle_rad": "rad",
}
"""What the estimator is given, with units."""
DELAYED = {
    "motor_torque": ("motor_torque_nm",),
    "torque_sensor": ("torque_sensor_nm",),
    "motor_speed": ("motor_speed_rad_s", "motor_angle_rad"),
}
"""Names of the model file's delays, and the signals that each moves."""


@dataclass(frozen=True, slots=True)
class Source:
    """One source: its name as in an uncertainty file, ``size`` in ``unit`` (one deviation).

    ``random`` sources are drawn anew for each sample; the others are one number per rig, which a
    calibration finds or misses.
    """

    name: str
    group: Group
    size: float
    unit: str
    random: bool = False


def unit_of(name: str) -> str:
    """The unit that a model parameter's name carries."""
    for ending, unit in (
        ("_nm_s_per_rad", "Nm s/rad"),
        ("_nm_per_rad", "Nm/rad"),
        ("_nm_per_n", "Nm/N"),
        ("_rad_s", "rad/s"),
        ("_nm", "Nm"),
    ):
        if name.endswith(ending):
            return unit
    return _DRIVE.get(name, "")


def model_parameters() -> dict[str, Group]:
    """Names of the model file's numbers that a source may be, with their groups."""
    groups = {f.name: Group.BRISTLE if f.name in _BRISTLE else Group.LEVELS
              for f in fields(Friction)}  # fmt: skip
    return groups | dict.fromkeys(_DRIVE, Group.INERTIA)


def wrong_model(model: Model, errors: Mapping[str, float]) -> Model:
    """The model with ``errors`` added to its numbers; none becomes negative (ratios stay above 0).

    Keys that are no model parameter are left alone.
    """
    known = model_parameters()
    friction: dict[str, float] = {}
    drive: dict[str, float] = {}
    for name, error in errors.items():
        if name not in known:
            continue
        into = drive if known[name] is Group.INERTIA else friction
        value = getattr(model if into is drive else model.friction, name)
        least = 0.02 * value  # far outside any sensible interval, and still a model
        into[name] = max(value + error, least)
    changed = replace(model, friction=replace(model.friction, **friction))
    return replace(changed, **drive)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class Samples:
    """What a rig's sensors would report without any error: 1 kHz columns, each (n,)."""

    time_s: Floats
    columns: Mapping[str, Floats]


def recorded(
    clean: Samples, errors: Mapping[str, float], periods_s: Mapping[str, float], seed: int
) -> dict[str, Series]:
    """The recording with ``errors`` by source name (see ``uncertainty.sources``).

    ``gain.X``, ``offset.X``, ``delay.D``: a number; ``noise.X``, ``step.X``, ``jitter.X``: rms,
    resolution, rms of stamps; 0 or absent: none. The same seed gives the same noise whatever else
    is on. ``periods_s``: the slower sample periods of signals.
    """
    late = {
        signal: errors.get(f"delay.{name}", 0.0)
        for name, signals in DELAYED.items()
        for signal in signals
    }
    t_ns = np.round(clean.time_s * 1e9).astype(np.int64)
    result = {}
    for place, name in enumerate(n for n in SIGNALS if n in clean.columns):
        rng = np.random.default_rng([seed, place])
        n = len(t_ns)
        value = clean.columns[name] * (1.0 + errors.get(f"gain.{name}", 0.0))
        value = value + errors.get(f"offset.{name}", 0.0)
        value = value + errors.get(f"noise.{name}", 0.0) * rng.standard_normal(n)
        step = errors.get(f"step.{name}", 0.0)
        if step > 0.0:
            value = np.round(value / step) * step
        stamps = t_ns + round(late[name] * 1e9)
        # a stamp that overtakes its neighbour would be dropped: jitter stays inside half a sample
        jitter = np.clip(errors.get(f"jitter.{name}", 0.0) * rng.standard_normal(n), -4e-4, 4e-4)
        stamps = stamps + np.round(jitter * 1e9).astype(np.int64)
        every = max(1, round(periods_s.get(name, 1e-3) / 1e-3))
        result[name] = Series(stamps[::every], value[::every])
    return result
