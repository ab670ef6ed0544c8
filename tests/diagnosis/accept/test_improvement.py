"""An explanation is one only where hold-outs are better for it, beyond chance."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept.improvement import (
    NOT_CLEAR,
    Improvement,
    Judged,
    improvement,
    in_force,
    in_torque,
    only_if_clear,
)
from eps_hil.diagnosis.accept.proof_of_fit import Holdout, rack_force_error_n, torque_nrmse
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model
from eps_hil.series import Series

LEVEL_NM = 0.03
STRIBECK = {"effect": "stribeck", "level_nm": LEVEL_NM, "speed_rad_s": 10.0}


@pytest.fixture(scope="module")
def kept(record: Callable[..., Any], other_rig: ModuleType) -> list[Holdout]:
    """Of a rig with a Stribeck effect."""
    plant = {other_rig.STRIB: LEVEL_NM, other_rig.STRIB_W: 10.0}
    made = record(plant, ("weave", "slow"), seed=7, seconds=12.0)
    return [Holdout(prepare(*one), one[1]) for one in made.items()]


def with_(model: Model, level_nm: float) -> Model:
    return replace(model, effects=({**STRIBECK, "level_nm": level_nm},))


def test_the_share_is_that_of_the_figures_that_are_told(
    kept: list[Holdout], reference_model: Model
) -> None:
    right = with_(reference_model, LEVEL_NM)
    told = in_torque(Judged(kept, reference_model), Judged(kept, right))
    before, after = (torque_nrmse(kept, reference_model, m) for m in (reference_model, right))
    assert told.share == pytest.approx(1.0 - (after / before) ** 2)
    assert 0.0 < told.ci95[0] < told.share < told.ci95[1]
    # the force is compared only where the torque leaves it open
    assert list(improvement(Judged(kept, reference_model), Judged(kept, right), right, right)) == [
        "torque_residual"
    ]


def test_the_force_is_as_much_better_as_its_error_says(
    kept: list[Holdout], reference_model: Model
) -> None:
    right = with_(reference_model, LEVEL_NM)
    told = in_force(kept, reference_model, right)
    errors = [rack_force_error_n(kept, reference_model, m) for m in (reference_model, right)]
    assert told is not None
    assert None not in errors
    before, after = (float(one or 0.0) for one in errors)
    assert told.share == pytest.approx(1.0 - (after / before) ** 2, abs=0.1)
    bare = [
        replace(one, series={"motor_speed_rad_s": one.series["motor_speed_rad_s"]}) for one in kept
    ]
    assert in_force(bare, reference_model, right) is None


def test_what_is_no_better_is_not_explained(kept: list[Holdout], reference_model: Model) -> None:
    right, worse = (with_(reference_model, LEVEL_NM * k) for k in (1.0, 1.02))
    same = improvement(Judged(kept, right), Judged(kept, right), right, right)
    assert {name: one["share"] for name, one in same.items()} == {"torque_residual": 0.0}
    told = improvement(Judged(kept, right), Judged(kept, worse), right, worse)
    assert told["torque_residual"]["ci95"][0] < 0.0
    assert "rack_force" in told
    content = {
        "verdict": "explained",
        "findings": [{"effect": "stribeck"}],
        "limits": ["else"],
        "fit": {"improvement": same},
    }
    said = only_if_clear(content)
    assert said["verdict"] == "partly_explained"
    assert said["limits"][0] == "else"
    assert said["limits"][1].startswith(NOT_CLEAR)
    assert only_if_clear({**said, "verdict": "explained"})["limits"] == said["limits"]
    # a name of other evidence needs no gain here, and lends none to a name of the balance
    assert only_if_clear(content, ["stribeck"]) == content
    more = [{"effect": "dropped_frames"}, {"effect": "stribeck"}]
    assert only_if_clear({**content, "findings": more[:1]}, ["dropped_frames"])["limits"] == [
        "else"
    ]
    both = only_if_clear({**content, "findings": more}, ["dropped_frames"])
    assert both["verdict"] == "partly_explained"
    # nothing is said of findings that are none any more
    none = only_if_clear({**said, "verdict": "no_mismatch", "findings": []})
    assert (none["verdict"], none["limits"]) == ("no_mismatch", ["else"])
    better = {"torque_residual": {"share": 0.2, "ci95": [0.01, 0.4]}}
    assert only_if_clear({**content, "fit": {"improvement": better}})["verdict"] == "explained"


@pytest.mark.slow
def test_counted_losses_explain_though_no_torque_is_better(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """One frame in forty of the motor's torque is lost, nothing else is wrong."""
    made = record({}, ("sweep", "weave", "slow"), seed=3, seconds=12.0)
    for series in made.values():
        torque = series["motor_torque_nm"]
        there = np.arange(len(torque.t_ns)) % 40 != 0
        series["motor_torque_nm"] = Series(torque.t_ns[there], torque.value[there])
    last = list(made)[-1]
    told = diagnose(reference_model, made, {last: made.pop(last)}).content
    assert [one["effect"] for one in told["findings"]] == ["dropped_frames"]
    assert told["fit"]["improvement"] == {"torque_residual": {"share": 0.0, "ci95": [0.0, 0.0]}}
    assert told["verdict"] == "explained"
    assert not [one for one in told["limits"] if one.startswith(NOT_CLEAR)]


