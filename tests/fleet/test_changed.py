"""A unit's changes as numbers, from the first state to the second, in whichever they were seen."""

from typing import Any

import pytest

from eps_hil.fleet.changed import NOTHING, UNDECIDED, rows_of, values_of


def content(seen_in: str, *findings: dict[str, Any], undecided: tuple[str, ...] = ()) -> Any:
    return {
        "findings": findings, "seen_in": seen_in, "undecided": undecided,
        "fit": {"holdout": {"baseline": {"torque_nrmse": 0.2}, "augmented": {}, "noise_floor": {}}},
    }  # fmt: skip


def found(
    effect: str,
    is_: str,
    parameters: dict[str, tuple[float, float, float]],
    before: tuple[dict[str, Any], ...] = (),
    size: float | None = None,
    numbers: tuple[tuple[str, float, float], ...] = (),
) -> dict[str, Any]:
    told = {
        name: {"value": value, "unit": "u", "ci95": [low, high]}
        for name, (value, low, high) in parameters.items()
    }
    moved = [{"name": n, "before": x, "after": y, "unit": "u"} for n, x, y in numbers]
    change = {"is": is_, "before": list(before), "size_after": size, "numbers": moved}
    return {"effect": effect, "confidence": 0.9, "parameters": told, "change": change}


LEVEL = "level_nm"


@pytest.mark.parametrize(
    ("seen_in", "finding", "before", "after"),
    [  # each state's number with its interval
        ("after", found("stribeck", "new", {LEVEL: (0.04, 0.03, 0.05)}),
         (0.0, None, None), (0.04, 0.03, 0.05)),
        ("before", found("stribeck", "gone", {LEVEL: (0.04, 0.03, 0.05)}),
         (0.04, 0.03, 0.05), (0.0, None, None)),
        ("after", found("stribeck", "gone", {LEVEL: (-0.04, -0.05, -0.03)}, ({LEVEL: 0.041},)),
         (0.04, 0.03, 0.05), (0.0, None, None)),
        ("before", found("stribeck", "new", {LEVEL: (-0.04, -0.05, -0.03)}),
         (0.0, None, None), (0.04, 0.03, 0.05)),
        ("after", found("stribeck", "stronger", {LEVEL: (0.02, 0.01, 0.03)}, ({LEVEL: 0.04},), 1.5),
         (0.04, None, None), (0.06, 0.05, 0.07)),
        ("after", found("stribeck", "stronger", {LEVEL: (0.06, 0.05, 0.07)}, ({LEVEL: 0.04},), 1.5),
         (0.04, None, None), (0.06, 0.05, 0.07)),  # fitted anew, not as a difference
        ("before", found("stribeck", "weaker", {LEVEL: (0.02, 0.01, 0.03)},
                         ({LEVEL: 0.04}, {LEVEL: 0.02}), 2 / 3),
         (0.06, 0.05, 0.07), (0.04, None, None)),
        ("after", found("cogging_torque", "weaker", {"amplitude_nm": (0.03, 0.02, 0.04)},
                        ({"amplitude_nm": 0.1},), 0.7),
         (0.1, None, None), (0.07, 0.06, 0.08)),  # a ripple that takes off some of another
        ("after", found("stribeck", "different", {LEVEL: (0.02, 0.01, 0.03)}, ({LEVEL: 0.04},)),
         (0.04, None, None), (None, None, None)),
        ("after", found("torque_sensor_gain", "new", {"gain": (1.1, 1.0, 1.2)}),
         (1.0, None, None), (1.1, 1.0, 1.2)),
        ("after", found("backlash", "new", {"gap_rad": (0.02, 0.01, 0.03)}),
         (0.0, None, None), (0.02, 0.01, 0.03)),
        ("after", found("inertia", "higher", {"scale": (1.2, 1.1, 1.3)}, size=1.2,
                        numbers=(("j", 2.0, 2.4),)),
         (2.0, None, None), (2.4, 2.2, 2.6)),
        ("before", found("inertia", "higher", {"scale": (0.8, 0.7, 0.9)}, size=1.25,
                         numbers=(("j", 1.6, 2.0),)),
         (1.6, 1.4, 1.8), (2.0, None, None)),
        ("after", found("viscous_friction", "lower",
                        {"coefficient_nm_s_per_rad": (-0.1, -0.2, -0.05)},
                        numbers=(("c", 0.5, 0.4),)),
         (0.5, None, None), (0.4, 0.3, 0.45)),
        ("after", found("inertia", "higher", {"scale": (1.2, 1.1, 1.3)},
                        numbers=(("j", 2.0, 3.5),)),
         (2.0, None, None), (3.5, None, None)),  # something else has moved it, too
        ("after", found("motor_torque_gain", "higher", {"gain": (1.1, 1.0, 1.2)},
                        numbers=(("gain", 2.0, 2.2),)),
         (2.0, None, None), (2.2, 2.0, 2.4)),  # one gain after the other
    ],
)  # fmt: skip
def test_a_number_of_both_states(
    seen_in: str, finding: dict[str, Any], before: Any, after: Any
) -> None:
    told = content(seen_in, finding)
    (row,) = rows_of(told)
    for state, (value, low, high) in (("before", before), ("after", after)):
        assert row[state] == pytest.approx(value), state
        assert row[f"{state}_low"] == pytest.approx(low), state
        assert row[f"{state}_high"] == pytest.approx(high), state
    steps: dict[str, Any] = {name: one for name, *one in values_of(told, [row]) if "." in name}
    if row["after"] is None:
        assert steps == {}
        return
    ((step, _unit, (low, high)),) = steps.values()
    assert step == pytest.approx(row["after"] - row["before"])
    assert (low is None) is (row["before_low"] is row["after_low"] is None)
    assert low is None or low < step < high


def test_where_an_effect_acts_is_no_amount() -> None:
    told = content(
        "after",
        found("stribeck", "new", {LEVEL: (0.04, 0.03, 0.05), "speed_rad_s": (6.0, 5.0, 7.0)}),
    )
    level, speed = rows_of(told)
    assert level["parameter"] == LEVEL
    assert (speed["before"], speed["after"], speed["after_high"]) == (None, 6.0, 7.0)
    assert [name for name, *_ in values_of(told, [level, speed])] == [
        "stribeck", "stribeck.level_nm", "torque_nrmse_as_before",
    ]  # fmt: skip


def test_what_has_no_number_and_no_change() -> None:
    unknown = {**found("unknown", "new", {}), "confusable_with": ["a", "b"]}
    (row,) = rows_of(content("after", unknown))
    assert (row["effect"], row["parameter"], row["confusable_with"]) == ("unknown", "", "a, b")
    (row,) = rows_of(content("after"))
    assert (row["change"], row["effect"], row["holdout_gain"]) == (NOTHING, "", None)
    (row,) = rows_of(content("before", undecided=("stribeck",)))
    assert (row["change"], row["effect"]) == (UNDECIDED, "stribeck")
