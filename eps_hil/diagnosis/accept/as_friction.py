"""Laws of the friction level, written so that there is friction left wherever the rotor slows down.

A law is fitted where the rotor slides. Drawn on to standstill it may take all of the level away and
more, within its own interval: the balance hardly sees it, and a simulation never gets past it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.remainder.find import Remainder, rounded, share_removed
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.physics.balance import sliding_levels_nm
from eps_hil.physics.model import Model

_LEAST = 0.02
"""Of the level without the laws: what is left of it at the least."""
_AT_REST_RAD_S = 1e-6
_PART = 1e-3
_ROUNDS = 3
"""Laws that are factors of one another are no sum: their sizes are asked again."""


def as_friction(problem: Problem, kept: Problem, found: Remainder) -> Remainder:
    """``found`` with its laws of the friction level no larger than leaves friction at standstill
    and at the speeds of the fitted recordings. ``kept``: the hold-outs.
    """
    terms, model = list(found.terms), found.model
    of_level = [k for k, term in enumerate(terms) if _is_level(term.entry)]
    for _ in range(_ROUNDS if of_level else 0):
        share = _most(problem, model, [terms[k].entry for k in of_level])
        if share >= 1.0:
            break
        for k in of_level:
            entry = terms[k].entry
            less = rounded({**entry, "size": share * float(entry["size"])})
            effects = tuple(less if dict(one) == dict(entry) else one for one in model.effects)
            model, terms[k] = replace(model, effects=effects), replace(terms[k], entry=less)
    if model is found.model:
        return found
    bare = replace(model, effects=_others(model, [one.entry for one in terms]))
    share_off, ends = share_removed(Sight(kept, bare), kept.residual(model))
    return replace(
        found,
        terms=tuple(terms),
        model=model,
        share=share_off,
        ci95=ends,
        after=problem.residual(model),
    )


def _is_level(entry: Mapping[str, Any]) -> bool:
    return entry["where"] == "friction" and isinstance(entry.get("size"), float)


def _most(problem: Problem, model: Model, laws: Sequence[Mapping[str, Any]]) -> float:
    """The share of the laws' sizes that leaves friction; 1 where all of them does.

    A level never acts below zero: what laws take of it is asked of a small part of them.
    """
    others, most = _others(model, laws), 1.0
    part = tuple({**one, "size": _PART * float(one["size"])} for one in laws)
    bare, little = (replace(model, effects=(*others, *some)) for some in ((), part))
    for one in problem.recordings:
        motion = one.motion(model)
        rest = np.copysign(_AT_REST_RAD_S, motion.speed_rad_s)
        for at in (motion, motion._replace(speed_rad_s=rest)):
            without, level = (sliding_levels_nm(each, at) for each in (bare, little))
            taken = (without - level) / _PART
            low = (without - taken < _LEAST * without) & (without > 0.0)
            if low.any():
                most = min(most, float(np.min((1.0 - _LEAST) * without[low] / taken[low])))
    return most


def _others(model: Model, laws: Sequence[Mapping[str, Any]]) -> tuple[Mapping[str, Any], ...]:
    told = [dict(one) for one in laws]
    return tuple(one for one in model.effects if dict(one) not in told)
