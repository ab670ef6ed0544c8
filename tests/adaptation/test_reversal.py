"""Reversal adaptation: the sum of both levels at any load, and honesty about the rest."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.adaptation.gates import InjectionInputs
from eps_hil.adaptation.reversal import ReversalAdaptation, ReversalSettings, ReversalState
from eps_hil.adaptation.reversal_fit import Blocks, Stretch, blocks_of, evidence
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import Model
from eps_hil.proof.manoeuvres import weave
from eps_hil.proof.sensors import measured, reported
from eps_hil.proof.world import World
from eps_hil.rig.manoeuvre import Driver, Manoeuvre, Motor, Rig, Segment
from eps_hil.rig.offline import simulate_recording
from eps_hil.rig.profile import Multisine, Sine, _Profile

Floats = npt.NDArray[np.float64]
Columns = Mapping[str, Floats]

CHAIN = Path(__file__).parents[2] / "configs" / "reference_chain.yaml"
TRUE = 5.6e-2 + 1.258e-1
BLIND = ReversalSettings(load_cell=False)


def driving(model: Model, *, road_n: float = 0.0, amplitude: float = 1.2) -> Columns:
    """Half a minute of a driver who weaves against a tyre, on a smooth or a bumpy road."""
    angle = _Profile(
        sine=Sine(amplitude=amplitude, frequency_hz=0.25, fade_s=0.8),
        multisine=Multisine(rms=0.25 * amplitude, from_hz=0.1, to_hz=0.6, lines=10),
    )
    road = Multisine(rms=road_n, from_hz=1.0, to_hz=12.0, lines=40)
    segment = Segment(
        duration_s=33.0,
        rack_force_n=_Profile(multisine=road),
        rig=Rig(stiffness_n_per_m=46e3, damping_n_s_per_m=500.0),
        driver=Driver(angle_rad=angle, stiffness_nm_per_rad=30.0, damping_nm_s_per_rad=1.0),
        motor=Motor(assist_nm_per_nm=0.1, damping_nm_s_per_rad=5e-4),
    )
    manoeuvre = Manoeuvre("driving", (segment,))
    return simulate_recording(model, load_chain(CHAIN), manoeuvre).columns


def feed(
    columns: Columns, model: Model, choice: ReversalSettings = BLIND, *, angle: bool = True
) -> list[ReversalState]:
    """All states on the way; the last one is the result."""
    adaptation = ReversalAdaptation(choice, model)
    missing = np.full(len(columns["time_s"]), math.nan)
    rows = zip(
        columns["motor_torque_nm"],
        columns["motor_speed_rad_s"],
        columns["torque_sensor_nm"],
        columns["motor_angle_rad"] if angle else missing,
        columns["rack_force_n"],
        strict=True,
    )
    states = []
    for k, (torque, speed, sensor, phi, force) in enumerate(rows):
        inputs = InjectionInputs(torque, speed, sensor, phi, rack_force_n=force)
        state = adaptation.step(k * 1_000_000, inputs)
        if state is not None:
            states.append(state)
    assert adaptation.state == states[-1]
    return states


@pytest.fixture(scope="module")
def smooth(reference_model: Model) -> Columns:
    return driving(reference_model)


@pytest.fixture(scope="module")
def bumpy(reference_model: Model) -> Columns:
    return driving(reference_model, road_n=50.0)


@pytest.mark.parametrize("factor", [0.5, 1.0, 1.5])
def test_the_sum_comes_from_ordinary_driving(
    reference_model: Model, scaled_levels: Any, smooth: Columns, factor: float
) -> None:
    states = feed(smooth, scaled_levels(reference_model, factor, factor))
    last = states[-1]
    assert last.sum_nm == pytest.approx(TRUE, rel=0.03)
    assert last.confident
    assert not last.asymmetry_known, "nothing in these signals shows it"
    assert abs(last.sum_nm - TRUE) < 3.0 * last.sum_std_nm
    assert bool(last.flag) == (factor != 1.0)
    assert last.used >= 10


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_a_bumpy_road_is_not_taken_for_friction(
    reference_model: Model, scaled_levels: Any, bumpy: Columns, factor: float
) -> None:
    last = feed(bumpy, scaled_levels(reference_model, factor, factor))[-1]
    assert last.sum_nm == pytest.approx(TRUE, rel=0.05)
    assert abs(last.sum_nm - TRUE) < 3.0 * last.sum_std_nm


@pytest.mark.slow
def test_without_the_angle_it_still_works(
    reference_model: Model, scaled_levels: Any, smooth: Columns
) -> None:
    last = feed(smooth, scaled_levels(reference_model, 0.5, 0.5), angle=False)[-1]
    assert last.sum_nm == pytest.approx(TRUE, rel=0.05)


@pytest.mark.slow
def test_a_road_that_drives_the_rack_teaches_nothing(
    reference_model: Model, scaled_levels: Any
) -> None:
    columns = driving(reference_model, road_n=250.0, amplitude=0.0)
    last = feed(columns, scaled_levels(reference_model, 1.4, 1.4))[-1]
    assert last.used == 0
    assert last.left_out >= 4
    assert last.sum_nm == pytest.approx(1.4 * TRUE)
    assert not last.confident
    assert last.flag == ""


@pytest.mark.parametrize("factors", [pytest.param((0.5, 0.5), marks=pytest.mark.slow), (0.6, 1.4)])
def test_with_a_load_cell_both_levels_are_seen(
    reference_model: Model, scaled_levels: Any, sweep_truth: Any, factors: tuple[float, float]
) -> None:
    """A rig of other code, moved by its rack force: the load cell says what the road does."""
    model = scaled_levels(reference_model, *factors)
    last = feed(sweep_truth.columns, model, ReversalSettings())[-1]
    assert last.levels == pytest.approx((5.6e-2, 1.258e-1), rel=0.02)
    assert last.asymmetry_known
    blind = feed(sweep_truth.columns, model)[-1]
    assert blind.used == 0, "without it, nobody can tell the road's work from missing friction"


@pytest.mark.slow
@pytest.mark.parametrize("simple", [True, False])
def test_on_the_truth_plant_with_its_own_friction(
    reference_model: Model, scaled_levels: Any, simple: bool
) -> None:
    """Five masses and Maxwell-slip elements, where the model has one mass and a bristle."""
    rng = np.random.default_rng(5)
    world = World(simple)
    program = np.concatenate([weave(rng, 20.0), weave(rng, 20.0)])
    clean = reported(world.run(program), world.instruments)
    columns = measured(clean, world.instruments, rng)
    last = feed(columns, scaled_levels(reference_model, 0.6, 0.6))[-1]
    assert last.sum_nm == pytest.approx(TRUE, rel=0.04)


@pytest.mark.slow
def test_friction_that_drifts_is_followed(reference_model: Model, smooth: Columns) -> None:
    """The same half minute with other friction: forgetting lets the estimate go along."""
    f = reference_model.friction
    less = replace(f, offset_pos_nm=0.7 * f.offset_pos_nm, offset_neg_nm=0.7 * f.offset_neg_nm)
    warm = driving(replace(reference_model, friction=less))
    both = {name: np.concatenate([smooth[name], warm[name], warm[name]]) for name in smooth}
    quick = replace(BLIND, drift_per_sqrt_hour=2.0)
    states = feed(both, reference_model, quick)
    assert states[4].sum_nm == pytest.approx(TRUE, rel=0.05)
    assert states[-1].sum_nm == pytest.approx(0.7 * TRUE, rel=0.07)


def _some_blocks(reference_model: Model, columns: Columns) -> Blocks:
    part = slice(5000, 11_000)
    sensor = reference_model.sensor_to_rotor * columns["torque_sensor_nm"]
    torque = columns["motor_torque_nm"] + sensor
    stretch = Stretch(
        torque[part], columns["motor_speed_rad_s"][part], columns["motor_angle_rad"][part], 500
    )
    return blocks_of(stretch, reference_model, np.array([5.6e-2, 1.258e-1]))


@given(st.lists(st.floats(-3.0, 3.0), min_size=5, max_size=5))
@settings(max_examples=25)
def test_no_smooth_load_changes_what_is_seen(
    reference_model: Model, smooth: Columns, shares: list[float]
) -> None:
    """Any mixture of trend, spring and damper added to the rack force is worth nothing."""
    blocks = _some_blocks(reference_model, smooth)
    time = np.linspace(-1.0, 1.0, len(blocks.left))
    basis = [np.ones_like(time), time, time**2, blocks.angle_rad / 50, blocks.speed_rad_s / 50]
    load = np.array(shares) @ np.array(basis)
    plain = evidence(blocks, 1e-3)
    loaded = evidence(blocks._replace(left=blocks.left + load), 1e-3)
    assert loaded.matrix == pytest.approx(plain.matrix, rel=1e-4)
    assert loaded.pull == pytest.approx(plain.pull, rel=1e-3, abs=1e-3 * abs(plain.pull).max())


def test_one_step_of_the_levels_is_what_the_evidence_says(
    reference_model: Model, smooth: Columns
) -> None:
    """x is linear in the levels: shifting both by d Nm moves the answer by 2 d."""
    blocks = _some_blocks(reference_model, smooth)
    shifted = blocks._replace(left=blocks.left + 0.01 * blocks.slopes.sum(axis=0))
    ones = np.ones(2)
    answers = []
    for one in (blocks, shifted):
        found = evidence(one, 1e-3)
        answers.append(2.0 * ones @ found.pull / (ones @ found.matrix @ ones))
    assert answers[1] - answers[0] == pytest.approx(0.02, rel=1e-3)


def test_gaps_and_bad_samples_start_a_stretch_anew(reference_model: Model) -> None:
    adaptation = ReversalAdaptation(BLIND, reference_model)
    t_ns = 0
    for k in range(30_000):
        t_ns += 1_000_000 if k % 5000 else 50_000_000
        speed = math.nan if k % 3000 == 7 else 20.0 * math.sin(k * 1e-3)
        assert adaptation.step(t_ns, InjectionInputs(0.1, speed, 0.0)) is None
    assert adaptation.state.used == 0


@pytest.mark.parametrize(("sensor_nm", "stretches"), [(math.nan, 1), (0.5, 0)])
def test_a_torsion_bar_may_be_absent_but_not_lost(
    reference_model: Model, sensor_nm: float, stretches: int
) -> None:
    """The one counts as no torque; the other did, too, in the middle of a stretch."""
    adaptation = ReversalAdaptation(BLIND, reference_model)
    complete = 0
    for k in range(11_000):
        now = sensor_nm if k < 2000 else math.nan
        inputs = InjectionInputs(0.1, 20.0 * math.sin(k * 1e-3), now)
        complete += adaptation.step(k * 1_000_000, inputs) is not None
    assert min(complete, 1) == stretches
