"""A model of what no name stands for: laws first, a curve or map where none will do, each gated.

A term counts only where it improves hold-outs, by a share of their excess whose interval is clear
of zero, and, unless that share is most of it, by more than any of the null searches reached.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import turned
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.balance.reference import torque_is_referenced
from eps_hil.diagnosis.data.repeated import repeated
from eps_hil.diagnosis.remainder.grammar import Law
from eps_hil.diagnosis.remainder.refine import refine
from eps_hil.diagnosis.remainder.screen import Screened, Screening, screen
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.diagnosis.remainder.table import tables
from eps_hil.physics.effects.added import MOST_TERMS as MOST_IN_A_SLOT
from eps_hil.physics.effects.empirical import EFFECT
from eps_hil.physics.empirical_entry import slot_of
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
Ranges = dict[str, tuple[float, float]]
Entry = dict[str, Any]

MOST_TERMS = 3
LEAST_SHARE, LEAST_LOWER = 0.10, 0.02
"""Of the hold-outs' excess that a term has to take off; the same of its 95 % interval's end."""
MOST_OF_IT = 0.5
"""A term that takes off so much of recordings it never saw needs no null search beside it."""
LEFT_OF_SIMPLE = 0.5
"""Most that a costlier law may leave of what a cheaper one leaves to be taken in its place, where
what that one leaves can be seen: a share of the gain says nothing where nearly all is gained."""
LAW_MARGIN = 0.05
"""Share of the excess by which a curve or map has to be better than a law to be written."""
TIME_LEAVES = 0.5
"""Most that a law of the time since a recording began may leave of what all others leave: that time
is no state of a rig, and says nothing of a recording that begins warm."""
LEAST_TURN_RAD = np.pi
"""What a sine has to turn by over all that was seen: half a period."""
_LEFT, _MORE = 0.08, 0.04
"""Excess of the hold-outs in noise variances, and as a share of what it was, below which nothing
more is looked for; no further term is worth less than the latter."""
_REFINED, _SIMPLE, _OF_TIME, _SHAPED = 6, 4, 2, 2
_BEYOND = 0.02
_DRAWS = 400
_OWN_STEP = 0.05
"""Of a usual error of a number of the model's own, for a difference."""


@dataclass(frozen=True)
class Term:
    """One part of the model of the remainder: the entry, and what made it (None: a table)."""

    entry: Entry
    law: Law | None


@dataclass(frozen=True)
class Remainder:
    """What was found: its terms, and the share of the hold-outs' excess that they take off."""

    terms: tuple[Term, ...]
    model: Model
    share: float
    ci95: tuple[float, float]
    before: Floats
    after: Floats
    """Residuals (n,) of the fitted problem without and with it, noise deviations."""
    refitted: bool = False
    """Whether ``model`` has own numbers that were fitted beside the terms."""

    @property
    def entries(self) -> tuple[Entry, ...]:
        """As a model file holds them."""
        return tuple(term.entry for term in self.terms)


@dataclass(frozen=True)
class _Trial:
    term: Term
    kept: Floats
    fitted: Floats
    worth: float
    model: Model
    """What it is beside: numbers of its own that are free have moved with it."""


class Own:
    """Numbers of the model's own that move with a term, and what they do to the residual.

    A term that shares its work with such a number (friction that follows the load late, with the
    part that follows at once) is only found with both free.
    """

    def __init__(self, sight: Sight, names: Sequence[str]) -> None:
        self.sight, self.names = sight, names
        self.columns = self.of(sight) if names else None

    def of(self, sight: Sight) -> Floats:
        """Sensitivities (n, p) of a residual to the numbers, each in usual errors of it."""

        def column(name: str) -> Floats:
            moved = turned(sight.model, {name: _OWN_STEP}, sight.problem.size)
            return (sight.problem.residual(moved) - sight.residual) / _OWN_STEP

        return np.column_stack([column(name) for name in self.names])

    def moved(self, entry: Entry) -> Model:
        """The model beside ``entry``, its numbers by one linear step within their prior."""
        sight = self.sight
        if self.columns is None:
            return sight.model
        left = sight.problem.residual(_with(sight.model, [entry])) * sight.weight
        prior = np.eye(len(self.names))
        rows = np.vstack([self.columns * sight.weight[:, None], prior])
        step = -np.linalg.lstsq(rows, np.append(left, np.zeros(len(prior))), rcond=None)[0]
        values = dict(zip(self.names, step.tolist(), strict=True))
        return turned(sight.model, values, sight.problem.size)


