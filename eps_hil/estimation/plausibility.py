"""Whether signals can be what they say: range, rate, frozen, angle against speed, torque jumps.

A frame with a right CRC and a running counter may still carry nonsense. What a sample cannot be is
taken out as it arrives; what several signals cannot be together is told beside the estimate
(docs/theory-estimator.md, "Plausibility"). Compiled; all that is remembered is one record.
"""

import math

import numpy as np

from eps_hil.compiled import kernel
from eps_hil.estimation.creep import follow_creep, lose_sight, see_again
from eps_hil.estimation.frozen import take_equal, torques_untold
from eps_hil.estimation.gain_and_lag import SMOOTHED_S, doubt_lessons, relation_steps
from eps_hil.estimation.holes import blind, course, in_the_dark, lose_course, unseen
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import Inputs, smoothing
from eps_hil.estimation.speed_and_angle import (
    LEAK_PER_MS,
    SLOW_LEAK_PER_MS,
    SUDDEN,
    angle_off,
    await_angle,
    jumped_alone,
    jumped_in_hole,
    mean_noise,
    mean_share,
    spiked_alone,
)
from eps_hil.estimation.state import Records
from eps_hil.estimation.torque_jumps import (
    add_pace,
    bend_noise,
    bridge,
    due_noise,
    hinge,
    latched,
    swing_hinge,
    watch_jump,
)
from eps_hil.estimation.validity import Reason
from eps_hil.estimation.watch import COUNT, WRAP, Limits, Watch, next_step
from eps_hil.physics.model import Model

_TORQUE, _SENSOR, _SPEED, _ANGLE = range(4)
_RANGE, _RATE = int(Reason.RANGE), int(Reason.RATE)
_FROZEN, _INCONSISTENT = int(Reason.FROZEN), int(Reason.INCONSISTENT)
_SETTLING = int(Reason.SETTLING)
_CONTINUOUS_NS = 50_000_000
_MOVING_RAD_S = 1.0
_SPREAD_MEMORY_MS = 512.0
_TOLD_S, _EDGE_S, _WINDOW_S = 0.2, 0.002, 0.010
_BRIDGED_S = 0.018
"""A hole at whose end a jump of the torque is still told from the load's own course."""
_SCARCE_S = 0.3
"""Holes that end, and come again: for so much longer than it is seen a torque may be unseen."""
_STALLED_S = 1.5
"""How long torque is doubted that stood still, or whose jump back may have been missed."""
_ANGLE_SIGMA = 10.0
_ZERO_S = 0.02
"""Over so long an angle that jumped tells where its zero is now."""


