"""Clocks, rotor against rack, and the twist: on a truth plant of other code (``eps_hil/proof``)."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.first_look import FirstLook, first_look
from eps_hil.physics.model import Model
from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.world import Instruments, World
from eps_hil.series import Series

Look = Callable[..., FirstLook]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def look(reference_model: Model) -> Look:
    """A first look at two recordings and a hold-out of a world."""

    def at(
        world: World,
        change: Callable[[dict[str, Any]], None] | None = None,
        without: tuple[str, ...] = (),
        model: Model = reference_model,
    ) -> FirstLook:
        rng = np.random.default_rng(3)
        made = []
        for name, program in zip(
            ("a", "b", "c"),
            (*manoeuvres.training(rng), manoeuvres.holdout(rng)),
            strict=True,
        ):
            clean = sensors.reported(world.run(program), world.instruments)
            columns = sensors.measured(clean, world.instruments, rng)
            t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
            series = {key: Series(t_ns, value) for key, value in columns.items()}
            if change:
                change(series)
            made.append((prepare(name, series), series))
        return first_look(made[:2], made[2:], model, without)

    return at


FULL = World(simple=False)


def bent_by(slope_per_m: float) -> Callable[[dict[str, Any]], None]:
    """The same motion and the same work on a rack whose φ = i·x·(1 + slope·x)."""

    def bent(series: dict[str, Series]) -> None:
        x = series["rack_position_m"]
        place = (np.sqrt(1.0 + 4.0 * slope_per_m * x.value) - 1.0) / (2.0 * slope_per_m)
        series["rack_position_m"] = Series(x.t_ns, place)
        for name in ("rack_force_n", "torque_sensor_nm"):
            one = series[name]
            series[name] = Series(one.t_ns, one.value * (1.0 + 2.0 * slope_per_m * place))

    return bent


def only(found: FirstLook, effect: str, parameter: str) -> dict[str, Any]:
    (finding,) = found.findings
    assert finding["effect"] == effect
    value: dict[str, Any] = finding["parameters"][parameter]
    low, high = value["ci95"]
    assert low <= value["value"] <= high
    return value


@pytest.mark.parametrize("noise", [1.0, 3.0])
def test_five_masses_and_nothing_wrong_is_nothing(look: Look, noise: float) -> None:
    found = look(dataclasses.replace(FULL, instruments=Instruments(noise=noise)))
    assert found.findings == ()
    assert found.kinematics["rms_left_rad"] < 1.05 * found.kinematics["noise_rad"]


def test_a_soft_belt_is_found(look: Look) -> None:
    """In series with the plant's screw of 300 Nm/rad."""
    found = look(dataclasses.replace(FULL, belt_nm_per_rad=10.0, belt_damping=5e-3))
    value = only(found, "belt_compliance", "stiffness_nm_per_rad")
    assert value["value"] == pytest.approx(1 / (1 / 10 + 1 / 300), rel=0.02)
    assert found.entries[0]["effect"] == "belt_compliance"


@pytest.mark.parametrize("gap", [0.01, 0.1, 0.5])
def test_play_between_rotor_and_rack_is_found(look: Look, gap: float) -> None:
    found = look(dataclasses.replace(FULL, gap_rad=gap))
    assert only(found, "backlash", "gap_rad")["value"] == pytest.approx(gap, rel=0.03)
    barred = found.fitted[0].barred
    assert barred is not None
    assert 0.02 < np.mean(barred) < 0.5


@pytest.mark.parametrize(
    ("hidden", "withheld", "follows"),
    [
        ({"gap_rad": 0.1}, "backlash", "rack_force_n"),
        ({"belt_nm_per_rad": 10.0}, "belt_compliance", "rack_force_n"),
    ],
)
def test_what_no_name_may_stand_for_is_unknown(
    look: Look, hidden: dict[str, Any], withheld: str, follows: str
) -> None:
    found = look(dataclasses.replace(FULL, **hidden), without=(withheld,))
    assert found.left is not None
    content = found.added_to({"verdict": "no_mismatch", "findings": []})
    (unknown,) = content["findings"]
    assert unknown["effect"] == "unknown"
    assert unknown["where"][0]["signal"] == follows
    assert content["verdict"] == "unknown_effect"
    assert "mrad at the rotor" in unknown["summary"]
    assert max(abs(y) for _, y, _ in unknown["curve"]) > 0.02


