"""A belt that gives: what the torque balance of one mass misses, put right.

Behind the belt moves the inertia J₂ = share · J with what pushes it, at the rotor:

    J₂ · i_APA ẍ = T − (F/i_APA − i_pi/i_APA · T_s),     T = k e + c ė,     e = φ − i_APA x

which is a driven oscillator in e, whose input is measured. It turns the rotor's acceleration into
the mean of both masses', (1 − share) φ̈ + share · i_APA ẍ = φ̈ − share · ë, and with that the
balance of one mass is exact again. e itself is too noisy to be differentiated twice.

The oscillator resonates with the noise of its input too, the sharper the less it is damped. What
that adds to the balance is known, and no reason to damp it: it is taken off (``noise_nm2``).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import ALL
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import CUTOFF_HZ, STEP_S, THIN, Prepared
from eps_hil.identification.butterworth import power_gain
from eps_hil.physics.effects.catalogue import joint_of, with_model_effects
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

ID = "belt_compliance"
USUAL_SHARE = 0.33
"""Of the inertia, behind the belt; what it is is looked for, and this is where from."""
_RATIO, _SHARE = (0.005, 1.0), (0.1, 0.7)
"""Between which damping (of the critical one) and share are looked for."""
_USUAL_RATIO = 0.2
"""Of the critical damping, whatever the machine's size: where the damping is looked for from."""
_TRIALS = 40
_CLEAR = 10.0
"""Noise variances that a belt has to gain."""
_WIDEST = 3.0
"""Times the damping, up to which its interval's upper end tells something of it."""
_LOOK = 0.2
"""Step in ln damping at which the cost is looked at for that interval; in the share it is one that
moves the resonance by half of what its damping makes it wide."""
_NOISE_ERROR = 0.1
"""Of a noise's variance, how wrong it may be."""
_METHOD = 0.03
"""Deviation of ln damping by sampling at 1 ms, times (ω₀ · 1 ms)² over the ratio: motion at the
resonance is drawn a little too small, and that counts against what its damping makes it wide."""


@dataclass(frozen=True)
class Belt:
    """Stiffness and damping at the rotor, and the share of the inertia behind it."""

    stiffness_nm_per_rad: float
    damping_nm_s_per_rad: float
    share: float = USUAL_SHARE
    damping_ci95: tuple[float, float] | None = None
    """None where the recordings do not determine the damping."""

    def told(self, finding: Mapping[str, Any]) -> dict[str, Any]:
        """The finding of the belt's stiffness (CONTRACT 7) with what is known of the damping."""
        if self.damping_ci95 is None:
            words = (
                " The recordings do not determine its damping: "
                f"{self.damping_nm_s_per_rad:.3g} Nm s/rad is a usual one."
            )
            return {**finding, "summary": finding["summary"] + words}
        damping = {
            "value": self.damping_nm_s_per_rad,
            "unit": "Nm s/rad",
            "ci95": list(self.damping_ci95),
        }
        named = {**finding["parameters"], "damping_nm_s_per_rad": damping}
        return {**finding, "parameters": named}


def belt_in(model: Model) -> Belt | None:
    """The belt that a model holds, with the usual share of the inertia behind it."""
    joint = joint_of(model) if any(one["effect"] == ID for one in model.effects) else None
    if joint is None:
        return None
    return Belt(joint.stiffness_nm_per_rad, joint.damping_nm_s_per_rad, joint.behind_share)


def usual_belt(model: Model, stiffness_nm_per_rad: float) -> Belt:
    """The belt of that stiffness with the usual damping and share."""
    return _belt(model, stiffness_nm_per_rad, _USUAL_RATIO, USUAL_SHARE)


def _belt(model: Model, stiffness_nm_per_rad: float, ratio: float, share: float) -> Belt:
    critical = 2.0 * np.sqrt(stiffness_nm_per_rad * share * model.inertia_kg_m2)
    return Belt(stiffness_nm_per_rad, float(ratio * critical), share)


