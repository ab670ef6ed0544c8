"""What a stretch of driving says about k0+ and k0−, at any rack force.

Once friction is taken off, the torque balance (eq. 1d) leaves the rack force:

    x(t) = T_1m − J ω̇ − T_f(z; k0+, k0−)  =  F_r/i_APA

A tyre's force follows position and speed of the rack (and drifts), smoothly through a change of
direction; friction jumps there by the sum of both levels. The road adds a force of its own, which
also shakes the rack, so it is not independent of the motion: a plain fit takes its work for missing
friction. So the balance is judged through *instruments*: functions of the slow motion, which the
driver makes and the road does not. Of these, the slow direction of motion, freed of everything that
a smooth load could be, tells the sum of the levels. With a load cell there is nothing to be free
of, and both levels are seen. docs/theory-adaptation.md derives it.
"""

from collections.abc import Generator
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.physics.friction import (
    FrictionLaw,
    bristle_step,
    friction_law,
    friction_torque_nm,
    static_level_nm,
)
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
T = TypeVar("T")

STEP_S = 1e-3
BLOCK = 8
"""Samples that are averaged before the speed is differentiated over neighbouring blocks."""
SMOOTH = 9
"""Samples of the moving mean over speed and angle before they bend the bristle."""
_LEAST_LEVEL_NM = 1e-3
_ROUNDS = 3
_PROBE_NM = 1e-3
_MOVING_RAD_S = 0.5
_GAP_SIGMA = 3.0
_SLOW_HZ = 2.0
"""What the driver does lies below, most of what the road does above."""
_SLIDING_RAD_S = 4.0
"""Faster than this a rotor is well away from its turn: neither bristle nor noise matter."""
_FULL_SHARE = 0.98
_LEAST_RUN = 13
"""Blocks (0.1 s) for which the rotor must slide one way, where the rack force is measured."""
_MEMORY = 25
"""Blocks (0.2 s) over which what is left may be correlated."""
_LOAD_HZ = 8.0
"""Low-pass of the rack force that eq. 3 is given."""


class Stretch(NamedTuple):
    """Signals at 1 kHz and at physical instants, all (n,), at the rotor; T_1m of eq. 1a.

    The first ``lead`` samples only bring the bristle into its state.
    ``force_n`` is the load cell's, or None.
    """

    torque_nm: Floats
    speed_rad_s: Floats
    angle_rad: Floats
    lead: int
    force_n: Floats | None = None


class Blocks(NamedTuple):
    """A stretch in blocks of 8 ms, linear in the levels: x = ``left`` − ``slopes`` · (k0 − at).

    ``left`` (n,) in Nm, ``slopes`` (2, n), speed and angle (n,); ``reversals`` counts full changes
    of the bristle from one side to the other. ``known``: the rack force was. ``fed``: share of the
    friction's work that motor and driver did; the rest is what the road did.
    """

    left: Floats
    slopes: Floats
    speed_rad_s: Floats
    angle_rad: Floats
    at_nm: Floats
    reversals: int
    known: bool
    fed: float


class Evidence(NamedTuple):
    """Information on (k0+, k0−): ``matrix`` (2, 2) in 1/Nm², ``pull`` (2,) in 1/Nm at ``at_nm``.

    Alone it would move the levels by matrix⁻¹ · pull, where that exists. ``residual_nm`` is the
    rms of what no smooth load explains.
    """

    matrix: Floats
    pull: Floats
    at_nm: Floats
    residual_nm: float


@njit
def _friction_nm(
    law: FrictionLaw, speed: Floats, travel: Floats, force: Floats, forth: float, back: float
) -> tuple[Floats, int]:
    """T_f (n,) with the bristle through it all, for added levels; and how often it turned over."""
    out = np.empty(len(speed))
    bristle, side, turns = 0.0, 0, 0
    for k in range(len(speed)):
        direction = travel[k] if travel[k] != 0.0 else bristle
        added = forth if direction >= 0.0 else back
        along = abs(speed[k]) if direction >= 0.0 else -max(abs(speed[k]), 1e-12)
        level = max(static_level_nm(along, force[k], law) + added, _LEAST_LEVEL_NM)
        bristle = bristle_step(bristle, travel[k], abs(travel[k]), level, law.sigma0_nm_per_rad)
        out[k] = friction_torque_nm(bristle, speed[k], level, law)
        if abs(bristle) * law.sigma0_nm_per_rad > 0.9 * level:
            now = 1 if bristle > 0.0 else -1
            turns += now == -side
            side = now
    return out, turns


