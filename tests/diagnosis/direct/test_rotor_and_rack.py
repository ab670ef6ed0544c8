"""Rotor against rack as least squares: against the same with every constant as a column."""

from collections.abc import Callable
from copy import copy
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.data.quality import look_at
from eps_hil.diagnosis.direct.kinematics import examine, small_ratio
from eps_hil.diagnosis.direct.rotor_and_rack import Rows, _held_out_gain, rotor_against_rack, solved
from eps_hil.diagnosis.direct.seen import robust_cost
from eps_hil.diagnosis.direct.separation import separation, shown
from eps_hil.physics.effects.catalogue import can_be
from eps_hil.physics.model import Model
from eps_hil.series import Series

NAMES = ["ratio", "delay", "compliance", "inertia"]
GROUP = ["half_gap"]


@pytest.fixture(scope="module")
def rows(record: Callable[..., Any], reference_model: Model) -> list[Rows]:
    made = record({}, ("weave", "slow", "sweep"), seconds=12.0)
    return [Rows(prepare(name, one), reference_model) for name, one in made.items()]


def _with_constants(rows: list[Rows], names: list[str]) -> tuple[Any, Any]:
    parts = []
    for k, one in enumerate(rows):
        constants = np.zeros((len(one.e), len(rows)))
        constants[:, k] = 1.0
        parts.append(np.hstack([constants, np.column_stack([one.columns[n] for n in names])]))
    sigma = np.concatenate([np.full(len(one.e), one.sigma) for one in rows])
    return np.vstack(parts) / sigma[:, None], np.concatenate([one.e for one in rows]) / sigma


def test_constants_taken_out_first_leave_the_same_numbers(rows: list[Rows]) -> None:
    a, b = _with_constants(rows, NAMES)
    expected = np.linalg.lstsq(a, b, rcond=None)[0]
    values, left = solved(rows, NAMES)
    assert list(values.values()) == pytest.approx(expected[len(rows) :].tolist(), rel=1e-6)
    np.testing.assert_allclose(left, b - a @ expected, atol=1e-6)


