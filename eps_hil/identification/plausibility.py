"""Wrong signs, swapped channels and wrong units of torques and load, before anything is fitted.

The torque balance while sliding is linear, with an inertia near the model file's and friction not
below zero. Each thing that can be wrong with the channels is tried; one that makes the balance
close where it did not is named, the simplest where several do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.identification import filters
from eps_hil.identification.balance import Case
from eps_hil.identification.state import State, get

Floats = npt.NDArray[np.float64]

_CLEARLY = 0.5
"""Something is called wrong when without it less than this part of the residual is left."""
_CLOSED = 0.05
_OPEN = 0.6
"""Residuals, of the torques' size: below the first nothing is asked, beyond the second no fit."""
_AS_SIMPLE = 1.25
_FARTHEST = 5.0
"""How far an inertia may be from the model file's for the channels to be right."""
_MATTERS = 0.05
"""Share of the torques from which on an acceleration torque is looked at."""
_MOST_NM = 30.0
"""No steering motor, and no rack force at the rotor, makes more (75 kN at the reference rack)."""
_TRIED_S = (0.0, -0.008, 0.008, -0.016, 0.016)
_FEWEST = 200
_MOST = 2500
_TORQUES = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")
_SMALLER = {"motor_torque_nm": "mNm", "torque_sensor_nm": "mNm", "rack_force_n": "mN"}
_LARGER = {"motor_torque_nm": "kNm", "torque_sensor_nm": "kNm", "rack_force_n": "kN"}
_SILENT = 2.0
"""Times its noise: less is a torque that is none."""
_MOST_OF_LOAD = 0.4
"""Friction that grows with the load, per load: a load that drives the rotor always opposes it, and
friction of its size would be all that it does."""
_LEAST_OF_FRICTION = 0.02
"""Of the model's friction: a torque that is smaller in the unit that is tried moves nothing; nobody
steers with 4 mNm, and no load cell of a rig reads 0.3 N."""
_RIGHT = {"motor_torque_nm": "Nm", "torque_sensor_nm": "Nm", "rack_force_n": "N"}


@dataclass(frozen=True)
class _Rows:
    """While sliding: torques at the rotor as given (3, m), and what the motion explains (m, 5)."""

    torques: Floats
    motion: Floats
    direction: Floats
    place: Floats

    def part(self, some: slice) -> "_Rows":
        """Those samples only."""
        return _Rows(
            self.torques[:, some], self.motion[some], self.direction[some], self.place[some]
        )

    def with_spring(self) -> "_Rows":
        """The same, where a spring of either sign may be missing too."""
        motion = np.column_stack([self.motion, self.place, -self.place])
        return replace(self, motion=motion)


@dataclass(frozen=True)
class _Wrong:
    """One thing that may be wrong: which column each torque comes from, times what."""

    source: tuple[int, int, int]
    times: tuple[float, float, float]
    hard: float
    signal: str = ""
    problem: str = ""
    remedy: str = ""

    def moves(self, sizes: Floats, least: float) -> bool:
        """Whether the torques (rms at the rotor as given) are not made smaller than ``least``."""
        return all(
            times >= 1.0 or times * sizes[came] > least or times < 0.0
            for times, came in zip(self.times, self.source, strict=True)
        )

    def possible(self, recorded: Sequence[bool]) -> bool:
        """Whether it says something of channels that were ``recorded`` (of the three) only."""
        changed = [
            {k, came} for k, came in enumerate(self.source) if came != k or self.times[k] != 1.0
        ]
        return all(recorded[k] for places in changed for k in places)


def check(cases: Sequence[Case], state: State) -> None:
    """:class:`InputError` that names the channel, for each recording on its own."""
    for case in cases:
        torque = case.recording.raw["motor_torque_nm"]
        if float(np.ptp(torque)) <= 0:
            problem = f"is {torque[0]:g} all the time"
            raise InputError(case.recording.name, "motor_torque_nm", problem, "record it")
        as_is = check_one(case, state)
        if as_is > _OPEN:
            problem = (
                f"the torques do not balance: {100 * as_is:.0f} % of them remain, whatever sign, "
                "unit or swap is tried"
            )
            raise InputError(case.recording.name, "", problem, "check what each column holds")


