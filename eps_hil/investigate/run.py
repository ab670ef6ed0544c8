"""The whole investigation: diagnose, choose, run, again; every step on disk before the next.

The rig is led through ``programme/link.py`` alone, which sends speed and preload and no torque of
the motor, and lets go of it after every experiment, however that ends.
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eps_hil.bus.config import BusSetup
from eps_hil.bus.record import open_log
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.errors import EpsHilError, SafetyStop
from eps_hil.investigate.course import Course, Phase
from eps_hil.investigate.decide import Decision, Stop, decide
from eps_hil.investigate.experiment import TICK_S, Experiment, menu
from eps_hil.investigate.foreseen import foresee
from eps_hil.investigate.journal import Journal, Step, next_number
from eps_hil.investigate.possible import Menu, Possible
from eps_hil.investigate.worth import FITTED, Prospect, friction_level_nm, prospect, shapes
from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.model import Model
from eps_hil.programme.limits import Limits
from eps_hil.programme.link import Rig
from eps_hil.recordings.read import read_recording
from eps_hil.series import Series

_LAWS = "empirical"
_SHOWN = 5
_TRIED = 3
"""Recordings after which a diagnosis that refuses them is not a matter of their length."""

Signals = dict[str, Series]
Stopped = Callable[[], bool]
OpenRig = Callable[[Stopped], contextlib.AbstractContextManager[Rig]]


class InterruptedInvestigationError(EpsHilError):
    """Somebody stopped it; finished steps are kept."""


@dataclass(frozen=True)
class Outcome:
    """How it ended: the last round's content, and the diagnosis that it rests on."""

    rounds: Sequence[Mapping[str, Any]]
    found: Diagnosis | None
    stop: Stop
    rig_s: float

    @property
    def settled(self) -> bool:
        """Whether nothing is open."""
        return self.stop is Stop.SETTLED


