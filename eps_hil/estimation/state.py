"""What the estimator remembers, as two named records, and the one place where they are made.

:class:`Moment` is of the moment: a reset replaces it by :func:`new_moment`, whole, so that nothing
can be left at a value that no start would give. :class:`Rig` is of the rig: adapted friction levels
and for how long it has run; no reset touches it. Torques and speeds at the rotor, force at the
rack. Compiled code sees numpy records, and reads and writes their fields by name.
"""

from typing import Annotated, Any, NamedTuple, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.estimation.records import copy
from eps_hil.physics.effects.added import Added
from eps_hil.physics.effects.effect import Instant

LINE_LENGTH = 640
"""Steps of friction that wait for the filtered force: 64 ms at the shortest step."""
INSTANT = len(Instant._fields)
NEVER_RAN, HELD, RUNS = -1, 0, 1
NOBODY_KNOWS = 1 << 40
"""``held_steps``, and more, where the clock went back by over a second."""
"""Values of ``running``: nothing estimated yet; the last estimate is held; estimating."""

Records = npt.NDArray[Any]
"""One record as an array of shape (1,), which compiled code can replace whole."""


class Moment:
    """What is of the moment. A field's type says how the record holds it."""

    # The observer's state (eq. 5 to 9), the torque it was given last, its force's slope and filter.
    phi: float
    omega: float
    force: float
    torque: float
    slope: float
    once_filtered: float
    filtered: float
    # Friction (eq. 2): deflection z; speed of the last step, acceleration for eq. 4a.
    bristle: float
    speed: float
    acceleration: float
    # Its torque of the last step (Nm), and how well the bristle filter knows z (rad, rms).
    friction: float
    bristle_rms: float
    # The same before the limiter of eq. 4a, which follows the torque and not the motion.
    unlimited: float
    # By how much the friction may be off (Nm), and by how much more since the rotor may have crept
    # and no angle shows it; what both are at the rack (N), and for how many steps more the output
    # holds something of it.
    unknown_nm: float
    unseen_nm: float
    unknown_n: float
    unknown_steps: int
    # Across held steps: the last measured angle, how many there were, and whether speed and angle
    # parted meanwhile (0 or 1); then the way that the speed told (rad).
    last_angle: float
    held_steps: int
    parted: int
    went: float
    # Whether the torque is doubted in this step, and estimated on with (0 or 1), and the way since
    # it is (rad).
    wary: int
    wary_way: float
    # Way by the speed since the first step, and sum of the angle's changes over held steps (rad).
    turned: float
    leapt: float
    # The angle less its way without jumps, and by how much that has changed while held (rad).
    zero: float
    other_zero: float
    # While held: whether the angle's way is known, the bristle that it bends, and the angle,
    # smoothed, and followed past its noise (creep.py).
    carried: int
    bent: float
    smoothed: float
    followed: float
    # Dead zone: the noise that is there (second differences), path inside the zone, creep.
    speed_before: float
    speed_noise: float
    speed_periods: float
    path: float
    drive: float
    drive_before: float
    drive_noise: float
    angle: float
    angle_before: float
    angle_earlier: float
    angle_noise: float
    angle_periods: float
    held: float
    # By how much the speed draws the filtered angle away, beyond noise, and what that was while the
    # bristle slid (rad).
    bias: float
    bias_slid: float
    # dφ/dx over i_APA where the rack is: ``force`` is as it would be in mid travel.
    local: float
    # Outputs, and the line in which the friction waits for the filtered force.
    out_force: float
    out_friction: float
    line: Annotated[npt.NDArray[np.float64], LINE_LENGTH]
    head: int
    running: int
    settle_steps: int
    # What the physics was told last (an Instant): added effects act by it while held.
    told: Annotated[npt.NDArray[np.float64], INSTANT]


class Rig:
    """What is of the rig: its time, what adaptation adds to k0+ and k0− now, and its goals (Nm).

    The largest motor torque (Nm) and speed (rad/s) so far. What is unknown of what effects
    remember, as a rack force (N), and how much that is at most.
    """

    clock_s: float
    added_pos: float
    added_neg: float
    goal_pos: float
    goal_neg: float
    most_nm: float
    most_rad_s: float
    memory_n: float
    memory_most_n: float