def check_one(case: Case, state: State, sure: bool = False) -> float:
    """:class:`InputError` that names the channel with which one recording's torques close.

    ``sure``: only where the balance then closes, and a spring that the model lacks does not do it.
    Returns what of the torques the balance leaves as they are (rms over rms); 0 where nothing can
    be tried: without a load, and where the rotor hardly slides.
    """
    if not case.measured_load:
        return 0.0
    rows = [_rows(case, state, late) for late in _TRIED_S]
    if rows[0].motion.shape[0] < _FEWEST or not np.any(rows[0].torques):
        return 0.0
    there = [_speaks(case, name) for name in _TORQUES]
    tried = [one for one in _everything(state) if one.possible(there)]
    friction = state.model.friction
    level = 0.5 * (friction.offset_pos_nm + friction.offset_neg_nm)
    sizes = np.sqrt(np.mean(rows[0].torques ** 2, axis=1))
    tried = [one for one in tried if one.moves(sizes, _LEAST_OF_FRICTION * level)]
    inertia = state.model.inertia_kg_m2
    if sure and _left([one.with_spring() for one in rows], tried[0], inertia)[0] < _CLOSED:
        as_is, apart = _left(rows, tried[0], inertia)
        if as_is >= _CLOSED or _likely(apart):
            return as_is
    return _check(case.recording.name, rows, tried, inertia, _CLOSED if sure else np.inf)


def _speaks(case: Case, name: str) -> bool:
    """Whether a torque is there and more than its noise: of a motor that is off nothing is told."""
    if not case.recording.has(name):
        return False
    noise = float(np.sqrt(case.recording.density[name] / (2.0 * filters.STEP_S)))
    return float(np.std(case.recording.raw[name])) > _SILENT * noise


def _check(
    name: str, rows: Sequence[_Rows], tried: Sequence[_Wrong], inertia: float, most: float
) -> float:
    """``most``: what may be left of the torques for the channel to be named."""
    as_is, apart = _left(rows, tried[0], inertia)
    plausible = _likely(apart)
    if plausible and as_is < _CLOSED:
        return as_is
    found = [(one, *_left(rows, one, inertia)) for one in tried[1:]]
    found = [one for one in found if _likely(one[2])]
    least = min((left for _, left, _ in found), default=np.inf)
    if least < min(_CLEARLY * as_is, most):
        likely = [one for one, left, _ in found if left < _AS_SIMPLE * least]
        wrong = min(likely, key=lambda one: one.hard)
        if _in_halves(rows, wrong, inertia) < _CLEARLY * _in_halves(rows, tried[0], inertia):
            raise InputError(name, wrong.signal, wrong.problem, wrong.remedy)
    if not plausible and as_is < _CLOSED and apart > 0:
        problem = (
            f"the inertia comes out {apart:.2g} times the model file's: is the motion in degrees, "
            "revolutions or rpm?"
        )
        raise InputError(name, "motor_speed_rad_s", problem, "give it in rad/s")
    return as_is


def _everything(state: State) -> list[_Wrong]:
    """As given first; then signs, units, swaps, in the order of how easily each is wrong."""
    straight, scale = (0, 1, 2), _scales(state)
    tried = []
    for a, b, c in product((1.0, -1.0), repeat=3):
        signs = (a, b, c)
        wrong = [name for name, sign in zip(_TORQUES, signs, strict=True) if sign < 0]
        words = " and ".join(wrong) + (" has" if len(wrong) == 1 else " have") + " the wrong sign"
        signal = wrong[0] if wrong else ""
        if len(wrong) == 3:
            signal = "motor_speed_rad_s"
            words = "motor_speed_rad_s (and motor_angle_rad) has the wrong sign"
        remedy = "turn it (in a mapping: scale: -1), or check the sensor's direction"
        hard = 1.0 if len(wrong) == 3 else float(len(wrong))
        tried.append(_Wrong(straight, signs, hard, signal, words, remedy))
    for k, name in enumerate(_TORQUES):
        for factor, units, word in ((1e-3, _SMALLER, "large"), (1e3, _LARGER, "small")):
            p, q, r = (factor if i == k else 1.0 for i in range(3))
            words = f"is about 1000 times too {word}: in {units[name]}?"
            remedy = f"give it in {_RIGHT[name]}"
            tried.append(_Wrong(straight, (p, q, r), 1.5, name, words, remedy))
    for i, j in combinations(range(3), 2):
        source = [0, 1, 2]
        source[i], source[j] = j, i
        swapped = (source[0], source[1], source[2])
        p, q, r = (scale[n] / scale[source[n]] for n in range(3))
        words = f"{_TORQUES[j]} looks like {_TORQUES[i]}: the two columns are swapped"
        tried.append(_Wrong(swapped, (p, q, r), 2.5, _TORQUES[j], words, "swap the columns"))
    return tried


