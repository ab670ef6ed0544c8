"""One balance of two states: entries act in one of them, all else in both."""

import numpy as np
import pytest

from eps_hil.diagnosis.balance.baseline import ALL
from eps_hil.diagnosis.balance.both_states import BothStates, one_state
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.physics.model import Model

STRIBECK = {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 10.0}


@pytest.fixture
def both(problem: Problem) -> BothStates:
    """The sweep is of the known state, the weave of the other one; both have a Stribeck effect."""
    known = frozenset(one.name for one in problem.recordings if one.name.startswith("sweep"))
    assert len(known) == 1
    return BothStates(problem.recordings, problem.model, known=known)


def test_an_entry_acts_in_the_other_state_only(both: BothStates, problem: Problem) -> None:
    known = both.in_known()
    bare = problem.residual(problem.model)
    everywhere = problem.residual(problem.with_entries([STRIBECK]))
    assert np.any(everywhere[known] != bare[known])
    there = both.residual(both.with_entries([STRIBECK]))
    assert np.array_equal(there[known], bare[known])
    assert np.array_equal(there[~known], everywhere[~known])
    assert np.array_equal(both.residual(problem.model), bare)


def test_the_models_own_numbers_move_in_both_states(both: BothStates, problem: Problem) -> None:
    own = {"inertia": 0.5, "motor_torque_offset": 0.2}
    known = both.in_known()
    moved = both.residual(both.with_entries([STRIBECK], own))
    assert np.array_equal(moved[known], problem.residual(problem.with_entries([], own))[known])
    assert np.array_equal(
        moved[~known], problem.residual(problem.with_entries([STRIBECK], own))[~known]
    )


def test_other_recordings_are_of_the_other_state(both: BothStates, problem: Problem) -> None:
    renamed = [one.changed(name="holdout") for one in problem.recordings]
    kept = both.over(renamed)
    assert isinstance(kept, BothStates)
    assert not kept.in_known().any()


def test_what_both_states_have_is_no_difference(both: BothStates, problem: Problem) -> None:
    """A friction level that both have is fitted to both; an entry of it is nothing then."""
    shared = Problem(problem.recordings, problem.with_entries([STRIBECK]))
    states = BothStates(shared.recordings, shared.model, known=both.known)
    found = fit(states, [{**STRIBECK, "level_nm": 0.01}], own=ALL)
    assert abs(found.entries[0]["level_nm"]) < 0.003
    alone = fit(both, [{**STRIBECK, "level_nm": 0.01}], own=ALL)
    assert alone.entries[0]["level_nm"] > 0.01


def test_a_file_holds_the_model_of_the_other_state(both: BothStates, problem: Problem) -> None:
    assert one_state(both.with_entries([STRIBECK])) == problem.with_entries([STRIBECK])
    assert type(one_state(both.with_entries([STRIBECK]))) is Model
    assert one_state(problem.model) is problem.model
