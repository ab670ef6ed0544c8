"""Which manoeuvres a case is driven through: two recordings to learn from, one that judges.

Beside the ordinary programme there are those in which twins cannot be told apart, those that the
motor drives against one form of load or none, and one with hardly any excitation.
"""

from collections.abc import Callable, Mapping

import numpy as np

from eps_hil.proof import manoeuvres as m
from eps_hil.proof.truth import Drive, Floats

Programme = tuple[Floats, Floats, Floats]
JOINT_RAD_PER_M = Drive().rack_rad_per_m / 60.0
"""Of an axis with a gear of 60 to the rotor, as ``sizes.SIZES['joint']`` has."""
_RACK = Drive().rack_rad_per_m


def programme(name: str, rng: np.random.Generator) -> Programme:
    """(train_1, train_2, holdout) of one of :data:`PROGRAMMES`, columns as ``plant.PROGRAM``."""
    return PROGRAMMES[name](rng)


def _ordinary(rng: np.random.Generator) -> Programme:
    first, second = m.training(rng)
    return first, second, m.holdout(rng)


def _never_free(rng: np.random.Generator) -> Programme:
    """The ordinary one, in which no sensor is ever seen with nothing on it."""
    first, second, last = _ordinary(rng)
    return m.held(rng, first), m.held(rng, second), m.held(rng, last)


def _poor(rng: np.random.Generator) -> Programme:
    first, second = m.poor(rng)
    return first, second, m.holdout(rng)


def _three(one: Callable[[np.random.Generator], Floats], rng: np.random.Generator) -> Programme:
    return one(rng), one(rng), one(rng)


def _by_motor(rng: np.random.Generator, **load: float) -> Programme:
    """Strokes and shaking by the motor, hands at the wheel now and then, against a load or none.

    ``load``: columns of ``plant.PROGRAM`` that are the same all the time.
    """

    def one(rng: np.random.Generator) -> Floats:
        parts = [_strokes(rng, 14.0, 0.0), m.slow_reversals(rng, 14.0), _shaken(rng, 10.0)]
        program = np.concatenate(parts)
        free = dict.fromkeys(("force_n", "rig_n_per_m", "rig_n_s_per_m", "feed_nm"), 0.0)
        for column, value in {**free, **load}.items():
            program[:, m.column(column)] = value
        return program

    return _three(one, rng)


def _spring(rng: np.random.Generator) -> Programme:
    stiffness, damping = rng.uniform(20e3, 60e3), rng.uniform(200.0, 2000.0)
    return _by_motor(rng, rig_n_per_m=stiffness, rig_n_s_per_m=damping)


def _weight(rng: np.random.Generator) -> Programme:
    """A weight on an axis that the rack turns, as a robot's joint does, by about a radian."""
    numbers = (rng.uniform(400.0, 1200.0), JOINT_RAD_PER_M, rng.uniform(-np.pi, np.pi))
    return _by_motor(
        rng, **dict(zip(("weight_n", "weight_rad_per_m", "weight_rad"), numbers, strict=True))
    )


def _scrub(rng: np.random.Generator) -> Programme:
    return _by_motor(rng, scrub_n=rng.uniform(200.0, 600.0), scrub_m=rng.uniform(5e-4, 3e-3))


def _one_speed(rng: np.random.Generator) -> Programme:
    """Both ways, always equally fast: drags of different powers of the speed look alike."""
    return _three(lambda r: _strokes(r, 30.0, 1500.0, speeds=(20.0,)), rng)


def _one_torque(rng: np.random.Generator) -> Programme:
    """Slowly one way under one load and quickly back: what is proportional to torque is constant.

    On the way back ripples are too quick for anybody's filter.
    """

    def one(rng: np.random.Generator) -> Floats:
        cycle, seconds = 8.0, 32.0
        t = np.arange(round(seconds * 1000)) * 1e-3
        slow = rng.uniform(5.0, 7.0)
        back = slow * 6.4 / 1.6
        speed = np.where(t % cycle < 6.4, slow, -back)
        target = np.cumsum(m.smoothed(speed, 0.1)) * 1e-3
        load = np.full(len(t), 1000.0)
        return _held(seconds, m.faded(target - target.mean(), 0.8), m.faded(load, 0.8))

    return _three(one, rng)


def _strokes(
    rng: np.random.Generator,
    seconds: float,
    most_load_n: float,
    speeds: tuple[float, ...] = (40.0, 25.0, 12.0),
) -> Floats:
    """Strokes of constant speed both ways, each pair at a load of its own."""
    t = np.arange(round(seconds * 1000)) * 1e-3
    pair = 4.0
    which = (t / pair).astype(int)
    speed = np.array(speeds)[which % len(speeds)] * np.where((t / pair) % 1.0 < 0.5, 1.0, -1.0)
    loads = rng.uniform(-most_load_n, most_load_n, which[-1] + 1)
    target = np.cumsum(m.smoothed(speed, 0.1)) * 1e-3
    return _held(
        seconds, m.faded(target - target.mean(), 0.8), m.faded(m.smoothed(loads[which], 0.25))
    )


def _held(seconds: float, target: Floats, load: Floats) -> Floats:
    """The motor follows ``target`` (rad) stiffly and carries ``load`` (N)."""
    return m.segment(
        seconds,
        force_n=load,
        target_rad=target,
        motor_nm_per_rad=0.5,
        motor_nm_s_per_rad=4.0e-3,
        feed_nm=load / _RACK,
    )


def _shaken(rng: np.random.Generator, seconds: float) -> Floats:
    t = np.arange(round(seconds * 1000)) * 1e-3
    hz = np.linspace(0.4, 4.0, 15)
    lines = np.sin(2 * np.pi * hz[:, None] * t + rng.uniform(0, 2 * np.pi, (15, 1)))
    target = 4.0 * np.sum(lines / hz[:, None], axis=0) / np.sqrt(15)
    return _held(seconds, m.faded(target, 0.8), np.zeros(len(t)))


PROGRAMMES: Mapping[str, Callable[[np.random.Generator], Programme]] = {
    "training": _ordinary,
    "never_free": _never_free,
    "poor": _poor,
    "free_rack": _by_motor,
    "spring": _spring,
    "weight": _weight,
    "scrub": _scrub,
    "one_speed": _one_speed,
    "one_torque": _one_torque,
}