def _scales(state: State) -> tuple[float, float, float]:
    """Torque at the rotor per unit of each signal."""
    model = state.model
    return 1.0, model.sensor_to_rotor, -1.0 / model.rack_to_rotor_ratio_rad_per_m


def _rows(case: Case, state: State, late_s: float) -> _Rows:
    motion = case.motion
    sliding = np.abs(motion.speed) > 2.0 * case.slowest
    whole = filters.smooth((~sliding).astype(np.float64)) < 1e-9
    mine = np.flatnonzero(whole & case.good)
    mine = mine[:: max(1, len(mine) // _MOST)]
    keys = ("delays_s.motor_torque", "delays_s.torque_sensor", "delays_s.rack_force")
    torques = np.array(
        [
            factor * filters.smooth(case.signal(name, get(state, key) + late_s))[mine]
            for name, key, factor in zip(_TORQUES, keys, _scales(state), strict=True)
        ]
    )
    speed = filters.thinned(motion.speed)[mine]
    one = np.ones(len(speed))
    # a constant of either sign: an offset may be larger than the friction
    terms = [case.motion.acceleration[mine], np.sign(speed), one, -one, speed]
    return _Rows(
        torques, np.column_stack(terms), np.sign(speed), filters.thinned(motion.angle)[mine]
    )


def _left(rows: Sequence[_Rows], wrong: _Wrong, inertia: float) -> tuple[float, float]:
    """(rms left at the best of a few skews, of the torques' own; inertia over the model file's).

    The inertia is 1 where it does not matter, 0 where the torques are impossible.
    """
    from scipy.optimize import lsq_linear

    best, apart = np.inf, 1.0
    for one in rows:
        torques = np.array(wrong.times)[:, None] * one.torques[list(wrong.source)]
        each = np.sqrt(np.mean(torques**2, axis=1))
        size = float(np.sqrt(np.sum(each**2)))
        if size <= 0 or each.max() > _MOST_NM:
            return np.inf, 0.0
        # friction grows with the load of this hypothesis
        columns = np.column_stack([one.motion, one.direction * np.abs(torques[2])])
        scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
        most = np.append(np.full(columns.shape[1] - 1, np.inf), _MOST_OF_LOAD * scale[-1] / size)
        wanted = torques.sum(axis=0) / size
        done = lsq_linear(columns / scale, wanted, (0.0, most), method="bvls")
        left, found = float(np.sqrt(2.0 * done.cost / len(columns))), float(done.x[0]) * size
        if left < best:
            accelerated = max(scale[0] * inertia, found) > _MATTERS * size
            best, apart = left, found / scale[0] / inertia if accelerated else 1.0
    return best, apart


def _in_halves(rows: Sequence[_Rows], wrong: _Wrong, inertia: float) -> float:
    """What is left (rms, of the torques' own) where each half in time is fitted by itself.

    A friction that warms up is another one in each half, and a torque that happens to fall as it
    does explains neither; a channel is wrong in both.
    """
    middle = rows[0].torques.shape[1] // 2
    halves = [[one.part(some) for one in rows] for some in (slice(middle), slice(middle, None))]
    return float(np.sqrt(np.mean([_left(half, wrong, inertia)[0] ** 2 for half in halves])))


def _likely(apart: float) -> bool:
    return 1 / _FARTHEST < apart < _FARTHEST
