"""Two methods that anybody would try first, as fairly as we can: ERR and STLSQ.

Both regress the torque that the nominal model leaves over on a library of candidate terms, the
baseline's own parameters refitted beside them: ERR is forward orthogonal least squares by error
reduction ratio (as in NARMAX practice) with BIC to stop it, STLSQ is sequentially thresholded
least squares (as in SINDy) with its threshold chosen on the hold-out. Their friction terms use
sign(ω), as such libraries do. They show how far a case can be solved without more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.proof.sensors import RATE_HZ
from eps_hil.proof.strength import aligned, beyond_refit, filtered, residual, sensitivities
from eps_hil.proof.truth import Drive, Floats

_MOST_TERMS, _SPEED_CUT_HZ, _LEAST_LEFT = 8, 40.0, 0.05
_THRESHOLDS = np.geomspace(1e-3, 1.0, 10)


@dataclass(frozen=True, slots=True)
class Said:
    """Effects that a naive method names, the strongest first."""

    err: tuple[str, ...]
    stlsq: tuple[str, ...]


def smoothed(columns: Mapping[str, Floats]) -> dict[str, Floats]:
    """The recording with its speed low-passed without phase, as anybody would before using it.

    A bristle at rest would otherwise leak away with the noise of the speed.
    """
    from scipy.signal import butter, sosfiltfilt

    sos = butter(4, _SPEED_CUT_HZ, fs=RATE_HZ, output="sos")
    speed = np.asarray(sosfiltfilt(sos, columns["motor_speed_rad_s"]))
    return {**columns, "motor_speed_rad_s": speed}


def library(d: Drive, columns: Mapping[str, Floats]) -> tuple[list[str], Floats]:
    """Candidate terms of one recording: effect ids (several terms may share one), and (p, n)."""
    a = aligned(columns)
    speed, angle, load = a["motor_speed_rad_s"], a["motor_angle_rad"], a["rack_force_n"]
    motor, sensor, place = a["motor_torque_nm"], a["torque_sensor_nm"], a["rack_position_m"]
    sign, t = np.sign(speed), np.arange(len(speed)) * 1e-3
    terms: list[tuple[str, Floats]] = [
        ("viscous_friction", speed),
        ("quadratic_drag", speed * np.abs(speed)),
        ("coulomb_level", sign),
        ("load_dependent_friction", sign * np.abs(load)),
        ("motor_torque_offset", np.ones(len(speed))),
        ("inertia", np.gradient(speed) * 1e3),
        ("motor_torque_gain", motor),
        ("motor_torque_saturation", motor**3),
        ("motor_torque_delay", np.gradient(motor) * 1e3),
        ("torque_sensor_gain", sensor),
        ("rack_ratio", load),
        ("unmodelled_spring", angle),
    ]
    terms += [("stribeck", sign * np.exp(-((speed / w) ** 2))) for w in (4.0, 8.0, 16.0)]
    terms += [("friction_warmup", sign * np.exp(-t / tau)) for tau in (5.0, 20.0)]
    for centre in (-0.005, 0.0, 0.005):
        bump = np.exp(-(((place - centre) / 0.003) ** 2))
        terms += [("position_dependent_friction", sign * bump), ("position_torque", bump)]
    ripples = [("screw_ripple", 1 / d.belt_ratio, np.ones(len(speed)))]
    ripples += [("cogging_torque", order, np.ones(len(speed))) for order in (4, 6, 8, 12)]
    ripples.append(("torque_ripple", 6 * d.pole_pairs, motor))
    ripples.append(("cardan_joint", 2 * d.pinion_rad_per_m / d.rack_rad_per_m, sensor))
    for name, order, weight in ripples:
        terms += [(name, weight * np.sin(order * angle)), (name, weight * np.cos(order * angle))]
    return [name for name, _ in terms], np.array([term for _, term in terms])


def naive(d: Drive, train: Sequence[Mapping[str, Floats]], holdout: Mapping[str, Floats]) -> Said:
    """What ERR and STLSQ make of the recordings of a case."""
    every, x, y, own = _data(d, train)
    _, x_out, y_out, _ = _data(d, [holdout])
    names = [name for name, kept in zip(every, own, strict=True) if kept]
    x, x_out = x[:, own], x_out[:, own]
    return Said(_err(names, x, y), _stlsq(names, (x, y), (x_out, y_out)))


def _data(
    d: Drive, recordings: Sequence[Mapping[str, Floats]]
) -> tuple[list[str], Floats, Floats, npt.NDArray[np.bool_]]:
    """Names, terms (n, p) and target (n,), all orthogonal to the baseline's own parameters; and
    which terms (p,) are more than what the baseline can do already."""
    names: list[str] = []
    terms, target, base = [], [], []
    for noisy in recordings:
        one = smoothed(noisy)
        names, raw = library(d, one)
        terms.append(filtered(raw))
        target.append(filtered(residual(d, one)))
        base.append(filtered(sensitivities(d, one)))
    both = np.column_stack([np.concatenate(terms, axis=1).T, np.concatenate(target)])
    rest = beyond_refit(np.concatenate(base, axis=1), both)
    return (
        names,
        rest[:, :-1],
        rest[:, -1],
        _norms(rest[:, :-1]) > _LEAST_LEFT * _norms(both[:, :-1]),
    )


def _norms(x: Floats) -> Floats:
    return np.asarray(np.linalg.norm(x, axis=0))


def _err(names: Sequence[str], x: Floats, y: Floats) -> tuple[str, ...]:
    q = x / np.linalg.norm(x, axis=0)
    left, chosen = y.copy(), []
    n = len(y)
    for _ in range(_MOST_TERMS):
        gains = (q.T @ left) ** 2
        best = int(gains.argmax())
        before = float(left @ left)
        if n * np.log(1 - gains[best] / before) + np.log(n) > 0:  # BIC gets no better
            break
        chosen.append(names[best])
        left = left - q[:, best] * (q[:, best] @ left)
        q = q - np.outer(q[:, best], q[:, best] @ q)
        norms = np.linalg.norm(q, axis=0)
        q = np.where(norms > 1e-3, q / np.maximum(norms, 1e-12), 0.0)
    return tuple(dict.fromkeys(chosen))


def _stlsq(
    names: Sequence[str], fit: tuple[Floats, Floats], judge: tuple[Floats, Floats]
) -> tuple[str, ...]:
    """Worked on the normal equations: the data is long, the terms are few."""
    scale = _norms(fit[0])
    gram, moment = _normal(fit[0] / scale, fit[1])
    gram_out, moment_out = _normal(judge[0] / scale, judge[1])
    best: Floats = np.zeros(len(moment))
    least = 0.0
    for threshold in _THRESHOLDS * np.linalg.norm(fit[1]):
        weights = _solved(gram, moment)
        for _ in range(10):
            kept = np.abs(weights) >= threshold
            weights = np.zeros(len(weights))
            if kept.any():
                weights[kept] = _solved(gram[np.ix_(kept, kept)], moment[kept])
        error = float(weights @ gram_out @ weights - 2 * weights @ moment_out)
        if error < least:
            best, least = weights, error
    order = np.argsort(-np.abs(best))
    return tuple(dict.fromkeys(names[k] for k in order if best[k] != 0))


def _normal(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    return x.T @ x, x.T @ y


def _solved(gram: Floats, moment: Floats) -> Floats:
    return np.asarray(np.linalg.lstsq(gram, moment, rcond=None)[0], dtype=np.float64)
