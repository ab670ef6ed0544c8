"""The written numbers once more, by torque balance and free simulation together.

A balance weighs what changes, a free run what lasts: 0.2 N that lasts is nothing in the one and
millimetres in the other. Recordings are simulated from measured states, whole (as far as 30 s) and
in pieces of 3 s (multiple shooting: Bock 1983), and the model's own numbers and the sizes of what
has no name move by Gauss-Newton on the sum of both costs, each relative to what it was. Recordings
kept from the fit have to gain in their free run, and to lose nowhere else.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.free_run import free_run, memories_at, simulated
from eps_hil.diagnosis.accept.proof_of_fit import CLEARLY, Holdout, rack_force_error_n
from eps_hil.diagnosis.balance.baseline import ALL, HOLD, OFFSET, turned
from eps_hil.diagnosis.balance.problem import Problem, huber, knee
from eps_hil.diagnosis.data.prepare import STEP_S, Prepared
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

LENGTHS_S = (3.0, 30.0)
"""Pieces that are simulated: short ones, and a recording as a whole."""
MOST_S = 45.0
"""Of each length that is simulated for one evaluation; long recordings are sampled evenly."""
_SHORTEST_S = 1.0
_STARTS_RAD_S = 5.0
"""A piece begins while the rotor slides so fast (of an ordinary drive): its bristle is known."""
_NOT = {HOLD, OFFSET, "sigma0_nm_per_rad", "sigma1_nm_s_per_rad"}
"""Numbers of which reversals and delays say more; a constant is in the levels of both directions.
"""
_STEP, _SHARE = 0.02, 0.3
"""Of a number's usual error, for a difference; and what such an error is of a learnt size."""
_PRIOR = 0.01
"""Of the balance's cost before: what a usual error of a number costs."""
_ROUNDS = 3
_ENOUGH = 0.01
"""Share of the cost by which a round has to lower it to be worth another one."""
_LEARNT = "empirical"
_LEAST_GAIN, _NO_WORSE = 0.98, 1.005
"""Times the error that it was: what hold-outs' free run has to reach, and what else may have."""


@dataclass(frozen=True)
class Piece:
    """Samples [first, last) of a recording, and which of ``LENGTHS_S`` it is of."""

    recording: int
    first: int
    last: int
    kind: int


def refined_by_simulation(
    problem: Problem, model: Model, judged: Sequence[Holdout], *, own: bool
) -> Model:
    """``model`` with learnt sizes (and ``own`` numbers) refined.

    Itself where the balance leaves nothing but noise, and where hold-outs do not confirm it.
    """
    left = problem.residual(model)[problem.sliding]
    if float(np.mean(left**2)) < CLEARLY**2:  # nothing but noise is left: likelihood has its say
        return model
    parts, names = pieces(problem, model), _names(problem, model, own=own)
    if not parts or not names:
        return model
    best = _least(_Cost(problem, model, parts), model, names)
    for share in (1.0, 0.5):
        moved = _moved(model, {name: share * value for name, value in best.items()}, problem)
        if _borne_out(problem, model, moved, judged):
            return moved
    return model


def _least(cost: "_Cost", model: Model, names: Sequence[str]) -> dict[str, float]:
    """Where the sum of both costs and the prior is least, in usual errors of each number."""
    pull = np.sqrt(_PRIOR)

    def at(values: Floats) -> Floats:
        moved = _moved(model, dict(zip(names, values.tolist(), strict=True)), cost.problem)
        return np.concatenate([cost(moved), pull * values])

    values = np.zeros(len(names))
    left = at(values)
    columns = [(at(step) - left) / _STEP for step in _STEP * np.eye(len(names))]
    jacobian = np.column_stack(columns)  # nearly linear: one serves all rounds
    for _ in range(_ROUNDS):
        change = -np.linalg.lstsq(jacobian, left, rcond=None)[0]
        before = float(left @ left)
        for share in (1.0, 0.3):
            trial = values + share * change
            remains = at(trial)
            if float(remains @ remains) < before:
                values, left = trial, remains
                break
        if float(left @ left) > (1.0 - _ENOUGH) * before:
            break
    return dict(zip(names, values.tolist(), strict=True))


def pieces(problem: Problem, model: Model) -> list[Piece]:
    """What is simulated, of each length at most ``MOST_S``."""
    found: list[Piece] = []
    for kind, length in enumerate(LENGTHS_S):
        these: list[Piece] = []
        n = round(length / STEP_S)
        for k, one in enumerate(problem.recordings):
            speed = np.abs(one.motion(model).speed_rad_s)
            bad = _bad(one)
            starts = range(0, len(speed), n)
            for start in starts:
                moving = np.flatnonzero(speed[start : start + n] >= _STARTS_RAD_S * one.size.angle)
                first = start + (int(moving[0]) if start and len(moving) else 0)
                last = min(first + n, len(speed))
                known = start == 0 or len(moving) > 0
                if known and (last - first) * STEP_S >= _SHORTEST_S and not bad[first:last].any():
                    these.append(Piece(k, first, last, kind))
        found += these[:: 1 + int(len(these) * length / MOST_S)]
    return found


