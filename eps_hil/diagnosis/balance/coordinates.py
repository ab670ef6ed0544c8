"""The measured coordinates of the thinned samples."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.prepare import THIN, Prepared
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]


def coordinates_of(recordings: Sequence[Prepared], model: Model) -> Mapping[str, Floats]:
    """Canonical signals at the thinned samples, physical instants, all shape (n,)."""
    rows: dict[str, list[Floats]] = {}
    for recording in recordings:
        motion = recording.motion(model)
        edge = (len(recording.time_s) - len(recording.thin_time_s) * THIN) // 2
        take = slice(edge, edge + len(recording.thin_time_s) * THIN, THIN)
        signals = {
            "motor_speed_rad_s": motion.speed_rad_s,
            "rack_position_m": motion.position_m,
            "rack_force_n": motion.rack_force_n,
            "motor_torque_nm": motion.motor_torque_nm,
            "torque_sensor_nm": motion.torque_sensor_nm,
            "time_s": recording.time_s,
        }
        for name, values in signals.items():
            rows.setdefault(name, []).append(values[take].copy())  # a view holds all of it
    return {name: np.concatenate(parts) for name, parts in rows.items()}
