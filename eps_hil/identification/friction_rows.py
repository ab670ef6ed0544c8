"""Friction of a measured motion together with its sensitivities, in one compiled pass.

The bristle (eq. 2a, exact over a step) and its derivatives obey the same recursion, so they are
simulated side by side: nine parameters for about the price of two runs of the balance.
"""

import math

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.physics.balance import Motion, residual_nm
from eps_hil.physics.friction import (
    FrictionLaw,
    bristle_step,
    friction_law,
    static_level_nm,
)
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

COLUMNS = (
    "friction.offset_pos_nm",
    "friction.offset_neg_nm",
    "friction.viscous_pos_nm_s_per_rad",
    "friction.viscous_neg_nm_s_per_rad",
    "friction.load_pos_nm_per_n",
    "friction.load_neg_nm_per_n",
    "friction.sigma0_nm_per_rad",
    "friction.sigma1_nm_s_per_rad",
    "friction.sigma1_speed_rad_s",
)
"""Rows 1 to 9 of the result, d residual / d parameter; row 0 is the residual itself."""


def friction_rows(model: Model, motion: Motion) -> Floats:
    """(10, n): residual of ``physics.balance`` for ``motion``, and its sensitivities.

    With added effects the sensitivities are those of the level without them.
    """
    out = np.empty((1 + len(COLUMNS), len(motion.time_s)))
    _rows(friction_law(model.friction), motion, out)
    out[0], _ = residual_nm(model, motion)
    return out


@njit
def _rows(law: FrictionLaw, m: Motion, out: Floats) -> None:
    s0 = law.sigma0_nm_per_rad
    z = 0.0
    dz = np.zeros(7)
    dlevel = np.zeros(6)
    for k in range(len(m.time_s)):
        speed, force = m.speed_rad_s[k], m.rack_force_n[k]
        direction = speed if speed != 0.0 else m.travel_rad[k]
        if direction == 0.0:
            direction = z
        level = static_level_nm(direction, force, law)
        at = 0 if direction >= 0.0 else 1
        for i in range(6):
            dlevel[i] = 0.0
        dlevel[at], dlevel[2 + at], dlevel[4 + at] = 1.0, abs(direction), abs(force)
        if speed == 0.0:
            dlevel[2 + at] = 0.0
        # the bristle's step, differentiated: z+ = z e^-d + travel (1 - e^-d)/d, d = slip s0/level
        travel, slip = m.travel_rad[k], m.slip_rad[k]
        d = slip * s0 / level
        kept = math.exp(-d)
        shape = (kept * (1.0 + d) - 1.0) / (d * d) if d > 1e-6 else -0.5 + d / 3.0
        by_decay = -z * kept + travel * shape
        z = bristle_step(z, travel, slip, level, s0)
        for i in range(6):
            dz[i] = kept * dz[i] - by_decay * d / level * dlevel[i]
        dz[6] = kept * dz[6] + by_decay * slip / level
        # T_f = s0 z + s1(w) (w - |w| s0 z / level)
        ratio = speed / law.sigma1_speed_rad_s
        fade = math.exp(-ratio * ratio) if ratio * ratio < 60.0 else 0.0
        s1 = law.sigma1_nm_s_per_rad * fade
        rate = speed - abs(speed) * s0 * z / level
        per_z = s0 - s1 * abs(speed) * s0 / level
        per_level = s1 * abs(speed) * s0 * z / (level * level)
        for i in range(6):
            out[1 + i, k] = -(per_z * dz[i] + per_level * dlevel[i])
        out[7, k] = -(per_z * dz[6] + z - s1 * abs(speed) * z / level)
        out[8, k] = -fade * rate
        out[9, k] = -s1 * rate * 2.0 * ratio * ratio / law.sigma1_speed_rad_s
