"""What a load that was not measured makes doubtful."""

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from eps_hil.diagnosis.balance.load import (
    FREE,
    LIKE_LOAD,
    NAMED,
    Load,
    doubted,
    load_knobs,
    load_of,
    not_told_apart,
    own_drag,
)
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.data.size import size_of
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.identification.butterworth import low_pass
from eps_hil.physics.model import Friction, Model
from eps_hil.physics.simulate import simulate
from eps_hil.proof import sensors
from eps_hil.proof.manoeuvres import column
from eps_hil.proof.programmes import programme
from eps_hil.proof.world import World
from eps_hil.series import Series


def finding(effect: str) -> dict[str, object]:
    return {"effect": effect, "confidence": 0.9, "confusable_with": [], "next_experiment": ""}


def test_friction_at_a_place_may_be_friction_of_a_springs_load() -> None:
    spring = Load("spring", 5e4, 100.0, 0.0)
    place, other = doubted(
        [finding("position_dependent_friction"), finding("cogging_torque")], spring
    )
    assert place["confusable_with"] == ["load_dependent_friction"]
    assert place["confidence"] == 0.45
    assert "record the rack force" in str(place["next_experiment"])
    assert other == finding("cogging_torque")


@pytest.mark.parametrize("load", [None, Load("arbitrary", 0.0, 0.0, 0.0)])
def test_without_a_spring_it_stands(load: Load | None) -> None:
    one = finding("position_dependent_friction")
    assert doubted([one], load) == [one]


@pytest.mark.parametrize("load", [Load("free", 0.0, 0.0, 0.0), Load("spring", 4e4, 300.0, 50.0)])
def test_with_no_rack_force_a_sensor_s_gain_may_be_the_ratio(load: Load) -> None:
    """Both only scale what the torsion bar brings to the rotor."""
    (one,) = doubted([finding("torque_sensor_gain")], load)
    assert one["confusable_with"] == ["rack_ratio"]
    assert one["confidence"] == 0.45
    (measured,) = doubted([finding("torque_sensor_gain")], None)
    assert measured["confusable_with"] == []


def test_beside_any_force_a_twin_that_was_not_asked_for_is_told() -> None:
    """A sensor's gain is hidden by such a force, and a joint that hardly turns looks like it."""
    load = Load("arbitrary", 0.0, 0.0, 0.0)
    joint, cogging = doubted([finding("cardan_joint"), finding("cogging_torque")], load)
    assert joint["confusable_with"] == ["torque_sensor_gain"]
    assert joint["confidence"] == 0.45
    assert cogging["confusable_with"] == []  # its twin, torque_ripple, was asked for


def test_what_a_load_could_do_is_half_as_sure_of_a_rack_that_is_taken_as_free() -> None:
    asymmetry, ripple = doubted([finding("friction_asymmetry"), finding("torque_ripple")], NAMED)
    assert asymmetry["confidence"] == 0.45
    assert "record the rack force" in str(asymmetry["next_experiment"])
    assert ripple == finding("torque_ripple")


def test_nothing_stands_for_the_load_of_a_rack_that_is_taken_as_free() -> None:
    assert not load_knobs(NAMED)
    assert not not_told_apart(NAMED)
    assert set(not_told_apart(FREE)) == set(LIKE_LOAD)
    assert load_knobs(FREE)


def test_the_written_model_pulls_as_the_load_did(reference_model: Model) -> None:
    """In the place of a force that no input holds: the same torque at the rotor, and friction."""
    load = Load("spring", 4e4, 300.0, 50.0)
    written = load.in_model(reference_model)
    time_s = np.arange(2000, dtype=np.float64) * 1e-3
    motor_nm = np.asarray(0.8 * np.sin(6.0 * time_s), dtype=np.float64)
    none = np.zeros(len(time_s))
    with_it = simulate(written, time_s, motor_nm, none, none)
    ratio = reference_model.rack_to_rotor_ratio_rad_per_m
    force = none
    for _ in range(40):  # the same load as an input, which follows the motion that it makes
        run = simulate(reference_model, time_s, motor_nm, none, force)
        wanted = (4e4 * run.angle_rad + 300.0 * run.speed_rad_s) / ratio + 50.0
        force = 0.7 * force + 0.3 * wanted
    assert np.std(run.angle_rad) > 1.0
    assert with_it.angle_rad == pytest.approx(
        run.angle_rad, abs=0.02 * float(np.std(run.angle_rad))
    )


