"""Which names are taken, and which are not although they would fit."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest

from eps_hil.diagnosis.attribute.numbers import SPANNED, levels_first
from eps_hil.diagnosis.attribute.scoring import score
from eps_hil.diagnosis.attribute.select import _believable, select, timed
from eps_hil.diagnosis.balance.baseline import ALL, HOLD, TIMING
from eps_hil.diagnosis.balance.fit import fit, matters
from eps_hil.diagnosis.balance.probes import bounds, candidates
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.effects.catalogue import catalogue, with_model_effects
from eps_hil.physics.model import Model
from eps_hil.series import Series

pytestmark = pytest.mark.slow


def limits(problem: Problem, effect: str, parameter: str) -> tuple[float, float]:
    entry = catalogue()[effect]
    (found,) = (one for one in entry.parameters if one.name == parameter)
    return bounds(entry, found, problem)


def test_a_shape_upside_down_is_another_effect(problem: Problem) -> None:
    assert limits(problem, "stribeck", "level_nm")[0] == 0.0
    assert limits(problem, "quadratic_drag", "coefficient_nm_s2_per_rad2")[0] == 0.0
    assert limits(problem, "unmodelled_spring", "stiffness_nm_per_rad")[0] < 0.0


def test_what_the_model_holds_may_be_too_much(problem: Problem) -> None:
    held = {"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 10.0}
    model = replace(problem.model, effects=(held,))
    beside = Problem(problem.recordings, model)
    assert limits(beside, "stribeck", "level_nm")[0] < 0.0
    found = fit(beside, [{"effect": "stribeck", "level_nm": 0.0, "speed_rad_s": 10.0}])
    assert found.entries[0]["level_nm"] == pytest.approx(-0.02, abs=0.004)


def test_either_sign_where_the_shape_matters(problem: Problem) -> None:
    beside = Problem(problem.recordings, problem.model, either_sign=True)
    assert limits(beside, "stribeck", "level_nm")[0] < 0.0


def test_a_place_is_one_that_was_visited(problem: Problem) -> None:
    low, high = limits(problem, "position_dependent_friction", "centre_m")
    assert (low, high) == pytest.approx(problem.visited_m)
    widest = limits(problem, "position_dependent_friction", "width_m")[1]
    assert widest < 0.5 * (high - low)


def test_levels_of_both_directions_are_not_a_level_and_an_offset(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    plant = {other_rig.K0P: 5.6e-2 * 1.15, other_rig.K0N: 1.258e-1 * 0.9}
    found = diagnose(reference_model, record(plant), record(plant, ("weave",), 2)).content
    names = {one["effect"] for one in found["findings"]}
    assert "friction_asymmetry" in names
    assert not names & {"motor_torque_offset", "torque_sensor_offset"}


@pytest.mark.parametrize(
    ("beside", "constant"),
    [
        ([{"effect": "coulomb_level", "scale": 1.0}], "friction_asymmetry"),
        ([{"effect": "load_dependent_friction", "gain_nm_per_n": 0.0}], "friction_asymmetry"),
        ([{"effect": "viscous_friction", "coefficient_nm_s_per_rad": 0.0}], "friction_asymmetry"),
        ([{"effect": "inertia", "scale": 1.0}], "motor_torque_offset"),
        ([], "motor_torque_offset"),
    ],
)
def test_where_friction_is_off_anyway_a_constant_is_frictions(
    problem: Problem, beside: list[dict[str, Any]], constant: str
) -> None:
    """A constant fits as well under each of its names: the fewest causes say which comes first."""
    offset = {"effect": "motor_torque_offset", "offset_nm": 0.0}
    found = fit(problem, [*beside, offset])
    told = levels_first(problem, found, 10.0, {"friction_asymmetry"})
    names = [entry["effect"] for entry in told.entries]
    assert sorted(names) == sorted([constant, *(one["effect"] for one in beside)])
    assert levels_first(problem, found, 10.0, set()) is found  # it is not to be named


def test_a_stiffer_bristle_is_no_finding_where_the_angles_noise_hides_its_path(
    problem: Problem,
) -> None:
    """A rotor that creeps back inside the noise loses path, which only ever looks stiffer."""
    model = problem.model.friction
    level = 0.5 * (model.offset_pos_nm + model.offset_neg_nm)
    shorter = 0.2 * level / model.sigma0_nm_per_rad  # of the way that friction takes to turn
    stiff, soft = (
        {"effect": "presliding_hysteresis", "sigma0_nm_per_rad": model.sigma0_nm_per_rad * factor}
        for factor in (1 / 0.8, 0.8)
    )

    def with_angle(noise_rad: float) -> Problem:
        noisy = [
            one.changed(noise={**one.noise, "motor_angle_rad": noise_rad})
            for one in problem.recordings
        ]
        return Problem(noisy, problem.model)

    lost_per_noise = with_angle(1.0).recordings[0].lost_path_rad
    fine, coarse = (with_angle(shorter / lost_per_noise * share) for share in (0.5, 1.0))
    assert matters(stiff, fine)
    assert not matters(stiff, coarse)
    assert matters(soft, coarse)
    blind = [
        one.changed(raw={k: v for k, v in one.raw.items() if k != "motor_angle_rad"})
        for one in problem.recordings
    ]
    assert not matters(soft, Problem(blind, problem.model))


def test_a_delay_with_a_name_holds_all_of_it(problem: Problem) -> None:
    """How the torque is held, free beside it, would pull against it and widen its interval."""
    late = {"effect": "motor_torque_delay", "delay_s": 0.004}
    both = fit(problem, [late], 0, own={**TIMING, "inertia": 0.0})
    told = timed(problem, both)
    assert told.own.keys() == {"inertia"}
    small = fit(problem, [{**late, "delay_s": 1e-4}], 0, own={})
    told = timed(problem, small)
    assert told.entries == ()
    assert told.own.keys() == TIMING.keys()


def test_a_strong_drag_is_recognised_beside_a_model_that_is_no_fit(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """Where a refit bends the model out of all reason the search begins without one."""
    recordings = record({other_rig.QUAD: 8e-5, other_rig.STRIB: 0.02, other_rig.STRIB_W: 5.0})
    problem = Problem([prepare(name, one) for name, one in recordings.items()], reference_model)
    bare = fit(problem, [], 0, dict.fromkeys(ALL, 0.0))
    pool = candidates(problem, [], bare.residual, None, dict.fromkeys(ALL, 0.0))
    scored = [one for one in score(problem, bare, pool) if one.candidate.effect.id not in SPANNED]
    assert scored[0].candidate.effect.id == "quadratic_drag"
    told = scored[0].entry["coefficient_nm_s2_per_rad2"]
    assert told == pytest.approx(8e-5, rel=0.5)  # as far as a clipped residual can tell


def test_a_late_torque_that_may_not_be_named_is_unknown(
    record: Callable[..., Any], reference_model: Model
) -> None:
    late = replace(reference_model.delays_s, motor_torque=-2e-3)
    model = replace(reference_model, delays_s=late)
    told = diagnose(
        model, record({}), record({}, ("weave",), 2),
        without=("motor_torque_delay", "speed_sensor_delay"),
    ).content  # fmt: skip
    assert told["verdict"] == "unknown_effect"
    (finding,) = told["findings"]
    assert finding["effect"] == "unknown"


def test_an_unknown_effect_is_not_cut_into_names(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """An eddy-current brake is a level, a slope and a bend of friction, none of which is there."""
    plant = {other_rig.EDDY: 0.03, other_rig.EDDY_W: 15.0}
    told = diagnose(reference_model, record(plant), record(plant, ("weave",), 2)).content
    assert told["verdict"] == "unknown_effect"
    assert [one["effect"] for one in told["findings"]] == ["unknown"]
    assert told["findings"][0]["curve"]


@pytest.mark.parametrize("zero_rad", [0.0, 700.0])
def test_a_spring_is_one_wherever_its_angle_counts_from(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType, zero_rad: float
) -> None:
    stiffness = 4e-4
    ready = []
    for name, one in record({other_rig.SPRING: stiffness}, ("sweep", "weave"), 3).items():
        angle = one["motor_angle_rad"]
        moved = {**one, "motor_angle_rad": Series(angle.t_ns, angle.value + zero_rad)}
        ready.append(prepare(name, moved))
    found = select(Problem(ready, reference_model)).found
    (entry,) = found.entries
    assert entry["effect"] == "unmodelled_spring"
    half = found.half_width[0, "stiffness_nm_per_rad"]
    assert entry["stiffness_nm_per_rad"] == pytest.approx(stiffness, abs=max(half, 1e-5))
    if zero_rad:
        assert entry["middle_rad"] == pytest.approx(zero_rad, abs=10.0)


def test_a_late_torque_makes_no_refit_unbelievable(problem: Problem) -> None:
    """It bends no other number; but what ends where a fit stops is no torque that is late."""
    found = fit(problem, [], 0, {HOLD: 0.0})
    assert _believable(replace(found, own={HOLD: 5.0, "inertia": 2.0}))
    assert not _believable(replace(found, own={HOLD: 8.0, "inertia": 2.0}))
    assert not _believable(replace(found, own={HOLD: 0.0, "inertia": 4.0}))


def test_under_a_push_numbers_that_are_off_are_no_saturation(
    pushed: tuple[Any, Model, dict[str, dict[str, Series]]],
) -> None:
    """The motor's torque has a level for each direction there, and so does what saturates."""
    rig, model, recordings = pushed
    made = [prepare(name, recordings[name]) for name in ("1", "2")]
    problem = Problem(made, model)
    told = select(problem)
    assert not any(one.effect.id == "motor_torque_saturation" for one in told.pool)
    found = {str(one["effect"]): one for one in told.found.entries}
    assert set(found) <= set(SPANNED)
    # a level and what grows with the load are one number under a load that hardly changes
    written = with_model_effects(problem.with_entries(told.found.entries, told.found.own))
    levels = written.friction
    assert levels.offset_pos_nm + levels.load_pos_nm_per_n * rig.push == pytest.approx(
        rig.level_pos + rig.grows * rig.push, rel=0.01
    )
    assert levels.offset_neg_nm + levels.load_neg_nm_per_n * rig.push == pytest.approx(
        rig.level_neg + rig.grows * rig.push, rel=0.01
    )