def test_what_has_a_name_and_what_is_usual_leave_nothing_unknown(look: Look) -> None:
    assert look(dataclasses.replace(FULL, gap_rad=0.1)).left is None
    assert look(FULL, without=("belt_compliance", "rack_ratio", "backlash")).left is None


@pytest.mark.parametrize(("play", "rel"), [(0.04, 0.15), (0.1, 0.05), (0.4, 0.05)])
def test_play_in_the_torque_sensor_is_found_and_taken_out(
    look: Look, play: float, rel: float
) -> None:
    found = look(dataclasses.replace(FULL, instruments=Instruments(sensor_play_nm=play)))
    value = only(found, "torque_sensor_hysteresis", "play_nm")
    assert value["value"] == pytest.approx(play, rel=rel)


def test_a_wrong_ratio_is_found(look: Look) -> None:
    drive = FULL.drive._replace(rack_rad_per_m=2513.0 * 1.03)
    found = look(dataclasses.replace(FULL, drive=drive))
    assert only(found, "rack_ratio", "scale")["value"] == pytest.approx(0.03, abs=1e-4)
    assert found.model.effects[-1]["effect"] == "rack_ratio"


@pytest.mark.parametrize(
    ("effect", "hidden", "instruments", "parameter", "other"),
    [
        ("backlash", {"gap_rad": 0.1}, {}, "gap_rad", 0.05),
        (
            "belt_compliance",
            {"belt_nm_per_rad": 10.0, "belt_damping": 5e-3},
            {},
            "stiffness_nm_per_rad",
            20.0,
        ),
        ("torque_sensor_hysteresis", {}, {"sensor_play_nm": 0.4}, "play_nm", 0.2),
    ],
)
def test_what_the_model_holds_already_is_known_and_no_finding(
    look: Look,
    reference_model: Model,
    effect: str,
    hidden: dict[str, Any],
    instruments: dict[str, Any],
    parameter: str,
    other: float,
) -> None:
    """A written model meets its recordings again; one of another size is a finding, told whole."""
    world = dataclasses.replace(FULL, **hidden, instruments=Instruments(**instruments))
    first = look(world)
    value = only(first, effect, parameter)["value"]
    written = first.in_model(reference_model)
    again = look(world, model=written)
    assert again.findings == ()
    assert again.in_model(again.model).effects == written.effects
    for one, before in zip(again.fitted, first.fitted, strict=True):
        np.testing.assert_allclose(one.left_over(again.model), before.left_over(first.model))
    wrong = dataclasses.replace(reference_model, effects=({"effect": effect, parameter: other},))
    told = look(world, model=wrong)
    assert only(told, effect, parameter)["value"] == pytest.approx(value, rel=1e-6)
    assert [one[parameter] for one in told.in_model(told.model).effects] == [
        pytest.approx(value, rel=1e-6)
    ]


@pytest.mark.parametrize("slope_per_m", [0.0, 0.3])
def test_a_ratio_that_the_model_holds_is_the_models(
    look: Look, reference_model: Model, slope_per_m: float
) -> None:
    drive = FULL.drive._replace(rack_rad_per_m=2513.0 * 1.03)
    world = dataclasses.replace(FULL, drive=drive)
    change = bent_by(slope_per_m) if slope_per_m else None
    written = look(world, change).model
    again = look(world, change, model=written)
    assert again.findings == ()
    assert again.kinematics["ratio_error"] == pytest.approx(0.0, abs=1e-4)
    assert again.model.effects == written.effects


@pytest.mark.parametrize(("drift", "rel"), [(1e-4, 0.1), (6e-4, 0.01), (-1.5e-3, 0.01)])
def test_a_drifting_clock_is_found_and_set_right(look: Look, drift: float, rel: float) -> None:
    """A clock that stamps early: 100 ppm are 4 ms after 40 s, 1,500 ppm 60 ms."""
    found = look(dataclasses.replace(FULL, instruments=Instruments(speed_drift=drift)))
    value = only(found, "clock_drift", "ppm")
    assert value["value"] == pytest.approx(-1e6 * drift, rel=rel)
    assert found.findings[0]["signal"] == "motor_speed_rad_s"
    assert found.left is None


