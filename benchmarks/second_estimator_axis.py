"""The paper's estimator and the bristle filter on a real axis (EMPS, docs/proof-emps.md).

    .venv/bin/python benchmarks/second_estimator_axis.py DATA_DIR

Fitted on ``DATA_EMPS``, judged on ``DATA_EMPS_PULSES``: a square wave of 178 N that neither
estimator is told of. Errors in N rms, each over the whole run, between the wave's edges (50 ms
before to 100 ms after one left out), and there apart for moving and for slow (rotor below 1 rad/s:
1.6 mm/s of the axis). Noise settings: as they are for a steering, and of this axis (angle from the
third differences of the position, torque from the residual of the fitted model).
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.axis.augment import augment
from eps_hil.axis.emps import ARM_M, published_model, read
from eps_hil.axis.phase import rephased
from eps_hil.axis.proof import _inside, _plateau, balance_n, online_error_n
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.identification.prepare import noise_of

Floats = npt.NDArray[np.float64]
Masks = npt.NDArray[np.bool_]
SLOW_RAD_S = 1.0
STEP_S = 1e-3


def row(name: str, error: Floats, parts: dict[str, Masks]) -> str:
    """One line of the table."""
    seen = np.isfinite(error)
    cells = [f"{np.sqrt(np.mean(error[part & seen] ** 2)):6.2f}" for part in parts.values()]
    return f"  {name:44}" + " ".join(f"{cell:>9}" for cell in cells)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, metavar="DATA_DIR")
    fitted, judged = read(parser.parse_args().folder)
    augmented = augment(fitted, published_model())
    models = {
        "published model": published_model(),
        "identified": augmented.identified,
        "augmented": rephased(judged, augmented.model),
    }
    speed = np.gradient(judged.position_m, STEP_S) / ARM_M
    inside, plateau = _inside(judged), _inside(judged) & _plateau(judged.hidden_force_n)
    slow = np.abs(np.convolve(speed, np.ones(31) / 31, mode="same")) < SLOW_RAD_S
    parts = {
        "whole run": inside,
        "plateaus": plateau,
        "moving": plateau & ~slow,
        "slow": plateau & slow,
    }
    print(f"N rms on {judged.name}; slow {100 * np.mean(slow[plateau]):.0f} % of the plateaus")
    print(" " * 46 + " ".join(f"{name:>9}" for name in parts))
    for name, model in models.items():
        print(f"{name}:")
        own = {
            "angle_noise_rad": noise_of(judged.position_m) / ARM_M,
            "torque_noise_nm": float(np.std(balance_n(fitted, model))) * ARM_M,
        }
        for words, numbers in (("a steering's noise", {}), ("this axis' noise", own)):
            base = replace(EstimatorSettings(), **numbers)
            print(row(f"observer, {words}", online_error_n(judged, model, base), parts))
            for kind in ("bristle_filter", "smoother"):
                chosen = replace(base, kind=kind)
                print(row(f"{kind}, {words}", online_error_n(judged, model, chosen), parts))
        print("    " + ", ".join(f"{key} {value:.3g}" for key, value in own.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
