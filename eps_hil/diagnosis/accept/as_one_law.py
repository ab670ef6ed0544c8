"""Names beside laws that are one law in several pieces, by that law.

A drive that loses more where the load drives it is, piece by piece, a friction that grows with the
load and a part that is linear in it; the first piece has a name. Where one law in the place of some
names and of all laws beside them has fewer numbers, and leaves no more of recordings that were
kept from the fit, it stands there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from eps_hil.diagnosis.accept.beside_law import names_first, without_laws
from eps_hil.diagnosis.accept.holdout_support import augmented_by, refitted
from eps_hil.diagnosis.accept.nameless import sensitivities
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.accept.standing import number_count, price, price_of_one
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.baseline import SIDES, TIMING, is_free, law_knobs
from eps_hil.diagnosis.balance.fit import ablated, fit
from eps_hil.diagnosis.balance.problem import Problem, term_of
from eps_hil.diagnosis.remainder.find import Remainder, find, share_removed
from eps_hil.diagnosis.remainder.sight import Sight


@dataclass(frozen=True)
class OneLaw:
    """A law, the names that stand beside it (places in the fit of ``selection``), its price.

    ``told``: the same names as they are fitted in ``weighed``, which has the law in its model.
    """

    selection: Selection
    findings: Sequence[int]
    law: Remainder
    price: float
    weighed: Problem
    told: Selection


def as_one_law(
    problem: Problem,
    selection: Selection,
    findings: Sequence[int],
    laws: Remainder,
    judged: Sequence[Holdout],
) -> OneLaw | None:
    """One law in the place of all ``laws`` and of one name or of all; None where none does better.

    ``selection`` and ``findings`` are of ``problem``, which has no laws in its model.
    """
    whole = price(problem, selection, findings, judged, laws.model, laws)
    many = number_count(selection, findings, laws)
    best: OneLaw | None = None
    others = [[one for one in findings if one != k] for k in findings] if len(findings) > 1 else []
    for some in ([], *others):
        one = _beside(problem, selection, some, judged)
        if one is None:
            continue
        spared = many - number_count(one.selection, one.findings, one.law)
        less = whole - one.price - spared * price_of_one(problem, judged)  # of energy
        if spared > 0 and less >= 0.0 and (best is None or one.price < best.price):
            best = one
    return best


def _beside(
    problem: Problem, selection: Selection, some: Sequence[int], judged: Sequence[Holdout]
) -> OneLaw | None:
    """The best law beside ``some`` of the findings, all of them fitted together."""
    kept = problem.apart([one.prepared for one in judged])
    fewer = replace(selection)
    places = refitted(problem, fewer, some) if some else []
    start = augmented_by(problem, fewer.found, places)
    law = find(problem, kept, start, sensitivities(fewer.found, places), one_law=True)
    if law is None:
        return None
    first = len(problem.model.effects)
    given = replace(problem.model, effects=(*problem.model.effects, *law.entries))
    entries = [fewer.found.entries[k] for k in places]
    sides = [name for entry in entries for name in SIDES.get(str(entry["effect"]), ())]
    own = fewer.found.own
    if not is_free(own):
        own = {name: own[name] for name in (*TIMING, *sides) if name in own}
    knobs = law_knobs(given, first)
    again = Problem(problem.recordings, given, tied=knobs)
    found = fit(again, entries, own={**own, **knobs})
    model = augmented_by(again, found, range(len(entries)), moved=True)
    (term,), entry = law.terms, dict(model.effects[first])
    named = model.effects[first + 1 :]
    model = names_first(problem, replace(model, effects=(*problem.model.effects, entry, *named)))
    alone = without_laws(problem, found)
    spared = {term_of(one): ablated(again, found, k) for k, one in enumerate(found.entries)}
    told, fewer = replace(fewer, found=found, without=spared), replace(fewer, found=alone)
    places = list(range(len(entries)))
    start = augmented_by(problem, alone, places)
    share, ends = share_removed(Sight(kept, start), kept.residual(model))
    law = replace(
        law,
        terms=(replace(term, entry=entry),),
        model=model,
        share=share,
        ci95=ends,
        before=problem.residual(start),
        after=problem.residual(model),
    )
    costs = price(problem, fewer, places, judged, model, law)
    return OneLaw(fewer, places, law, costs, again, told)
