"""A speed whose scale is not the angle's: a gear ratio or a factor that one of the two lacks.

Of means over windows of 2 s, which a delay or a filter of milliseconds hardly changes, the angle's
rate is a factor times the speed, beside a constant, τ ω̇ and, for tens of milliseconds, ω̈. Noise of
the speed makes that factor too small where the rate is regressed on it, noise of the angle too
large where it is the other way round: the true one is between them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.spread import Integers, half_widths, partitions
from eps_hil.diagnosis.data.prepare import STEP_S, Prepared
from eps_hil.diagnosis.direct.rotor_and_rack import BLOCK_S, least_squares

Floats = npt.NDArray[np.float64]

LEAST = 0.01
"""A factor that may be nearer to 1 is how sensors are."""
_SAME = 0.02
"""Between both regressions: more, and the two signals are not one motion."""
_WINDOW_S, _EVERY = 2.0, 20
"""Of a window (Hann's), and samples of 1 ms from one to the next."""
_FEWEST = 10
"""Seconds that are compared."""


@dataclass(frozen=True)
class SpeedScale:
    """The angle's rate is ``factor`` (``low`` to ``high``, 95 %) times the reported speed."""

    factor: float
    low: float
    high: float

    def speed_is_wrong(self, kinematics: Mapping[str, Any]) -> bool | None:
        """By the rack's position, where it was measured; None where it tells of neither."""
        if "ratio_error" not in kinematics:
            return None
        by_rack = 1.0 + float(kinematics["ratio_error"])
        apart = [abs(np.log(abs(by_rack) / one)) for one in (1.0, self.factor)]
        nearer = int(np.argmin(apart))
        clear = apart[nearer] < 0.25 * abs(np.log(self.factor))
        return nearer == 0 if clear else None

    def told(
        self, recordings: Sequence[Prepared], kinematics: Mapping[str, Any]
    ) -> tuple[list[Prepared], list[str], list[str]]:
        """(recordings, sentences on what was put right in them, sentences on what was not)."""
        wrong = self.speed_is_wrong(kinematics)
        by_angle = all(one.speed_is_derived for one in recordings)
        said = self.remark(wrong, by_angle=by_angle)
        if wrong and not by_angle:
            return [self.put_right(one) for one in recordings], [said], []
        return list(recordings), [], [said]

    def put_right(self, one: Prepared) -> Prepared:
        """The recording with the speed in the angle's scale."""
        name = "motor_speed_rad_s"
        if one.speed_is_derived:
            return one
        return one.changed(
            raw={**one.raw, name: self.factor * one.raw[name]},
            noise={**one.noise, name: self.factor * one.noise[name]},
        )

    def remark(self, wrong: bool | None, *, by_angle: bool) -> str:
        """Sentences (CONTRACT 7, ``limits``); ``by_angle``: whether the speed was not used."""
        if wrong is None:
            why = "nothing that was recorded tells which is right"
        else:
            which = "angle" if wrong else "speed"
            why = f"rack_position_m goes with the {which} by the model's ratio"
        if by_angle:
            used = "Motion was read from the angle"
        elif wrong:
            used = "The speed was read in the angle's scale"
        else:
            used = "Drag and inertia were read from the speed, places from the angle"
        return (
            f"motor_angle_rad turns {self.factor:.4g} times as fast as motor_speed_rad_s says "
            f"({self.low:.4g} to {self.high:.4g}, 95 %): the scale of one of them is wrong. "
            f"{used}; {why}. Check the gear ratio between both and their scale in the mapping: "
            f"{self.factor:.4g} for the speed or {1.0 / self.factor:.4g} for the angle makes them "
            "agree."
        )


def has_both(one: Prepared) -> bool:
    """Whether speed and angle were both measured."""
    return "motor_angle_rad" in one.raw and not one.speed_is_derived


def speed_scale(recordings: Sequence[Prepared]) -> SpeedScale | None:
    """What all recordings that have both show together; None where the two surely agree enough, or
    show no one factor.
    """
    rows = [_rows(one) for one in recordings if has_both(one)]
    rows = [row for row in rows if len(row[1]) * _EVERY * STEP_S >= _FEWEST]
    if not rows:
        return None
    # each recording's constant goes with its means
    columns, rate = (np.concatenate([row[k] for row in rows]) for k in (0, 1))
    speed = columns[:, 0] - columns[:, 1:] @ least_squares(columns[:, 1:], columns[:, 0])
    rate = rate - columns[:, 1:] @ least_squares(columns[:, 1:], rate)
    both = float(speed @ rate)
    if both <= 0.0:
        return None
    least, most = both / float(speed @ speed), float(rate @ rate) / both
    if most > (1.0 + _SAME) * least:
        return None
    groups = partitions([row[2] for row in rows])
    half = float(half_widths(speed[:, None], rate - least * speed, groups)[0]) / least
    found = SpeedScale(float(np.sqrt(least * most)), least * (1.0 - half), most * (1.0 + half))
    return found if found.low > 1.0 + LEAST or found.high < 1.0 - LEAST else None


def _rows(one: Prepared) -> tuple[Floats, Floats, Integers]:
    """(mean speeds and their derivatives (n, 3), the angle's rates (n,), block (n,)), each without
    its mean: of the same windows, so that ends and gaps of a recording bend neither.
    """
    ends = np.arange(0, len(one.time_s), _EVERY)
    step_s = _EVERY * STEP_S
    taps = round(_WINDOW_S / step_s)
    if len(ends) < 2 * taps:
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64)
    window = np.hanning(taps + 2)[1:-1]
    window /= np.sum(window)
    speed = one.raw["motor_speed_rad_s"]
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * STEP_S])
    mean, rate = (
        np.convolve(np.diff(angle[ends]) / step_s, window, mode="valid")
        for angle in (turned, one.raw["motor_angle_rad"])
    )
    good = np.ones(len(rate), bool)
    if one.barred is not None:
        at = np.searchsorted(one.thin_time_s, one.time_s[ends]).clip(0, len(one.barred) - 1)
        good = np.convolve(one.barred[at][1:], np.ones(taps), mode="valid") < 0.5
    slope = np.gradient(mean, step_s)
    columns = np.column_stack([mean, slope, np.gradient(slope, step_s)])[good]
    rate = rate[good]
    block = (step_s * np.flatnonzero(good) // BLOCK_S).astype(np.int64)
    if len(rate):
        columns, rate = columns - np.mean(columns, axis=0), rate - np.mean(rate)
    return columns, rate, block