def record_of(kind: type) -> np.dtype[Any]:
    """The record that holds the fields of a class: floats, integers, and arrays of either.

    An array's type is ``Annotated[array, length]``.
    """
    fields: list[tuple[Any, ...]] = []
    for name, of in get_type_hints(kind, include_extras=True).items():
        if get_origin(of) is Annotated:
            whole = of.__origin__ == npt.NDArray[np.int64]
            fields.append((name, "i8" if whole else "f8", of.__metadata__))
        else:
            fields.append((name, "i8" if of is int else "f8"))
    return np.dtype((np.record, fields))


MOMENT, RIG = record_of(Moment), record_of(Rig)


class Carried(NamedTuple):
    """Both records, (1,) each, as the estimator's step is given them."""

    moment: Records
    rig: Records


def new_moment() -> Records:
    """The state before the first step."""
    moment = np.zeros(1, MOMENT)
    moment["running"], moment["local"] = NEVER_RAN, 1.0
    return moment


def new_carried() -> Carried:
    """Nothing estimated yet, of a rig with the model's own friction levels."""
    return Carried(new_moment(), np.zeros(1, RIG))


class Kept(NamedTuple):
    """States of a while ago: two moments, (2,), the older one first; steps since the newer was
    taken, since the older was, and how many there are, (3,)."""

    moments: Records
    steps: npt.NDArray[np.int64]


def new_kept() -> Kept:
    """None yet."""
    return Kept(np.concatenate([new_moment(), new_moment()]), np.zeros(3, np.int64))


_NEW = new_moment()


@kernel
def keep(e: Carried, kept: Kept, good: bool, every: int) -> None:
    """Take the state ``every`` so many steps, while nothing is wrong with the inputs."""
    kept.steps[0] += 1
    kept.steps[1] += 1
    if not good or kept.steps[0] < every:
        return
    copy(kept.moments, 0, kept.moments, 1)
    copy(kept.moments, 1, e.moment, 0)
    kept.steps[1], kept.steps[0] = kept.steps[0], 0
    kept.steps[2] = min(kept.steps[2] + 1, 2)


@kernel
def roll_back(e: Carried, kept: Kept) -> None:
    """The state from before inputs that turned out to be false: a doubt comes some steps late.

    The older of two that are 32 ms apart; estimating goes on from it as after a gap. Where
    there is none yet, it begins anew.
    """
    if kept.steps[2] < 2:
        copy(e.moment, 0, _NEW, 0)
        return
    copy(e.moment, 0, kept.moments, 0)
    copy(kept.moments, 1, kept.moments, 0)
    kept.steps[0] = kept.steps[1]
    s = e.moment[0]
    s.running, s.held_steps = HELD, kept.steps[1]
    s.carried, s.bent = 1, s.bristle


@kernel
def move_by_angle(e: Carried, angle_rad: float, step_s: float) -> None:
    """What is rolled back because speed and angle part moved as the angle did since.

    The speed there may be wrong already, and a rotor that rests would seem to have moved.
    """
    s = e.moment[0]
    if s.running == HELD and s.held_steps > 0:
        s.speed = (angle_rad - s.last_angle) / (s.held_steps * step_s)
        s.acceleration = 0.0


@kernel
def begin_anew(e: Carried) -> None:
    """The state before the first step once more, for what a jump of time or nonsense spoilt.

    The levels are at their goals then: nothing is published in which a step could show.
    """
    copy(e.moment, 0, _NEW, 0)
    r = e.rig[0]
    r.added_pos, r.added_neg = r.goal_pos, r.goal_neg


@kernel
def begin_after_nonsense(e: Carried, effects: Added) -> None:
    """The same, and nothing that effects remember: they did, and nobody knows what."""
    begin_anew(e)
    effects.state[:] = 0.0
    e.rig[0].memory_n = e.rig[0].memory_most_n
