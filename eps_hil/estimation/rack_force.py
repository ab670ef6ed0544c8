"""The rack-force estimator (PAPER fig. 8): friction compensation and disturbance observer.

One compiled step; the class, the live stream and the batch run all call the same machine code,
so their results agree bit for bit. No I/O, no clock. Torques and speeds are at the rotor, the
rack force at the rack (signs: CONTRACT 1).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from eps_hil.compiled import kernel
from eps_hil.estimation import acting
from eps_hil.estimation.compensation import drive_torque_nm, friction_step, instant_of, moved
from eps_hil.estimation.gap import another_time, bridge, rests
from eps_hil.estimation.levels import FrictionLevels, level_in_use_nm, levels_in_use
from eps_hil.estimation.memory import LONG_S, end_hold, hold_memory
from eps_hil.estimation.observer import observer_step
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import (
    Constants,
    Inputs,
    Physics,
    constants,
    physics_of,
)
from eps_hil.estimation.state import (
    HELD,
    LINE_LENGTH,
    NEVER_RAN,
    RUNS,
    Carried,
    Moment,
    Rig,
    begin_after_nonsense,
    begin_anew,
    new_carried,
)
from eps_hil.estimation.validity import Reason
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model

_SETTLING = int(Reason.SETTLING)
_DIVERGED = int(Reason.DIVERGED)
_OUT_OF_RANGE = int(Reason.OUT_OF_RANGE)
_FRICTION_UNKNOWN = int(Reason.FRICTION_UNKNOWN)
_IMPOSSIBLE_N = 1e6


class Output(NamedTuple):
    """What one step gives: both figures speak of ``lag_s`` before the inputs' instant."""

    rack_force_n: float
    friction_torque_nm: float
    reason: Reason


@kernel
def start(c: Constants, x: Physics, s: Moment, r: Rig, u: Inputs) -> None:
    """Begin, or begin again after a gap, from the inputs of one instant.

    A rotor that rests goes on resting: one noisy speed for the observed one would count the noise
    of its angle as a way.
    """
    law = x.law
    i = instant_of(c, x, s, r, u)
    torque = drive_torque_nm(c, x, i, u)
    s.phi = u.motor_angle_rad
    resting = s.running == HELD and rests(c, s, u.motor_speed_rad_s)
    if not resting or abs(u.motor_speed_rad_s) < abs(s.omega):
        s.omega = u.motor_speed_rad_s
    load = s.force if s.running == HELD else c.ratio * torque
    way = s.bristle if s.running == HELD else u.motor_speed_rad_s
    now = moved(i, 0.0, i.position_m, s.local * load)
    pos, neg = level_in_use_nm(x, r, 1.0, now), level_in_use_nm(x, r, -1.0, now)
    most = max(pos, neg)  # it may have rested meanwhile
    if x.use.level and not rests(c, s, u.motor_speed_rad_s):
        now = moved(i, u.motor_speed_rad_s, i.position_m, s.local * load)
        pos, neg = level_in_use_nm(x, r, 1.0, now), level_in_use_nm(x, r, -1.0, now)
        most = max(pos, neg, most)
    bridge(c, s, u, torque, pos, neg, most, way, law.sigma0_nm_per_rad)
    s.drive = s.drive_before = torque
    s.acceleration = s.slope = s.path = s.bias = s.bias_slid = 0.0
    if s.running == NEVER_RAN:  # a rotor at rest balances its torque with the rack
        s.speed_noise, s.drive_noise = c.first_noise, c.first_drive_noise
        s.angle_noise = c.first_angle_noise
        s.force = c.ratio * torque
        if c.compensate:
            s.force -= c.ratio * law.sigma0_nm_per_rad * s.bristle
        if c.known_force:
            s.force -= u.rack_force_n / s.local
        s.once_filtered = s.filtered = s.force
    compensated = torque
    if c.compensate:
        compensated -= law.sigma0_nm_per_rad * s.bristle
    if c.known_force:
        compensated -= u.rack_force_n / (c.ratio * s.local)
    s.torque = compensated
    s.speed = s.speed_before = u.motor_speed_rad_s
    s.running, s.settle_steps, s.held_steps, s.carried = RUNS, c.settle_steps, 0, 0


