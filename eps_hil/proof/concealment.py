"""How well a case hides what is in it: the evidence that goes into the sealed answer.

The wrong model must look good, the effect must drown in the noise of any one second, and what a
naive method says must be known, right or wrong.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eps_hil.proof.naive import naive, smoothed
from eps_hil.proof.strength import aligned, beyond_refit, filtered, residual, sensitivities
from eps_hil.proof.truth import Drive, Floats

_PER_SECOND = 250
Columns = Mapping[str, Floats]


def evidence(
    d: Drive, clean: Sequence[Columns], train: Sequence[Columns], holdout: Columns, noise_nm: float
) -> dict[str, Any]:
    """Facts for the answer of a case.

    ``clean`` are the training recordings without noise, ``noise_nm`` the rms of the noise in the
    torque balance. ``wrong_model_fit_percent``: 100 (1 − rms residual / rms drive torque) of the
    nominal model with its parameters refitted. ``seconds_above_noise``: share of seconds in which
    what is hidden is larger than the noise; ``loudest_second``: the largest ratio of a second.
    """
    hidden = _refitted(d, clean)
    seconds = hidden[: len(hidden) // _PER_SECOND * _PER_SECOND].reshape(-1, _PER_SECOND)
    ratio = np.sqrt(np.mean(seconds**2, axis=1)) / noise_nm
    drive = np.concatenate([filtered(_drive(d, one)) for one in train])
    left = _refitted(d, [smoothed(one) for one in train])
    said = naive(d, train, holdout)
    return {
        "wrong_model_fit_percent": 100.0 * (1.0 - float(np.std(left) / np.std(drive))),
        "seconds_above_noise": float(np.mean(ratio > 1.0)),
        "loudest_second": float(ratio.max()),
        "naive_err": list(said.err),
        "naive_stlsq": list(said.stlsq),
    }


def _drive(d: Drive, columns: Columns) -> Floats:
    a = aligned(columns)
    to_rotor = d.pinion_rad_per_m / d.rack_rad_per_m
    return np.asarray(a["motor_torque_nm"] + to_rotor * a["torque_sensor_nm"])


def _refitted(d: Drive, recordings: Sequence[Columns]) -> Floats:
    """What the nominal model leaves over after a refit of all its parameters (Nm)."""
    rest = np.concatenate([filtered(residual(d, one)) for one in recordings])
    free = np.concatenate([filtered(sensitivities(d, one)) for one in recordings], axis=1)
    return beyond_refit(free, rest)
