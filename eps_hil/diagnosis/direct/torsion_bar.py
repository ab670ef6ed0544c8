"""The torsion bar's twist, u = ψ_wheel − i_pi · x, against the torque that its sensor reports.

The twist is the bar's torque without the sensor, so play inside the sensor shows as a loop between
the two. Inverting the play from the reported torque would leave several times the error. Nobody
says how late either angle is: τ between the two makes k·τ·ψ̇ of torque, as a drag would. So it is
fitted with the rest.
"""

from collections.abc import Sequence
from copy import copy
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.spread import Integers, half_widths
from eps_hil.diagnosis.data.prepare import Prepared, with_play
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.direct.seen import LEAST_GAIN, LEAST_SHARE, Seen, robust_squares
from eps_hil.identification.bounds import inside
from eps_hil.identification.butterworth import low_pass, passed
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

PLAY = "torque_sensor_hysteresis"

LEAST_PLAY_NM = 0.03
"""Of a torsion bar as steering drives have; on a machine of another size, so much more or less."""
_LEAST_TWIST = 0.9
"""Least correlation of twist and torque for the twist to be the torsion bar's."""
_RATE_HZ = 40.0
_BEFORE_HZ = 17.0
"""Low-pass of the twist before play. Noise inside the play makes it look wider than it is, and
smoothed reversals narrower; here the two are about as large."""
_PLAY_HZ = 15.0
"""Low-pass of both torques after it."""
_CLEAR = 1.5
"""Play is seen where it is this many deviations of the twist's noise, filtered. Noise alone looks
like play of a quarter of one; what matters most is the share of the residual that it explains."""
_LEAST_SHARE = 3 * LEAST_SHARE
_CALM_HZ, _SEED = 6.0, 1
_LOST, _BEYOND = 0.25, 0.6
"""Of the gain: what the same play has to lose where there is none, and what there has to be beyond
the noise to gain. A play passes no noise that is smaller than it is, and gains by that alone where
torques are small and the angles noisy."""
_STRETCH = 1250
"""Thinned samples in 10 s."""
_PLAYS_NM = (0.05, 0.1, 0.2, 0.4, 0.8)


def has_twist(one: Prepared) -> bool:
    """Whether wheel angle, rack position and torsion-bar torque are all there."""
    needed = ("steering_wheel_angle_rad", "rack_position_m", "torque_sensor_nm")
    return all(name in one.raw for name in needed)


def twist_rad(one: Prepared, model: Model) -> Floats:
    """The bar's twist (rad at the column, 1 kHz), with an unknown zero."""
    return np.asarray(one.raw["steering_wheel_angle_rad"] - pinion_rad(one, model))


def twist_noise(one: Prepared, model: Model) -> float:
    """Deviation (rad) of what noise the two angles put into a sample of the twist."""
    return float(
        np.hypot(
            one.noise["steering_wheel_angle_rad"],
            model.pinion_ratio_rad_per_m * one.noise["rack_position_m"],
        )
    )


class Law(NamedTuple):
    """Torque of a twist u (rad) at the column: gain·u + damping·u̇ + lag·ψ̇ + offset, Nm."""

    gain: float
    damping: float
    lag: float
    """Nm s/rad: one of the two angles may be later than the other."""
    offset: float


def torque_of_twist(one: Prepared, model: Model, law: Law) -> Floats:
    """Torsion-bar torque (Nm at the column, 1 kHz) by its ``law``."""
    twist = twist_rad(one, model)
    rates = (
        law.damping * np.gradient(low_pass(twist, _RATE_HZ), 1e-3),
        law.lag * np.gradient(low_pass(pinion_rad(one, model), _RATE_HZ), 1e-3),
    )
    return np.asarray(law.gain * twist + rates[0] + rates[1] + law.offset)


def pinion_rad(one: Prepared, model: Model) -> Floats:
    """The pinion's angle by the rack's position (rad, 1 kHz)."""
    return np.asarray(model.pinion_ratio_rad_per_m * one.raw["rack_position_m"])