def find(
    problem: Problem,
    kept: Problem,
    model: Model,
    jacobian: Floats,
    say: Callable[[float], None] | None = None,
    free: Sequence[str] = (),
    *,
    one_law: bool = False,
) -> Remainder | None:
    """Terms that ``model`` lacks to explain ``problem``, as far as ``kept`` confirms them.

    ``jacobian`` (n, p): sensitivities of the residual to what was fitted beside; see ``screen``.
    ``free``: numbers of the model's own that move with each term (``balance/baseline.py``).
    ``one_law``: no more than one term, and no curve or map, which may hold a name's effect too.
    """
    known = torque_is_referenced(problem)
    maps = not one_law and not repeated(problem.recordings, kept.recordings)
    before, first = (Sight(one, model, referenced=known) for one in (problem, kept))
    ranges = _ranges(before)
    terms: list[Term] = []
    fitted, judged = before, first
    whole = _excess(first, first.residual)
    for step in range(1 if one_law else MOST_TERMS):
        if say is not None:
            say(step / MOST_TERMS)
        left = _excess(first, judged.residual)
        if left < max(_LEFT * np.sum(first.weight**2), _MORE * whole * bool(terms)):
            break
        if np.sum(fitted.use) < 500 or np.sum(judged.use) < 100 or is_full(model):
            break
        own = Own(fitted, free)
        best = _best(fitted, judged, jacobian, ranges, own, maps=maps, drawn=not one_law)
        if best is None or left - _excess(first, best.kept) < _MORE * whole:
            break
        terms.append(best.term)
        model = _with(best.model, [best.term.entry])
        fitted, judged = (Sight(one, model, referenced=known) for one in (problem, kept))
    if not terms:
        return None
    share, ends = share_removed(first, judged.residual)
    return Remainder(
        tuple(terms),
        model,
        share,
        ends,
        before.residual,
        fitted.residual,
    )


def is_full(model: Model) -> bool:
    """Whether a model holds as many learnt terms in one place of the drive as can act there."""
    places = Counter(slot_of(one) for one in model.effects if one["effect"] == EFFECT.id)
    return any(count >= MOST_IN_A_SLOT for count in places.values())


def _best(
    fitted: Sight,
    kept: Sight,
    jacobian: Floats,
    ranges: Ranges,
    own: Own,
    *,
    maps: bool,
    drawn: bool,
) -> _Trial | None:
    """The term that takes most off, if the gate lets it through."""
    free = None
    if own.columns is not None:
        free = own.columns, own.of(kept)
    screening = screen(fitted, kept, jacobian, free)

    def refined(some: Sequence[Law]) -> list[_Trial]:
        tried = [_law(fitted, kept, one, ranges, own) for one in some]
        return [one for one in tried if one is not None]

    first = _shortlist(screening.best)
    trials = refined(first)
    trials += refined(_other_shapes(trials, first, screening.best))
    drawings = tables(fitted, kept, maps=maps) if drawn else ()
    others = [_table(fitted, kept, one.entry(ranges), own) for one in drawings]
    lasting, timed = ([one for one in trials if _of_time(one) is of] for of in (False, True))
    simple, table, late = (max(k, key=_worth, default=None) for k in (lasting, others, timed))
    chosen = None if simple is None else _costlier(simple, lasting, fitted, kept)
    if table is not None and (chosen is None or table.worth > chosen.worth + LAW_MARGIN):
        chosen = table
    if late is not None and (chosen is None or _leaves_less(late, chosen, kept)):
        chosen = late
    if chosen is None or not _passes(chosen, kept, screening):
        return None
    return chosen


