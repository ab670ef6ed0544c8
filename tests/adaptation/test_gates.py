"""Gates: met, not met, missing, absent, filtered."""

import math

import pytest
from pydantic import TypeAdapter, ValidationError

from eps_hil.adaptation.gates import (
    GATES,
    SLOWEST_FILTER_S,
    GateLimit,
    Gates,
    GateSettings,
    InjectionInputs,
)
from eps_hil.physics.model import Model
from eps_hil.service.limits import CEILINGS

GOOD = InjectionInputs(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", [name for name in GATES if name != "rack_force_n"])
def test_each_gate_judges_its_own_signal(reference_model: Model, name: str) -> None:
    limit = getattr(GateSettings(), name).limit
    for value, met in ((0.9 * limit, True), (-0.9 * limit, True), (1.1 * limit, False)):
        gates = Gates(GateSettings(), reference_model)
        states = gates.update(1e-3, GOOD._replace(**{name: value}))
        assert gates.met is met
        assert gates.closed == (() if met else (name,))
        state = next(one for one in states if one.name == name)
        assert (state.value, state.limit, state.met) == (value, limit, met)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_missing_and_broken_signals_are_never_met(reference_model: Model, value: float) -> None:
    gates = Gates(GateSettings(), reference_model)
    gates.update(1e-3, GOOD._replace(vehicle_speed_m_s=value))
    assert gates.closed == ("vehicle_speed_m_s",)


def test_before_the_first_sample_nothing_is_met(reference_model: Model) -> None:
    gates = Gates(GateSettings(), reference_model)
    assert not gates.met
    assert set(gates.closed) == set(GATES) - {"rack_force_n"}


def test_an_absent_signal_that_comes_is_judged_and_missed_when_it_goes(
    reference_model: Model,
) -> None:
    gates = Gates(GateSettings(rack_force_n=GateLimit(20.0, absent=True)), reference_model)
    for force, met in ((math.nan, True), (5.0, True), (50.0, False), (math.nan, False)):
        gates.update(1e-3, GOOD._replace(rack_force_n=force))
        assert gates.met is met
    broken = Gates(GateSettings(rack_force_n=GateLimit(20.0, absent=True)), reference_model)
    broken.update(1e-3, GOOD._replace(rack_force_n=math.inf))
    assert not broken.met


def test_the_position_comes_from_the_angle_where_it_must(reference_model: Model) -> None:
    gates = Gates(GateSettings(), reference_model)
    away = 0.006 * reference_model.rack_to_rotor_ratio_rad_per_m
    inputs = GOOD._replace(rack_position_m=math.nan, motor_angle_rad=away)
    gates.update(1e-3, inputs)
    assert gates.closed == ("rack_position_m",)
    assert next(g.value for g in gates.states if g.name == "rack_position_m") == pytest.approx(
        0.006
    )


def test_the_centre_is_where_the_settings_say(reference_model: Model) -> None:
    gates = Gates(GateSettings(rack_position_m=GateLimit(0.005, centre=0.02)), reference_model)
    gates.update(1e-3, GOOD._replace(rack_position_m=0.022))
    assert gates.met
    gates.update(1e-3, GOOD)
    assert not gates.met


def test_a_filter_averages_noise_but_not_a_missing_signal(reference_model: Model) -> None:
    gates = Gates(GateSettings(), reference_model)
    for k in range(2000):
        value = 0.049 if k % 2 else -0.03
        gates.update(1e-3, GOOD._replace(lateral_acceleration_m_s2=value))
        assert gates.met
    gates.update(1e-3, GOOD._replace(lateral_acceleration_m_s2=math.nan))
    assert not gates.met
    for _ in range(1000):
        gates.update(1e-3, GOOD._replace(lateral_acceleration_m_s2=0.2))
    assert not gates.met


def test_no_low_pass_is_slower_than_the_guard_waits_for_anything() -> None:
    """A gate of 1e9 s would never open again: the value of its first sample is its value for ever.

    The guard's longest patience is a second: for the operator's sign of life and a frozen input.
    """
    from_file = TypeAdapter(GateLimit).validate_python
    patience = {
        most for name, most in CEILINGS.items()
        if name == "heartbeat_timeout_s" or name.endswith("_frozen_s")
    }  # fmt: skip
    assert patience == {SLOWEST_FILTER_S}
    assert from_file({"limit": 1.0, "filter_s": SLOWEST_FILTER_S}).filter_s == SLOWEST_FILTER_S
    for slower in (1.01, 1e9, math.inf, math.nan):
        with pytest.raises(ValidationError, match="filter_s"):
            from_file({"limit": 1.0, "filter_s": slower})
