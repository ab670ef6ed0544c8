"""Identification on rigs that this project's physics did not simulate."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.identification.identify import identify
from eps_hil.identification.result import Identification
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.series import Series

pytestmark = pytest.mark.slow

Recordings = Mapping[str, Mapping[str, Series]]


def with_signal(recordings: Recordings, signal: str, change: Callable[[Any], Any]) -> Recordings:
    return {
        name: {
            key: Series(one.t_ns, change(one.value)) if key == signal else one
            for key, one in series.items()
        }
        for name, series in recordings.items()
    }


def within_the_issues_limits(found: Identification, true: Any) -> None:
    p = found.parameters
    assert p["inertia_kg_m2"].value == pytest.approx(true.inertia_kg_m2, rel=0.03)
    assert p["friction.offset_pos_nm"].value == pytest.approx(true.k0_pos, rel=0.05)
    assert p["friction.offset_neg_nm"].value == pytest.approx(true.k0_neg, rel=0.05)
    assert p["friction.load_pos_nm_per_n"].value == pytest.approx(true.kr_pos, rel=0.08)
    assert p["friction.load_neg_nm_per_n"].value == pytest.approx(true.kr_neg, rel=0.08)
    skew = found.skews_s["motor_speed_minus_motor_torque"].value
    assert skew == pytest.approx(0.0045, abs=0.5e-3)


def test_everything_on_a_rig_of_the_models_form(
    programme: Recordings, reference_model: Model, true: Any
) -> None:
    found = identify(programme, reference_model)
    within_the_issues_limits(found, true)
    p = found.parameters
    truth = {
        "inertia_kg_m2": true.inertia_kg_m2,
        "friction.offset_pos_nm": true.k0_pos,
        "friction.offset_neg_nm": true.k0_neg,
        "friction.viscous_pos_nm_s_per_rad": true.kw_pos,
        "friction.viscous_neg_nm_s_per_rad": true.kw_neg,
        "friction.load_pos_nm_per_n": true.kr_pos,
        "friction.load_neg_nm_per_n": true.kr_neg,
        "friction.sigma0_nm_per_rad": true.sigma0,
        "friction.sigma1_nm_s_per_rad": true.sigma1,
    }
    intervals = {name: p[name].ci95 for name in truth}
    inside = [ci[0] <= truth[name] <= ci[1] for name, ci in intervals.items() if ci is not None]
    assert len(inside) == len(truth)
    assert sum(inside) >= len(truth) - 1
    assert p["friction.sigma0_nm_per_rad"].value == pytest.approx(true.sigma0, rel=0.06)
    assert p["friction.sigma1_nm_s_per_rad"].value == pytest.approx(true.sigma1, rel=0.3)
    assert p["delays_s.motor_speed"].value == pytest.approx(0.0052, abs=0.3e-3)
    assert found.delay_reference in ("rack_force", "torque_sensor")
    assert found.residual_nm < 1.1 * found.floor_nm
    preloaded = [c for c in found.map.cells if c.load_n > 1500 and c.seconds > 0.5]
    assert preloaded
    for cell in preloaded:
        k0, kr = (true.k0_pos, true.kr_pos) if cell.speed_rad_s > 0 else (true.k0_neg, true.kr_neg)
        kw = true.kw_pos if cell.speed_rad_s > 0 else true.kw_neg
        level = k0 + kw * abs(cell.speed_rad_s) + kr * cell.load_n
        assert cell.friction_nm == pytest.approx(level, rel=0.02)


def test_levels_on_five_masses_with_maxwell_slip(
    record: Callable[..., Any], reference_model: Model, true: Any
) -> None:
    what = {"constant_speed": 45.0, "sweep": 20.0}
    found = identify(record(what, simple=False), reference_model)
    within_the_issues_limits(found, true)


def test_a_stiffness_is_found_beside_the_damping_that_is_written(
    record: Callable[..., Any], reference_model: Model, true: Any
) -> None:
    """Maxwell slip shows no bristle damping: it stays the file's, and so does its speed."""
    what = {"constant_speed": 30.0, "slow_reversals": 20.0}
    found = identify(record(what, simple=False), reference_model)
    for name in ("sigma1_nm_s_per_rad", "sigma1_speed_rad_s"):
        one = found.parameters[f"friction.{name}"]
        assert one.status == "kept"
        assert one.value == getattr(reference_model.friction, name)
        assert getattr(found.model.friction, name) == one.value
    stiffness = found.parameters["friction.sigma0_nm_per_rad"].value
    assert stiffness == pytest.approx(true.sigma0, rel=0.06)
    assert found.presliding_misfit is not None
    assert found.presliding_misfit < 0.065  # 0.069 beside a damping that nobody writes