class _Twisted:
    """Twist, its rate, the pinion's and the reported torque of one recording, low-passed; 1 kHz."""

    def __init__(self, one: Prepared, model: Model) -> None:
        late = model.delays_s.of("torque_sensor_nm")
        self.as_read = twist_rad(one, model)
        self.twist = low_pass(self.as_read, _BEFORE_HZ)
        self.rate = np.gradient(self.twist, 1e-3)
        self.turning = np.gradient(low_pass(pinion_rad(one, model), _BEFORE_HZ), 1e-3)
        reported = low_pass(one.raw["torque_sensor_nm"], _PLAY_HZ)
        self.torque = np.interp(one.time_s + late, one.time_s, reported)
        self.sigma = max(one.noise["torque_sensor_nm"], 1e-4 * one.size.power)
        self.noise = twist_noise(one, model)

    def sigma_nm(self, slope: float) -> float:
        """Deviation (Nm) that noise alone leaves beside a law without play, of this slope."""
        twist = slope * self.noise * np.sqrt(_passed_twice())
        return float(np.hypot(twist, self.sigma * np.sqrt(passed(_PLAY_HZ, 0))))

    def without_play(self, law: Law, rng: np.random.Generator) -> "_Twisted":
        """The same twist, slowly, under a sensor of this law without play; noise as it is."""
        calm, other = low_pass(self.as_read, _CALM_HZ), copy(self)
        other.twist = low_pass(calm + self.noise * rng.standard_normal(len(calm)), _BEFORE_HZ)
        other.rate = np.gradient(other.twist, 1e-3)
        true = law.gain * calm + law.damping * np.gradient(calm, 1e-3) + law.lag * self.turning
        noise = self.sigma * rng.standard_normal(len(calm))
        other.torque = low_pass(true + law.offset + noise, _PLAY_HZ)
        return other

    def left(self, law: Law, play: float) -> Floats:
        """Reported torque less what a sensor with this play would report; thinned."""
        true = law.gain * self.twist + law.damping * self.rate + law.lag * self.turning + law.offset
        seen = low_pass(with_play(true, play) if play > 0 else true, _PLAY_HZ)
        edge = 250
        return np.asarray((self.torque - seen)[edge:-edge:8])

    def costs(self, law: Law, play: float, slope: float) -> Floats:
        """What is left, in noise variances, by stretch of 10 s, (stretches,)."""
        squares = robust_squares(self.left(law, play) / self.sigma_nm(slope))
        by_stretch = np.bincount(np.arange(len(squares)) // _STRETCH, weights=squares)
        return by_stretch.astype(np.float64)


@cache
def _passed_twice() -> float:
    """What both low-passes of the twist, one after the other, leave of white noise's variance."""
    struck = np.zeros(2000)
    struck[1000] = 1.0
    return float(np.sum(low_pass(low_pass(struck, _BEFORE_HZ), _PLAY_HZ) ** 2))


def _stretches(rows: Sequence[_Twisted]) -> Integers:
    """The stretch of 10 s that each sample of all rows lies in, ascending, (n,)."""
    found: list[Integers] = []
    first = 0
    for one in rows:
        samples = np.arange(len(one.left(Law(1.0, 0.0, 0.0, 0.0), 0.0)), dtype=np.int64)
        found.append(first + samples // _STRETCH)
        first = int(found[-1][-1]) + 1
    return np.concatenate(found)


def _bounds(offset: float) -> tuple[Floats, Floats]:
    """Least and most of gain, damping, lag, offset and play, as shares of what is usual.

    The offset is about that of the law without play: how far off a reading's zero is says nothing.
    """
    low = np.array([0.2, -1.0, -0.1, offset - 5.0, 0.0])
    return low, np.array([5.0, 1.0, 0.1, offset + 5.0, 2.0])


def _more_than_noise_held_back(gains: Floats, lost: Floats, excess: float) -> bool:
    """Whether a play gains by what is there; by stretch of 10 s: its gain, its loss by no play.

    What it gains lies beyond the noise, and it gains where a play that is none would lose.
    """
    gain = float(gains.sum())
    telling = float(gains[lost > 0.0].sum())
    return excess >= _BEYOND * gain and float(lost.sum()) >= _LOST * gain and telling > 0.0


def sensor_play(
    fitted: Sequence[Prepared], judged: Sequence[Prepared], model: Model
) -> tuple[Seen, Law] | None:
    """Play in the torque sensor, with the law of twist to torque; None if none.

    It must be clear of the noise, explain what is beyond it, lower what is left of the ``judged``
    recordings too, and raise what would be left if there were none.
    """
    from scipy.optimize import least_squares

    rows = [_Twisted(one, model) for one in fitted if has_twist(one)]
    kept = [_Twisted(one, model) for one in judged if has_twist(one)]
    if not rows:
        return None
    twist = np.concatenate([one.twist for one in rows])
    torque = np.concatenate([one.torque for one in rows])
    if np.std(twist) < 1e-9 or np.std(torque) < 1e-9:
        return None
    alike = float(np.corrcoef(twist, torque)[0, 1])
    if not abs(alike) >= _LEAST_TWIST:
        return None
    # of a reading whose sign is turned too: the play is in its size
    slope = float(np.copysign(np.std(torque) / np.std(twist), alike))
    sigma = float(np.sqrt(np.mean([one.sigma_nm(slope) ** 2 for one in rows])))

    unit = fitted[0].size.power  # what 1 Nm is on a machine of this size
    middle = float(np.mean(twist))  # where an angle or a place counts from is nobody's torque

    def law(p: Floats) -> Law:
        return Law(slope * p[0], slope * p[1], slope * p[2], unit * p[3] - slope * p[0] * middle)

    def residual(p: Floats) -> Floats:
        return np.concatenate(each(lambda one: one.left(law(p), unit * float(p[4])), rows))

    def cost(p: Floats, records: Sequence[_Twisted]) -> Floats:
        return np.concatenate(
            each(lambda one: one.costs(law(p), unit * float(p[4]), slope), records)
        )

    plain = least_squares(lambda p: residual(np.append(p, 0.0)), [1.0, 0.0, 0.0, 0.0])
    start = np.append(plain.x, 0.0)
    best = min((np.append(plain.x, w) for w in _PLAYS_NM), key=lambda p: cost(p, rows).sum())
    low, high = _bounds(float(plain.x[3]))
    done = least_squares(
        residual, inside(best, low, high), loss="soft_l1", f_scale=3 * sigma,
        x_scale=[0.1, 0.01, 0.001, 0.1, 0.1], bounds=(low, high), diff_step=1e-3,
    )  # fmt: skip
    found, play = np.asarray(done.x), unit * float(done.x[4])
    before = cost(start, rows)
    gains = before - cost(found, rows)
    gain, excess = float(gains.sum()), float(before.sum()) - len(done.fun)
    least = max(LEAST_PLAY_NM * unit, _CLEAR * sigma)
    if play < least or gain < max(LEAST_GAIN, _LEAST_SHARE * excess):
        return None
    rng = np.random.default_rng(_SEED)
    whole = [one.without_play(law(found), rng) for one in rows]
    lost = cost(found, whole) - cost(np.append(found[:4], 0.0), whole)
    worse = kept and cost(found, kept).sum() >= cost(start, kept).sum()
    if worse or not _more_than_noise_held_back(gains, lost, excess):
        return None
    half = half_widths(done.jac, done.fun, (_stretches(rows),))[4]
    # noise in the play and the filter against it
    half = float(np.hypot(unit * half, 1.96 * 0.5 * sigma))
    least_nm, most_nm = (float(v) for v in np.percentile(torque, [2, 98]))
    seen = Seen(
        {"effect": PLAY, "play_nm": play},
        {"play_nm": half},
        gain,
        min(1.0, gain / max(excess, 1.0)),
        (("torque_sensor_nm", least_nm, most_nm, 1.0),),
    )
    return seen, law(found)
