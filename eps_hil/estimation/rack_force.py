"""The rack-force estimator (PAPER fig. 8): friction compensation and disturbance observer.

One compiled step; the class, the live stream and the batch run all call the same machine code,
so their results agree bit for bit. No I/O, no clock. Torques and speeds are at the rotor, the
rack force at the rack (signs: CONTRACT 1).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.estimation.compensation import drive_torque_nm, friction_step, instant_of
from eps_hil.estimation.levels import FrictionLevels, adapted_level_nm, forget, levels_in_use
from eps_hil.estimation.observer import observer_step
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import (
    ACCELERATION,
    ANGLE,
    ANGLE_BEFORE,
    ANGLE_EARLIER,
    BRISTLE,
    CLOCK,
    DRIVE,
    DRIVE_BEFORE,
    DRIVE_NOISE,
    FORCE,
    GOAL_NEG,
    GOAL_POS,
    HEAD,
    HELD,
    LINE,
    LINE_LENGTH,
    LOCAL,
    LP1,
    LP2,
    NOISE,
    OMEGA,
    OUT_FORCE,
    OUT_FRICTION,
    PATH,
    PHI,
    RUNNING,
    SETTLE,
    SLOPE,
    SPEED,
    SPEED_BEFORE,
    STEP_S,
    TORQUE,
    Constants,
    Inputs,
    Physics,
    constants,
    new_state,
    physics_of,
)
from eps_hil.estimation.validity import Reason
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model

_SETTLING = int(Reason.SETTLING)
_DIVERGED = int(Reason.DIVERGED)
_IMPOSSIBLE_N = 1e6


class Output(NamedTuple):
    """What one step gives: both figures speak of ``lag_s`` before the inputs' instant."""

    rack_force_n: float
    friction_torque_nm: float
    reason: Reason


@njit
def start(c: Constants, x: Physics, s: npt.NDArray[np.float64], u: Inputs) -> None:
    """Begin, or begin again after a gap, from the inputs of one instant."""
    law = x.law
    torque = drive_torque_nm(c, x, instant_of(c, x, s, u), u)
    s[PHI], s[OMEGA] = u.motor_angle_rad, u.motor_speed_rad_s
    s[SPEED] = s[SPEED_BEFORE] = u.motor_speed_rad_s
    s[ANGLE] = s[HELD] = s[ANGLE_BEFORE] = s[ANGLE_EARLIER] = u.motor_angle_rad
    s[DRIVE] = s[DRIVE_BEFORE] = torque
    s[ACCELERATION] = s[SLOPE] = s[PATH] = 0.0
    if s[RUNNING] < 0.0:
        s[NOISE], s[DRIVE_NOISE] = c.first_noise, c.first_drive_noise
    if s[RUNNING] < 0.0:  # never ran: a rotor at rest balances its torque with the rack
        if abs(u.motor_speed_rad_s) > c.limiter_speed:
            load = s[LOCAL] * c.ratio * torque
            level = adapted_level_nm(x, s, u.motor_speed_rad_s, load)
            s[BRISTLE] = math.copysign(level / law.sigma0_nm_per_rad, u.motor_speed_rad_s)
        s[FORCE] = c.ratio * torque
        if c.compensate:
            s[FORCE] -= c.ratio * law.sigma0_nm_per_rad * s[BRISTLE]
        if c.known_force:
            s[FORCE] -= u.rack_force_n / s[LOCAL]
        s[LP1] = s[LP2] = s[FORCE]
    compensated = torque
    if c.compensate:
        compensated -= law.sigma0_nm_per_rad * s[BRISTLE]
    if c.known_force:
        compensated -= u.rack_force_n / (c.ratio * s[LOCAL])
    s[TORQUE] = compensated
    s[RUNNING], s[SETTLE] = 1.0, c.settle_steps


