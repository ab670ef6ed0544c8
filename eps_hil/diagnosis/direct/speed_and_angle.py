"""Speed against angle of one rotor: one of them late, its clock adrift, or the speed smoothed.

ω(t) is φ̇(t). What is reported later by τ shows as −τ φ̈, a clock adrift as one that grows, and a
low-pass of first order (lag T, as ECUs have) as −T φ̈ + T² d³φ/dt³, where a dead time has half of
the second term. No torque is needed for it. Noise of the speed sits in both sides of the second
term: what that makes of it (at most) counts as an error of it.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.spread import Integers, half_widths, partitions
from eps_hil.diagnosis.data.drift import MOTION, Drift, drift_matters
from eps_hil.diagnosis.data.entry import around, known
from eps_hil.diagnosis.data.prepare import CUTOFF_HZ, STEP_S, Prepared
from eps_hil.diagnosis.direct.rotor_and_rack import BLOCK_S, least_squares
from eps_hil.identification.butterworth import low_pass, passed
from eps_hil.identification.filters import shifted
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

LEAST_S = 1e-3
"""Less is how a drive samples the two and puts them into messages."""
LEAST_LAG_S = 2e-3
"""A first-order lag below this (above 80 Hz) leaves the balance as it is."""
SLOWEST_S = 0.011
"""Between samples: beyond it, motion itself is between them."""
LATE, DRIFT = "speed_sensor_delay", "clock_drift"
SEEN_IN = "speed and angle"
HZ = 20.0
_MOST_S = 0.1
_SMOOTHED_NOISE = 1.2
_SURE = 4.0
"""Half widths of a 95 % interval from nothing."""
_ROUNDS, _CLOSE_S, _FEWEST = 8, 2e-5, 250


@dataclass(frozen=True)
class Number:
    """A fitted number and the half width of its 95 % interval."""

    value: float
    half: float

    @property
    def sure(self) -> bool:
        """Whether it is surely not nothing."""
        return abs(self.value) > _SURE * self.half


@dataclass(frozen=True)
class OutOfStep:
    """How the speed differs from the angle's rate beyond what the model file's delays say.

    ``late_s``: the speed is so much later than the angle; ``ppm``: and by so much more as time
    goes on; ``lag_s`` of a first-order low-pass, 0 where there is none; ``noise_ratio``: noise that
    the two have below 40 Hz over what they have above says, as white noise.
    """

    late_s: Number
    ppm: Number
    lag_s: float
    noise_ratio: float
    drifts: bool
    model: Model
    """The model file's."""

    @property
    def is_late(self) -> bool:
        """Whether one is later than the other, by enough."""
        return self.late_s.sure and abs(self.late_s.value) > LEAST_S

    @property
    def smoothed(self) -> bool:
        """Whether the speed is a smoothed one: by its lag, or late and its noise smoothed too."""
        return self.lag_s > 0.0 or (self.is_late and self.noise_ratio > _SMOOTHED_NOISE)

    @property
    def _how(self) -> str:
        if self.lag_s == 0.0:
            return "by a low-pass whose noise tells it"
        return f"as by a low-pass of {1.0 / (2.0 * np.pi * self.lag_s):.2g} Hz"

    @property
    def matters(self) -> bool:
        """Whether anything is to be done."""
        return self.is_late or self.smoothed or self.drifts

    @property
    def _angle_s(self) -> float:
        """The angle's delay that puts it in step with the speed as the model file has that."""
        return self.model.delays_s.of("motor_angle_rad") - self.late_s.value

    @property
    def speed_is_late(self) -> bool:
        """Whether it must be the speed: a smoothed one, or an angle that could not be so early."""
        return self.is_late and (self.smoothed or self._angle_s < 0.0)

    def in_model(self, model: Model) -> Model:
        """The model with the two in step.

        By the speed's delay where that is known to be the wrong one; else by the angle's, and
        torques tell whether both are late.
        """
        if not self.is_late:
            return model
        delays = model.delays_s
        if self.speed_is_late:
            right = {
                "motor_speed": max(delays.motor_speed + self.late_s.value, 0.0),
                "motor_angle": delays.of("motor_angle_rad"),
            }
        else:
            right = {"motor_angle": self._angle_s}
        return replace(model, delays_s=replace(delays, **right))

    def put_right(self, one: Prepared) -> Prepared:
        """The recording with the angle's rate for a smoothed speed, the speed's clock set right."""
        if not has_both(one):
            return one
        if self.smoothed:
            return one.by_angle()
        return self._drift.corrected(one) if self.drifts else one

    @property
    def _drift(self) -> Drift:
        return Drift(self.ppm.value, self.ppm.half, np.inf, MOTION[:1], SEEN_IN)

    def findings(self) -> list[dict[str, Any]]:
        """JSON entries (CONTRACT 7)."""
        told = [self._late_speed()] if self.speed_is_late else []
        return [*told, self._drift.finding()] if self.drifts else told

    def remarks(self) -> list[str]:
        """Sentences (CONTRACT 7, ``limits``) on what has been put right."""
        if self.smoothed:
            return [
                f"motor_speed_rad_s is no plain speed but smoothed, {self._how}; the rate of "
                "motor_angle_rad was used in its place. A live estimator that reads this speed "
                "sees motion late and too small: let the ECU send it unfiltered."
            ]
        if not self.is_late or self.speed_is_late:
            return []
        way = "earlier" if self.late_s.value > 0.0 else "later"
        return [
            f"motor_angle_rad comes {1e3 * abs(self.late_s.value):.3g} ms {way} against "
            "motor_speed_rad_s than the model file says; it was read in step with the speed "
            f"(delays_s.motor_angle of {self._angle_s:.4f} s)."
        ]

    def _late_speed(self) -> dict[str, Any]:
        late = self.late_s.value
        way = "later" if late > 0.0 else "earlier"
        why = f", smoothed {self._how}" if self.smoothed else ""
        return known(
            LATE,
            f"The speed is reported {1e3 * abs(late):.3g} ms {way} than the model file says{why}; "
            "the angle is not. Speed and angle show it against each other.",
            {"delay_s": around(late, self.late_s.half)},
            0.99,
            SEEN_IN,
            signal=MOTION[0],
        )