def test_what_is_gained_elsewhere_is_the_same(rows: list[Rows]) -> None:
    a, b = _with_constants(rows, [*NAMES, *GROUP])
    even = np.concatenate([one.block % 2 == 0 for one in rows])
    gain = 0.0
    for fitted in (even, ~even):
        for sign, columns in ((1.0, a[:, :-1]), (-1.0, a)):
            best = np.linalg.lstsq(columns[fitted], b[fitted], rcond=None)[0]
            gain += sign * robust_cost(b[~fitted] - columns[~fitted] @ best)
    assert _held_out_gain(rows, NAMES, GROUP) == pytest.approx(gain, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(("slope_per_m", "named"), [(2e-3, False), (0.5, True)])
def test_a_ratio_that_hardly_changes_is_no_finding(
    rows: list[Rows], reference_model: Model, slope_per_m: float, named: bool
) -> None:
    """However clear it is: in an hour of recordings everything is above the noise."""
    ratio = reference_model.rack_to_rotor_ratio_rad_per_m
    exact = []
    for one in rows:
        exact.append(copy(one))
        exact[-1].sigma = one.sigma * 1e-3
        exact[-1].e = slope_per_m * ratio * one.x**2
    found, _, accepted = rotor_against_rack(exact, [])
    assert "rack_ratio" in accepted
    assert any(one.entry["effect"] == "rack_ratio" for one in found) == named


@pytest.mark.parametrize("factor", [0.0, 1e-3, 1e3])
def test_a_ratio_that_no_drive_has_is_no_finding(
    record: Callable[..., Any], reference_model: Model, factor: float
) -> None:
    """Of an angle in another unit, or dead: no model file may hold it."""
    some = []
    for name, one in record({}, ("weave", "slow"), seconds=12.0).items():
        ready = prepare(name, one)
        angle = factor * ready.raw["motor_angle_rad"]
        some.append(ready.changed(raw={**ready.raw, "motor_angle_rad": angle}))
    seen = examine(some, [], reference_model)
    for effect in seen.seen:
        assert can_be(effect.entry, reference_model)
    assert small_ratio({"kinematics": seen.content, "findings": []}) == []


def test_two_that_cancel_each_other_do_not_pass_the_hold_outs(rows: list[Rows]) -> None:
    """Against a spring the torque is the place, and a soft belt a wrong ratio the other way."""
    rng = np.random.default_rng(3)
    fitted, kept = [copy(one) for one in rows], [copy(one) for one in rows]
    for one in fitted:
        spring = 0.02 * one.columns["ratio"]
        one.torque = spring + 0.03 * rng.standard_normal(len(one.e))
        one.columns = {**one.columns, "compliance": one.torque}
        one.e = 0.5 * (one.torque - spring) + one.sigma * rng.standard_normal(len(one.e))
    for one in kept:
        one.e = one.sigma * rng.standard_normal(len(one.e))
    found, _, _ = rotor_against_rack(fitted, [])
    assert {"belt_compliance", "rack_ratio"} <= {one.entry["effect"] for one in found}
    found, content, accepted = rotor_against_rack(fitted, kept)
    assert found == []
    assert accepted == []
    assert content["holdout_left_rad"] == pytest.approx(content["holdout_rms_rad"])


@pytest.mark.parametrize(("again", "told"), [(True, True), (False, False)])
def test_what_no_name_stands_for_shows_in_the_hold_outs_too(
    rows: list[Rows], again: bool, told: bool
) -> None:
    """A wave over the place, of twice the noise, in the fitted recordings and perhaps again."""
    rng = np.random.default_rng(2)
    fitted, kept = [copy(one) for one in rows], [copy(one) for one in rows]
    for one in (*fitted, *kept):
        wave = np.sin(2500.0 * one.x) if again or one in fitted else 0.0
        one.e = one.sigma * (2.0 * wave + rng.standard_normal(len(one.e)))
    left = separation(fitted, [], ())
    assert left is not None
    assert shown(left, kept, []) is told
    assert shown(left, [], [])


def test_a_joint_that_is_never_loaded_says_nothing(
    record: Callable[..., Any], reference_model: Model
) -> None:
    (one,) = (prepare(name, series) for name, series in record({}, ("weave",)).items())
    still = ("rack_force_n", "torque_sensor_nm", "motor_speed_rad_s")
    nothing = {name: np.zeros(len(one.time_s)) for name in still}
    free = one.changed(raw={**one.raw, **nothing})
    found = examine([free], [free], reference_model)
    assert found.seen == ()
    assert found.left is None
    assert found.content == {}


@pytest.mark.parametrize(("stiffness", "left"), [(8.0, False), (None, True)])
def test_friction_of_the_rack_goes_through_a_belt_that_gives(
    rows: list[Rows], stiffness: float | None, left: bool
) -> None:
    """Beside a belt it is no unknown; rotor and rack that part by themselves are one."""
    rng, parted = np.random.default_rng(3), []
    for one in rows:
        parted.append(copy(one))
        parted[-1].e = 0.002 * np.tanh(one.at["motor_speed_rad_s"] / 0.8)
        parted[-1].e += one.sigma * rng.standard_normal(len(one.e))
        if stiffness is not None:
            parted[-1].e = parted[-1].e + one.torque / stiffness
    accepted = ["belt_compliance"] if stiffness is not None else []
    assert (separation(parted, accepted, ()) is not None) == left


def test_bad_stretches_are_left_out(record: Callable[..., Any], reference_model: Model) -> None:
    """A stuck angle is no rotor that comes loose from its rack."""
    (series,) = record({}, ("weave",), seconds=12.0).values()
    angle = series["motor_angle_rad"]
    held = angle.value.copy()
    held[4000:7000] = held[4000]
    series = {**series, "motor_angle_rad": Series(angle.t_ns, held)}
    one, look = prepare("r", series), look_at("r", series)
    assert "stuck" in {flag for channel in look.channels for flag in channel.flags}
    whole = Rows(one, reference_model)
    barred = one.changed(barred=look.barred(one))
    good = Rows(barred, reference_model)
    assert np.std(whole.e) > 10 * whole.sigma
    assert np.std(good.e) < 2 * good.sigma
    assert len(good.e) == len(good.x) == len(good.block) == len(good.columns["delay"])
    seen = examine([barred], [barred], reference_model)
    assert seen.left is None
    assert seen.content["holdout_rms_rad"] < 2 * good.sigma
    nothing = one.changed(barred=np.ones_like(barred.barred))
    assert examine([nothing], [barred], reference_model).seen == ()
