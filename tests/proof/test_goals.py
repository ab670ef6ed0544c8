"""The table: what is counted for which row, its interval, and whether it is met."""

import math
from typing import Any

import numpy as np
import pytest

from eps_hil.proof.goals import Figure, Scored, as_json, figures, table
from eps_hil.proof.judge import Estimate, Judgement


def _judged(kind: str, level: float = 0.6, **more: object) -> Judgement:
    values: dict[str, object] = {
        "id": "a", "kind": kind, "form": "full", "decoy": "", "level": level,
        "truths": ("stribeck",), "answered": True, "verdict": "explained", "first": "stribeck",
        "named": ("stribeck",), "in_set": ("stribeck",), "invented": (), "said_unknown": False,
        "estimates": (), "stated": (),
    }  # fmt: skip
    return Judgement(**{**values, **more})  # type: ignore[arg-type]


def _worth(baseline: float, augmented: float, oracle: float) -> dict[str, dict[str, float | None]]:
    names = {"baseline": baseline, "augmented": augmented, "oracle": oracle}
    return {n: {"rack_force_rmse_n": v, "residual_nm": v / 1e3} for n, v in names.items()}


def _row(rows: list[Figure], start: str) -> Figure:
    (found,) = (row for row in rows if row.what.startswith(start))
    return found


def test_shares_are_of_their_own_kind_and_level() -> None:
    cases = [Scored(_judged("singles", 0.6), {}) for _ in range(39)]
    cases += [Scored(_judged("singles", 0.6, first="inertia"), {})]
    cases += [Scored(_judged("singles", 0.3, first=""), {}), Scored(_judged("pairs"), {})]
    rows = figures(cases)
    row = _row(rows, "right name first, effect/noise 0.6")
    assert (row.value, row.cases, row.met) == (39 / 40, 40, True)
    assert row.low is not None
    assert row.low < 0.95
    assert _row(rows, "right name first, effect/noise 0.3").met is False
    assert _row(rows, "right name first, effect/noise 1.5").met is None
    assert _row(rows, "masked pairs, both named").met is True


def test_a_row_without_a_goal_is_neither_met_nor_missed() -> None:
    cases = [Scored(_judged("singles", 0.6), {}) for _ in range(3)]
    offset = {"truths": ("motor_torque_offset",), "first": "friction_asymmetry"}
    cases += [Scored(_judged("singles", 0.6, **offset), {})]
    rows = figures(cases)
    row = _row(rows, "right name first, at 0.6 and more, without the three constants")
    assert (row.value, row.cases, row.met, row.verdict) == (1.0, 3, None, "")
    assert _row(rows, "right name first, effect/noise 0.6").value == 0.75
    assert _row(rows, "masked pairs, both in").verdict == "no cases"


def test_no_diagnosis_is_a_false_alarm_and_a_wrong_name() -> None:
    silent: dict[str, Any] = {"answered": False, "first": "", "named": (), "in_set": ()}
    cases = [Scored(_judged("decoys", truths=(), **silent), {})]
    cases += [Scored(_judged("missing", **silent), {})]
    rows = figures(cases)
    assert _row(rows, "false alarms").value == 1.0
    assert _row(rows, "family withheld: wrong").value == 1.0
    assert _row(rows, "family withheld: said").value == 0.0


@pytest.mark.parametrize(("inside", "met"), [(5, False), (9, True), (10, False)])
def test_intervals_must_be_neither_too_narrow_nor_too_wide(inside: int, met: bool) -> None:
    estimates = tuple(Estimate("e", "p", 0.0, True, k < inside) for k in range(10))
    rows = figures([Scored(_judged("singles", estimates=estimates), {})])
    assert _row(rows, "90 %").met is met
    assert _row(rows, "95 % intervals as given; 0 parameters have none").value == 1.0


def test_silence_that_is_excused_is_no_name() -> None:
    """Of loads, right names stand alone, too: a sentence may name half of the catalogue."""
    excused = _judged("loads", group="spring", first="", named=(), told_hidden=("stribeck",))
    rows = figures([Scored(_judged("loads", group="spring"), {}), Scored(excused, {})])
    alone, either = (row for row in rows if row.what.startswith("loads, spring: right name first"))
    assert (alone.value, either.value) == (0.5, 1.0)


def test_what_has_no_figure_is_worth_nothing() -> None:
    """A written model whose simulation ends in NaN left the denominator."""
    none: dict[str, float | None] = {"rack_force_rmse_n": None, "residual_nm": None}
    worth = _worth(30.0, 10.0, 10.0)
    rows = figures([Scored(_judged("singles"), {**worth, "augmented": none})])
    assert _row(rows, "share of the true model's rack-force gain, all").value == 0.0


