"""The rotor's motion from speed and angle together, on the clock of the speed.

Both measure one motion with noise of different colour: below ``sqrt(D_ω/D_φ)/2π`` the angle's
derivative is the quieter of the two, above it the speed is. The mixture that weighs them by their
noise is a first-order low-pass of their difference, run both ways: no phase, no prior.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from eps_hil.identification import filters
from eps_hil.identification.butterworth import low_pass
from eps_hil.identification.filters import STEP_S
from eps_hil.identification.finding import Finding
from eps_hil.identification.motion_check import check_speed, varies
from eps_hil.identification.prepare import Prepared

Floats = npt.NDArray[np.float64]
Masks = npt.NDArray[np.bool_]

SMOOTH_HZ = 80.0
REST_WINDOW_S = 0.03
MOST_SKEW_S = 0.04
_WORN = 0.25
FREQUENCY = np.linspace(0.25, 500.0, 2000)


@dataclass(frozen=True)
class Skew:
    """How much later the angle is reported than the speed (s), and how sure; gain speed/(dφ/dt)."""

    seconds: float
    sigma_s: float
    gain: float
    gain_sigma: float


@dataclass(frozen=True)
class Kinematics:
    """Rotor motion of one recording at the speed's stamps; arrays (n,).

    ``speed`` is smoothed, for friction to be evaluated at; ``fused`` is not; ``travel`` is the
    displacement since the step before, ``slip`` the path (part of the noise taken off: it
    would wear the bristle down); ``resting``: slower than the noise can tell.
    ``acceleration_variance`` is that of noise in the filtered derivative of ``fused``.
    """

    speed: Floats
    fused: Floats
    angle: Floats
    travel: Floats
    slip: Floats
    resting: Masks
    speed_sigma: float
    acceleration_variance: float

    @cached_property
    def acceleration(self) -> Floats:
        """Filtered and thinned, rad/s²."""
        return filters.derivative(self.fused)


def kinematics(recording: Prepared, skew_s: float) -> Kinematics:
    """Mix speed and angle (reported ``skew_s`` later than the speed)."""
    raw, density = recording.raw, recording.density
    if "motor_speed_rad_s" not in raw:
        angle = raw["motor_angle_rad"]
        fused = filters.slope(angle)
        noise = (2 * np.pi * FREQUENCY) ** 2 * density["motor_angle_rad"]
    elif "motor_angle_rad" in raw:
        angle = filters.shifted(raw["motor_angle_rad"], skew_s)
        fused, noise = _mixed(raw["motor_speed_rad_s"], angle, density)
    else:
        fused = raw["motor_speed_rad_s"]
        noise = np.full(len(FREQUENCY), density["motor_speed_rad_s"])
        angle = None
    smooth = low_pass(fused, SMOOTH_HZ)
    power = noise * filters.low_pass_power(FREQUENCY, SMOOTH_HZ)
    sigma = float(np.sqrt(np.sum(power) * (FREQUENCY[1] - FREQUENCY[0])))
    resting = _resting(smooth, sigma)
    path = np.concatenate([[0.0], np.cumsum(0.5 * (smooth[1:] + smooth[:-1])) * STEP_S])
    travel = np.diff(path, prepend=0.0)
    return Kinematics(
        smooth,
        fused,
        path if angle is None else angle,
        travel,
        np.sqrt(np.maximum(travel**2 - _WORN * (sigma * STEP_S) ** 2, 0.0)),
        resting,
        sigma,
        filters.derivative_variance(noise, FREQUENCY),
    )


def skew(recordings: Sequence[Prepared], signs: bool = True) -> Skew | None:
    """Skew between angle and speed over all recordings that have both; None where none has.

    Least squares on filtered signals, ω(t) = gain · φ'(t + skew), with the spread over blocks as
    its error. :class:`InputError` for opposite signs and for speeds in another unit.
    """
    both = [r for r in recordings if r.has("motor_speed_rad_s") and r.has("motor_angle_rad")]
    if not both:
        return None
    if signs:
        for one in both:
            check(one)
    both = [one for one in both if varies(one)]
    if not both:
        return None
    late, gain = 0.0, 1.0
    for _ in range(8):
        rows = [_skew_rows(one, late, gain) for one in both]
        normal = sum(columns.T @ columns for columns, _, _ in rows)
        slope = sum(columns.T @ residual for columns, residual, _ in rows)
        step = np.linalg.solve(normal + 1e-12 * np.trace(normal) * np.eye(2), slope)
        late = float(np.clip(late + step[0], -MOST_SKEW_S, MOST_SKEW_S))
        gain = float(np.clip(gain + step[1], 0.5, 2.0))
        if abs(step[0]) < 1e-7:
            break
    rows = [_skew_rows(one, late, gain) for one in both]
    covariance = _block_covariance(rows, np.asarray(np.linalg.inv(normal), dtype=np.float64))
    return Skew(late, float(np.sqrt(covariance[0, 0])), gain, float(np.sqrt(covariance[1, 1])))


def ratio_findings(recordings: Sequence[Prepared], found: Skew | None) -> list[Finding]:
    """A speed whose scale disagrees with the angle's."""
    if found is None or abs(found.gain - 1.0) < max(0.01, 4 * found.gain_sigma):
        return []
    words = f"motor_speed_rad_s is {found.gain:.4g} times the derivative of motor_angle_rad"
    return [Finding("scale", "", "motor_speed_rad_s", words)]