def test_a_weight_is_written_with_its_friction(reference_model: Model) -> None:
    """1,500 N is 0.6 Nm at the rotor, more than a motor's offset usually is."""
    weight = Load("spring", 0.0, 0.0, 1500.0)
    time_s = np.arange(2000, dtype=np.float64) * 1e-3
    motor_nm = np.asarray(0.6 + 0.3 * np.sin(6.0 * time_s), dtype=np.float64)
    none = np.zeros(len(time_s))
    expected = simulate(reference_model, time_s, motor_nm, none, none + 1500.0).angle_rad
    told = simulate(weight.in_model(reference_model), time_s, motor_nm, none, none).angle_rad
    assert np.std(expected) > 0.5
    assert told == pytest.approx(expected, abs=0.02 * float(np.std(expected)))


def test_a_force_that_may_have_any_form_hides_the_motors_scale_too() -> None:
    """A motor that holds against it has a torque that is like it, less of which leaves less."""
    arbitrary = Load("arbitrary", 4e4, 300.0, 50.0)
    assert "stribeck" in not_told_apart(arbitrary)
    followed = arbitrary.followed()
    assert {"motor_torque_gain", "unmodelled_spring"} <= set(not_told_apart(followed))
    assert not {"stribeck", "motor_torque_delay"} & set(not_told_apart(followed))
    assert "may be a load of another form" in followed.sentence()
    assert "motor_torque_gain" not in not_told_apart(replace(followed, doubtful=False))


def test_a_load_that_no_model_can_hold_is_not_written(reference_model: Model) -> None:
    assert Load("spring", 1e9, 0.0, 0.0).in_model(reference_model) is reference_model
    assert Load("arbitrary", 1e4, 0.0, 0.0).in_model(reference_model) is reference_model


STIFFNESS, DAMPING = 4e4, 300.0


def on_a_spring(model: Model, level: float, other_rig: ModuleType, seed: int) -> Prepared:
    """A rig against spring and damper, its friction levels times ``level``, without a load cell."""
    plant = {place: level * other_rig._BASE[place] for place in (other_rig.K0P, other_rig.K0N)}
    columns = other_rig.record(other_rig.Effects(plant), "weave", seed, 1.0, 20.0)
    t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
    ready = prepare("weave", {name: Series(t_ns, one) for name, one in columns.items()})
    raw = {**ready.raw}
    x = raw["rack_position_m"]
    force = STIFFNESS * x + DAMPING * np.gradient(low_pass(x, 20.0), 1e-3)
    push = (force - raw.pop("rack_force_n")) / model.rack_to_rotor_ratio_rad_per_m
    late = round(1e3 * model.delays_s.motor_torque)
    raw["motor_torque_nm"] = raw["motor_torque_nm"] + np.roll(push, late)
    return ready.changed(raw=raw)


@pytest.mark.slow
def test_a_damper_takes_in_no_friction(reference_model: Model, other_rig: ModuleType) -> None:
    """A fifth more or less of friction is no load: 0.01 Nm at 30 rad/s would be 2,000 N s/m."""
    loads = [
        load_of(
            [on_a_spring(reference_model, level, other_rig, seed) for seed in (1, 2)],
            reference_model,
        )
        for level in (1.0, 1.2, 0.8)
    ]
    for one in loads:
        assert one.form == "spring"
        assert one.stiffness_n_per_m == pytest.approx(STIFFNESS, rel=0.1)
        assert one.damping_n_s_per_m == pytest.approx(DAMPING, abs=200.0)


