#!/usr/bin/env python3
"""What a free run over DATA_EMPS can tell of the one over DATA_EMPS_PULSES.

    python benchmarks/emps_free_run.py DATA_DIR [--windows]

Models of a few numbers are fitted to nothing but the position of a free run (motor force in,
position out, no measurement fed back): to the one recording, to the other and to both. Where a fit
to both is nearly as good on the first as a fit to the first alone, and far better on the second,
the first recording does not hold what the second one needs. Nothing of `eps_hil.diagnosis` is used.
With --windows the first one is fitted in free runs over windows of some seconds, each from its
measured state: whether a loss that drifts less finds what a whole run does not.

Columns: RMSE in mm after the first 20 samples on either recording, then mass (kg), drag to and fro
(N s/m), sliding friction to and fro (N), and what friction is higher by at standstill (N).
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.optimize import least_squares
from scipy.signal import butter, filtfilt

from eps_hil.axis.emps import (
    COULOMB_N,
    MASS_KG,
    OFFSET_N,
    VISCOUS_N_S_PER_M,
    AxisRecord,
    read,
)
from eps_hil.errors import EpsHilError

Floats = npt.NDArray[np.float64]

STEP_S, PARTS, DELAY_S, UNJUDGED = 1e-3, 4, 0.78e-3, 20
"""The delay is what `eps-hil prove emps` finds."""
BRISTLE_N_PER_M, SLIDES_M_S = 1e6, 2e-3
WINDOWS_S, STATE_HZ = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0), 60.0
NAMES = ("published form", "by direction", "by direction, standstill")
START = np.array(
    [
        MASS_KG,
        VISCOUS_N_S_PER_M,
        VISCOUS_N_S_PER_M,
        COULOMB_N + OFFSET_N,
        COULOMB_N - OFFSET_N,
        -4.0,
        0.012,
    ]
)
SIZE = np.array([10.0, 50.0, 50.0, 5.0, 5.0, 4.0, 0.01])


@njit(cache=False)
def simulated(force: Floats, start_m: float, p: Floats, start_m_s: float = 0.0) -> Floats:
    """Position (n,), m: a mass, drag and a bristle whose level is ``p``'s, full where it slides."""
    out = np.empty(len(force))
    x, v, z = start_m, start_m_s, 0.0
    if abs(v) > SLIDES_M_S:
        z = np.sign(v) * (p[3] if v > 0.0 else p[4]) / BRISTLE_N_PER_M
    h = STEP_S / PARTS
    for i in range(len(force)):
        out[i] = x
        after = force[min(i + 1, len(force) - 1)]
        for j in range(PARTS):
            level = (p[3] if v > 0.0 else p[4]) + p[5] * np.exp(-abs(v) / p[6])
            z = (z + h * v) / (1.0 + h * BRISTLE_N_PER_M * abs(v) / level)
            drag = (p[1] if v > 0.0 else p[2]) * v
            pull = force[i] + (after - force[i]) * j / PARTS
            v += h * (pull - BRISTLE_N_PER_M * z - drag) / p[0]
            x += h * v
    return out


def forces(record: AxisRecord) -> Floats:
    """What drives the carriage, late as the drive is, N, shape (n,)."""
    asked = record.force_n - record.hidden_force_n
    t = STEP_S * np.arange(len(asked))
    return np.asarray(np.interp(t - DELAY_S, t, asked))


def numbers(name: str, q: Floats) -> Floats:
    """All seven numbers from those that are free."""
    p = START.copy()
    p[5] = 0.0
    if name == NAMES[0]:
        p[[0, 1]] += q[:2] * SIZE[:2]
        p[2] = p[1]
        p[3:5] += np.array([q[2] + q[3], q[2] - q[3]]) * SIZE[3:5]
    else:
        p[:5] += q[:5] * SIZE[:5]
    if name == NAMES[2]:
        p[5:] = START[5:] + q[5:] * SIZE[5:]
        p[6] = abs(p[6]) + 1e-3
    return p


Run = tuple[Floats, Floats, float, float]
"""Force (n,), measured position (n,), and where and how fast a free run begins."""


def whole(record: AxisRecord) -> Run:
    """The run over all of a recording, from rest."""
    return forces(record), record.position_m, float(record.position_m[0]), 0.0


def windows(record: AxisRecord, length_s: float) -> list[Run]:
    """Half overlapping runs, each from the measured state, smoothed without phase."""
    b, a = butter(4, STATE_HZ, fs=1 / STEP_S)
    place = filtfilt(b, a, record.position_m)
    speed, force, n = np.gradient(place, STEP_S), forces(record), round(length_s / STEP_S)
    return [
        (force[k : k + n], record.position_m[k : k + n], float(place[k]), float(speed[k]))
        for k in range(0, len(place) - n + 1, n // 2)
    ]


def fitted(name: str, runs: Sequence[Run], near: Sequence[Floats] = ()) -> Floats:
    """What is free of the numbers at the least squared error of position in free runs.

    The best from the published numbers and from each fit ``near`` by, of fewer: with seven free
    one start ends in one valley on one computer and in another on the next.
    """

    def off_mm(q: Floats) -> Floats:
        p = numbers(name, q)
        return np.concatenate(
            [1e3 * (simulated(force, x, p, v) - at)[UNJUDGED:] for force, at, x, v in runs]
        )

    free = {NAMES[0]: 4, NAMES[1]: 5, NAMES[2]: 7}[name]
    starts = [np.zeros(free), *(np.append(one, np.ones(free - len(one))) for one in near)]
    found = [least_squares(off_mm, start, x_scale="jac") for start in starts]
    return np.asarray(min(found, key=lambda one: float(one.cost)).x)


def rmse_mm(record: AxisRecord, p: Floats) -> float:
    """Of the free run over a whole recording."""
    force, at, x, _ = whole(record)
    return 1e3 * float(np.sqrt(np.mean((simulated(force, x, p) - at)[UNJUDGED:] ** 2)))


def main() -> int:
    """The command line."""
    told = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    told.add_argument("folder", type=Path)
    told.add_argument("--windows", action="store_true", help="fit windows of the first recording")
    asked = told.parse_args()
    try:
        first, second = read(asked.folder)
    except EpsHilError as error:
        told.error(str(error))
    fits = {
        "DATA_EMPS": [whole(first)],
        "DATA_EMPS_PULSES": [whole(second)],
        "both": [whole(first), whole(second)],
    }
    if asked.windows:
        fits = {f"DATA_EMPS, {one:g} s": windows(first, one) for one in WINDOWS_S}
    found: dict[tuple[str, str], Floats] = {}
    print(f"{'model':26}{'fitted to':22}{'EMPS':>7}{'PULSES':>8}   numbers")
    for name in NAMES[: 2 if asked.windows else 3]:
        for label, runs in fits.items():
            near = [found[NAMES[1], label]] if name == NAMES[2] else []
            found[name, label] = fitted(name, runs, near)
            p = numbers(name, found[name, label])
            off = "".join(f"{rmse_mm(one, p):{w}.2f}" for one, w in ((first, 7), (second, 8)))
            shown = " ".join(f"{value:.4g}" for value in p[: 7 if name == NAMES[2] else 5])
            print(f"{name:26}{label:22}{off}   {shown}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