def test_short_holdouts_have_an_interval_too(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """2 s are one block of a longer one: in parts they are not all better alike."""
    plant = {other_rig.STRIB: LEVEL_NM, other_rig.STRIB_W: 10.0}
    (series,) = record(plant, ("weave",), seed=8, seconds=6.0).values()
    begin = series["motor_speed_rad_s"].t_ns[0]
    ends = begin + np.array([2.0, 4.01]) * 1e9
    for name, one in series.items():
        inside = (one.t_ns >= ends[0]) & (one.t_ns < ends[1])
        series[name] = Series(one.t_ns[inside], one.value[inside])
    kept = [Holdout(prepare("short", series), series)]
    told = in_torque(Judged(kept, reference_model), Judged(kept, with_(reference_model, LEVEL_NM)))
    assert told.ci95[1] - told.ci95[0] > 0.01


def test_a_gain_by_chance_has_zero_inside_its_interval() -> None:
    """Of blocks whose squares change at random, one in forty is clear; of a gain of all, each."""
    rng = np.random.default_rng(1)
    clear = 0
    for _ in range(200):
        before = 1.0 + 0.1 * rng.standard_normal(20)
        clear += Improvement.of([before], [before + 0.1 * rng.standard_normal(20)]).ci95[0] > 0.0
    assert 0 < clear < 0.07 * 200
    assert Improvement.of([before], [0.9 * before]).ci95 == pytest.approx((0.1, 0.1))
    assert Improvement.of([np.zeros(3)], [np.zeros(3)]).ci95 == (0.0, 0.0)


def test_what_acts_in_few_places_is_clear_where_it_acts() -> None:
    """An end stop met twice in 60 s of hold-outs, beside noise that stays as it was."""
    rng = np.random.default_rng(2)
    parts = [1.0 + 0.1 * rng.standard_normal(240) for _ in range(2)]
    noise = [0.01 * rng.standard_normal(240) for _ in range(2)]
    before = [one.copy() for one in parts]
    for one in before:
        one[100:105] += 200.0
    after = [one + more for one, more in zip(parts, noise, strict=True)]
    told = Improvement.of(before, after, finest=16)
    assert 0.7 < told.ci95[0] < told.share < told.ci95[1]
    # where it made one of the visits worse by as much, nothing is clear
    after[1][100:105] += 400.0
    assert Improvement.of(before, after, finest=16).ci95[0] < 0.0
