"""A channel that is seconds off the others: two files pasted together, a recorder begun later.

No physics does that, and nothing sensible can be said beside it. Below 3 Hz the torques of a drive
add up by a rough linear balance, and the rack goes with the rotor; where they do not as recorded,
but do with one channel moved by a tenth of a second or more, and so that each half of the recording
follows from the other, that channel is named. In motion of one or two frequencies a channel that is
off looks like spring and damper: it is not told.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from eps_hil.errors import InputError
from eps_hil.identification.butterworth import low_pass
from eps_hil.identification.prepare import Prepared

Floats = npt.NDArray[np.float64]

LOW_HZ, EVERY = 3.0, 50
"""Low-pass, and samples of 1 ms from one that is looked at to the next."""
FARTHEST_S, NEAREST_S = 5.0, 0.1
UNEXPLAINED, EXPLAINED, BETTER = 0.1, 0.05, 0.2
"""Shares of the variance: more is left as recorded, less with the channel moved; and of the former
by the latter at most."""
ELSEWHERE = 0.5
"""Of what is left as recorded: more of either half, by the other half's fit, and it is chance."""
_SHORTEST, _SAME = 200, 1e-9
_TURNS = 0.1
"""Of the usual speed, below which friction turns over."""
_LOADS = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")


def check_clocks(one: Prepared) -> None:
    """:class:`InputError` with the channel that is far off the clock of the others."""
    raw = {name: np.where(np.isfinite(v), v, 0.0) for name, v in one.raw.items()}
    speed = raw.get("motor_speed_rad_s")
    if speed is None:
        speed = np.gradient(low_pass(raw["motor_angle_rad"], 10.0 * LOW_HZ), 1e-3)
    if not np.any(speed):
        return
    found = None
    loads = [name for name in _LOADS if name in raw]
    if loads:
        turning = np.tanh(speed / (_TURNS * np.sqrt(np.mean(speed**2))))
        motion = [_slow(c) for c in (turning, speed, np.gradient(speed, 1e-3))]
        found = _moved(loads, [_slow(raw[name]) for name in loads], motion)
    if found is None and {"rack_position_m", "motor_angle_rad"} <= raw.keys():
        place = _slow(raw["rack_position_m"])
        found = _moved(["rack_position_m"], [place], [_slow(raw["motor_angle_rad"])])
    if found is not None:
        name, late_s = found
        word = "later" if late_s > 0.0 else "earlier"
        raise InputError(
            one.name,
            name,
            f"comes some {abs(late_s):.1f} s {word} than the other channels",
            "put all channels on one clock",
        )


def _slow(values: Floats) -> Floats:
    return low_pass(values, LOW_HZ)[::EVERY]


def _moved(
    names: Sequence[str], channels: Sequence[Floats], motion: Sequence[Floats]
) -> tuple[str, float] | None:
    """The channel with which, moved, the first follows from all others, and how late it is, s."""
    step_s = 1e-3 * EVERY
    most = round(FARTHEST_S / step_s)
    n = len(channels[0])
    if n - 2 * most < _SHORTEST:
        return None
    inside = slice(most, n - most)
    fixed = np.column_stack([np.ones(n - 2 * most), *(c[inside] for c in motion)])

    def rows(k: int, by: int) -> tuple[Floats, Floats]:
        moved = [c[inside] for c in channels]
        moved[k] = channels[k][most + by : n - most + by]
        target, *others = moved
        return target, np.column_stack([fixed, *others])

    def left(k: int, by: int) -> float:
        target, columns = rows(k, by)
        return _left(target, columns, slice(None), slice(None))

    def left_elsewhere(k: int, by: int) -> float:
        """Of either half by the other: a few free numbers explain a slow swing at some shift."""
        target, columns = rows(k, by)
        half = len(target) // 2
        first, second = slice(None, half), slice(half, None)
        return max(_left(target, columns, first, second), _left(target, columns, second, first))

    recorded = left(0, 0)
    if recorded < UNEXPLAINED:
        return None
    shifts = range(-most, most + 1)
    tries = [
        (one, k, by)
        for k in range(len(names))
        for by, one in zip(shifts, _left_of_all(channels, k, fixed, inside), strict=True)
        if abs(by) * step_s >= NEAREST_S
    ]
    best, k, by = min(tries)
    if best >= min(EXPLAINED, BETTER * recorded) or abs(by) == most:
        return None
    return (names[k], by * step_s) if left_elsewhere(k, by) < ELSEWHERE * recorded else None


def _left_of_all(channels: Sequence[Floats], k: int, fixed: Floats, inside: slice) -> list[float]:
    """:func:`_left` for channel ``k`` at every shift, the earliest first: all at once."""
    moved = sliding_window_view(channels[k], len(fixed))
    others = [one[inside] for i, one in enumerate(channels) if i not in (0, k)]
    basis = _basis(np.column_stack([fixed, *others]))

    def own(rows: Floats) -> Floats:
        return rows - (rows @ basis) @ basis.T

    target = moved if k == 0 else channels[0][None, inside]
    rest = own(target)
    left = np.sum(rest**2, axis=1)
    if k > 0:
        column = own(moved)
        size, there = np.sum(column**2, axis=1), np.sum(moved**2, axis=1)
        along = (column @ rest[0]) ** 2 / np.maximum(size, 1e-300)
        left = left - np.where(size > _SAME**2 * there, along, 0.0)
    variance = np.var(target, axis=1)
    shares = np.where(variance > 0.0, left / len(fixed) / np.maximum(variance, 1e-300), 0.0)
    return np.broadcast_to(shares, len(moved)).tolist()


def _basis(columns: Floats) -> Floats:
    """An orthonormal basis (n, k) of what columns (n, p) span."""
    size = np.sqrt(np.sum(columns**2, axis=0)) + 1e-300
    u, strength, _ = np.linalg.svd(columns / size, full_matrices=False)
    return np.asarray(u[:, strength > _SAME * strength[0]])


def _left(target: Floats, columns: Floats, fitted: slice, judged: slice) -> float:
    """Share of the variance that a fit to some rows leaves of others."""
    variance = float(np.var(target))
    if variance <= 0.0:
        return 0.0
    size = np.sqrt(np.sum(columns**2, axis=0)) + 1e-300
    found = np.linalg.lstsq(columns[fitted] / size, target[fitted], rcond=1e-9)[0]
    rest = target[judged] - columns[judged] / size @ found
    return float(np.mean(rest**2)) / variance