def limits_of(model: Model, settings: EstimatorSettings, angle_seen: bool) -> Limits:
    """Limits of a model and its settings; what is not set follows from the model."""
    chosen, ratio = settings.plausibility, model.rack_to_rotor_ratio_rad_per_m
    torque = chosen.largest_torque_nm(ratio)
    most = (torque, chosen.torque_sensor_nm, chosen.motor_speed_rad_s, math.inf, math.inf)
    fastest = chosen.largest_acceleration_rad_s2(ratio, model.inertia_kg_m2)
    rate = (math.inf, math.inf, fastest, chosen.largest_turning_rad_s, math.inf)
    step_s, step_ms = settings.step_s, settings.step_s * 1e3
    stiff = math.sqrt(model.friction.sigma0_nm_per_rad / model.inertia_kg_m2)
    window = min(max(round(1.5 / stiff / step_s), 4), round(_WINDOW_S / step_s))
    slow, leak, share = SLOW_LEAK_PER_MS**step_ms, LEAK_PER_MS**step_ms, mean_share(step_s)
    by_angle, by_speed = mean_noise(leak, share, step_s)
    before = min(3 * window, WRAP - 1 - window)
    learn_every, memory, related_steps, forgotten_steps = relation_steps(step_s)
    return Limits(
        on=chosen.enabled,
        step_s=step_s,
        most=np.array(most),
        rate=np.array(rate),
        frozen_samples=chosen.frozen_samples,
        window=window,
        lag=math.ceil(SMOOTHED_S / step_s) + 1,
        inverse_inertia=1.0 / model.inertia_kg_m2,
        ratio=ratio,
        sensor_to_rotor=model.sensor_to_rotor,
        jump=chosen.jump_chi_square,
        consistent_steps=round(chosen.consistent_s / step_s),
        told_steps=round(_TOLD_S / step_s),
        stalled_steps=round(_STALLED_S / step_s),
        unsure_steps=round(chosen.unseen_s / step_s),
        scarce_steps=round(_SCARCE_S / step_s),
        bridged=round(_BRIDGED_S / step_s),
        edge=max(round(_EDGE_S / step_s), 1),
        hinge=hinge(window),
        hinge_noise=float(np.sum(hinge(window) ** 2)),
        bend_noise=bend_noise(hinge(window)),
        due_noise=due_noise(window, step_s, 1.0 / model.inertia_kg_m2),
        spread_memory=step_ms / _SPREAD_MEMORY_MS,
        swing_before=before,
        swing_every=max(window // 2, 1),
        swing_hinge=swing_hinge(before, window),
        swing_noise=float(np.sum(swing_hinge(before, window) ** 2)),
        leak=leak,
        slow_leak=slow,
        slow_noise=step_s**2 / (1.0 - slow**2),
        slow_rest=settings.dead_zone_rad_s * step_s / (1.0 - slow),
        learn_every=learn_every,
        relation_memory=memory,
        related_steps=related_steps,
        forgotten_steps=forgotten_steps,
        creep_share=smoothing(settings.creep_low_pass_hz, step_s),
        zero_steps=max(round(_ZERO_S / step_s), 1),
        mean_share=share,
        mean_angle_noise=by_angle,
        mean_speed_noise=by_speed,
        angle_seen=angle_seen,
        angle_noise=settings.angle_noise_rad**2,
        angle_tolerance=_ANGLE_SIGMA * settings.angle_noise_rad,
        sudden_turn=max(fastest * step_s**2, 3.0 * _ANGLE_SIGMA * settings.angle_noise_rad),
        estimate_n=chosen.estimate_n,
    )


@kernel
def judge_sample(watch: Records, p: Limits, i: int, t: int, v: float) -> float:
    """The sample of signal ``i``, or NaN where it cannot be what it says."""
    if not p.on or not math.isfinite(v):
        return v
    w = watch[0]
    before, since = w.last[i], t - w.last_ns[i]
    w.last[i], w.last_ns[i] = v, t
    if abs(v) > p.most[i]:
        w.refused[i] = _RANGE
        return math.nan
    if not 0 < since < _CONTINUOUS_NS:
        w.same[i] = w.still[i] = w.frozen[i] = 0
        w.change[i] = 0.0
        return v
    if abs(v - before) > p.rate[i] * max(since * 1e-9, p.step_s):
        w.refused[i] = _RATE
        return math.nan
    take_equal(w, p, i, before, v)
    return v


@kernel
def _miss(w: Watch, p: Limits, u: Inputs, turns: bool) -> None:
    """A step with missing inputs; where the rotor still ``turns`` in sight, its way is followed."""
    w.slip, w.path, w.gain = 0.0, 0.0, 0.0
    w.mean_slip, w.mean_path, w.mean_gain = 0.0, 0.0, 0.0
    w.slow, w.turned, w.slow_gain = 0.0, 0.0, 0.0
    if turns and p.angle_seen and w.unbroken > 0:
        if w.sightless > 0:
            see_again(w, p, u)
        follow_creep(w, p, u)
        w.angle = u.motor_angle_rad
    else:
        lose_sight(w)


@kernel
def _speed_before(w: Watch, p: Limits, u: Inputs) -> float:
    """The speed (rad/s) of the step before; where nothing was seen then, as it is now."""
    if w.steps > 0 and w.hole == 0:
        return float(w.speed[(w.steps - 1) & WRAP])
    if w.sightless > 0:
        see_again(w, p, u)
    if w.unbroken == 0:
        w.angle = u.motor_angle_rad - u.motor_speed_rad_s * p.step_s
    return u.motor_speed_rad_s


@kernel
def judge_step(
    watch: Records, p: Limits, u: Inputs, seen: bool, missing: int, turns: bool
) -> tuple[int, bool]:
    """Reason bits of signals that do not fit each other, and whether that is seen at this moment.

    ``seen``: T_1m is read where no samples are lost. ``missing``: why inputs are missing, or 0;
    ``turns``: speed and angle are not. What is doubted for something past is estimated on.
    """
    if not p.on:
        return 0, False
    w = watch[0]
    parting, w.parted, w.parting = w.parting, 0, 0
    if missing != 0:
        _miss(w, p, u, turns)
        blind(w, p, u.motor_speed_rad_s, missing & (_RANGE | _RATE) != 0)
        return latched(w, p), w.told > 0
    if not seen and w.unseen > p.bridged and w.steps > 0:  # drawn straight: nobody saw it
        lose_course(w)
    before = _speed_before(w, p, u)
    if w.hole > 0:
        bridge(w, p, u)
    in_the_dark(w, p, u.speed_periods > 1.0)
    at = w.steps & WRAP
    reason = unseen(w, p) | (_SETTLING if torques_untold(w) else 0)
    torque = u.motor_torque_nm + p.sensor_to_rotor * u.torque_sensor_nm
    w.torque[at] = course(w, p, torque - w.unexplained_nm, u.drive_noise, seen)
    w.speed[at] = u.motor_speed_rad_s
    add_pace(w, p)
    next_step(w, p)
    w.moving = 1 if abs(u.motor_speed_rad_s) > _MOVING_RAD_S else 0
    watch_jump(w, p, u)
    reason |= latched(w, p)
    now = w.told > 0
    if p.angle_seen:
        follow_creep(w, p, u)
    off = angle_off(w, p, u, before) if p.angle_seen else 0
    if p.angle_seen:
        await_angle(w, p, u)
    if p.angle_seen and (jumped_alone(w, p, u) or jumped_in_hole(w, p, u)):
        w.stalled, w.missed, off = p.stalled_steps, 1, 1
        doubt_lessons(w, p)
    elif p.angle_seen and spiked_alone(w, p, u):
        off = 1
    if off:
        w.parted, w.parting = 1, min(parting + 1, 2)
        if parting < 2:
            w.sudden = 1 if off == SUDDEN else 0
        reason |= _INCONSISTENT
        now = True
    for i in range(COUNT):
        if w.frozen[i]:
            reason |= _FROZEN | _INCONSISTENT
            w.stalled, w.missed = p.stalled_steps, 1
            now = True
    return reason, now