def _bad(one: Prepared) -> npt.NDArray[np.bool_]:
    """Samples (n,) that nothing may be concluded from."""
    bad = np.zeros(len(one.time_s), bool)
    if one.barred is not None and one.barred.any():
        at = np.searchsorted(one.thin_time_s, one.time_s).clip(0, len(one.barred) - 1)
        bad = one.barred[at]
    return bad


def _names(problem: Problem, model: Model, *, own: bool) -> list[str]:
    """Numbers that move: of the model's own those that it has, and sizes of what was learnt now."""
    learnt = [
        f"{_LEARNT}{k}"
        for k, entry in enumerate(model.effects)
        if entry["effect"] == _LEARNT and entry not in problem.model.effects
    ]
    friction = [
        name for name in ALL if name not in _NOT and getattr(model.friction, name, 1.0) != 0.0
    ]
    return [*(friction if own else []), *learnt]


def _moved(model: Model, values: Mapping[str, float], problem: Problem) -> Model:
    own = {name: value for name, value in values.items() if not name.startswith(_LEARNT)}
    effects = [dict(one) for one in model.effects]
    for name, value in values.items():
        if name.startswith(_LEARNT):
            entry, factor = effects[int(name.removeprefix(_LEARNT))], 1.0 + _SHARE * value
            key = "size" if "size" in entry else "values"
            entry[key] = (np.asarray(entry[key]) * factor).tolist()
    return turned(replace(model, effects=tuple(effects)), own, problem.size)


def _borne_out(problem: Problem, before: Model, after: Model, judged: Sequence[Holdout]) -> bool:
    """Whether hold-outs gain in their free run, and lose neither balance nor rack force by it."""
    kept = problem.over([one.prepared for one in judged])

    def figures(model: Model) -> list[float | None]:
        run = free_run(judged, model)
        left = float(np.sum(kept.residual(model)[kept.sliding] ** 2))
        force = rack_force_error_n(judged, problem.model, model)
        return [run["angle_rmse_rad"], run["speed_rmse_rad_s"], np.sqrt(left), force or 0.0]

    most = (_LEAST_GAIN, _NO_WORSE, _NO_WORSE, _NO_WORSE)
    pairs = zip(figures(before), figures(after), most, strict=True)
    return all(
        one is not None and other is not None and other <= times * one
        for one, other, times in pairs
    )


class _Cost:
    """Both costs as one vector of squares, a third of each kind: 1 before, for each kind."""

    def __init__(self, problem: Problem, model: Model, pieces: Sequence[Piece]) -> None:
        self.problem, self.pieces = problem, pieces
        residual = problem.residual(model)
        weight = np.where(problem.sliding, huber(residual, knee(residual)), 0.0)
        self.weight = np.sqrt(weight / max(float(weight @ residual**2), 1e-300))
        self.motions = [one.motion(model) for one in problem.recordings]
        errors = self._errors(model)
        energy = np.zeros(len(LENGTHS_S))
        for piece, error in zip(pieces, errors, strict=True):
            energy[piece.kind] += float(error @ error)
        kinds = max(int(np.count_nonzero(energy)), 1)
        self.scale = np.sqrt(kinds * np.maximum(energy, 1e-300))

    def __call__(self, model: Model) -> Floats:
        balance = self.problem.residual(model) * self.weight
        errors = self._errors(model)
        runs = [e / self.scale[p.kind] for p, e in zip(self.pieces, errors, strict=True)]
        return np.concatenate([balance, *runs])

    def _errors(self, model: Model) -> list[Floats]:
        memory: dict[tuple[int, int], Floats | None] = {}
        for k, motion in enumerate(self.motions):
            firsts = sorted({one.first for one in self.pieces if one.recording == k})
            kept = memories_at(motion, model, firsts)
            memory |= {(k, first): one for first, one in zip(firsts, kept, strict=True)}

        def error(piece: Piece) -> Floats:
            motion = self.motions[piece.recording]
            part = slice(piece.first, piece.last)
            begun = memory[piece.recording, piece.first]
            run = simulated(motion, model, part, begun).angle_rad - motion.angle_rad[part]
            return np.nan_to_num(run[::10], nan=1e9, posinf=1e9, neginf=-1e9)

        return each(error, self.pieces)
