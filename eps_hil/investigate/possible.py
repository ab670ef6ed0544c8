"""What is still possible: the questions that recordings leave open, and what would answer them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.problem import Problem, clipped, knee
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.investigate.experiment import Experiment
from eps_hil.investigate.worth import (
    CLEAR,
    FITTED,
    Prospect,
    Shape,
    Sight,
    amplitudes,
    friction_level_nm,
    information,
    sight,
    wrong,
)
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model
from eps_hil.programme.limits import Limits

Floats = npt.NDArray[np.float64]

_REACH = 3
"""Runs of one experiment within which a question has to be answerable to count as open."""
_ASKED = 2
"""Experiments after which two names that still look alike count as the same on this rig."""
_LEAST_BITS = 0.002
_LEAST_SLIDING_S = 7.0
"""A diagnosis needs 4 s to fit, which are two thirds of a recording."""


@dataclass(frozen=True)
class Menu:
    """Experiments within the limits, simulated once, and the shapes that are asked for."""

    model: Model
    limits: Limits
    shapes: Sequence[Shape]
    prospects: Mapping[Experiment, Prospect]

    @property
    def size(self) -> Floats:
        """Of each shape, the amplitude at which it matters."""
        sights = [one.sight for one in self.prospects.values()]
        return amplitudes(sights, self.limits.matters * friction_level_nm(self.model))

    def seen(self, of: Sight, size: Floats) -> Floats:
        """D² of each shape at that amplitude."""
        return np.asarray(of.distance * size**2)


def explained_in_part(content: Mapping[str, Any]) -> bool:
    """Whether what a diagnosis named leaves something that it does not explain."""
    nameless = any(one["effect"] == "unknown" for one in content["findings"])
    return nameless or content["verdict"] == "partly_explained"


@dataclass(frozen=True)
class Rival:
    """A name that was found, and another that the recordings cannot tell from it."""

    entry: Mapping[str, Any]
    rival: str


@dataclass(frozen=True)
class Choice:
    """An experiment, what it is expected to tell, and of what most of that is."""

    experiment: Experiment
    bits: float
    minutes: float
    about: tuple[str, ...]

    @property
    def rate(self) -> float:
        """Bits a minute of rig time."""
        return self.bits / self.minutes

    def content(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "experiment": self.experiment.name,
            "words": self.experiment.words,
            "bits": round(self.bits, 4),
            "minutes": round(self.minutes, 4),
            "bits_per_min": round(self.rate, 4),
            "about": list(self.about),
        }


@dataclass
class Possible:
    """The questions after some recordings; ``found`` None: nothing could be diagnosed yet."""

    menu: Menu
    found: Diagnosis | None
    asked: Mapping[tuple[str, str], int] = field(default_factory=dict)
    """How often an experiment was to tell a finding from a rival."""
    discrepancy: float = field(init=False, default=1.0)
    shown: Floats = field(init=False)
    """D² of each shape that the recordings had."""
    rivals: list[Rival] = field(init=False, default_factory=list)
    same: list[Rival] = field(init=False, default_factory=list)
    """Names that nothing on this rig tells apart."""
    _apart: dict[tuple[Experiment, str, str], float] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._size = self.menu.size
        self.shown = np.zeros(len(self.menu.shapes))
        self._best = np.max([self._of(one) for one in self.menu.prospects], axis=0)
        if self.found is None:
            return
        problem, fit = self.found.problem, self.found.selection.found
        left = fit.residual[problem.sliding]
        self.discrepancy = max(1.0, float(np.mean(clipped(left, knee(left)) ** 2)))
        bare = Problem(problem.recordings, self.menu.model)
        self.shown = self.menu.seen(sight(bare, self.menu.shapes, self.menu.limits), self._size)
        entries = {one["effect"]: one for one in self.found.model.effects}
        for finding in self.found.content["findings"]:
            for rival in finding["confusable_with"]:
                if finding["effect"] not in entries or rival not in catalogue():
                    continue
                pair = Rival(entries[finding["effect"]], rival)
                told = self.asked.get((finding["effect"], rival), 0) < _ASKED
                (self.rivals if told and self._told(pair) else self.same).append(pair)

    @property
    def names(self) -> tuple[str, ...]:
        """That were found."""
        if self.found is None:
            return ()
        return tuple(sorted(one["effect"] for one in self.found.content["findings"]))

    @property
    def unnamed(self) -> bool:
        """Whether something is left that has no name."""
        return "unknown" in self.names

    @property
    def in_part(self) -> bool:
        """Whether what was named does not explain all that the recordings show."""
        return self.found is not None and explained_in_part(self.found.content)

    @property
    def open(self) -> list[int]:
        """Shapes that may be there unseen, and that some experiment would show."""
        reach = self.shown + _REACH * self._best
        far = CLEAR * self.discrepancy
        return [k for k in self._others if self.shown[k] < far <= reach[k]]

    @property
    def hidden(self) -> list[str]:
        """Effects of which no experiment within the limits shows some shape."""
        reach = self.shown + _REACH * self._best
        far = CLEAR * self.discrepancy
        return sorted({self.menu.shapes[k][0] for k in self._others if reach[k] < far})

    @property
    def answered(self) -> bool:
        """Whether nothing is open that an experiment would tell."""
        return self.found is not None and not (self.open or self.rivals or self.in_part)

    def choices(self, done: Sequence[Experiment], fresh: bool) -> list[Choice]:
        """Experiments by what they tell a minute; ``fresh``: as if nothing had been shown yet.

        What was run already is then left out.
        """
        found = []
        for experiment, prospect in self.menu.prospects.items():
            if not (fresh and experiment in done):
                found.append(self._choice(experiment, prospect, fresh))
        found = [one for one in found if one.bits > _LEAST_BITS]
        if self.found is None:  # the first has to be one that a diagnosis takes
            sights = {one: prospect.sight for one, prospect in self.menu.prospects.items()}
            long = [one for one in found if sights[one.experiment].sliding_s > _LEAST_SLIDING_S]
            found = long or found
        return sorted(found, key=lambda one: -one.rate)

    @property
    def _others(self) -> list[int]:
        return [k for k, shape in enumerate(self.menu.shapes) if shape[0] not in self.names]

    def _of(self, experiment: Experiment) -> Floats:
        """D² of each shape that one run of it adds."""
        seen = self.menu.seen(self.menu.prospects[experiment].sight, self._size)
        return np.asarray(FITTED * seen)

    def _told(self, pair: Rival) -> bool:
        most = max(self._between(one, pair) for one in self.menu.prospects)
        return _REACH * most >= CLEAR * self.discrepancy

    def _between(self, experiment: Experiment, pair: Rival) -> float:
        assert self.found is not None
        key = experiment, str(pair.entry["effect"]), pair.rival
        if key not in self._apart:
            prospect = self.menu.prospects[experiment]
            self._apart[key] = prospect.between(self.found.model, pair.entry, pair.rival)
        return FITTED * self._apart[key]

    def _choice(self, experiment: Experiment, prospect: Prospect, fresh: bool) -> Choice:
        names = {shape[0] for shape in self.menu.shapes}
        more = self._of(experiment)
        bits: dict[str, float] = {}
        for k in self._others if fresh else self.open:
            effect = self.menu.shapes[k][0]
            shapes = sum(shape[0] == effect for shape in self.menu.shapes)
            before = 0.0 if fresh else float(self.shown[k])
            prior = 1.0 / len(names) / shapes
            gained = [
                information(prior, wrong(far, self.discrepancy))
                for far in (before, before + float(more[k]))
            ]
            bits[effect] = bits.get(effect, 0.0) + max(0.0, gained[1] - gained[0])
        for pair in self.rivals:
            error = wrong(self._between(experiment, pair), self.discrepancy)
            what = f"{pair.entry['effect']} or {pair.rival}"
            bits[what] = information(0.5, error)
        by_worth = sorted(bits, key=lambda one: -bits[one])
        about = tuple(one for one in by_worth[:4] if bits[one] > 0.1 * bits[by_worth[0]])
        minutes = (prospect.sight.seconds + _WAY_S) / 60.0
        return Choice(experiment, sum(bits.values()), minutes, about)


_WAY_S = 2.0
"""Usual time to an experiment's start and to rest after it."""