def test_one_preload_leaves_the_load_gains_to_the_model_file(
    record: Callable[..., Any], reference_model: Model
) -> None:
    recordings = with_signal(
        record({"constant_speed": 30.0}), "rack_force_n", lambda force: 0.0 * force
    )
    # a rack that is free in truth: the preload's share of the motor torque goes with it
    ratio = reference_model.rack_to_rotor_ratio_rad_per_m
    force = record({"constant_speed": 30.0})["constant_speed"]["rack_force_n"].value
    recordings = with_signal(recordings, "motor_torque_nm", lambda torque: torque - force / ratio)
    found = identify(recordings, reference_model)
    for side in ("pos", "neg"):
        one = found.parameters[f"friction.load_{side}_nm_per_n"]
        assert one.status == "kept"
        assert one.ci95 is None
        assert one.value == getattr(reference_model.friction, f"load_{side}_nm_per_n")
        assert "preload" in one.note
    assert found.model.friction.load_pos_nm_per_n == reference_model.friction.load_pos_nm_per_n


def test_without_a_load_cell_against_a_spring(
    record: Callable[..., Any], reference_model: Model, true: Any
) -> None:
    recordings = {
        name: {key: one for key, one in series.items() if key != "rack_force_n"}
        for name, series in record({"weave": 25.0, "multisine": 15.0}).items()
    }
    found = identify(recordings, reference_model)
    p = found.parameters
    assert p["inertia_kg_m2"].value == pytest.approx(true.inertia_kg_m2, rel=0.03)
    assert p["friction.offset_pos_nm"].value == pytest.approx(true.k0_pos, rel=0.05)
    assert p["friction.load_neg_nm_per_n"].value == pytest.approx(true.kr_neg, rel=0.08)
    assert found.loads["multisine"]["stiffness_n_per_m"] == pytest.approx(1.2e5, rel=0.02)
    # the speed is 1.2 ms later than the model file says: no damping must come of that
    assert found.loads["multisine"]["damping_n_s_per_m"] == pytest.approx(4.0e3, rel=0.02)
    truth = {"offset_pos_nm": true.k0_pos, "offset_neg_nm": true.k0_neg}
    truth |= {"viscous_pos_nm_s_per_rad": true.kw_pos, "viscous_neg_nm_s_per_rad": true.kw_neg}
    for name, value in truth.items():
        interval = p[f"friction.{name}"].ci95
        assert interval is not None
        assert interval[0] < value < interval[1]
    assert {one.kind for one in found.findings} >= {"no_load_cell"}
    alike = [unknown.what for unknown in found.cannot_tell]
    assert "viscous friction and the damping of the load" in alike


def test_an_unmeasured_load_that_is_no_spring_is_refused(
    record: Callable[..., Any], reference_model: Model
) -> None:
    series = record({"sweep": 20.0})["sweep"]
    lost = {key: one for key, one in series.items() if key != "rack_force_n"}
    with pytest.raises(InputError, match="record the load cell"):
        identify({"sweep": lost}, reference_model)


def test_what_a_model_says_of_its_ratio_is_not_lost(
    programme: Recordings, reference_model: Model
) -> None:
    """A ratio put right by an effect is the ratio of the model that is written."""
    true = reference_model.rack_to_rotor_ratio_rad_per_m
    effect = {"effect": "rack_ratio", "scale": 0.25, "slope_per_m": 0.01}
    model = replace(reference_model, rack_to_rotor_ratio_rad_per_m=true / 1.25, effects=(effect,))
    found = identify(programme, model).model
    worked_in = with_model_effects(found)
    assert worked_in.rack_to_rotor_ratio_rad_per_m == pytest.approx(true)
    assert [one["slope_per_m"] for one in worked_in.effects] == [pytest.approx(0.008)]