@kernel
def estimator_step(c: Constants, x: Physics, e: Carried, u: Inputs, reason: int) -> int:
    """One millisecond: updates what is carried; returns the reason bits.

    ``reason`` says what is wrong with the inputs; anything but 0 holds the last estimate.
    """
    s, r = e.moment[0], e.rig[0]
    if reason != 0:
        hold_memory(x, s, c.step_s)
        r.clock_s += c.step_s if r.clock_s > 0.0 else 0.0
        if s.running == RUNS:
            s.carried, s.bent = 1, s.bristle
        s.running = min(s.running, HELD)
        s.held_steps += 1
        return reason
    if s.running != RUNS:
        anew = another_time(c, s, u, drive_torque_nm(c, x, instant_of(c, x, s, r, u), u))
        end_hold(c, x, s, r, LONG_S if anew else s.held_steps * c.step_s)
        if anew:
            begin_anew(e)
        start(c, x, s, r, u)
    i = instant_of(c, x, s, r, u)
    torque = drive_torque_nm(c, x, i, u)
    friction = friction_step(c, x, s, r, u, i, torque)
    r.clock_s += c.step_s
    if c.compensate:
        torque -= friction
    if c.known_force:
        torque -= u.rack_force_n / (c.ratio * s.local)
    observer_step(c, s, torque, u)
    s.once_filtered += c.low_pass * (s.force - s.once_filtered)
    s.filtered += c.low_pass * (s.once_filtered - s.filtered)
    if not abs(s.filtered) < _IMPOSSIBLE_N or not abs(s.bristle) < _IMPOSSIBLE_N:
        begin_after_nonsense(e, x.effects)
        return _DIVERGED
    publish(c, s, friction)
    beyond = _OUT_OF_RANGE if x.use.ranged and acting.out_of_range(x.effects, i) else 0
    return verdict(c, s, r) | beyond


@kernel
def verdict(c: Constants, s: Moment, r: Rig) -> int:
    """Whether the observer has settled and the friction is known: reason bits of the step."""
    reason = c.always
    if r.memory_n > 0.0:
        reason |= _FRICTION_UNKNOWN if r.memory_n > c.unknown_limit_n else 0
        r.memory_n *= c.memory_keep
    if c.compensate and s.unknown_n > c.unknown_limit_n:
        reason |= _FRICTION_UNKNOWN
        s.unknown_steps = c.unknown_steps
    elif s.unknown_steps > 0:
        reason |= _FRICTION_UNKNOWN
        s.unknown_steps -= 1
    if s.settle_steps > 0:
        s.settle_steps -= 1
        reason |= _SETTLING
    return reason


@kernel
def publish(c: Constants, s: Moment, friction: float) -> None:
    """Outputs of one instant: the friction waits for as long as the force was filtered.

    A rack force that is known is not estimated: NaN.
    """
    s.friction = friction
    if c.known_force:
        s.out_force, s.out_friction = math.nan, s.filtered / c.ratio
        return
    head = s.head
    s.line[head] = friction
    steps = min(c.output_lag_s / c.step_s, LINE_LENGTH - 2.0)
    whole = int(steps)
    newer = s.line[(head - whole) % LINE_LENGTH]
    older = s.line[(head - whole - 1) % LINE_LENGTH]
    s.out_force = s.local * s.filtered
    s.out_friction = newer + (steps - whole) * (older - newer)
    s.head = (head + 1) % LINE_LENGTH


@dataclass(slots=True)
class RackForceEstimator:
    """The estimator for inputs that are aligned already: one :meth:`step` a millisecond."""

    constants: Constants
    physics: Physics
    carried: Carried

    def __init__(self, model: Model, settings: EstimatorSettings | None = None) -> None:
        model = with_model_effects(model)
        self.constants = constants(model, settings or EstimatorSettings())
        self.physics = physics_of(model)
        self.carried = new_carried()

    @property
    def lag_s(self) -> float:
        """How far before its inputs' instant the output speaks (exact for slow forces)."""
        return self.constants.output_lag_s

    def step(self, inputs: Inputs, reason: Reason = Reason.FINE) -> Output:
        """Take the inputs of the next millisecond; hold the last estimate if they are bad."""
        if reason == Reason.FINE and not all(map(math.isfinite, inputs)):
            reason = Reason.BAD_SAMPLE
        bits = estimator_step(self.constants, self.physics, self.carried, inputs, int(reason))
        now = self.carried.moment[0]
        return Output(float(now.out_force), float(now.out_friction), Reason(bits))

    @property
    def friction_levels(self) -> FrictionLevels:
        """The levels in use at this moment, on their way to what was set."""
        return levels_in_use(self.physics, self.carried.rig[0])

    def set_friction_levels(self, levels: FrictionLevels) -> None:
        """Go over to adapted levels from the next step on, at the rate of the settings."""
        rig = self.carried.rig[0]
        rig.goal_pos, rig.goal_neg = levels.above(self.physics)

    def reset(self) -> None:
        """Forget everything, adapted levels too."""
        self.carried = new_carried()
        self.physics.effects.state[:] = 0.0
