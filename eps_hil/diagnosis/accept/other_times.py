"""Whether what acts at one place of the travel acts there at other times, too.

A place that every recording comes by once, or always as long after it began, may hold what that
time holds: friction that was another one for a while is then the same regressor. What tells them
apart is another pass, well before or after: what passes at other times say of the amount has to
be there. Each pass is predicted from those, and is better off or worse.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.scoring import threshold
from eps_hil.diagnosis.balance.coordinates import coordinates_of
from eps_hil.diagnosis.balance.fit import Fit, fit
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee
from eps_hil.diagnosis.data.entry import also
from eps_hil.physics.effects.catalogue import catalogue

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_LEFT = 1.5
"""Widths from the centre at which a place is left: a tenth of its effect acts there."""


class Place(Enum):
    """What passes at other times say of an effect at a place."""

    STAYS = "stays"
    OPEN = "open"
    """There are none, or they say too little: it may as well be a time."""
    GOES = "goes"
    """It is not there at other times."""


@dataclass(frozen=True)
class _Pass:
    """Thinned samples inside a place, from coming to leaving, and when (s since the start)."""

    samples: Integers
    first_s: float
    last_s: float

    def is_apart(self, other: "_Pass") -> bool:
        """Whether as long lies between the two as they last: else both may be one event."""
        gap = max(self.first_s - other.last_s, other.first_s - self.last_s)
        lengths = self.last_s - self.first_s, other.last_s - other.first_s
        return gap > 0.5 * sum(lengths)


def places_in_time(
    problem: Problem, found: Fit, findings: Sequence[int], judged: Sequence[Holdout]
) -> dict[str, Place]:
    """Of each finding that is bound to a place: whether it is there at other times (by id)."""
    return {
        str(found.entries[k]["effect"]): _at_other_times(problem, found, k, judged)
        for k in findings
        if {"centre_m", "width_m"} <= found.entries[k].keys()
    }


def gone(places: Mapping[str, Place]) -> set[str]:
    """Ids of effects whose place does not hold them at other times."""
    return {name for name, told in places.items() if told is Place.GOES}


def or_a_time(
    findings: Sequence[Mapping[str, Any]], places: Mapping[str, Place], without: Collection[str]
) -> list[dict[str, Any]]:
    """Findings (CONTRACT 7), with what follows time beside those that a place alone shows.

    Effects in ``without`` are not named.
    """
    told = [dict(one) for one in findings]
    for one in told:
        if places.get(one["effect"]) is not Place.OPEN:
            continue
        for other, settle in catalogue()[one["effect"]].twins.items():
            if catalogue()[other].over_time and other not in without:
                also(one, other, settle)
    return told


def only_at_one_time(places: Mapping[str, Place]) -> list[str]:
    """A sentence (CONTRACT 7, ``limits``) for each effect that a place alone shows."""
    return [
        f"{name}: no recording passes its place again at another time, to show that it is still "
        "there; what differed for a while only would look the same."
        for name, told in places.items()
        if told is Place.OPEN
    ]


def _at_other_times(problem: Problem, found: Fit, k: int, judged: Sequence[Holdout]) -> Place:
    """By the passes of all recordings, fitted or not; the place is where the fit has put it."""
    entry = found.entries[k]
    test = problem.over([*problem.recordings, *(one.prepared for one in judged)])
    test.knee, test.at = problem.knee, problem.at
    here = fit(test, found.entries, 0, found.own)
    slides = [problem.sliding, *(one.judging(problem.model) for one in judged)]
    use = np.flatnonzero(np.concatenate(slides))
    column, without = _alone(here, k, use, len(found.own))
    passes = _passes(test, entry, use)
    least = threshold(test, here.residual, 0.0)
    gained = promised = 0.0
    for one in passes:
        others = [other.samples for other in passes if other.is_apart(one)]
        if not others:
            continue
        there = np.concatenate(others)
        power = float(column[there] @ column[there])
        amount = float(column[there] @ without[there]) / max(power, 1e-300)
        change = amount * column[one.samples]
        gained += float(2.0 * change @ without[one.samples] - change @ change)
        promised += float(change @ change)
    if gained > least:
        return Place.STAYS
    return Place.GOES if gained < 0.0 and promised > least else Place.OPEN


def _alone(here: Fit, k: int, use: Integers, own: int) -> tuple[Floats, Floats]:
    """(what one unit of the effect takes off the samples in ``use``, what is there without it).

    Both without what all other numbers could do. Rows of unused samples are zero.
    """
    probe = catalogue()[here.entries[k]["effect"]].probe
    assert probe is not None
    amounts = [own + i for i, name in enumerate(here.names) if name == (k, probe.amplitude)]
    others = [own + i for i, (place, _) in enumerate(here.names) if place != k]
    jacobian = here.jacobian[use]
    rest = jacobian[:, [*range(own), *others]]
    rest = rest / (np.sqrt(np.sum(rest**2, axis=0)) + 1e-300)
    left = clipped(here.residual, knee(here.residual))[use]
    both = np.column_stack([-jacobian[:, amounts], left])
    both = both - rest @ np.linalg.lstsq(rest, both, rcond=1e-9)[0]
    column, without = (np.zeros(len(here.residual)) for _ in range(2))
    column[use] = both[:, 0]
    without[use] = both[:, 1] + both[:, 0] * here.entries[k][probe.amplitude]
    return column, without


def _passes(test: Problem, entry: Mapping[str, Any], use: Integers) -> list[_Pass]:
    """Each stay within the width, until the place is left; those with samples in ``use``."""
    found, first = [], 0
    for one in test.recordings:
        position = coordinates_of([one], test.model)["rack_position_m"]
        since = np.interp(one.thin_time_s, one.time_s, one.since_start_s)
        off = np.abs(position - entry["centre_m"]) / entry["width_m"]
        number = np.cumsum(off > _LEFT)  # the same from one sample outside to the next
        inside = np.flatnonzero(off < 1.0)
        for samples in np.split(inside, 1 + np.flatnonzero(np.diff(number[inside]))):
            used = np.intersect1d(samples + first, use)
            if len(used):
                found.append(_Pass(used, float(since[samples[0]]), float(since[samples[-1]])))
        first += len(position)
    return found