def _worth(trial: _Trial) -> float:
    return trial.worth


def _costlier(simple: _Trial, trials: Sequence[_Trial], fitted: Sight, kept: Sight) -> _Trial:
    """The law that clearly leaves less than half of what ``simple`` leaves, or that one.

    Prices are shares of the whole gain: beside a large effect they would hide a wrong shape that
    stands far out of the noise. So the cheaper law has to leave what is worth another term, and
    the costlier less than half of it on the fitted recordings and, by its interval, on hold-outs.
    """
    chosen = simple
    while _excess(kept, chosen.kept) > _LEFT * float(np.sum(kept.weight**2)):
        most = LEFT_OF_SIMPLE * _excess(fitted, chosen.fitted)
        better = [
            one
            for one in trials
            if _excess(fitted, one.fitted) < most and _clearly_halves(kept, one.kept, chosen.kept)
        ]
        if not better:
            break
        chosen = max(better, key=_worth)
    return chosen


def _clearly_halves(sight: Sight, after: Floats, before: Floats) -> bool:
    """Whether ``after`` leaves less than its share of the excess of ``before``, block by block."""
    block, share = sight.block, LEFT_OF_SIMPLE
    more = sight.weight**2 * ((after**2 - 1.0) - share * (before**2 - 1.0))
    sums = np.bincount(block, more, minlength=int(np.max(block)) + 1)
    drawn = np.random.default_rng(20).integers(0, len(sums), (_DRAWS, len(sums)))
    return float(np.percentile(np.sum(sums[drawn], axis=1), 97.5)) < 0.0


def _of_time(trial: _Trial) -> bool:
    return trial.term.law is not None and trial.term.law.of_time


def _leaves_less(late: _Trial, best: _Trial, kept: Sight) -> bool:
    """Whether a law of time leaves so much less than the best of all others that it has to be."""
    _, (low, _) = share_removed(kept, late.kept, best.kept)
    return low > 0.0 and 1.0 - late.worth < TIME_LEAVES * (1.0 - best.worth)


def _passes(trial: _Trial, kept: Sight, screening: Screening) -> bool:
    weight = kept.weight**2  # outliers, of a stop that was hit, are another term's
    share, (low, _) = share_removed(kept, trial.kept, weight=weight)
    if share < LEAST_SHARE or low < LEAST_LOWER:
        return False
    return share > MOST_OF_IT or screening.most > float(np.max(screening.null))


def _other_shapes(
    trials: Sequence[_Trial], tried: Sequence[Law], best: Sequence[Screened]
) -> list[Law]:
    """Of the families that are best once numbers are fitted, the shapes that were not tried: which
    one is right shows only then.
    """
    found: list[Any] = []
    for one in sorted(trials, key=_worth, reverse=True):
        law = one.term.law
        if law is not None and not law.of_time and law.family not in found:
            found.append(law.family)
    families = found[:_SHAPED]
    return [one.law for one in best if one.law.family in families and one.law not in tried]


def _shortlist(best: Sequence[Screened]) -> list[Law]:
    """The best laws of different families, among them the best simple ones; those of time apart."""
    chosen: dict[Any, Screened] = {}
    lasting = [one for one in best if not one.law.of_time]
    for one in lasting:
        if len(chosen) < _REFINED:
            chosen.setdefault(one.law.family, one)
    simple = [one for one in lasting if len(one.law.inputs) == 1]
    for one in simple:
        if sum(len(other.law.inputs) == 1 for other in chosen.values()) >= _SIMPLE:
            break
        chosen.setdefault(one.law.family, one)
    timed: dict[Any, Screened] = {}
    for one in best:
        if one.law.of_time and len(timed) < _OF_TIME:
            timed.setdefault(one.law.family, one)
    return [one.law for one in (*chosen.values(), *timed.values())]