def slack_rad_s2(one: Prepared, model: Model, belt: Belt) -> Floats:
    """−share · ë (n,) at the stamps at which the speed is reported, rad/s² at the rotor."""
    from scipy.signal import bilinear, lfilter, lfilter_zi

    motion, model = one.motion(model), with_model_effects(model)
    behind = belt.share * model.inertia_kg_m2
    load = motion.rack_force_n / model.rack_to_rotor_ratio_rad_per_m
    pushed = load - model.sensor_to_rotor * motion.torque_sensor_nm
    driven = motion.acceleration_rad_s2 + pushed / behind
    # ë + (c/J₂) ė + (k/J₂) e = φ̈ + pushed/J₂, from a rest under what pushes at first
    b, a = bilinear([-belt.share, 0.0, 0.0], _oscillator(belt, behind), 1.0 / STEP_S)
    slack = lfilter(b, a, driven, zi=lfilter_zi(b, a) * driven[0])[0]
    delays = model.delays_s
    late = delays.of("motor_angle_rad" if one.speed_is_derived else "motor_speed_rad_s")
    return np.asarray(np.interp(one.time_s - late, one.time_s, slack))


def _oscillator(belt: Belt, behind: float) -> tuple[float, float, float]:
    """1, c/J₂ and k/J₂ for the bilinear transform, the resonance put where it is.

    The transform makes it lower: by 0.6 % at 44 Hz, a quarter of a lightly damped one's width.
    """
    turn = np.sqrt(belt.stiffness_nm_per_rad / behind)
    warped = 2.0 * np.tan(0.5 * turn * STEP_S) / STEP_S
    slower = 1.0 + (0.5 * warped * STEP_S) ** 2
    return 1.0, belt.damping_nm_s_per_rad / behind * slower, float(warped**2)


def with_belt(one: Prepared, model: Model, belt: Belt) -> Prepared:
    """The recording with the acceleration that all its inertia has; without a load as it was."""
    if "rack_force_n" not in one.raw:
        return one
    bare = one.changed(slack_rad_s2=None)
    return bare.changed(slack_rad_s2=slack_rad_s2(bare, model, belt))


def noise_nm2(one: Prepared, model: Model, belt: Belt) -> float:
    """Variance (Nm²) of the noise in the thinned residual of ``with_belt``.

    What the sensors' noise does there passes the oscillator as the signals do: R = s²/(s² + c/J₂ s
    + k/J₂) of the acceleration's and the load's comes back, a ``share`` of it and all of it.
    """
    motor, load, moved = one.noise_parts_nm2(model)
    behind = belt.share * model.inertia_kg_m2
    frequency_hz, gain = power_gain(min(CUTOFF_HZ, one.motion_hz))
    turn = 2.0 * np.pi * frequency_hz * STEP_S
    s = 2j * np.tan(0.5 * turn) / STEP_S  # as the bilinear transform has it
    back = s**2 / np.polyval(_oscillator(belt, behind), s)
    power = 4 if one.speed_is_derived else 2
    coloured = gain * np.abs(1.0 - belt.share * back) ** 2 * np.sin(turn) ** power
    moved *= float(np.sum(coloured) / np.sum(gain * turn**power))
    load *= float(np.sum(gain * np.abs(1.0 - back) ** 2) / np.sum(gain))
    return motor + load + moved