def joint(drag: float, damper: float = 0.0) -> Model:
    """A joint that a spring holds, whose bristle is soft: friction turns over 10 mrad."""
    friction = Friction(0.8, 0.8, drag, drag, 0.0, 0.0, 300.0, 0.0, 0.75)
    held = {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 8.0}
    damped = {"effect": "viscous_friction", "coefficient_nm_s_per_rad": damper}
    return Model(0.2, 125.7, 2513.0, friction, effects=(held, damped) if damper else (held,))


def moved(truth: Model) -> Prepared:
    """The joint as it is driven to and fro, its samples 1 ms apart."""
    time_s = np.arange(40_000, dtype=np.float64) * 1e-3
    motor_nm = np.asarray(3.0 * np.sin(1.5 * time_s) + 2.0 * np.sin(4.3 * time_s))
    none = np.zeros(len(time_s))
    run = simulate(truth, time_s, motor_nm, none, none)
    t_ns = np.round(time_s * 1e9).astype(np.int64)
    rng = np.random.default_rng(3)
    columns = {
        "motor_torque_nm": motor_nm + 0.01 * rng.standard_normal(len(time_s)),
        "motor_angle_rad": run.angle_rad + 1e-5 * rng.standard_normal(len(time_s)),
        "motor_speed_rad_s": run.speed_rad_s + 1e-3 * rng.standard_normal(len(time_s)),
    }
    one = prepare("joint", {name: Series(t_ns, values) for name, values in columns.items()})
    return one.changed(size=size_of([one], truth))