def prepared_menu(
    model: Model,
    limits: Limits,
    motor_share: float,
    chain: ChainParameters | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Menu:
    """Every experiment within the limits, simulated once with the model file.

    ``chain``: of the rig, where it is known.
    """
    if friction_level_nm(model) == 0.0:
        problem = "the model file has no friction, of which an effect could be a share"
        raise EpsHilError(f"{problem}; identify it first (eps-hil programme)")
    planned, asked = menu(limits, model), None
    prospects: dict[Experiment, Prospect] = {}
    for k, one in enumerate(planned):
        seen = foresee(model, one, limits, motor_share, chain)
        if asked is None:
            asked = shapes(model, limits, Problem([prepare(one.name, seen.series)], model))
        if seen.within(limits):
            prospects[one] = prospect(one.name, seen.series, model, asked, limits)
        if on_progress:
            on_progress((k + 1) / len(planned))
    if not prospects or asked is None:
        raise EpsHilError("no experiment keeps the limits of the investigate: block; widen them")
    return Menu(model, limits, asked, prospects)


class Investigation:
    """An investigation, checked; :meth:`run` goes on from whatever its folder holds."""

    def __init__(
        self,
        setup: BusSetup,
        menu: Menu,
        journal: Journal,
        open_rig: OpenRig,
        say: Callable[[Mapping[str, Any]], None] = lambda _: None,
    ) -> None:
        self._setup, self._menu, self._journal = setup, menu, journal
        self._open_rig, self._say = open_rig, say

    def run(self, budget_s: float, stop: Stopped = lambda: False) -> Outcome:
        """Until the physics is settled, the budget is spent, or nothing more can be told.

        :class:`SafetyStop` where the rig went beyond a limit, :class:`EpsHilError` where it does
        not follow, :class:`InterruptedInvestigationError` after ``stop()``.
        """
        steps = self._journal.steps()
        rounds = self._journal.rounds()[: len(steps)]
        while True:
            if stop():  # steps are kept; what they say may take minutes of compiling
                raise self._interrupted()
            found, problem = self._diagnosed(steps)
            possible = Possible(self._menu, found, _asked(rounds))
            used_s = sum(one.rig_s for one in steps)
            done = [one.experiment for one in steps]
            barred = [one.experiment for one in steps if one.problem]
            decided = decide(possible, rounds, done, budget_s - used_s)
            chosen = [one for one in decided.choices if one.experiment not in barred]
            decision = replace(decided, choices=chosen)  # what is said is what is run
            content = _content(len(steps), used_s, possible, decision) | {
                "problem": problem,
                "tripped": [[one.experiment.words, one.problem] for one in steps if one.problem],
            }
            self._journal.write_round(content)
            rounds = [*rounds, content]
            self._say(content)
            if decision.stop is not None:
                return Outcome(rounds, found, decision.stop, used_s)
            if stop():
                raise self._interrupted()
            if not chosen:
                raise SafetyStop("every experiment that would tell more went beyond a limit before")
            steps = [*steps, self._led(next_number(steps), chosen[0].experiment, stop)]

    def _led(self, number: int, experiment: Experiment, stop: Stopped) -> Step:
        """Run one experiment; its log and its step are then kept."""
        course = Course(experiment, self._menu.limits, self._menu.model)
        log = self._journal.log_of(number, experiment)
        part = log.with_suffix(".part.log")

        def before_tick() -> None:
            if stop():
                raise self._interrupted()

        file = open_log(part, self._setup.bus.channel, overwrite=True)
        try:  # a disk may take its time to close a file: the rig is let go of before
            with self._open_rig(stop) as rig:
                rig.lead(course, file, before_tick)
        finally:
            file.close()
        if course.phase is Phase.FAILED:
            raise EpsHilError(f"{experiment.name}: {course.reason}; finished steps are kept")
        part.replace(log)
        problem = course.reason if course.phase is Phase.TRIPPED else ""
        step = Step(number, experiment, course.ticks * TICK_S, log, problem)
        self._journal.write_step(step)
        if problem:
            raise SafetyStop(f"{experiment.name} ended: {problem}; it is not run again")
        return step

    def _interrupted(self) -> InterruptedInvestigationError:
        return InterruptedInvestigationError(
            f"interrupted; finished steps are kept in {self._journal.folder}, call again to go on"
        )

    def _diagnosed(self, steps: Sequence[Step]) -> tuple[Diagnosis | None, str]:
        """What all recordings say; None, and why, while they are too short to say anything."""
        logs = {one.log.stem: one.log for one in steps if not one.problem}
        if not logs:
            return None, ""
        setup = self._setup
        read = {
            name: dict(read_recording(log, dbc=setup.dbc, signals=setup.signals).series)
            for name, log in logs.items()
        }
        try:
            return diagnosed(self._menu.model, read), ""
        except ValueError as error:
            if len(logs) >= _TRIED:
                raise EpsHilError(f"no verdict after {len(logs)} experiments: {error}") from error
            return None, str(error)


def diagnosed(model: Model, read: Mapping[str, Signals]) -> Diagnosis:
    """Recordings of one run of a rig: two thirds of each are fitted, the last third judges."""
    fitted: dict[str, Signals] = {}
    kept: dict[str, Signals] = {}
    began: dict[str, float] = {}
    first = min(_span(one)[0] for one in read.values())
    for name, signals in read.items():
        start, end = _span(signals)
        cut = start + int(FITTED * (end - start))
        judging = f"{name}, last third"
        fitted[name] = {key: _part(one, start, cut) for key, one in signals.items()}
        kept[judging] = {key: _part(one, cut, end) for key, one in signals.items()}
        began |= {name: 1e-9 * (start - first), judging: 1e-9 * (cut - first)}
    return diagnose(model, fitted, kept, without={_LAWS}, began_s=began)


def _span(signals: Signals) -> tuple[int, int]:
    ends = [(int(one.t_ns[0]), int(one.t_ns[-1])) for one in signals.values()]
    return min(start for start, _ in ends), max(end for _, end in ends)


def _part(one: Series, start: int, end: int) -> Series:
    keep = slice(*np.searchsorted(one.t_ns, (start, end + 1)).tolist())
    return Series(one.t_ns[keep], one.value[keep])


def _asked(rounds: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str], int]:
    """How often a round chose its experiment while a pair of names was open."""
    count: dict[tuple[str, str], int] = {}
    for one in rounds:
        for effect, rival in one["open_names"]:
            count[effect, rival] = count.get((effect, rival), 0) + 1
    return count


def _content(number: int, used_s: float, possible: Possible, decision: Decision) -> dict[str, Any]:
    """What was thought in this round, JSON-ready."""
    shapes, found = possible.menu.shapes, possible.found
    return {
        "round": number,
        "rig_s": round(used_s, 3),
        "verdict": None if found is None else found.content["verdict"],
        "findings": [] if found is None else found.content["findings"],
        "limits": [] if found is None else found.content["limits"],
        "fit": None if found is None else found.content["fit"],
        "discrepancy": None if found is None else round(possible.discrepancy, 4),
        "open_effects": sorted({shapes[k][0] for k in possible.open}),
        "open_names": [[one.entry["effect"], one.rival] for one in possible.rivals],
        "not_told_apart": [[one.entry["effect"], one.rival] for one in possible.same],
        "not_shown_here": possible.hidden,
        "next": [one.content() for one in decision.choices[:_SHOWN]],
        "stop": None if decision.stop is None else decision.stop.value,
        "why": decision.why,
    }


@contextlib.contextmanager
def letting_go(rig: Any) -> Iterator[Rig]:
    """A rig that is let go of, however its experiment ends."""
    try:
        yield rig
    finally:
        rig.let_go()
