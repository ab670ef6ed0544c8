"""The model's own numbers as knobs: whatever is turned, a model file can hold it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.diagnosis.balance.baseline import ALL, HOLD, KNOBS, SIDES, is_free, law_knobs, turned
from eps_hil.physics.model import dump_model, load_model

REFERENCE = load_model(Path(__file__).parents[3] / "configs" / "reference_rig.yaml")


@given(
    st.dictionaries(
        st.sampled_from([knob.name for knob in KNOBS if knob.name != HOLD]), st.floats(-1e6, 1e6)
    )
)
def test_no_turn_makes_a_model_that_no_file_may_hold(values: dict[str, float]) -> None:
    moved = turned(REFERENCE, values)
    friction = moved.friction
    assert 0.0 < moved.inertia_kg_m2 < np.inf
    for name in ("offset", "viscous", "load"):
        for side in ("pos", "neg"):
            unit = {"offset": "nm", "viscous": "nm_s_per_rad", "load": "nm_per_n"}[name]
            assert getattr(friction, f"{name}_{side}_{unit}") >= 0.0
    assert friction.sigma0_nm_per_rad > 0.0


def test_the_written_model_can_be_read(tmp_path: Path) -> None:
    names = (knob.name for knob in KNOBS if knob.name != HOLD)
    (tmp_path / "m.yaml").write_text(dump_model(turned(REFERENCE, dict.fromkeys(names, -8.0))))
    assert load_model(tmp_path / "m.yaml").friction.offset_pos_nm == 0.0


@given(st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_what_goes_with_a_name_turns_the_directions_against_each_other(
    value: float, pos: float, neg: float
) -> None:
    """Their mean is the name's own, and is not touched; what else is turned stays turned."""
    first, second = "viscous_pos_nm_s_per_rad", "viscous_neg_nm_s_per_rad"
    (name,) = SIDES["viscous_friction"]
    assert name not in ALL
    model = replace(REFERENCE, friction=replace(REFERENCE.friction, **{first: 1e-3, second: 1e-3}))
    before = turned(model, {first: pos, second: neg}).friction
    after = turned(model, {first: pos, second: neg, name: value}).friction
    up, down = (getattr(after, side) - getattr(before, side) for side in (first, second))
    assert up == pytest.approx(7e-4 * value, abs=1e-15)  # half the mean, and 2e-4
    assert down == pytest.approx(-up, abs=1e-15)


def test_a_learnt_law_has_a_knob_for_each_of_its_numbers() -> None:
    """At nothing the law is what it was; each knob moves its own number alone."""
    law = {
        "effect": "empirical", "form": "law", "where": "rotor", "how": "sum",
        "inputs": ["motor_speed_rad_s", "motor_angle_rad"], "memory": ["none", "none"],
        "shapes": ["gaussian", "sine"], "size": 0.02, "centre_1": 4.0, "width_1": 2.0,
        "order_2": 1.25, "phase_2": 0.5,
    }  # fmt: skip
    model = replace(REFERENCE, effects=(law,))
    knobs = law_knobs(model, 0)
    keys = {name.split(".")[2] for name in knobs}
    assert keys == {"size", "centre_1", "width_1", "order_2", "phase_2"}
    assert law_knobs(model, 1) == {}
    assert not is_free(knobs)
    assert is_free({**ALL, **knobs})
    assert turned(model, knobs).effects == (law,)
    for name in knobs:
        (moved,) = turned(model, {**knobs, name: 1.0}).effects
        assert {key for key in law if moved[key] != law[key]} == {name.split(".")[2]}
    (far,) = turned(model, dict.fromkeys(knobs, -8.0)).effects
    assert far["width_1"] > 0.0
    (wild,) = turned(model, dict.fromkeys(knobs, 1e6)).effects  # one step of a fit may be
    assert np.isfinite(wild["width_1"])
