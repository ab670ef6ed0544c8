"""A load that nobody measured, as effects of a model file, whose inputs have no rack force.

At the rotor F = k x + c ẋ + f is a spring, a drag and a constant torque. Friction grows with |F|
(eq. 3), each way by its own gain; that is a map over rack position and rotor speed, with knots at
both sides of zero speed and where a spring with its constant holds nothing.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from eps_hil.diagnosis.balance.baseline import OFFSET, SPRING, weight
from eps_hil.diagnosis.data.intake import BELIEVABLE
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model

Entry = dict[str, Any]

_LEAST = 1e-3
"""Friction of a load, of the model's own level, below which no map is written."""
_FAR, _KNOTS = 10.0, 11
_TURNING_RAD_S = 1e-6


class SpringLoad(NamedTuple):
    """F = stiffness x + damping ẋ + constant at the rack (SI), and where the rack went against it:
    how far from its middle, and how fast at the rotor. A weight on a joint follows the sine and the
    cosine of the rotor's angle (Nm).
    """

    stiffness_n_per_m: float
    damping_n_s_per_m: float
    constant_n: float
    travel_m: float
    speed_rad_s: float
    sine_nm: float = 0.0
    cosine_nm: float = 0.0

    @property
    def weight_nm(self) -> float:
        """The largest torque of the weight."""
        return float(np.hypot(self.sine_nm, self.cosine_nm))


def written(model: Model, load: SpringLoad) -> Model:
    """The model with the load, for recordings without a rack force; itself if no drive has such."""
    ratio = model.rack_to_rotor_ratio_rad_per_m
    most = abs(load.stiffness_n_per_m) * load.travel_m + abs(load.constant_n)
    if most + ratio * load.weight_nm > BELIEVABLE["rack_force_n"]:
        return model
    numbers = {
        (SPRING, "stiffness_nm_per_rad"): load.stiffness_n_per_m / ratio**2,
        ("viscous_friction", "coefficient_nm_s_per_rad"): load.damping_n_s_per_m / ratio**2,
        (OFFSET, "offset_nm"): -load.constant_n / ratio,
    }
    effects = [dict(entry) for entry in model.effects]
    springs = [one for one in effects if one["effect"] == SPRING]
    for one in springs:  # its stiffness takes the load's in, which is relaxed at zero
        pull = numbers[SPRING, "stiffness_nm_per_rad"] * float(one.get("middle_rad", 0.0))
        numbers[OFFSET, "offset_nm"] -= pull
    if load.weight_nm > 0.0 and not springs:
        del numbers[SPRING, "stiffness_nm_per_rad"]
    for (name, parameter), value in numbers.items():
        held = next((one for one in effects if one["effect"] == name), {"effect": name})
        total = float(f"{value + float(held.get(parameter, 0.0)):.6g}")
        effects = [*(one for one in effects if one is not held), {**held, parameter: total}]
    if load.weight_nm > 0.0:
        phase = float(np.arctan2(load.cosine_nm, load.sine_nm))
        effects.append(weight(float(f"{load.weight_nm:.6g}"), float(f"{phase:.6g}")))
    effects += _rubbing(with_model_effects(model), load)
    return replace(model, effects=tuple(effects))


def _rubbing(model: Model, load: SpringLoad) -> list[Entry]:
    """What the load adds to T_fs, with the friction numbers of ``model``; none where hardly any."""
    k, c, f = load.stiffness_n_per_m, load.damping_n_s_per_m, load.constant_n
    speed, travel = max(load.speed_rad_s, 1e-3), max(load.travel_m, 1e-6)
    places = {-_FAR * travel, *np.linspace(-travel, travel, _KNOTS).tolist(), _FAR * travel}
    if abs(f) < abs(k) * travel:
        places.add(-f / k)
    x = np.array(sorted(places))
    forward = np.array([_TURNING_RAD_S, 0.5 * speed, speed])
    v = np.concatenate([-forward[::-1], forward])
    ratio = model.rack_to_rotor_ratio_rad_per_m
    rate = v / ratio
    law = model.friction
    gain = np.where(v > 0.0, law.load_pos_nm_per_n, law.load_neg_nm_per_n)
    hangs = load.sine_nm * np.sin(ratio * x) + load.cosine_nm * np.cos(ratio * x)
    level = gain * np.abs((k * x + ratio * hangs)[:, None] + c * rate + f)
    if float(np.max(level[1:-1])) <= _LEAST * max(law.offset_pos_nm, law.offset_neg_nm):
        return []
    return [
        {
            "effect": "empirical",
            "form": "map",
            "where": "friction",
            "how": "sum",
            "inputs": ["rack_position_m", "motor_speed_rad_s"],
            "knots": [[float(f"{one:.8g}") for one in axis] for axis in (x, v)],
            "values": [[float(f"{one:.6g}") for one in row] for row in level],
        }
    ]