@njit
def estimator_step(
    c: Constants, x: Physics, s: npt.NDArray[np.float64], u: Inputs, reason: int
) -> int:
    """One millisecond: updates the state vector ``s`` (shape (STATES,)); returns the reason bits.

    ``reason`` says what is wrong with the inputs; anything but 0 holds the last estimate.
    """
    if reason != 0:
        s[CLOCK] += STEP_S if s[CLOCK] > 0.0 else 0.0
        s[RUNNING] = min(s[RUNNING], 0.0)
        return reason
    if s[RUNNING] <= 0.0:
        start(c, x, s, u)
    i = instant_of(c, x, s, u)
    torque = drive_torque_nm(c, x, i, u)
    friction = friction_step(c, x, s, u, i, torque)
    s[CLOCK] += STEP_S
    if c.compensate:
        torque -= friction
    if c.known_force:
        torque -= u.rack_force_n / (c.ratio * s[LOCAL])
    observer_step(c, s, torque, u)
    s[LP1] += c.low_pass * (s[FORCE] - s[LP1])
    s[LP2] += c.low_pass * (s[LP1] - s[LP2])
    if not abs(s[LP2]) < _IMPOSSIBLE_N or not abs(s[BRISTLE]) < _IMPOSSIBLE_N:
        forget(s)
        return _DIVERGED
    publish(c, s, friction)
    if s[SETTLE] > 0.0:
        s[SETTLE] -= 1.0
        return _SETTLING
    return 0


@njit
def publish(c: Constants, s: npt.NDArray[np.float64], friction: float) -> None:
    """Outputs of one instant: the friction waits for as long as the force was filtered."""
    if c.known_force:
        s[OUT_FORCE], s[OUT_FRICTION] = 0.0, s[LP2] / c.ratio
        return
    head = int(s[HEAD])
    s[LINE + head] = friction
    steps = min(c.output_lag_s / STEP_S, LINE_LENGTH - 2.0)
    whole = int(steps)
    newer = s[LINE + (head - whole) % LINE_LENGTH]
    older = s[LINE + (head - whole - 1) % LINE_LENGTH]
    s[OUT_FORCE] = s[LOCAL] * s[LP2]
    s[OUT_FRICTION] = newer + (steps - whole) * (older - newer)
    s[HEAD] = (head + 1) % LINE_LENGTH


@dataclass(slots=True)
class RackForceEstimator:
    """The estimator for inputs that are aligned already: one :meth:`step` a millisecond."""

    constants: Constants
    physics: Physics
    state: npt.NDArray[np.float64]

    def __init__(self, model: Model, settings: EstimatorSettings | None = None) -> None:
        model = with_model_effects(model)
        self.constants = constants(model, settings or EstimatorSettings())
        self.physics = physics_of(model)
        self.state = new_state()

    @property
    def lag_s(self) -> float:
        """How far before its inputs' instant the output speaks (exact for slow forces)."""
        return self.constants.output_lag_s

    def step(self, inputs: Inputs, reason: Reason = Reason.FINE) -> Output:
        """Take the inputs of the next millisecond; hold the last estimate if they are bad."""
        if reason == Reason.FINE and not all(map(math.isfinite, inputs)):
            reason = Reason.BAD_SAMPLE
        bits = estimator_step(self.constants, self.physics, self.state, inputs, int(reason))
        return Output(self.state[OUT_FORCE], self.state[OUT_FRICTION], Reason(bits))

    @property
    def friction_levels(self) -> FrictionLevels:
        """The levels in use at this moment, on their way to what was set."""
        return levels_in_use(self.physics, self.state)

    def set_friction_levels(self, levels: FrictionLevels) -> None:
        """Go over to adapted levels from the next step on, at the rate of the settings."""
        self.state[GOAL_POS], self.state[GOAL_NEG] = levels.above(self.physics)

    def reset(self) -> None:
        """Forget everything, adapted levels too."""
        self.state[:] = new_state()
        self.physics.effects.state[:] = 0.0
