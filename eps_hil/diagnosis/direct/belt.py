"""A belt that gives: what the torque balance of one mass misses, put right.

Behind the belt moves the inertia J₂ = share · J with what pushes it, at the rotor:

    J₂ · i_APA ẍ = T − (F/i_APA − i_pi/i_APA · T_s),     T = k e + c ė,     e = φ − i_APA x

which is a driven oscillator in e, whose input is measured. It turns the rotor's acceleration into
the mean of both masses', (1 − share) φ̈ + share · i_APA ẍ = φ̈ − share · ë, and with that the
balance of one mass is exact again. e itself is too noisy to be differentiated twice.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import ALL
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import STEP_S, Prepared
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


@dataclass(frozen=True)
class Belt:
    """Stiffness and damping at the rotor, and the share of the inertia behind it."""

    stiffness_nm_per_rad: float
    damping_nm_s_per_rad: float
    share: float = USUAL_SHARE


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
    damping, stiffness = belt.damping_nm_s_per_rad / behind, belt.stiffness_nm_per_rad / behind
    b, a = bilinear([-belt.share, 0.0, 0.0], [1.0, damping, stiffness], 1.0 / STEP_S)
    slack = lfilter(b, a, driven, zi=lfilter_zi(b, a) * driven[0])[0]
    delays = model.delays_s
    late = delays.of("motor_angle_rad" if one.speed_is_derived else "motor_speed_rad_s")
    return np.asarray(np.interp(one.time_s - late, one.time_s, slack))


def with_belt(one: Prepared, model: Model, belt: Belt) -> Prepared:
    """The recording with the acceleration that all its inertia has; without a load as it was."""
    if "rack_force_n" not in one.raw:
        return one
    bare = one.changed(slack_rad_s2=None)
    return bare.changed(slack_rad_s2=slack_rad_s2(bare, model, belt))


def belt_of(
    recordings: Sequence[Prepared], model: Model, stiffness_nm_per_rad: float
) -> Belt | None:
    """Damping and share beside a known stiffness: those that leave least of the torque balance.

    The model's own numbers are refitted with each. None where that makes no clear difference: a
    stiff belt's resonance is above what the balance sees, and would only add noise. The damping
    is the one that serves the balance best: too high by up to half, since a sharper resonance
    passes more noise.
    """
    from scipy.optimize import minimize

    knee = 0.0

    def cost(belt: Belt | None) -> float:
        nonlocal knee
        right = [one if belt is None else with_belt(one, model, belt) for one in recordings]
        problem = Problem(right, model)
        problem.knee = knee
        found = fit(problem, [], own=ALL)
        knee = problem.knee  # the first one's, for all
        return found.cost

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
    return belt(found.x) if found.fun < before - _CLEAR else None