def _law(fitted: Sight, kept: Sight, law: Law, ranges: Ranges, own: Own) -> _Trial | None:
    law = refine(fitted.problem, fitted.model, law, ranges, own.columns, fitted.residual)
    if not np.isfinite(law.size) or law.size == 0.0:
        return None
    if _is_a_clock(law, fitted) or _is_no_wave(law, fitted):
        return None
    entry = rounded(law.entry(ranges))
    trial = _table(fitted, kept, entry, own)
    return replace(trial, term=Term(entry, law), worth=trial.worth - law.price * abs(trial.worth))


def _is_a_clock(law: Law, sight: Sight) -> bool:
    slow = [one for one in law.inputs if one.memory in ("lag", "heat")]
    return any(one.numbers["memory"] > sight.longest_s for one in slow)


def _is_no_wave(law: Law, sight: Sight) -> bool:
    """Whether a sine turns by so little that a line and a constant say the same.

    The constant would be friction's asymmetry or an offset, and is taken off again by a name.
    """
    return any(
        one.numbers["order"] * float(np.ptp(sight.inputs[one.name][sight.rows])) < LEAST_TURN_RAD
        for one in law.inputs
        if one.shape == "sine"
    )


def _table(fitted: Sight, kept: Sight, entry: Entry, own: Own) -> _Trial:
    entry = rounded(entry)
    model = own.moved(entry)
    here, there = (one.problem.residual(_with(model, [entry])) for one in (fitted, kept))
    worth = min(_share(fitted, here), _share(kept, there))
    return _Trial(Term(entry, None), there, here, worth, model)


def _share(sight: Sight, after: Floats) -> float:
    """Share of the excess that is gone, by the weights of what was there before."""
    excess = max(_excess(sight, sight.residual), 1e-300)
    return 1.0 - _excess(sight, after) / excess


def _excess(sight: Sight, residual: Floats) -> float:
    return float(np.sum(sight.weight**2 * (residual**2 - 1.0)))


def share_removed(
    sight: Sight, after: Floats, before: Floats | None = None, weight: Floats | None = None
) -> tuple[float, tuple[float, float]]:
    """Share of the excess that is gone (since ``before``), with a 95 % interval over blocks.

    ``weight`` (n,): of each sample's energy; without one, all that are used count alike.
    """
    before = sight.residual if before is None else before
    block = sight.block
    n = int(np.max(block)) + 1
    use = sight.use.astype(np.float64) if weight is None else weight
    sums = np.array(
        [
            np.bincount(block, use * one, minlength=n)
            for one in (before**2 - after**2, sight.residual**2 - 1.0)
        ]
    )
    rng = np.random.default_rng(20)
    drawn = rng.integers(0, n, (_DRAWS, n))
    gone, there = (np.sum(row[drawn], axis=1) for row in sums)
    shares = gone / np.maximum(there, 1e-300)
    whole = float(np.sum(sums[0]) / max(float(np.sum(sums[1])), 1e-300))
    low, high = np.percentile(np.clip(shares, -10.0, 1.5), [2.5, 97.5])
    return whole, (float(low), float(high))


def _ranges(sight: Sight) -> Ranges:
    """What every input was between in the fitted recordings, and a little more."""
    found = {}
    for name, values in sight.inputs.items():
        if name.endswith("_sign") or name == "since_reversal_s":
            continue
        low, high = float(np.min(values)), float(np.max(values))
        more = _BEYOND * (high - low)
        found[name] = (0.0 if name.startswith("abs_") else low - more, high + more)
    return found


def with_remainder(model: Model, found: Remainder | None) -> Model:
    """The model with the terms that were found among its effects, and what was fitted beside."""
    return model if found is None else found.model


def _with(model: Model, entries: Sequence[Mapping[str, Any]]) -> Model:
    return replace(model, effects=(*model.effects, *entries))


def rounded(entry: Mapping[str, Any]) -> Entry:
    """Numbers with the digits that a model file is written with."""

    def short(value: Any) -> Any:
        if isinstance(value, float):
            return float(f"{value:.6g}")
        if isinstance(value, list):
            return [short(one) for one in value]
        if isinstance(value, dict):
            return {key: short(one) for key, one in value.items()}
        return value

    return {key: short(value) for key, value in entry.items()}
