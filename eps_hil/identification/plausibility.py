"""Wrong signs, swapped channels and wrong units, before anything is fitted to them.

The torque balance while sliding is linear; with every sign and every swap of torques tried, the
right one leaves far less than the others, if a channel carries anything at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.identification import filters
from eps_hil.identification.balance import Case
from eps_hil.identification.state import State, get

Floats = npt.NDArray[np.float64]

_CLEARLY = 0.5
"""A sign is called wrong when turning it leaves less than this part of the residual."""
_TRIED_S = (0.0, -0.008, 0.008, -0.016, 0.016)
_FEWEST = 200
_MOST = 2500
_TORQUES = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")


@dataclass(frozen=True)
class _Rows:
    """Filtered signals while sliding: torques at the rotor (3, m) and what motion explains."""

    torques: Floats
    motion: Floats


def check(cases: Sequence[Case], state: State) -> None:
    """:class:`InputError` that names the channel, for each recording and for all together."""
    for case in cases:
        if not case.measured_load:
            continue
        rows = [_rows(case, state, late) for late in _TRIED_S]
        if rows[0].motion.shape[0] < _FEWEST:
            continue
        _unit(case, rows)
        _swaps(case, state, rows)
        _signs(case, rows)


def _rows(case: Case, state: State, late_s: float) -> _Rows:
    model, motion = state.model, case.motion
    sliding = np.abs(motion.speed) > 2.0 * case.slowest
    whole = filters.smooth((~sliding).astype(np.float64)) < 1e-9
    mine = np.flatnonzero(whole & case.good)
    mine = mine[:: max(1, len(mine) // _MOST)]
    keys = ("delays_s.motor_torque", "delays_s.torque_sensor", "delays_s.rack_force")
    scale = (1.0, model.sensor_to_rotor, -1.0 / model.rack_to_rotor_ratio_rad_per_m)
    torques = np.array(
        [
            factor * filters.smooth(case.signal(name, get(state, key) + late_s))[mine]
            for name, key, factor in zip(_TORQUES, keys, scale, strict=True)
        ]
    )
    speed = filters.thinned(motion.speed)[mine]
    load = np.abs(filters.thinned(case.signal("rack_force_n", 0.0)))[mine]
    forth = (speed > 0).astype(np.float64)
    terms = [
        case.motion.acceleration[mine],
        forth,
        forth - 1.0,
        speed,
        np.sign(speed) * load,
    ]
    return _Rows(torques, np.column_stack(terms))


def _left(rows: Sequence[_Rows], weights: Sequence[float]) -> float:
    """Rms of the balance with torques so weighted, at the best of a few skews; Nm."""
    from scipy.optimize import nnls

    best = np.inf
    for one in rows:
        size = np.maximum(np.sqrt(np.mean(one.motion**2, axis=0)), 1e-12)
        _, norm = nnls(one.motion / size, np.asarray(weights) @ one.torques)
        best = min(best, norm / np.sqrt(one.motion.shape[0]))
    return float(best)


def _signs(case: Case, rows: Sequence[_Rows]) -> None:
    tried = {signs: _left(rows, signs) for signs in product((1, -1), repeat=3)}
    as_is, least = tried[1, 1, 1], min(tried.values())
    size = float(np.sqrt(np.mean(np.sum(rows[0].torques ** 2, axis=0))))
    if least > _CLEARLY * as_is or as_is < 0.05 * size:
        return
    # the fewest wrong channels that explain it; all three torques are one wrong motion
    likely = [signs for signs, left in tried.items() if left < 1.25 * least]
    signs = min(likely, key=lambda one: 1 if sum(one) == -3 else one.count(-1))
    wrong = [name for name, sign in zip(_TORQUES, signs, strict=True) if sign < 0]
    if len(wrong) == 3:
        words = "motor_speed_rad_s (and motor_angle_rad) has the wrong sign"
        raise InputError(case.recording.name, "motor_speed_rad_s", words, _remedy())
    words = " and ".join(f"{name} has the wrong sign" for name in wrong)
    raise InputError(case.recording.name, wrong[0], words, _remedy())


def _swaps(case: Case, state: State, rows: Sequence[_Rows]) -> None:
    """Motor torque and torsion-bar torque in each other's column."""
    if not case.recording.has("torque_sensor_nm"):
        return
    ratio = state.model.sensor_to_rotor
    best = min(_left(rows, signs) for signs in product((1, -1), repeat=3))
    swapped = _left(rows, (ratio, 1 / ratio, 1))
    if swapped < _CLEARLY * best:
        problem = "torque_sensor_nm looks like motor_torque_nm: the two columns are swapped"
        raise InputError(case.recording.name, "torque_sensor_nm", problem, "swap the columns")


def _unit(case: Case, rows: Sequence[_Rows]) -> None:
    """A load cell in kN, or zeroed far off: its own factor fitted freely."""
    from scipy.optimize import nnls

    one = rows[0]
    force = -one.torques[2]
    if np.std(force) <= 0:
        return
    columns = np.column_stack([one.motion[:, :4], np.maximum(force, 0), np.minimum(force, 0)])
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    found, _ = nnls(columns / size, one.torques[0] + one.torques[1])
    factor = float(np.max((found / size)[4:]))
    if 500 < factor < 2000:
        problem = f"is about {factor:.0f} times too small: in kN?"
        raise InputError(case.recording.name, "rack_force_n", problem, "give it in N")


def _remedy() -> str:
    return "turn it (in a mapping: scale: -1), or check the sensor's direction"
