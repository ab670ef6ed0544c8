#!/usr/bin/env python3
"""What a free run over DATA_EMPS can tell of the one over DATA_EMPS_PULSES.

    python benchmarks/emps_free_run.py DATA_DIR

Models of a few numbers are fitted to nothing but the position of a free run (motor force in,
position out, no measurement fed back): to the one recording, to the other and to both. Where a fit
to both is nearly as good on the first as a fit to the first alone, and far better on the second,
the first recording does not hold what the second one needs. Nothing of `eps_hil.diagnosis` is used.

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
BRISTLE_N_PER_M = 1e6
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
def simulated(force: Floats, start_m: float, p: Floats) -> Floats:
    """Position (n,), m, from rest: a mass, drag and a bristle whose level is ``p``'s."""
    out = np.empty(len(force))
    x, v, z = start_m, 0.0, 0.0
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


def fitted(name: str, records: Sequence[AxisRecord]) -> Floats:
    """The numbers with the least squared error of position in the free runs of ``records``."""
    given = [(forces(one), one.position_m) for one in records]

    def off_mm(q: Floats) -> Floats:
        p = numbers(name, q)
        return np.concatenate(
            [1e3 * (simulated(force, at[0], p) - at)[UNJUDGED:] for force, at in given]
        )

    free = {NAMES[0]: 4, NAMES[1]: 5, NAMES[2]: 7}[name]
    return numbers(name, least_squares(off_mm, np.zeros(free), x_scale="jac").x)


def main() -> int:
    """The command line."""
    told = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    told.add_argument("folder", type=Path)
    try:
        first, second = read(told.parse_args().folder)
    except EpsHilError as error:
        told.error(str(error))
    print(f"{'model':26}{'fitted to':22}{'EMPS':>7}{'PULSES':>8}   numbers")
    for name in NAMES:
        for label, records in (
            ("DATA_EMPS", [first]),
            ("DATA_EMPS_PULSES", [second]),
            ("both", [first, second]),
        ):
            p = fitted(name, records)
            rmse = [
                float(
                    np.sqrt(
                        np.mean(
                            (simulated(forces(one), one.position_m[0], p) - one.position_m)[
                                UNJUDGED:
                            ]
                            ** 2
                        )
                    )
                )
                for one in (first, second)
            ]
            shown = " ".join(f"{value:.4g}" for value in p[: 7 if name == NAMES[2] else 5])
            print(
                f"{name:26}{label:22}{1e3 * rmse[0]:7.2f}{1e3 * rmse[1]:8.2f}   {shown}", flush=True
            )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