def test_a_late_angle_is_measured_against_the_rack(look: Look) -> None:
    found = look(dataclasses.replace(FULL, instruments=Instruments(speed_late_s=2e-3)))
    assert found.findings == ()
    assert found.kinematics["angle_delay_beyond_model_s"] == pytest.approx(2e-3, rel=0.02)


def test_clipped_samples_are_barred(look: Look) -> None:
    def clip(series: dict[str, Series]) -> None:
        force = series["rack_force_n"]
        series["rack_force_n"] = Series(force.t_ns, np.clip(force.value, -800.0, 800.0))

    found = look(FULL, clip)
    flags = {f for q in found.data_quality for c in q["channels"] for f in c["flags"]}
    assert "clipped" in flags
    assert found.fitted[0].barred is not None


def test_a_stuck_angle_is_no_rotor_that_comes_loose(look: Look) -> None:
    def hold(series: dict[str, Series]) -> None:
        angle = series["motor_angle_rad"]
        moving = int(np.argmax(np.abs(np.gradient(angle.value))))
        values = angle.value.copy()
        first = min(max(moving - 500, 0), len(values) - 2000)
        values[first : first + 1500] = values[first]
        series["motor_angle_rad"] = Series(angle.t_ns, values)

    found = look(FULL, hold)
    assert "stuck" in {f for q in found.data_quality for c in q["channels"] for f in c["flags"]}
    assert found.left is None
    assert found.findings == ()


@pytest.mark.parametrize("late_s", [-3e-4, 0.0, 3e-4])
def test_play_leaves_no_drag_behind_where_an_angle_is_late(look: Look, late_s: float) -> None:
    """Late by 0.3 ms of the pinion, the twist's torque has a part in step with the speed."""

    def later(series: dict[str, Series]) -> None:
        angle = series["steering_wheel_angle_rad"]
        t_ns = angle.t_ns.astype(np.float64)
        moved = np.interp(t_ns - 1e9 * late_s, t_ns, angle.value)
        series["steering_wheel_angle_rad"] = Series(angle.t_ns, moved)

    world = dataclasses.replace(FULL, instruments=Instruments(sensor_play_nm=0.2))
    found = look(world, later)
    whole = look(dataclasses.replace(FULL, instruments=Instruments()))
    true = {one.name: one.raw["torque_sensor_nm"] for one in whole.fitted}
    assert only(found, "torque_sensor_hysteresis", "play_nm")["value"] == pytest.approx(
        0.2, rel=0.1
    )
    for one in found.fitted:
        off = one.raw["torque_sensor_nm"] - true[one.name]
        rate = np.gradient(one.raw["rack_position_m"], 1e-3) * 125.7
        columns = np.column_stack([rate, np.ones(len(rate))])
        drag = float(np.linalg.lstsq(columns, off, rcond=None)[0][0])
        assert abs(drag) < 4e-3  # Nm s/rad at the column: a tenth of what 0.3 ms make


@pytest.mark.parametrize("slope_per_m", [-0.3, 0.4])
def test_a_ratio_that_varies_is_in_the_balance(
    look: Look, reference_model: Model, slope_per_m: float
) -> None:
    """The same motion and the same work, but for friction, which goes with the force itself."""
    found, straight = look(FULL, bent_by(slope_per_m)), look(FULL)
    value = only(found, "rack_ratio", "slope_per_m")
    assert value["value"] == pytest.approx(slope_per_m, rel=0.02)
    assert "varies over the rack position" in found.findings[0]["summary"]
    loose = dataclasses.replace(
        reference_model.friction, load_pos_nm_per_n=0.0, load_neg_nm_per_n=0.0
    )
    bent, plain = (dataclasses.replace(one.model, friction=loose) for one in (found, straight))
    for one, as_it_was in zip(found.fitted, straight.fitted, strict=True):
        off = one.left_over(bent) - as_it_was.left_over(plain)
        assert float(np.sqrt(np.mean(off**2))) < 2e-5
        off = one.left_over(plain) - as_it_was.left_over(plain)
        assert float(np.sqrt(np.mean(off**2))) > 5e-4