def test_torsion_bar_offset_from_hands_off(
    programme: Recordings, reference_model: Model, true: Any
) -> None:
    shifted = with_signal(programme, "torque_sensor_nm", lambda torque: torque + 0.2)
    found = identify(shifted, reference_model)
    offset = found.offsets["torque_sensor_offset_nm"]
    assert offset.value == pytest.approx(0.2, abs=0.01)
    assert [dict(entry) for entry in found.model.effects] == [
        {"effect": "torque_sensor_offset", "offset_nm": offset.value}
    ]
    assert found.parameters["friction.offset_pos_nm"].value == pytest.approx(true.k0_pos, rel=0.03)
    # once more from what it wrote: the offset was taken off twice, and the levels were 36 % off
    again = identify(shifted, found.model)
    assert again.model.effects == found.model.effects
    levels = ("friction.offset_pos_nm", "friction.offset_neg_nm")
    for name in levels:
        assert again.parameters[name].value == pytest.approx(found.parameters[name].value, rel=0.01)
    # and from a file whose offset has gone since
    corrected = identify(programme, found.model)
    assert not corrected.model.effects
    assert corrected.parameters[levels[0]].value == pytest.approx(true.k0_pos, rel=0.03)


@pytest.mark.parametrize(
    ("signals", "words"),
    [
        (("motor_torque_nm",), "motor_torque_nm has the wrong sign"),
        (("rack_force_n",), "rack_force_n has the wrong sign"),
        (("motor_speed_rad_s",), "opposite signs"),
        (("motor_speed_rad_s", "motor_angle_rad"), "motor_speed_rad_s .* has the wrong sign"),
    ],
)
def test_wrong_signs_are_named(
    programme: Recordings, reference_model: Model, signals: tuple[str, ...], words: str
) -> None:
    turned = programme
    for signal in signals:
        turned = with_signal(turned, signal, lambda values: -values)
    with pytest.raises(InputError, match=words):
        identify(turned, reference_model)


