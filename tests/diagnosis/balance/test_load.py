"""What a load that was not measured makes doubtful."""

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from eps_hil.diagnosis.balance.load import Load, doubted, load_of
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.identification.butterworth import low_pass
from eps_hil.physics.model import Model
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
def test_the_load_is_fitted_beside_the_friction_that_was_found(reference_model: Model) -> None:
    """Friction a fifth too small is no force: neither in its size nor in the model written."""
    hidden = {"coulomb_scale": 1.2}
    first, second, kept = driven("free_rack", hidden, 6, springs=True)
    told = diagnose(reference_model, {"a": first, "b": second}, {"kept": kept})
    (finding_,) = told.content["findings"]
    assert finding_["effect"] == "coulomb_level"
    scale = finding_["parameters"]["scale"]
    assert scale["ci95"][0] < 1.2 < scale["ci95"][1]
    assert [entry["effect"] for entry in told.model.effects] == ["coulomb_level"]
    assert told.model.friction == reference_model.friction