@pytest.mark.parametrize("told", [20.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_drag_that_is_off_is_no_damper(told: float) -> None:
    """A drag inside friction lags as the bristle does; a damper that stood for it would not."""
    ready, given = [moved(joint(4.0))], replace(joint(told), effects=())
    load = load_of(ready, given)
    assert load.form == "spring"
    assert load.drag_nm_s_per_rad == pytest.approx(4.0 - told, abs=0.2)
    assert load.damping_n_s_per_m == 0.0
    written = load.in_model(given)
    assert written.friction.viscous_pos_nm_s_per_rad == pytest.approx(4.0, abs=0.2)
    (said,) = own_drag(given, written)
    assert f"not {told:g}" in said
    assert own_drag(given, given) == []


@pytest.mark.parametrize("damper", [pytest.param(0.0, marks=pytest.mark.slow), 10.0])
def test_a_damper_of_the_load_s_own_stays_one(damper: float) -> None:
    load = load_of([moved(joint(4.0, damper))], replace(joint(4.0), effects=()))
    assert load.drag_nm_s_per_rad == 0.0
    assert load.damping_n_s_per_m / 2513.0**2 == pytest.approx(damper, abs=0.5)


def driven(
    name: str, hidden: dict[str, float], seed: int, springs: bool = False
) -> list[dict[str, Series]]:
    """Recordings of a rig of the model's form with this hidden, without a load cell.

    Against ``springs``, if any, of :data:`STIFFNESS` and :data:`DAMPING`.
    """
    rng, rig = np.random.default_rng(seed), World(simple=True)
    rig = replace(rig, hidden=rig.hidden._replace(**hidden))
    made = []
    for program in programme(name, rng):
        if springs:
            program[:, column("rig_n_per_m")] = STIFFNESS
            program[:, column("rig_n_s_per_m")] = DAMPING
        clean = sensors.reported(rig.run(program), rig.instruments)
        columns = sensors.measured(clean, rig.instruments, rng)
        t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
        columns.pop("rack_force_n")
        made.append({key: Series(t_ns, one) for key, one in columns.items()})
    return made


@pytest.mark.slow
def test_a_ripple_under_any_force_has_its_own_size(reference_model: Model) -> None:
    """What the force takes up of the balance it takes up of the ripple, too."""
    first, second, kept = driven("training", {"screw_nm": 0.012}, 6)
    told = diagnose(reference_model, {"a": first, "b": second}, {"kept": kept}).content
    assert any("follows no spring and damper" in one for one in told["limits"])
    (finding_,) = told["findings"]
    assert finding_["effect"] == "screw_ripple"
    amplitude = finding_["parameters"]["amplitude_nm"]
    assert amplitude["value"] == pytest.approx(0.012, rel=0.04)
    assert amplitude["ci95"][0] < 0.012 < amplitude["ci95"][1]


@pytest.mark.slow
def test_a_free_rack_is_none_where_a_load_explains_less(reference_model: Model) -> None:
    """A drag of the second order looks like a damper, with whose force friction seems to grow."""
    first, second, kept = driven("free_rack", {"quadratic": 5e-5}, 6)
    told = diagnose(reference_model, {"a": first, "b": second}, {"kept": kept}).content
    (finding_,) = told["findings"]
    assert finding_["effect"] == "quadratic_drag"
    value = finding_["parameters"]["coefficient_nm_s2_per_rad2"]["value"]
    assert value == pytest.approx(5e-5, rel=0.1)
    assert any("free rack" in one for one in told["limits"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "effect"),
    [
        ({"half_difference_nm": 0.008}, "friction_asymmetry"),
        ({"spring": 1.5e-3}, "unmodelled_spring"),
    ],
)
def test_what_a_load_could_do_is_named_of_a_free_rack(
    reference_model: Model, hidden: dict[str, float], effect: str
) -> None:
    """Numbers that stand for a load would hold it, and the verdict would be that nothing is off.

    While sliding an asymmetry is a constant torque.
    """
    first, second, kept = driven("free_rack", hidden, 6)
    told = diagnose(reference_model, {"a": first, "b": second}, {"kept": kept}).content
    (finding_,) = told["findings"]
    assert effect in (finding_["effect"], *finding_["confusable_with"])
    assert finding_["confidence"] <= 0.5
    (found,), (true,) = finding_["parameters"].values(), hidden.values()
    assert abs(found["value"]) == pytest.approx(true, rel=0.1)
    before, after = (
        told["fit"]["holdout"][one]["torque_nrmse"] for one in ("baseline", "augmented")
    )
    assert after < 0.7 * before


@pytest.mark.slow
def test_a_free_rack_with_nothing_missing_gets_no_name(reference_model: Model) -> None:
    first, second, kept = driven("free_rack", {}, 7)
    told = diagnose(reference_model, {"a": first, "b": second}, {"kept": kept}).content
    assert told["verdict"] == "no_mismatch"
    assert told["findings"] == []


@pytest.mark.slow
def test_the_load_is_fitted_beside_the_friction_that_was_found(reference_model: Model) -> None:
    """Friction a fifth too small is no force: neither in its size nor in the load written."""
    hidden = {"coulomb_scale": 1.2}
    first, second, kept = driven("free_rack", hidden, 6, springs=True)
    told = diagnose(reference_model, {"a": first, "b": second}, {"kept": kept})
    (finding_,) = told.content["findings"]
    assert finding_["effect"] == "coulomb_level"
    scale = finding_["parameters"]["scale"]
    assert scale["ci95"][0] < 1.2 < scale["ci95"][1]
    (level, *load, rubbing) = told.model.effects
    assert level["effect"] == "coulomb_level"
    assert rubbing["where"] == "friction"
    written = {str(one["effect"]): next(v for k, v in one.items() if k != "effect") for one in load}
    squared = reference_model.rack_to_rotor_ratio_rad_per_m**2
    assert written["unmodelled_spring"] * squared == pytest.approx(STIFFNESS, rel=0.1)
    assert written["viscous_friction"] * squared == pytest.approx(DAMPING, abs=200.0)
    assert abs(written["motor_torque_offset"]) < 5e-3
    assert told.model.friction == reference_model.friction
