"""Which load it was where nobody measured one, told by the diagnosis under it."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from eps_hil.diagnosis.accept.as_written import under_any_force, under_written_load
from eps_hil.diagnosis.accept.beside_law import ENOUGH
from eps_hil.diagnosis.accept.proof_of_fit import torque_nrmse
from eps_hil.diagnosis.accept.standing import price_of_one
from eps_hil.diagnosis.attribute.scoring import FORWARD_SHARE, threshold
from eps_hil.diagnosis.balance.fit import matters
from eps_hil.diagnosis.balance.load import (
    FREE,
    LIKE_LOAD,
    LOAD_NUMBERS,
    NAMED,
    Load,
    load_of,
    may_be_free,
    own_drag,
    wrong_in_friction,
)
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.diagnosis.given_load import Asked, Diagnosis, begun, under
from eps_hil.diagnosis.verdict.content import without_nan
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

MOST_LEFT = 0.5
"""Of the hold-outs' energy: what names leave of a force that is no arbitrary one."""

LEFT_BY_LAW = 1.0 - ENOUGH
"""The same, of a law without a name."""

OF_MOTION = {"motor_angle_rad", "rack_position_m", "motor_speed_rad_s"}
"""What a force at the rack follows, with their absolute values."""

WORTH_A_LOAD = 0.98
"""Of what hold-outs keep without: below this a load is written where there may be none."""


def under_unmeasured_load(asked: Asked) -> Diagnosis:
    """The diagnosis under the load that fits best, where nobody measured one."""
    load = load_of(asked.learnt, asked.model)
    beside = load.beside_own_drag(asked.model)
    given = replace(load, drag_nm_s_per_rad=0.0)
    told = _under_load(given, replace(asked, model=beside), asked.model)
    said = [*own_drag(asked.model, told.model), *_may_be_load(told)]
    return replace(told, content={**told.content, "limits": [*said, *told.content["limits"]]})


def _may_be_load(told: Diagnosis) -> list[str]:
    """A sentence where a torque without a name follows the motion: so does a load."""
    for one in told.content["findings"]:
        terms = one.get("model", {}).get("terms", []) if one["effect"] == "unknown" else []
        for term in terms:
            inputs = {name.removeprefix("abs_") for name in term["inputs"]}
            if term["where"] == "rotor" and inputs <= OF_MOTION:
                return [
                    f"What has no name ({one['model']['law']}) may be the load itself, which "
                    "nobody measured: a tyre's scrub or a bushing at the rack follows the motion "
                    "as it does. Record rack_force_n to tell."
                ]
    return []


def _under_load(load: Load, asked: Asked, given: Model) -> Diagnosis:
    """Under the load that follows from the one that fits beside nothing else; or none, with names.

    Names are looked for in the ``given`` model: a drag of its own that only went with a load would
    come back as one of them.

    Numbers that stand for a load hold whatever follows the motion as it does. Where there may be
    no load, and names cost less of the hold-outs (``standing.py``), it is the rig's own: a load
    that is written has three numbers, and one that is not leaves what they held. Where the search
    finds no name that a load hides, and nothing stayed unknown beside the load, there is nothing to
    weigh.
    """
    told = _under_likely_load(load, asked)
    if load.form == "arbitrary" or not may_be_free(load, asked.every, asked.model):
        return told
    search = begun(NAMED, replace(asked, model=given))
    if search.names.isdisjoint(LIKE_LOAD) and told.remainder is None:
        return told
    named = search.told()
    if not named.content["findings"]:
        return told
    written = told.beside_load is not None and told.beside_load != told.model
    cost = told.price + written * LOAD_NUMBERS * price_of_one(told.problem, told.judged)
    return named if named.price < cost else told


def _under_likely_load(load: Load, asked: Asked) -> Diagnosis:
    """The same from the ``load`` that fits beside nothing else, and what follows from there."""
    model, every, learnt = asked.model, asked.every, asked.learnt

    def told_under(load: Load) -> Diagnosis:
        return under(load, replace(asked, model=load.beside_own_drag(model)))

    base = load.in_model(model)
    if load.form == "arbitrary":
        loose = may_be_free(load, every, model)
        return _under_any(load, told_under, model, learnt, loose=loose)
    first = told_under(load)
    if not first.content["findings"]:
        return _with_load(first, load, _as_told(load, first, learnt), base)
    better = load_of(learnt, first.model)  # beside the friction that was found it is another one
    fitted = load
    if better.form == "spring":
        if wrong_in_friction(load, better, every, model):
            first, fitted = told_under(better), better
            better = replace(better, drag_nm_s_per_rad=0.0)  # it is in what was found by now
        load = _as_told(better, first, learnt)
    if may_be_free(better, every, model):
        # friction that grows with a load that is none looks like many things
        free = told_under(FREE)
        if _price(free) < _price(first):
            return _with_what_follows(free, model, learnt)
    told = _with_load(first, fitted, load, base)
    if not _worse_under_load(told):
        return told
    own = fitted.beside_own_drag(model)
    bare = under(fitted, replace(asked, model=own, without=catalogue()))
    return _with_load(bare, fitted, load, base)