def belt_of(
    recordings: Sequence[Prepared], model: Model, stiffness_nm_per_rad: float
) -> Belt | None:
    """Damping and share beside a known stiffness: those that leave least of the torque balance.

    Least beyond the noise that the belt passes. The model's own numbers are refitted with each.
    None where that makes no clear difference: a stiff belt's resonance is above what the balance
    sees, and would only add noise. A damping that the recordings do not determine has no interval,
    and is the usual one.
    """
    from scipy.optimize import minimize

    knee, noise = 0.0, 0.0

    def cost(belt: Belt | None) -> float:
        """Of the balance, without what is noise; ``noise`` is that part."""
        nonlocal knee, noise
        right = [one if belt is None else with_belt(one, model, belt) for one in recordings]
        problem = Problem(right, model)
        problem.knee = knee
        found = fit(problem, [], own=ALL)
        knee = problem.knee  # the first one's, for all
        noise = 0.0 if belt is None else _noise(problem, recordings, model, belt)
        return found.cost - noise

    def belt(at: Floats) -> Belt:
        return _belt(model, stiffness_nm_per_rad, float(np.exp(at[0])), float(at[1]))

    before = cost(None)
    start = [np.log(_USUAL_RATIO), USUAL_SHARE]
    simplex = [start, [start[0] + 0.7, start[1]], [start[0], start[1] + 0.08]]
    found = minimize(
        lambda at: cost(belt(at)),
        start,
        method="Nelder-Mead",
        bounds=[np.log(_RATIO), _SHARE],
        options={"maxfev": _TRIALS, "xatol": 0.02, "fatol": 1.0, "initial_simplex": simplex},
    )
    if not found.fun < before - _CLEAR:
        return None

    def looked(at: Floats) -> tuple[float, float]:
        return cost(belt(at)), noise

    samples = sum(len(one.thin_time_s) for one in recordings)
    best = belt(found.x)
    turn2 = stiffness_nm_per_rad / (best.share * model.inertia_kg_m2) * STEP_S**2
    own = _METHOD * turn2 / float(np.exp(found.x[0]))
    half = 1.96 * float(np.hypot(_deviation(looked, found.x, float(found.fun), samples), own))
    if half > np.log(_WIDEST):
        return _belt(model, stiffness_nm_per_rad, _USUAL_RATIO, best.share)
    ends = tuple(best.damping_nm_s_per_rad * float(np.exp(side * half)) for side in (-1.0, 1.0))
    return replace(best, damping_ci95=(ends[0], ends[1]))


def _noise(problem: Problem, recordings: Sequence[Prepared], model: Model, belt: Belt) -> float:
    """The energy of noise that the belt adds to the balance, in units of its cost."""
    total, first = 0.0, 0
    for one in recordings:
        last = first + len(one.thin_time_s)
        added = noise_nm2(one, model, belt) - sum(one.noise_parts_nm2(model))
        more = 1.0 + added * problem.scale[first:last] ** -2.0
        total += float(np.sum(_robust(np.sqrt(np.maximum(more, 0.0)), problem.knee)))
        total -= len(more) * float(_robust(np.ones(1), problem.knee)[0])
        first = last
    return total


def _robust(deviation: Floats, knee: float) -> Floats:
    """The mean of twice Huber's loss (``Problem.cost``) over noise of these deviations, (n,)."""
    from scipy.special import ndtr

    at = knee / np.maximum(deviation, 1e-9)
    density = np.exp(-0.5 * at**2) / np.sqrt(2.0 * np.pi)
    beyond = 2.0 * ndtr(-at)
    inside = deviation**2 * (1.0 - beyond - 2.0 * at * density)
    return np.asarray(inside + 4.0 * knee * deviation * density - knee**2 * beyond)


def _deviation(
    looked: Callable[[Floats], tuple[float, float]], best: Floats, least: float, samples: int
) -> float:
    """Standard deviation of ln damping, the share free beside it; inf: not told.

    By the bend of the cost, which counts residuals that leave more than noise, or are not
    independent of their neighbours, as fewer; and by what the noise taken off may be wrong by.
    """
    steps = np.array([_LOOK, min(float(np.exp(best[0])), _LOOK) * best[1]])
    to, there = np.diag(steps), np.array([0.5, 0.5]) * steps
    ahead, behind = [looked(best + one) for one in to], [looked(best - one) for one in to]
    across = looked(best + 2.0 * there)[0]
    bend = np.empty((2, 2))
    for i in range(2):
        bend[i, i] = (ahead[i][0] - 2.0 * least + behind[i][0]) / steps[i] ** 2
    both = across - ahead[0][0] - ahead[1][0] + least
    bend[0, 1] = bend[1, 0] = both / (steps[0] * steps[1])
    slope = np.array([(ahead[i][1] - behind[i][1]) / (2.0 * steps[i]) for i in range(2)])
    if bend[1, 1] <= 0.0 or np.linalg.det(bend) <= 0.0:
        return float("inf")
    inverse = np.linalg.inv(bend)
    apart = max(least / max(samples, 1), 1.0) / (2.0 * CUTOFF_HZ * THIN * STEP_S)
    wrong = _NOISE_ERROR * float(inverse[0] @ slope)
    return float(np.sqrt(2.0 * apart * inverse[0, 0] + wrong**2))