@njit
def _travel(angle: Floats, speed: Floats, gap: float) -> Floats:
    """Displacement per sample (n,); at rest only what goes beyond a gap as wide as the noise."""
    out = np.zeros(len(angle))
    held = angle[0]
    for k in range(1, len(angle)):
        before = held
        if abs(speed[k]) > _MOVING_RAD_S:
            held = angle[k]
        else:
            held = min(max(held, angle[k] - gap), angle[k] + gap)
        out[k] = held - before
    return out


def finished(work: Generator[None, None, T]) -> T:
    """What a piece of work that is cut into slices comes to, done in one go."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value


def blocks_of(stretch: Stretch, model: Model, levels_nm: Floats) -> Blocks:
    """The stretch in blocks, linearised at ``levels_nm`` (k0+, k0−) in Nm."""
    return finished(blocks_in_slices(stretch, model, levels_nm))


def blocks_in_slices(
    stretch: Stretch, model: Model, levels_nm: Floats
) -> Generator[None, None, Blocks]:
    """:func:`blocks_of` in slices of a fraction of a millisecond, for a loop that has no more."""
    law, ratio = friction_law(model.friction), model.rack_to_rotor_ratio_rad_per_m
    speed, angle = _mean(stretch.speed_rad_s), _mean(stretch.angle_rad)
    noise = float(np.sqrt(np.mean(np.diff(stretch.angle_rad, 2) ** 2) / 6.0 / SMOOTH))
    travel = _travel(angle, speed, _GAP_SIGMA * noise)
    yield
    own = np.array([law.offset_pos_nm, law.offset_neg_nm])
    known = stretch.force_n is not None
    force = stretch.force_n if stretch.force_n is not None else np.zeros_like(speed)
    drive = _blocks(stretch.torque_nm) - model.inertia_kg_m2 * _rise(stretch.speed_rad_s)
    if known:
        drive = drive - _blocks(force) / ratio
    yield

    def friction(levels: Floats) -> tuple[Floats, int]:
        forth, back = levels - own
        return _friction_nm(law, speed, travel, force, float(forth), float(back))

    for _ in range(1 if known else _ROUNDS):
        base, turns = friction(levels_nm)
        yield
        left = drive - _blocks(base)
        if not known:
            force = _stretched(_low_pass(left, _LOAD_HZ) * ratio, len(speed))
        yield
    slopes = []
    for probe in _PROBE_NM * np.eye(2):
        slopes.append(_blocks(friction(levels_nm + probe)[0] - base) / _PROBE_NM)
        yield
    keep = slice(stretch.lead // BLOCK, None)
    rate = _blocks(speed)[keep]
    return Blocks(
        left[keep],
        np.array(slopes)[:, keep],
        rate,
        _blocks(angle)[keep],
        levels_nm.copy(),
        turns,
        known,
        _fed(_blocks(stretch.torque_nm)[keep], _blocks(base)[keep], rate),
    )


def _fed(drive: Floats, friction: Floats, speed: Floats) -> float:
    """Work of the drive over that of friction; tapered, so that no spring's energy counts."""
    taper = np.hanning(len(speed)) * speed
    lost = float(taper @ friction)
    return float(taper @ drive) / lost if lost > 0.0 else 0.0


def evidence(blocks: Blocks, noise_nm: float) -> Evidence:
    """Information of one stretch, at the levels at which it was linearised.

    ``noise_nm``: least residual that is believed.
    """
    return finished(evidence_in_slices(blocks, noise_nm))


def evidence_in_slices(blocks: Blocks, noise_nm: float) -> Generator[None, None, Evidence]:
    """:func:`evidence` in slices."""
    if blocks.known:
        # only where the bristle is at its level, so that its form does not matter
        instruments, left, slopes = blocks.slopes * sliding(blocks), blocks.left, blocks.slopes
    else:
        instruments, left, slopes = _freed(blocks)
    yield
    moment = instruments @ slopes.T
    if not blocks.known:  # the difference of the levels looks like a constant load
        moment = np.full_like(moment, float(np.mean(moment)))
    weights, *_ = np.linalg.lstsq(moment, instruments @ left, rcond=None)
    rest = left - weights @ slopes
    residual = float(np.sqrt(np.mean(rest**2)))
    scores = instruments * rest
    spread = _long_run_variance(scores) + noise_nm**2 * (instruments @ instruments.T)
    spread += 1e-12 * np.trace(spread) * np.eye(len(spread)) + 1e-30 * np.eye(len(spread))
    gain = np.linalg.solve(spread, moment).T
    return Evidence(gain @ moment, gain @ (instruments @ left), blocks.at_nm, residual)