def test_a_long_case_that_failed_is_missed() -> None:
    assert _row(figures([], math.inf), "20 min").verdict == "MISSED"
    assert _row(figures([]), "20 min").verdict == "no cases"


def test_an_unknown_beside_the_right_name_is_more_than_the_right_set() -> None:
    rows = figures([Scored(_judged("singles", said_unknown=True), {})])
    assert _row(rows, "right set and nothing else").value == 0.0


def test_the_right_set_is_whole_and_nothing_more() -> None:
    cases = [Scored(_judged("singles", 0.6), {}), Scored(_judged("pairs"), {})]
    cases += [Scored(_judged("singles", 1.5, invented=("inertia",)), {})]
    cases += [Scored(_judged("pairs", truths=("stribeck", "backlash")), {})]
    cases += [Scored(_judged("singles", 0.3, in_set=()), {})]
    row = _row(figures(cases), "right set and nothing else")
    assert (row.value, row.cases, row.met) == (0.5, 4, False)


@pytest.mark.parametrize(
    ("effect", "parameter", "most"),
    [
        ("stribeck", "level_nm", 0.15),
        ("breakaway_dwell", "time_s", 0.15),
        ("motor_torque_delay", "delay_s", 0.15),
        ("cogging_torque", "amplitude_nm", 0.10),
    ],
)
def test_a_parameter_is_close_or_not(effect: str, parameter: str, most: float) -> None:
    errors = (most - 0.01, 0.01 - most, most + 0.01, -most - 0.01)
    estimates = tuple(Estimate(effect, parameter, error, None) for error in errors)
    faint = Scored(_judged("singles", 0.3, estimates=estimates), {})
    row = _row(figures([Scored(_judged("singles", estimates=estimates), {}), faint]), "parameters")
    assert (row.value, row.cases, row.met) == (0.5, 4, None)


def test_a_hold_out_is_as_good_as_the_truth_or_not() -> None:
    cases = [Scored(_judged("singles"), _worth(30.0, one, 10.0)) for one in (10.0, 11.4, 11.6, 9.0)]
    rows = figures(cases)
    row = _row(rows, "held-out residual ÷ the true model's, at most 1.15")
    assert (row.value, row.cases) == (0.75, 4)


def test_the_gain_counts_against_the_true_models() -> None:
    cases = [Scored(_judged("singles"), _worth(30.0, 12.0, 10.0)) for _ in range(9)]
    cases += [Scored(_judged("singles"), _worth(20.0, 20.0, 10.0))]
    rows = figures(cases)
    pooled = _row(rows, "share of the true model's rack-force gain, all")
    assert pooled.value == pytest.approx(9 * 18 / (9 * 20 + 10))
    assert _row(rows, "share of the true model's rack-force gain, median").value == 0.9
    ratio = _row(rows, "held-out residual ÷ the true model's, median")
    assert ratio.value == pytest.approx(1.2)
    assert ratio.met is False
    assert ratio.low == pytest.approx(1.2)


def test_a_case_without_a_diagnosis_gains_nothing() -> None:
    worth = _worth(30.0, 0.0, 10.0)
    del worth["augmented"]
    rows = figures([Scored(_judged("singles"), worth)])
    assert _row(rows, "share of the true model's rack-force gain, all").value == 0.0


def test_the_table_says_missed() -> None:
    rows = figures([Scored(_judged("singles", 0.3, first=""), {})])
    text = table(rows)
    assert "MISSED" in text
    assert "no cases" in text
    assert len(as_json(rows)) == len(rows) == len(text.splitlines()) - 1
    assert np.isfinite(as_json(rows)[0]["value"])


def test_beside_an_alien_only_the_known_effect_can_be_right() -> None:
    both: dict[str, Any] = {"truths": ("alien_eddy_brake", "stribeck")}
    cases = [Scored(_judged("beside", **both, named=("stribeck",)), {}) for _ in range(9)]
    cases += [Scored(_judged("beside", **both, named=(), invented=("inertia",)), {})]
    rows = figures(cases)
    row = _row(rows, "right name beside")
    assert (row.value, row.cases, row.met) == (0.9, 10, True)
    assert _row(rows, "false name beside").met is False


def test_of_three_effects_the_whole_set_counts() -> None:
    three = ("stribeck", "backlash", "inertia")
    right = Scored(_judged("triples", truths=three, in_set=three), {})
    less = Scored(_judged("triples", truths=three, in_set=three[:2]), {})
    more = Scored(_judged("triples", truths=three, in_set=three, invented=("cogging_torque",)), {})
    row = _row(figures([right, right, less, more]), "three effects")
    assert (row.value, row.cases, row.met) == (0.5, 4, False)
