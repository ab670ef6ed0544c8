"""Whether all recordings are of one machine: the inertia of each against those of the others.

What a drive's recordings may differ in is physics (friction that warms up, a stop that one meets).
Its inertia may not. It is read off a rough linear balance of every recording apart; where it is
clearly another in one of them, these are two rigs in one call, and names would only stand for the
difference. A recording that hardly accelerates tells nothing; nor does one in which the motor's
torque is hardly more than the assistance's own law, which a regression finds in place of a balance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.intake import RecordingError
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.identification.butterworth import low_pass
from eps_hil.identification.prepare import Prepared

Floats = npt.NDArray[np.float64]

WAYS, EVERY = ((10.0, False), (4.0, False), (10.0, True)), 20
"""Low-pass in Hz, and whether a spring stands beside it, of each look; and samples of 1 ms from one
that is looked at to the next."""
ANOTHER = 1.3
"""Times the other recording's: more than a balance without what is to be found makes of it."""
DEVIATIONS = 6.0
"""Of the difference of logarithms, by how blocks of a recording differ."""
_UNEXPLAINED = 0.02
"""Of the variance: a balance that leaves more tells no number well enough to refuse anything."""
_AGAINST = {"torque_sensor_nm": -1.0, "rack_force_n": 1.0}
"""Sign with which the motor's torque balances each."""
_BLOCKS, _SHORTEST = 8, 400
_TURNS = 0.1


@dataclass(frozen=True)
class _Number:
    """A number of a recording, with the deviation of its logarithm."""

    value: float
    deviation: float


def check_one_machine(recordings: Sequence[Prepared]) -> None:
    """:class:`RecordingError` for a recording that is of another machine than one before it."""
    told: list[tuple[str, _Number]] = []
    for one, here in zip(recordings, each(_inertia, recordings), strict=True):
        if here is None:
            continue
        for other, there in told:
            unsure = float(np.hypot(here.deviation, there.deviation))
            if abs(np.log(here.value / there.value)) > max(np.log(ANOTHER), DEVIATIONS * unsure):
                raise RecordingError(
                    one.name,
                    f"is of another machine than {other}: the inertia at the rotor is "
                    f"{here.value:.2g} kg m², there {there.value:.2g}; diagnose the two apart",
                )
        told.append((one.name, here))


def _inertia(one: Prepared) -> _Number | None:
    """At the rotor; None where a linear balance hardly explains the torque.

    What differs between two bands, or beside a spring, is no inertia but what the balance lacks,
    or a motor that holds a place: its torque follows the motion, whatever it moves.
    """
    rows = {low_hz: _rows(one, low_hz) for low_hz in {low_hz for low_hz, _ in WAYS}}
    told = [_below(rows[low_hz], spring=spring) for low_hz, spring in WAYS]
    first = told[0]
    if first is None:
        return None
    deviation = first.deviation
    for other in told[1:]:
        if other is None:
            return None
        deviation = float(np.hypot(deviation, np.log(first.value / other.value)))
    return _Number(first.value, deviation)


@dataclass(frozen=True)
class _Rows:
    """Torque (m,), what it depends on (m, p), and of which columns the sign is known.

    The acceleration is the first column, the place of a spring the last.
    """

    torque: Floats
    columns: Floats
    signs: Mapping[int, float]


def _rows(one: Prepared, low_hz: float) -> _Rows | None:
    raw = {name: np.where(np.isfinite(v), v, 0.0) for name, v in one.raw.items()}
    speed = raw.get("motor_speed_rad_s")
    if speed is None:
        speed = np.gradient(low_pass(raw["motor_angle_rad"], 3.0 * low_hz), 1e-3)
    if not np.any(speed) or "motor_torque_nm" not in raw:
        return None
    size = float(np.sqrt(np.mean(speed**2)))
    turning = np.tanh(speed / (_TURNS * size))
    columns = [np.gradient(speed, 1e-3), turning, speed, np.abs(speed) * speed]
    columns += [turning * np.exp(-np.abs(speed) / size), np.ones(len(speed))]
    loads = [name for name in _AGAINST if name in raw]
    first, columns = len(columns), columns + [raw[name] for name in loads]
    if "rack_force_n" in raw:
        columns.append(np.abs(raw["rack_force_n"]) * turning)
    columns.append(np.cumsum(speed) * 1e-3)
    torque = low_pass(raw["motor_torque_nm"], low_hz)[::EVERY]
    if len(torque) < _SHORTEST or not np.ptp(torque) > 0.0:
        return None
    slow = np.column_stack([low_pass(c, low_hz)[::EVERY] for c in columns])
    return _Rows(torque, slow, {first + k: _AGAINST[name] for k, name in enumerate(loads)})


def _below(rows: _Rows | None, *, spring: bool) -> _Number | None:
    if rows is None:
        return None
    torque, a = rows.torque, rows.columns if spring else rows.columns[:, :-1]
    a = a / (scale := np.sqrt(np.mean(a**2, axis=0)) + 1e-300)
    parts = np.array_split(np.arange(len(a)), _BLOCKS)
    normal = np.array([a[p].T @ a[p] for p in parts])
    right = np.array([a[p].T @ torque[p] for p in parts])
    ridge = 1e-9 * len(a) * np.eye(a.shape[1])
    whole = np.linalg.solve(normal.sum(axis=0) + ridge, right.sum(axis=0))
    if float(np.mean((torque - a @ whole) ** 2)) > _UNEXPLAINED * float(np.var(torque)):
        return None
    if any(whole[k] * sign < 0.0 for k, sign in rows.signs.items()):
        return None
    without = np.array(
        [
            np.linalg.solve(normal.sum(axis=0) - normal[k] + ridge, right.sum(axis=0) - right[k])
            for k in range(_BLOCKS)
        ]
    )
    values = np.array([whole[0], *without[:, 0]])
    if not np.all(values > 0.0):
        return None
    logs = np.log(values[1:])
    spread = float(np.sqrt((_BLOCKS - 1) * np.mean((logs - np.mean(logs)) ** 2)))
    return _Number(float(values[0] / scale[0]), spread)
