"""What an identification moves: the model's numbers, and the spring of a load without a cell.

Every parameter has a prior as wide as a data sheet is wrong. It decides nothing where recordings
speak; it is the yardstick of whether they do.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from eps_hil.physics.model import Model

FRICTION_UNITS = {
    "offset_pos_nm": "Nm",
    "offset_neg_nm": "Nm",
    "viscous_pos_nm_s_per_rad": "Nm s/rad",
    "viscous_neg_nm_s_per_rad": "Nm s/rad",
    "load_pos_nm_per_n": "Nm/N",
    "load_neg_nm_per_n": "Nm/N",
}
BRISTLE_UNITS = {
    "sigma0_nm_per_rad": "Nm/rad",
    "sigma1_nm_s_per_rad": "Nm s/rad",
    "sigma1_speed_rad_s": "rad/s",
}
POSITIVE = ("inertia_kg_m2", *(f"friction.{name}" for name in BRISTLE_UNITS))
"""Parameters that a model holds above zero only."""
DELAYS = ("motor_torque", "torque_sensor", "rack_force")
"""Signals whose delay is found against that of the motor speed."""

_LEAST = {"offset": 0.05, "viscous": 1e-3, "load": 5e-5}
"""Priors are half of the model's value, or half of these typical ones where it says less."""
_DELAY_PRIOR_S = 0.006


@dataclass(frozen=True, slots=True)
class Spring:
    """F = force at x = 0 + stiffness · x + damping · dx/dt, at the rack."""

    stiffness_n_per_m: float = 0.0
    force_n: float = 0.0
    damping_n_s_per_m: float = 0.0


@dataclass(frozen=True)
class State:
    """A model, and a spring for each recording (by index) whose rack force was not measured."""

    model: Model
    springs: Mapping[int, Spring] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number: name as in the model file's tree, unit, prior deviation, step to probe it."""

    name: str
    unit: str
    prior: float
    step: float


def get(state: State, name: str) -> float:
    """The value of a parameter; delays are against the motor speed's."""
    group, _, key = name.rpartition(".")
    if group == "friction":
        return float(getattr(state.model.friction, key))
    if group == "delays_s":
        delays = state.model.delays_s
        return float(getattr(delays, key)) - delays.motor_speed
    if group.startswith("spring"):
        return float(getattr(state.springs[int(group[6:])], key))
    return float(getattr(state.model, key))


def put(state: State, name: str, value: float) -> State:
    """The state with one parameter changed."""
    group, _, key = name.rpartition(".")
    model = state.model
    if group == "friction":
        if key in BRISTLE_UNITS:
            value = max(value, 1e-6)
        return replace(
            state, model=replace(model, friction=replace(model.friction, **{key: value}))
        )
    if group == "delays_s":
        late = replace(model.delays_s, **{key: value + model.delays_s.motor_speed})
        return replace(state, model=replace(model, delays_s=late))
    if group.startswith("spring"):
        k = int(group[6:])
        return replace(
            state, springs={**state.springs, k: replace(state.springs[k], **{key: value})}
        )
    changed: dict[str, Any] = {key: value}
    return replace(state, model=replace(model, **changed))


def sliding_parameters(state: State, signals: set[str]) -> tuple[Parameter, ...]:
    """What sliding friction and motion show; ``signals`` are those that were recorded at all."""
    start = state.model
    found = [Parameter("inertia_kg_m2", "kg m²", 0.5 * start.inertia_kg_m2, 0.0)]
    for key, unit in FRICTION_UNITS.items():
        usual = max(abs(getattr(start.friction, key)), _LEAST[key.split("_")[0]])
        found.append(Parameter(f"friction.{key}", unit, 0.5 * usual, 0.02 * usual))
    for key in DELAYS:
        signal = {"motor_torque": "motor_torque_nm", "torque_sensor": "torque_sensor_nm"}
        if signal.get(key, "rack_force_n") in signals:
            found.append(Parameter(f"delays_s.{key}", "s", _DELAY_PRIOR_S, 2e-4))
    for k in state.springs:
        found.append(Parameter(f"spring{k}.stiffness_n_per_m", "N/m", 1e5, 200.0))
        found.append(Parameter(f"spring{k}.force_n", "N", 500.0, 5.0))
        found.append(Parameter(f"spring{k}.damping_n_s_per_m", "N s/m", 5e3, 20.0))
    return tuple(found)


def bristle_parameters(state: State) -> tuple[Parameter, ...]:
    """What reversals and small motion show; priors are a factor of a few."""
    friction = state.model.friction
    return tuple(
        Parameter(f"friction.{key}", unit, 2.0 * getattr(friction, key), 0.0)
        for key, unit in BRISTLE_UNITS.items()
    )