def _under_any(
    load: Load,
    told_under: Callable[[Load], Diagnosis],
    model: Model,
    learnt: Sequence[Prepared],
    *,
    loose: bool,
) -> Diagnosis:
    """The diagnosis under a force that may be arbitrary, and explain whatever there is.

    As one that follows the motion (``loose``: or none), where that is believed.
    """
    form = replace(FREE if loose else load.followed(), doubtful=True)
    told = _refitted(told_under(form), form, form.in_model(model), learnt)
    if told.content["verdict"] == "explained":
        return told
    if _follows(told, held=not loose and load.stiffness_n_per_m < 0.0):
        return told
    ripples = told_under(load)
    return replace(ripples, content=under_any_force(ripples.content))


def _worse_under_load(told: Diagnosis) -> bool:
    """Whether hold-outs are worse by the written file, whose load was fitted beside what was found.

    Then what was found had only taken over what the load does.
    """
    figures = told.content["fit"]["holdout"]
    before, after = (figures[one]["torque_nrmse"] for one in ("baseline", "augmented"))
    return bool(told.content["findings"] and after > before)


def _follows(told: Diagnosis, *, held: bool) -> bool:
    """Whether names explain most of the hold-outs' energy: that is no arbitrary force.

    A law without a name has to explain nearly all of it: in manoeuvres that are somewhat alike, a
    part of any force follows the motion somehow. And all of it does where the drive is ``held``: a
    motor that holds a place against any force gives way as a spring of negative stiffness.
    """
    named = any(one["effect"] != "unknown" for one in told.content["findings"])
    if held and not named:
        return False
    before, after = (
        told.content["fit"]["holdout"][one]["torque_nrmse"] for one in ("baseline", "augmented")
    )
    return bool(after**2 < (MOST_LEFT if named else LEFT_BY_LAW) * before**2)


def _as_told(load: Load, told: Diagnosis, learnt: Sequence[Prepared]) -> Load:
    """The load that is written beside what was found: with all that its damper had to hold there.

    A level of friction that it could not be told from has no name, and would be in neither.
    """
    again = load_of(learnt, told.model, level=False)
    return again if again.form == "spring" else load


def _with_what_follows(told: Diagnosis, model: Model, learnt: Sequence[Prepared]) -> Diagnosis:
    """Of a free rack: with the spring, damper and constant that stay in the balance, if they do.

    They are free in its fits, and have no name: a drag that is off would be nowhere else.
    """
    load = load_of(learnt, told.model, level=False)
    grows = told.model.friction.load_pos_nm_per_n + told.model.friction.load_neg_nm_per_n
    if load.form != "spring" or grows > 0.0:
        return told
    without, beside = (
        torque_nrmse(told.judged, model, one) for one in (told.model, load.in_model(told.model))
    )
    return _with_load(told, FREE, load, model) if beside < WORTH_A_LOAD * without else told


def _refitted(told: Diagnosis, form: Load, base: Model, learnt: Sequence[Prepared]) -> Diagnosis:
    """With the load in the model, a spring as it is beside what was found."""
    better = load_of(learnt, told.model, level=False) if form.form == "spring" else form
    better = replace(better, doubtful=True) if better.form == "spring" else form
    return _with_load(told, form, better, base)


def _with_load(told: Diagnosis, fitted: Load, load: Load, base: Model) -> Diagnosis:
    """With ``load`` in the model in place of the one ``fitted`` beside it, and with its figures.

    ``base``: the given model with the load that was fitted beside nothing else.
    """
    written = load.in_model(told.model)
    content = under_written_load(told.content, told.judged, told.as_read, base, written)
    content["limits"] = [
        load.sentence(told.shown) if one == fitted.sentence(told.shown) else one
        for one in content["limits"]
    ]
    content = without_nan(content)
    return replace(told, model=written, content=content, given=base, beside_load=told.model)


def _price(told: Diagnosis) -> float:
    """What is left, and what counts as a gain for each name that it took."""
    found, part = told.selection.searched, told.selection.part
    names = sum(matters(entry, part) for entry in found.entries)
    return found.cost + names * threshold(part, found.residual, FORWARD_SHARE)