def _skew_rows(one: Prepared, late: float, gain: float) -> tuple[Floats, Floats, Floats]:
    time = one.time_s
    angle = filters.shifted(one.raw["motor_angle_rad"], late)
    rate = filters.derivative(angle)
    measured = filters.smooth(one.raw["motor_speed_rad_s"])
    # d/dτ of φ'(t + τ) is φ'': from the speed, whose noise is another one
    bend = np.gradient(measured, STEP_S * filters.THIN)
    good = filters.smooth(one.good.astype(np.float64)) > 0.999
    columns = np.column_stack([gain * bend, rate])[good]
    return columns, (measured - gain * rate)[good], filters.thinned(time)[good]


def check(one: Prepared) -> None:
    """:class:`InputError` that names what is wrong between speed and angle, given both."""
    columns, _, _ = _skew_rows(one, 0.0, 1.0)
    good = filters.smooth(one.good.astype(np.float64)) > 0.999
    check_speed(one, columns[:, 1], filters.smooth(one.raw["motor_speed_rad_s"])[good])


def _block_covariance(rows: Sequence[tuple[Floats, Floats, Floats]], inverse: Floats) -> Floats:
    """Covariance over blocks of 2 s, nowhere below that of white noise through the filter.

    A handful of blocks may agree by chance.
    """
    middle, blocks, left, count = np.zeros_like(inverse), 0, 0.0, 0
    for columns, residual, time in rows:
        block = ((time - time[0]) // 2.0).astype(int) if len(time) else np.zeros(0, int)
        for k in np.unique(block):
            score = columns[block == k].T @ residual[block == k]
            middle += np.outer(score, score)
            blocks += 1
        left, count = left + float(residual @ residual), count + len(residual)
    clustered = np.asarray(inverse @ middle @ inverse * blocks / max(blocks - 2, 1))
    alike = 1.0 / (filters.THIN * float(np.sum(filters.kernel() ** 2)))
    white = np.diag(inverse) * left / max(count, 1) * alike
    np.fill_diagonal(clustered, np.maximum(np.diag(clustered), white))
    return clustered


def _mixed(speed: Floats, angle: Floats, density: Mapping[str, float]) -> tuple[Floats, Floats]:
    of_speed, of_angle = density["motor_speed_rad_s"], density["motor_angle_rad"]
    corner = float(np.clip(np.sqrt(of_speed / of_angle) / (2 * np.pi), 0.3, 60.0))
    fused = speed + low_pass(filters.slope(angle) - speed, corner, 1)
    share = 1.0 / (1.0 + (FREQUENCY / corner) ** 2)
    noise = (1 - share) ** 2 * of_speed + share**2 * (2 * np.pi * FREQUENCY) ** 2 * of_angle
    return fused, noise


def _resting(smooth: Floats, sigma: float) -> Masks:
    n = max(3, round(REST_WINDOW_S / STEP_S) | 1)
    mean = np.convolve(np.pad(smooth, n // 2, mode="edge"), np.ones(n) / n, mode="valid")
    return np.asarray(np.abs(mean) < max(2.0 * sigma, 0.02))
