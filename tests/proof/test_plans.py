"""A whole proof is mixed evenly, and what the diagnosis is told to leave out gives nothing away."""

from collections import Counter

import numpy as np
import pytest

from eps_hil.proof.effects import ALIENS, CATALOGUED
from eps_hil.proof.plans import (
    DECOYS,
    EVERY,
    KINDS,
    LEVELS,
    LOADS,
    MIX,
    MOST_SEED,
    QUICK,
    TWINS,
    mixed,
    near,
    plans,
)
from eps_hil.proof.programmes import PROGRAMMES, programme
from eps_hil.proof.sizes import SIZES
from eps_hil.proof.world import World


def test_a_full_proof_has_a_thousand_cases_and_every_kind() -> None:
    planned = mixed(MIX, 1, proof=True)
    assert len(planned) >= 1000
    assert Counter(plan.kind for plan in planned) == MIX
    assert set(MIX) == set(KINDS) - {"nameless"}  # benchmarks/nameless.py runs those
    singles = Counter(plan.wanted[0] for plan in planned if plan.kind == "singles")
    assert singles.keys() == {(name, level) for name in CATALOGUED for level in LEVELS}
    decoys = Counter(plan.decoy for plan in planned if plan.kind == "decoys")
    assert decoys == dict.fromkeys(DECOYS, 60)


def test_the_quick_proof_is_of_development_and_has_nearly_every_kind() -> None:
    kinds = {plan.kind for plan in mixed(QUICK, 1)}
    rare = {"twins", "poor", "nameless", "beside", "triples", "rates", "sizes", "loads", "behind"}
    assert kinds == set(KINDS) - rare


@pytest.mark.parametrize("count", [100, 250, 500])
def test_what_comes_first_is_a_fair_sample(count: int) -> None:
    first = Counter(plan.kind for plan in mixed(MIX, 1)[:count])
    for kind, whole in MIX.items():
        assert first[kind] == pytest.approx(whole * count / sum(MIX.values()), abs=1.5)


def test_being_told_to_leave_a_family_out_says_nothing() -> None:
    planned = mixed(MIX, 2)
    for plan in planned:
        hidden = {name for name, _ in plan.wanted}
        if plan.kind == "missing":
            assert near(plan.wanted[0][0]) == set(plan.withheld)
        else:
            assert not hidden & set(plan.withheld)
    told = Counter(plan.kind for plan in planned if plan.withheld)
    assert told["singles"] + told["decoys"] > 0.8 * told["missing"]


def test_seeds_of_development_and_proof_never_meet() -> None:
    development = {(plan.kind, plan.seed) for plan in mixed(MIX, 3)}
    assert not development & {(plan.kind, plan.seed) for plan in mixed(MIX, 3, proof=True)}
    assert mixed(MIX, 3) == mixed(MIX, 3)


def test_no_seed_of_development_is_one_of_a_proof() -> None:
    """Seed 1044 was the proof's 44."""
    highest = {plan.seed for plan in mixed(MIX, MOST_SEED)}
    lowest = {plan.seed for plan in mixed(MIX, 0, proof=True)}
    assert max(highest) < min(lowest)
    with pytest.raises(ValueError, match="at most"):
        mixed(MIX, MOST_SEED + 1)


def test_effects_come_at_more_than_one_level_rate_and_size() -> None:
    """They took turns in step with the effects: each came at one only."""
    aliens = [plan for seed in range(3) for plan in plans("aliens", seed, 60)]
    for name in ALIENS:
        levels = {plan.wanted[0][1] for plan in aliens if plan.wanted[0][0] == name}
        assert levels == set(LEVELS[1:])
    for kind, of in (("rates", "every"), ("sizes", "size")):
        planned = [plan for seed in range(6) for plan in plans(kind, seed, 60) if plan.wanted]
        seen = {(plan.wanted[0][0], getattr(plan, of)) for plan in planned}
        names = {name for name, _ in seen}
        assert len(seen) > 2.5 * len(names)


def test_what_is_hidden_together_are_no_twins_of_each_other() -> None:
    for kind in ("beside", "triples"):
        for plan in plans(kind, 4, 40):
            names = [name for name, _ in plan.wanted]
            assert len(names) == (2 if kind == "beside" else 3)
            assert not any(a in near(b) for a in names for b in names if a is not b)
            assert (names[0] in ALIENS) is (kind == "beside")
            assert set(names[1:]) <= set(CATALOGUED)


def test_every_rate_size_and_load_comes_with_something_and_with_nothing() -> None:
    seen = {
        "rates": {(plan.every, bool(plan.wanted)) for plan in plans("rates", 1, 54)},
        "sizes": {(plan.size, bool(plan.wanted)) for plan in plans("sizes", 1, 54)},
        "loads": {
            (plan.programme, plan.carried_kg > 0.0, bool(plan.wanted))
            for plan in plans("loads", 1, 60)
        },
    }
    both = (False, True)
    assert seen["rates"] == {(every, some) for every in EVERY for some in both}
    assert seen["sizes"] == {(size, some) for size in SIZES if size for some in both}
    loads = [(load, False) for load in LOADS if load != "carried"] + [("free_rack", True)]
    assert seen["loads"] == {(*load, some) for load in loads for some in both}
    assert all(plan.rubs_behind for plan in plans("behind", 1, 4))


def test_twins_are_twins_in_the_catalogue() -> None:
    for name, twin, manoeuvres in TWINS:
        assert twin in near(name)
        assert manoeuvres in PROGRAMMES


@pytest.mark.parametrize("name", PROGRAMMES)
def test_every_programme_stays_within_the_travel(name: str) -> None:
    *_, last = programme(name, np.random.default_rng(5))
    truth = World(True).run(last[:12000])
    assert np.abs(truth["rack_position_m"]).max() < 0.07
    assert np.abs(truth["motor_speed_rad_s"]).max() > 5.0
    if name == "free_rack":
        assert not truth["rack_force_n"].any()
    if name == "one_speed":
        speed = np.abs(truth["motor_speed_rad_s"])[1500:-1000]
        assert np.mean(np.abs(speed - 20.0) < 3.0) > 0.8
    if name == "one_torque":
        slow = np.abs(truth["motor_speed_rad_s"] - 6.0) < 1.5
        assert np.std(truth["motor_torque_nm"][slow][2000:]) < 0.03
