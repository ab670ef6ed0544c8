"""Names beside a whole model of what has no name: what it holds by another word, what it left."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept import named_terms as module
from eps_hil.diagnosis.accept.named_terms import named_terms
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.attribute.select import Selection
from eps_hil.diagnosis.balance.baseline import HOLD, HOLD_S, TIMING
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.probes import Candidate
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.remainder.find import Remainder, Term, rounded
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

BRAKE_NM, BRAKE_RAD_S, SPRING, DELAY_S = 0.05, 30.0, 4e-4, 1.2e-3
SPEED, ANGLE = "motor_speed_rad_s", "motor_angle_rad"
BRAKE = {
    "effect": "empirical", "form": "law", "where": "rotor", "how": "sum",
    "inputs": [SPEED, SPEED], "memory": ["none", "none"], "shapes": ["linear", "rational"],
    "size": 2.0 * BRAKE_NM / BRAKE_RAD_S, "width_2": BRAKE_RAD_S,
    "range": {SPEED: [-400.0, 400.0]},
}  # fmt: skip
PULL = {
    "effect": "empirical", "form": "law", "where": "rotor", "how": "sum",
    "inputs": [ANGLE], "memory": ["none"], "shapes": ["linear"],
    "size": SPRING, "range": {ANGLE: [-1e3, 1e3]},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spring", "terms"),
    [(SPRING, (BRAKE, PULL)), (SPRING, (BRAKE,)), (0.0, (BRAKE,))],
    ids=["a law that is a spring", "a spring that is left", "nothing else"],
)
def test_a_spring_beside_a_law_of_a_brake(
    spring: float,
    terms: tuple[dict[str, Any], ...],
    fitted_and_kept: Callable[..., Any],
    reference_model: Model,
    other_rig: ModuleType,
) -> None:
    plant = {
        other_rig.EDDY: BRAKE_NM,
        other_rig.EDDY_W: BRAKE_RAD_S,
        other_rig.SPRING: spring,
    }
    problem, judged = fitted_and_kept(plant)
    selection, remainder = _with(problem, reference_model, terms)
    found = named_terms(problem, selection, [], remainder, judged, measured=True)
    if not spring:
        assert found is None
        return
    assert found is not None
    (k,) = found.findings
    entry = found.selection.found.entries[k]
    assert entry["effect"] == "unmodelled_spring"
    half = found.selection.found.half_width[k, "stiffness_nm_per_rad"]
    assert entry["stiffness_nm_per_rad"] == pytest.approx(spring, abs=max(half, 0.03 * spring))
    assert found.remainder.refitted
    (law,) = found.remainder.entries
    assert law["width_2"] == pytest.approx(BRAKE_RAD_S, rel=0.05)
    written = found.remainder.model.effects
    assert [one["effect"] for one in written] == ["unmodelled_spring", "empirical"]
    assert all(dict(one) == rounded(one) for one in written)
    # what is written leaves hardly more than the sensors' noise
    left = np.mean(problem.residual(found.remainder.model)[problem.sliding] ** 2)
    assert left < 1.2


@pytest.mark.slow
def test_a_name_that_gains_less_than_what_stays_unexplained_takes_no_place_of_a_law(
    fitted_and_kept: Callable[..., Any],
    reference_model: Model,
    other_rig: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, judged = fitted_and_kept(
        {other_rig.EDDY: BRAKE_NM, other_rig.EDDY_W: BRAKE_RAD_S, other_rig.SPRING: SPRING}
    )
    selection, remainder = _with(problem, reference_model, (BRAKE, PULL))
    monkeypatch.setattr(module, "unexplained", lambda *_: np.inf)
    assert named_terms(problem, selection, [], remainder, judged, measured=True) is None


@pytest.mark.slow
def test_a_delay_that_a_fit_beside_a_law_took_along_has_its_name(
    fitted_and_kept: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """The file has the motor's torque 1.2 ms early; beside the law, the rig's own is fitted."""
    problem, judged = fitted_and_kept({other_rig.EDDY: BRAKE_NM, other_rig.EDDY_W: BRAKE_RAD_S})
    delays = reference_model.delays_s
    early = replace(delays, motor_torque=delays.motor_torque + DELAY_S)
    given = Problem(problem.recordings, replace(reference_model, delays_s=early))
    selection, remainder = _with(given, reference_model, (BRAKE,))
    found = named_terms(given, selection, [], remainder, judged, measured=True)
    assert found is not None
    entries = [found.selection.found.entries[k] for k in found.findings]
    assert [one["effect"] for one in entries] == ["motor_torque_delay"]
    right = Problem(problem.recordings, replace(reference_model, effects=(BRAKE,)))
    held = fit(right, [], own=TIMING).own[HOLD]
    assert entries[0]["delay_s"] == pytest.approx(DELAY_S + held * HOLD_S, abs=0.1e-3)


@pytest.mark.parametrize("measured", [False, True])
def test_a_ratio_that_is_measured_is_not_tried_in_a_laws_place(
    measured: bool, problem: Problem, reference_model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[set[str]] = []
    monkeypatch.setattr(module, "_left_by_all", lambda *_: None)
    monkeypatch.setattr(module, "_one_named", lambda *given: asked.append(given[-1]))
    selection, remainder = _with(problem, reference_model, (BRAKE, PULL))
    kept = [Holdout(problem.recordings[1], {})]
    assert named_terms(problem, selection, [], remainder, kept, measured=measured) is None
    assert ["rack_ratio" in one for one in asked] == [measured]


def _with(
    problem: Problem, rig: Model, terms: tuple[dict[str, Any], ...]
) -> tuple[Selection, Remainder]:
    """No names, and a remainder of terms beside the rig's own numbers."""
    nothing = fit(problem, [])
    pool = [one for one in catalogue().values() if one.probe is not None]
    selection = Selection(nothing, nothing, [_asked(one) for one in pool], problem, nothing)
    with_all = replace(rig, effects=terms)
    remainder = Remainder(
        tuple(Term(dict(one), None) for one in terms), with_all, 1.0, (1.0, 1.0), nothing.residual,
        problem.residual(with_all), refitted=True,
    )  # fmt: skip
    return selection, remainder


def _asked(effect: Any) -> Any:
    """A candidate that says no more than that its effect may be considered."""
    return Candidate(effect, {}, np.zeros((0, 1)))
