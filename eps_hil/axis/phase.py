"""The phase of a ripple, read anew from each recording without knowing the load in it.

A recording's angle counts from a zero of its own (an incremental encoder; the middle of the travel
here), so a ripple's pitch and amplitude carry over from one recording to another and its phase does
not. It shows in the force balance even where an unknown load acts: the load is smooth or jumps now
and then, the ripple keeps step with the travel.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from eps_hil.axis.emps import ARM_M, AxisRecord
from eps_hil.diagnosis.data.prepare import EDGE_S, SMOOTH_HZ, STEP_S, prepare
from eps_hil.identification.butterworth import low_pass
from eps_hil.physics.balance import residual_nm
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

RIPPLE = "cogging_torque"
LOCAL_S = 0.2
"""What changes slower than this is load or friction, not ripple; taken out of both sides alike."""
PASSING_HZ = (1.0 / LOCAL_S, 0.6 * SMOOTH_HZ)
"""The ripple is read where the speed makes it pass at these frequencies: fast enough to stand out
of that, slow enough to be whole after the low-pass."""
_ROUNDS = 20
_CUT = 4.685
"""Tukey's constant: beyond so many typical residuals a sample counts nothing (edges, reversals)."""


def rephased(record: AxisRecord, model: Model) -> Model:
    """``model`` with the phase of every ripple as this recording has it; amplitudes are kept.

    Uses the motor's force and the position, never ``hidden_force_n``. A ripple whose phase the
    recording does not tell (it never passes at ``PASSING_HZ``) keeps the one that it has.
    """
    effects = list(model.effects)
    for place, entry in enumerate(effects):
        if entry["effect"] == RIPPLE:
            others = tuple(effects[:place] + effects[place + 1 :])
            phase = _phase_rad(record, replace(model, effects=others), float(entry["order"]))
            if phase is not None:
                effects[place] = {**entry, "phase_rad": phase}
    return replace(model, effects=tuple(effects))


def _phase_rad(record: AxisRecord, model: Model, order: float) -> float | None:
    """Phase of sin(order·φ + phase) in the balance, by regression that forgives outliers."""
    motion = prepare(record.name, record.series()).motion(model)
    balance = low_pass(residual_nm(model, motion)[0], SMOOTH_HZ)
    angle = low_pass(record.position_m / ARM_M, SMOOTH_HZ)
    passing_hz = np.abs(np.gradient(angle, STEP_S)) * order / (2 * np.pi)
    seen = (passing_hz > PASSING_HZ[0]) & (passing_hz < PASSING_HZ[1])
    edge = round(EDGE_S / STEP_S)
    seen[:edge] = seen[-edge:] = False
    if np.count_nonzero(seen) < round(1.0 / STEP_S):
        return None
    waves = np.column_stack([np.sin(order * angle), np.cos(order * angle)])
    wanted, regressors = _local(balance)[seen], np.apply_along_axis(_local, 0, waves)[seen]
    weight = np.ones(len(wanted))
    share = np.zeros(2)
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        share = np.linalg.lstsq(regressors * root[:, None], wanted * root, rcond=None)[0]
        left = wanted - regressors @ share
        typical = float(np.median(np.abs(left))) / 0.6745
        weight = np.clip(1 - (left / (_CUT * typical + 1e-300)) ** 2, 0.0, None) ** 2
    return float(np.arctan2(share[1], share[0]))


def _local(values: Floats) -> Floats:
    return values - uniform_filter1d(values, round(LOCAL_S / STEP_S))
