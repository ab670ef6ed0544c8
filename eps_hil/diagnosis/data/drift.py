"""A clock that drifts: one signal's stamps run fast or slow against the others'.

A drift of 100 ppm is 6 ms after a minute: more than any delay of the model file. Speed and angle
are looked at against the rack position (``rotor_and_rack.py``) and each other
(``speed_and_angle.py``), where a delay that grows with time shows directly; a torque's only in the
torque balance (``channel_fault.py``).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eps_hil.diagnosis.data.entry import around, known
from eps_hil.diagnosis.data.prepare import Prepared

MOTION = ("motor_speed_rad_s", "motor_angle_rad")
"""They come from one sensor, and share its clock."""
LEAST_PPM = 10.0
LEAST_SKEW_S = 0.3e-3
"""Drift that moves a signal by less than this over a recording is left alone."""
_SURE = 60.0
IN_RACK, IN_BALANCE = "delays that grow with time", "torque balance"


@dataclass(frozen=True)
class Drift:
    """How much the clock of ``signals`` drifts, and how sure that is."""

    ppm: float
    half_width_ppm: float
    gain: float
    signals: tuple[str, ...] = MOTION
    seen_in: str = IN_RACK

    def corrected(self, one: Prepared) -> Prepared:
        """The recording, or a window of it, with that clock set right: right at its start."""
        late = one.since_start_s * self.ppm * 1e-6
        raw = dict(one.raw)
        for name in self.signals:
            if name in raw:
                raw[name] = np.interp(one.time_s + late, one.time_s, raw[name])
        return one.changed(raw=raw)

    def finding(self) -> dict[str, Any]:
        """The JSON entry (CONTRACT 7)."""
        return known(
            "clock_drift",
            f"The clock of {self.signals[0]} drifts by {self.ppm:+.3g} ppm against the other "
            "signals.",
            {"ppm": around(self.ppm, self.half_width_ppm)},
            round(min(0.99, 1.0 - 0.4 * float(np.exp(1 - self.gain / _SURE))), 3),
            self.seen_in,
            signal=self.signals[0],
        )


def drift_matters(ppm: float, recordings: Sequence[Prepared]) -> bool:
    """Whether this drift moves a signal far enough to be set right."""
    longest = max(float(one.since_start_s[-1]) for one in recordings)
    return abs(ppm) > LEAST_PPM and abs(ppm) * 1e-6 * longest > LEAST_SKEW_S
