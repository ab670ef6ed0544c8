"""Rest and presliding, which no gate judges by: whether the model turns round as the rig does.

Friction that goes with speed, or whose presliding is of another form (slip elements), may gain
nothing by another stiffness: the balance then bends other numbers, none of which hold-outs bear
out, and nothing is found. What is left there says all the same that the model's presliding is not
the rig's. What a right model would leave there depends on the sensors, so it is tried: the
recordings with the motor torque that this very model needs, and their noise once more.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.proof_of_fit import CLEARLY, NOISES, Holdout
from eps_hil.diagnosis.balance.problem import NOTHING_NM, Problem
from eps_hil.diagnosis.data.prepare import CLEAR_SIGMA, Prepared
from eps_hil.diagnosis.direct.reversals import LONGEST_INTERVAL_S, times_noise
from eps_hil.identification.filters import shifted
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_FEWEST, _FEWEST_MOVING = 8, 4
"""Samples of a block that tell anything of it; of those that move as well, 32 ms."""
_BLOCKS = 8
"""Blocks that tell of a rig."""
_WHERE = (
    "At rest and while the rotor turns round",
    "While the rotor breaks away and turns round",
)
_MUCH_MORE = (3.0, 2.0)
"""Times what a right model leaves at each: its motion is a smoothed one, a rig's turns more
sharply, and how a rig creeps at rest is in no signal."""
_SEED, _ROUNDS, _LEAST_SHARE = 20, 2, 0.1
_NOISY = (
    "motor_torque_nm",
    "torque_sensor_nm",
    "motor_speed_rad_s",
    "motor_angle_rad",
    "rack_force_n",
)


def turns_otherwise(
    problem: Problem, judged: Sequence[Holdout], model: Model, *, named: bool = False
) -> list[str]:
    """A sentence where rest and turning leave clearly more than in a right model.

    Of the fitted recordings and of the hold-outs, and in most blocks of time: no single event.
    ``named``: whether a finding tells of presliding already. Where instants are known too poorly
    to try a right model, it is silent then.
    """
    both = problem.over([one.prepared for one in judged]), problem
    fine = not any(
        one.load_is_assumed or one.interval_s > LONGEST_INTERVAL_S
        for each in both
        for one in each.recordings
    )
    if not fine:
        return [] if named else _coarsely(*both, model)
    residuals = [[one.left_over(model) for one in each.recordings] for each in both]
    left = [_usual(*one) for one in zip(both, residuals, strict=True)]
    if max(map(max, left)) < min(_MUCH_MORE) * problem.floor:
        return []  # no draw leaves less than the noise of sliding
    tried = [
        _usual(each, [right(one, model).left_over(model) for one in each.recordings])
        for each in both
    ]
    times = [
        min(
            have[k] / max(most[k], each.floor)
            for each, have, most in zip(both, left, tried, strict=True)
        )
        for k in range(len(_WHERE))
    ]
    k = int(np.argmax(np.divide(times, _MUCH_MORE)))
    if times[k] < _MUCH_MORE[k]:
        return []
    return [_said(_WHERE[k], left[0][k], f"{times[k]:.2g} {NOISES}", model, _form(problem, model))]


def _said(where: str, torque_nm: float, times: str, model: Model, form: str) -> str:
    force_n = torque_nm * model.rack_to_rotor_ratio_rad_per_m
    return (
        f"{where}, {torque_nm:.2g} Nm (rms, at the rotor; {force_n:.3g} N at the rack) stay "
        f"unexplained on hold-outs, {times} in a right model: how the rig sticks, breaks away and "
        f"turns round is not the model's way, and nothing that was found explains it.{form} Full "
        "reversals and slow travel at several speeds would show its form."
    )


def _coarsely(kept: Problem, fitted: Problem, model: Model) -> list[str]:
    """The same where a reversal's instant is all that is known of a right model's residual."""
    times = [_usual_of(one, one.residual(model), _unsettled(one)) for one in (kept, fitted)]
    if min(times) < CLEARLY:
        return []
    torque_nm = _usual_of(kept, kept.residual(model) * kept.scale, _unsettled(kept))
    return [_said(_WHERE[0], torque_nm, f"{times[0]:.2g} times what stays", model, "")]


def _form(problem: Problem, model: Model) -> str:
    """Which form full reversals are nearer to, if it is not the model's."""
    lugre, masing = (times_noise(problem.recordings, model, one) for one in (False, True))
    if lugre is None or masing is None or masing * CLEARLY > lugre:
        return ""
    return (
        f" Full reversals leave {lugre:.2g} times their noise in the model's form of presliding "
        f"(LuGre's) and {masing:.2g} times in that of slip elements (Masing's rule)."
    )


def _unsettled(problem: Problem) -> Flags:
    """Samples (n,) at rest and in presliding."""
    return ~problem.sliding & (problem.scale < 0.5 * NOTHING_NM * problem.size.torque)


def _usual(problem: Problem, residuals: Sequence[Floats]) -> list[float]:
    """Of ``residuals`` of each recording, what stays at each of ``_WHERE``, Nm."""
    use = _unsettled(problem)
    moves = np.concatenate([_moves(one, problem.model) for one in problem.recordings])
    values = np.concatenate(residuals)
    return [
        _usual_of(problem, values, use),
        _usual_of(problem, values, use & moves, _FEWEST_MOVING),
    ]


def _moves(one: Prepared, model: Model) -> Flags:
    """Thinned samples (m,) at which the rotor moves, clear of the speed's noise."""
    speed = one.thin(one.motion(model).speed_rad_s)
    return np.asarray(np.abs(speed) > CLEAR_SIGMA * one.speed_noise_rad_s)


def _usual_of(problem: Problem, values: Floats, use: Flags, fewest: int = _FEWEST) -> float:
    """Rms of ``values`` (n,) of the usual block of the samples to ``use``; 0: too few of them."""
    count = np.bincount(problem.block[use], minlength=int(problem.block[-1]) + 1)
    told = count >= fewest
    if np.sum(told) < _BLOCKS:
        return 0.0
    sums = np.bincount(problem.block[use], values[use] ** 2, len(count))
    return float(np.median(np.sqrt(sums[told] / count[told])))


def right(one: Prepared, model: Model) -> Prepared:
    """The recording as it might be if ``model`` were right: a parametric bootstrap's draw.

    Its smoothed motion is the true one, its motor torque what that needs; then comes the noise.
    """
    true = one.smoothly_moved()
    late_s, share = with_model_effects(model).delays_s.motor_torque, one.acting_share(model)
    for _ in range(_ROUNDS):  # the second is for a model that bends the motor's torque
        more = shifted(true.balance(model), -late_s) / max(share, _LEAST_SHARE)
        torque = true.raw["motor_torque_nm"] - more
        true = true.changed(raw={**true.raw, "motor_torque_nm": torque})
    rng = np.random.default_rng(_SEED)
    noisy = {
        name: values + one.noise[name] * rng.standard_normal(len(values))
        for name, values in true.raw.items()
        if name in _NOISY and name in one.noise
    }
    made = true.changed(raw={**true.raw, **noisy})
    return made.by_angle() if one.speed_is_derived else made