def sliding(blocks: Blocks) -> npt.NDArray[np.bool_]:
    """Where (n,) the rotor is fast and the bristle at its level, and was and stays so for a while.

    Bursts of some hundredths of a second, which is all that a road alone makes, are break-away from
    end to end: the masses behind the rotor have not followed yet, and would pass for friction.
    """
    full = np.abs(blocks.slopes).sum(axis=0) > _FULL_SHARE
    full &= np.abs(blocks.speed_rad_s) > _SLIDING_RAD_S
    way = np.where(full, np.sign(blocks.speed_rad_s), 0.0)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(way)) + 1, [len(way)]])
    for begin, end in pairwise(edges.tolist()):
        full[begin:end] &= end - begin >= _LEAST_RUN
    return full


def _freed(blocks: Blocks) -> tuple[Floats, Floats, Floats]:
    """Instrument (1, n), x (n,) and slopes (2, n), all without what a smooth load could be.

    The load may follow time, position and speed; its own instruments are time and the slow
    motion (two-stage least squares, exactly determined).
    """
    n = len(blocks.left)
    time = np.linspace(-1.0, 1.0, n)
    slow_speed = _low_pass(blocks.speed_rad_s, _SLOW_HZ)
    slow_angle = _low_pass(blocks.angle_rad, _SLOW_HZ)
    load = _scaled([np.ones(n), time, time**2, blocks.angle_rad, blocks.speed_rad_s])
    sliding = np.abs(slow_speed) > _SLIDING_RAD_S
    shown = _scaled([np.ones(n), time, time**2, slow_angle, slow_speed]) * sliding
    direction = np.sign(slow_speed) * sliding
    solve = np.linalg.pinv(shown @ load.T)
    # the direction without its share in ``load``: orthogonal to every smooth load
    pure = direction - (direction @ load.T) @ solve @ shown
    free = np.vstack([blocks.left, blocks.slopes])
    free = free - (free @ shown.T) @ solve.T @ load
    return pure[None, :], free[0], free[1:]


def _scaled(rows: list[Floats]) -> Floats:
    """Rows of mean square 1, so that none of them is lost in rounding."""
    return np.array([row / max(float(np.sqrt(np.mean(row**2))), 1e-9) for row in rows])


def _long_run_variance(scores: Floats) -> Floats:
    """Variance (k, k) of the sum of scores (k, n) that are correlated for a while (Newey-West)."""
    total = scores @ scores.T
    for lag in range(1, min(_MEMORY, scores.shape[1] - 1)):
        weight = 1.0 - lag / _MEMORY
        both = scores[:, lag:] @ scores[:, :-lag].T
        total = total + weight * (both + both.T)
    return np.asarray(total)


def _mean(values: Floats) -> Floats:
    padded = np.pad(values, SMOOTH // 2, mode="edge")
    return np.convolve(padded, np.ones(SMOOTH) / SMOOTH, mode="valid")


def _low_pass(values: Floats, frequency_hz: float) -> Floats:
    """Low-passed forward and back, so without lag, (n,)."""
    from scipy.signal import butter, filtfilt

    b, a = butter(2, 2.0 * frequency_hz * BLOCK * STEP_S)
    return np.asarray(filtfilt(b, a, values, padlen=min(len(values) - 1, 60)))


def _stretched(values: Floats, n: int) -> Floats:
    """Block values back on ``n`` samples."""
    centres = BLOCK * (np.arange(len(values)) + 1.0)
    return np.interp(np.arange(n), centres, values)


def _block_means(values: Floats) -> Floats:
    n = len(values) // BLOCK
    return values[: n * BLOCK].reshape(n, BLOCK).mean(axis=1)


def _rise(values: Floats) -> Floats:
    """Derivative from block to block, (blocks − 1,)."""
    return np.asarray(np.diff(_block_means(values)) / (BLOCK * STEP_S))


def _blocks(values: Floats) -> Floats:
    """What :func:`_rise` of an integral would give: means with triangular weights."""
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]))]) * STEP_S
    return _rise(integral)