def speed_and_angle(
    recordings: Sequence[Prepared], model: Model, without: Collection[str] = ()
) -> OutOfStep | None:
    """What all recordings that have both show; None where none has, or nothing is to be done.

    Effects in ``without`` (ids) are not considered.
    """
    both = [one for one in recordings if has_both(one)]
    if not both or LATE in without:
        return None
    delays = model.delays_s
    known = delays.of("motor_speed_rad_s") - delays.of("motor_angle_rad")
    late = 0.0
    for _ in range(_ROUNDS):
        rows = [_rows(one, known + late) for one in both]
        columns, speed = (np.concatenate([row[k] for row in rows]) for k in (0, 1))
        if len(speed) < _FEWEST or not np.any(columns[:, 3]):
            return None
        best = least_squares(columns, speed)
        if abs(best[0]) < _CLOSE_S:
            break
        late = float(np.clip(late + best[0], -_MOST_S, _MOST_S))
    else:
        return None  # an acceleration that is noise: each step goes on as far as the one before
    half = half_widths(columns, speed - columns @ best, partitions([row[2] for row in rows]))
    noise = sum(
        one.noise["motor_speed_rad_s"] ** 2 * passed(HZ, 2) * len(row[1])
        for one, row in zip(both, rows, strict=True)
    )
    bend = Number(float(best[3]), float(half[3] + noise / np.sum(columns[:, 3] ** 2)))
    smoothed = bend.sure and bend.value > 0.5 * LEAST_LAG_S**2
    ppm = Number(float(best[1]), float(half[1]))
    drifts = ppm.sure and drift_matters(ppm.value, both) and DRIFT not in without
    found = OutOfStep(
        Number(late + float(best[0]), float(half[0])),
        ppm,
        float(np.sqrt(2.0 * bend.value)) if smoothed else 0.0,
        float(np.median([_noise_ratio(one, known + late, 1.0 + float(best[2])) for one in both])),
        drifts and not smoothed,
        model,
    )
    return found if found.matters else None


def _noise_ratio(one: Prepared, apart_s: float, gain: float) -> float:
    """Rms of the two accelerations' difference below 40 Hz over what white noise would make it.

    ``gain``: of the speed, times the angle's rate.
    """
    rate = np.gradient(shifted(one.raw["motor_angle_rad"], -apart_s), STEP_S)
    between = one.thin(np.gradient(one.raw["motor_speed_rad_s"] - gain * rate, STEP_S))
    white = one.noise["motor_speed_rad_s"] ** 2 * passed(CUTOFF_HZ, 2)
    white += one.noise["motor_angle_rad"] ** 2 * passed(CUTOFF_HZ, 4) * gain**2
    if one.barred is not None:
        between = between[~one.barred]
    usual = 1.4826 * float(np.median(np.abs(between)))
    return usual / max(float(np.sqrt(white)), 1e-300)


def compared(one: Prepared, apart_s: float) -> tuple[Floats, Floats, Floats]:
    """(acceleration, that times time since the start, reported speed less the angle's rate).

    Good data only, thinned; the speed is taken to be ``apart_s`` later than the angle.
    """
    columns, residual, _ = _rows(one, apart_s)
    return -columns[:, 0], -1e6 * columns[:, 1], residual


def has_both(one: Prepared) -> bool:
    """Whether speed and angle were both measured, often enough to be compared."""
    measured = {"motor_speed_rad_s", "motor_angle_rad"} <= one.raw.keys()
    return measured and not one.speed_is_derived and one.interval_s < SLOWEST_S


def _rows(one: Prepared, apart_s: float) -> tuple[Floats, Floats, Integers]:
    """(columns for late, ppm, gain and lag; speed less rate; block), thinned, good data only.

    ``apart_s``: how much later the speed is taken to be than the angle.
    """
    speed = low_pass(one.raw["motor_speed_rad_s"], HZ)
    rate = np.gradient(low_pass(shifted(one.raw["motor_angle_rad"], -apart_s), HZ), STEP_S)
    bend = np.gradient(speed, STEP_S)
    signals = (
        -bend,
        -1e-6 * bend * one.since_start_s,
        rate,
        np.gradient(bend, STEP_S),
        speed - rate,
    )
    columns = np.column_stack([one.thin(signal) for signal in signals])
    good = np.ones(len(columns), bool) if one.barred is None else ~one.barred
    block = (one.thin_time_s - one.thin_time_s[0]) // BLOCK_S
    return columns[good, :4], columns[good, 4], block[good].astype(np.int64)