def swapped(recordings: Recordings, one: str, other: str) -> Recordings:
    return {
        name: {**series, one: series[other], other: series[one]}
        for name, series in recordings.items()
    }


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        ("motor_torque_nm", "torque_sensor_nm", "looks like motor_torque_nm.* swapped"),
        ("motor_torque_nm", "rack_force_n", "rack_force_n looks like motor_torque_nm.* swapped"),
        ("torque_sensor_nm", "rack_force_n", "rack_force_n looks like torque_sensor_nm.* swapped"),
        ("motor_speed_rad_s", "motor_angle_rad", "looks like the angle .* swapped"),
        ("motor_speed_rad_s", "motor_torque_nm", "motor_torque_nm looks like the speed"),
        ("rack_force_n", "rack_position_m", "do not balance"),
    ],
)
def test_swapped_columns_are_named(
    programme: Recordings, reference_model: Model, one: str, other: str, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        identify(swapped(programme, one, other), reference_model)


@pytest.mark.parametrize(
    ("signals", "factor", "words"),
    [
        (("rack_force_n",), 1e-3, "rack_force_n: is about 1000 times too small: in kN"),
        (("rack_force_n",), 1e3, "rack_force_n: is about 1000 times too large: in mN"),
        (("motor_torque_nm",), 1e3, "motor_torque_nm: is about 1000 times too large: in mNm"),
        (("torque_sensor_nm",), 1e3, "torque_sensor_nm: is about 1000 times too large: in mNm"),
        (("motor_speed_rad_s",), 9.5493, "in rpm"),
        (("motor_speed_rad_s", "motor_angle_rad"), 57.2958, "motor_angle_rad: is in degrees"),
        (("motor_torque_nm",), 0.0, "motor_torque_nm: is 0 all the time"),
    ],
)
def test_wrong_units_are_named(
    programme: Recordings,
    reference_model: Model,
    signals: tuple[str, ...],
    factor: float,
    words: str,
) -> None:
    wrong = programme
    for signal in signals:
        wrong = with_signal(wrong, signal, lambda values: factor * values)
    with pytest.raises(InputError, match=words):
        identify(wrong, reference_model)


def test_degrees_are_named_by_the_inertia_where_only_the_speed_is_recorded(
    programme: Recordings, reference_model: Model
) -> None:
    bare = {
        name: {k: v for k, v in series.items() if k not in ("motor_angle_rad", "rack_position_m")}
        for name, series in programme.items()
    }
    degrees = with_signal(bare, "motor_speed_rad_s", lambda speed: 57.2958 * speed)
    with pytest.raises(InputError, match=r"the inertia comes out 0\.01.* in degrees"):
        identify(degrees, reference_model)


def test_an_angle_that_starts_anew_every_turn_is_named(
    programme: Recordings, reference_model: Model
) -> None:
    wrapped = with_signal(programme, "motor_angle_rad", lambda a: (a + np.pi) % (2 * np.pi) - np.pi)
    with pytest.raises(InputError, match=r"jumps by 2π .* unwrap it"):
        identify(wrapped, reference_model)


def test_a_motor_that_is_a_spring_hides_its_delay(
    reference_model: Model, independent_rig: Any
) -> None:
    """Torque = −c φ − d ω: late torque, more viscous friction and less inertia look the same.

    Second truth plant: explicit integration at 100 kHz.
    """
    rig = independent_rig
    recordings = {}
    for name, force in (("sweep", rig.sweep(30.0)), ("steps", rig.steps())):
        columns = rig.run(force, np.zeros(len(force)), seed=len(name)).columns
        t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
        recordings[name] = {k: Series(t_ns, v) for k, v in columns.items() if k != "time_s"}
    found = identify(recordings, reference_model)
    p = found.parameters
    assert p["delays_s.motor_torque"].status == "kept"
    inertia = p["inertia_kg_m2"]
    assert inertia.ci95 is not None
    assert inertia.ci95[0] < rig.INERTIA < inertia.ci95[1]
    assert inertia.ci95[1] - inertia.ci95[0] > 0.02 * rig.INERTIA
    assert p["delays_s.motor_speed"].value == pytest.approx(0.004, abs=0.3e-3)
    assert p["friction.offset_pos_nm"].value == pytest.approx(0.056, rel=0.02)
    assert p["friction.load_neg_nm_per_n"].value == pytest.approx(4.345e-5, rel=0.03)


def test_a_time_in_ms_is_refused(programme: Recordings, reference_model: Model) -> None:
    slow = {
        name: {key: Series(one.t_ns * 1000, one.value) for key, one in series.items()}
        for name, series in programme.items()
    }
    with pytest.raises(InputError, match="is the time in ms"):
        identify(slow, reference_model)


def test_friction_below_zero_is_zero_and_the_rest_fitted_beside_it(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """A drive that helps with speed: viscous terms were cut, and the levels left as beside them,
    so that the friction written was too large at every speed."""
    recordings = record({"constant_speed": 30.0})
    for series in recordings.values():
        torque, speed = series["motor_torque_nm"], series["motor_speed_rad_s"]
        helped = torque.value - 6e-4 * np.interp(torque.t_ns, speed.t_ns, speed.value)
        series["motor_torque_nm"] = Series(torque.t_ns, helped)
    found = identify(recordings, reference_model)
    for name in ("viscous_pos_nm_s_per_rad", "viscous_neg_nm_s_per_rad"):
        one = found.parameters[f"friction.{name}"]
        assert getattr(found.model.friction, name) == one.value == 0.0
        assert one.ci95 is not None
        assert one.ci95[1] < 0.0
        assert "less than zero" in one.note
    f = found.model.friction
    for sign, level, load in (
        (1.0, f.offset_pos_nm, f.load_pos_nm_per_n),
        (-1.0, f.offset_neg_nm, f.load_neg_nm_per_n),
    ):
        cells = [c for c in found.map.cells if sign * c.speed_rad_s > 3.0]
        beyond = [c.friction_nm - level - load * c.load_n for c in cells]
        assert len(beyond) > 3
        assert abs(np.average(beyond, weights=[c.seconds for c in cells])) < 4e-3
