"""Model files (CONTRACT 4): the nominal one of every case, and the one that knows the truth."""

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from eps_hil.proof.sensors import SPEED_LATE_S, TORQUE_LATE_S
from eps_hil.proof.sizes import SIZES, Size
from eps_hil.proof.truth import Drive


def model_yaml(
    drive: Drive, effects: Sequence[Mapping[str, Any]] = (), size: Size = SIZES[""]
) -> str:
    """The model file of a drive, with added effects (CONTRACT 8) if any, in a size."""
    friction = {
        "offset_pos_nm": drive.k0_pos,
        "offset_neg_nm": drive.k0_neg,
        "viscous_pos_nm_s_per_rad": drive.kw_pos,
        "viscous_neg_nm_s_per_rad": drive.kw_neg,
        "load_pos_nm_per_n": drive.kr_pos,
        "load_neg_nm_per_n": drive.kr_neg,
        "sigma0_nm_per_rad": drive.sigma0,
        "sigma1_nm_s_per_rad": drive.sigma1,
        "sigma1_speed_rad_s": drive.sigma1_speed,
    }
    delays = {
        "motor_speed": SPEED_LATE_S,
        "motor_torque": TORQUE_LATE_S,
        "torque_sensor": 0.0,
        "rack_force": 0.0,
    }
    model = {
        "inertia_kg_m2": drive.inertia_kg_m2,
        "pinion_ratio_rad_per_m": drive.pinion_rad_per_m,
        "rack_to_rotor_ratio_rad_per_m": drive.rack_rad_per_m,
        "belt_ratio": drive.belt_ratio,
        "pole_pairs": int(drive.pole_pairs),
        "delays_s": delays,
        "friction": friction,
        "effects": [dict(one) for one in effects],
    }
    return str(yaml.safe_dump({"model": size.model(model)}, sort_keys=False))
