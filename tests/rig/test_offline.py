"""Recordings of the simulated rig: motion as in the paper's figures, sensors as configured."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.bus.database import load_database
from eps_hil.bus.mapping import load_mapping
from eps_hil.errors import InputError
from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.model import Model
from eps_hil.rig.frames import resolutions
from eps_hil.rig.manoeuvre import Manoeuvre, load_manoeuvre
from eps_hil.rig.offline import SimulatedRecording, simulate_recording
from eps_hil.rig.plant import Plant
from eps_hil.rig.sensors import NOISE_RMS, REPORTED, Sensors, SensorSettings

Floats = npt.NDArray[np.float64]
Quiet = Callable[[str], Mapping[str, Floats]]

REPOSITORY = Path(__file__).parents[2]
QUIET = SensorSettings(noise=False, quantise=False)


def short(name: str) -> Manoeuvre:
    """The beginning of a named manoeuvre."""
    whole = load_manoeuvre(name)
    return replace(whole, segments=whole.segments[:3])


@pytest.fixture(scope="module")
def quiet(model: Model, chain: ChainParameters) -> Quiet:
    """Truth of a named manoeuvre, simulated once."""

    @cache
    def truth(name: str) -> Mapping[str, Floats]:
        return simulate_recording(model, chain, load_manoeuvre(name), sensors=QUIET).truth

    return truth


@pytest.fixture(scope="module")
def sweep(model: Model, chain: ChainParameters) -> SimulatedRecording:
    return simulate_recording(model, chain, load_manoeuvre("sine_sweep"), seed=1)


def test_the_sweep_moves_as_in_figure_9(sweep: SimulatedRecording) -> None:
    truth = sweep.truth
    assert 350 < np.abs(truth["motor_speed_rad_s"]).max() < 450
    assert np.abs(truth["rack_position_m"]).max() < 0.03
    assert np.abs(truth["torque_sensor_nm"]).max() < 10.0
    assert np.abs(truth["motor_torque_nm"]).max() < 2.0
    assert 0.15 < np.abs(truth["friction_torque_nm"]).max() < 0.35


def test_equation_1d_holds_for_the_five_masses_below_their_resonances(
    model: Model, sweep: SimulatedRecording
) -> None:
    """The estimator's one-mass view of the five-mass rig, in newtons at the rack."""
    truth = sweep.truth
    speed = truth["motor_speed_rad_s"]
    acceleration = np.zeros_like(speed)
    acceleration[1:-1] = (speed[2:] - speed[:-2]) / 2e-3
    balance = (
        truth["motor_torque_nm"]
        + model.sensor_to_rotor * truth["torque_sensor_nm"]
        - truth["friction_torque_nm"]
        - model.inertia_kg_m2 * acceleration
    ) * model.rack_to_rotor_ratio_rad_per_m
    slow = np.convolve(balance - truth["rack_force_n"], np.ones(20) / 20, "same")[100:-100]
    assert np.sqrt(np.mean(slow**2)) < 10.0


@pytest.mark.parametrize(
    "name",
    [
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("constant_speed_preload", "demo", "multisine", "weave")
        ),
        "dwell",
        "steps",
    ],
)
def test_every_manoeuvre_stays_within_the_travel_and_the_ranges_of_the_bus(
    name: str, quiet: Quiet
) -> None:
    truth = quiet(name)
    assert np.abs(truth["rack_position_m"]).max() < 0.08
    assert np.abs(truth["motor_angle_rad"]).max() < 419
    assert np.abs(truth["torque_sensor_nm"]).max() < 16
    assert np.abs(truth["motor_speed_rad_s"]).max() < 838
    assert np.abs(truth["motor_speed_rad_s"]).max() > 20, "nothing moved"


def test_the_steps_come_to_rest(quiet: Quiet) -> None:
    truth = quiet("steps")
    for second in range(2, 21, 2):
        rest = truth["motor_speed_rad_s"][second * 1000 - 200 : second * 1000 - 2]
        assert np.abs(rest).max() < 0.5, second


def test_the_dwells_rest_and_break_away(quiet: Quiet) -> None:
    manoeuvre, truth = load_manoeuvre("dwell"), quiet("dwell")
    end = 0
    for segment in manoeuvre.segments:
        assert segment.duration_s is not None
        begin, end = end, end + round(segment.duration_s * 1000)
        speed = np.abs(truth["motor_speed_rad_s"][begin:end])
        if segment.duration_s == 3.0:
            assert speed.max() > 10.0
        else:
            assert speed[-300:].max() < 0.5


@pytest.mark.slow
def test_the_robot_holds_its_speed(model: Model, quiet: Quiet) -> None:
    """Figs 4 and 7: at constant speed the torque sensor reads the friction."""
    truth = quiet("constant_speed_preload")
    friction = model.friction
    steady = (
        (np.abs(truth["motor_speed_rad_s"] - 20) < 0.2)
        & (np.abs(truth["rack_force_n"] - 2000) < 1)
        & (np.abs(truth["steering_wheel_speed_rad_s"] - 1.0) < 0.01)
    )
    assert np.count_nonzero(steady) > 300
    read = model.sensor_to_rotor * np.median(truth["torque_sensor_nm"][steady])
    level = (
        friction.offset_pos_nm
        + friction.viscous_pos_nm_s_per_rad * 20
        + friction.load_pos_nm_per_n * 2000
    )
    assert read == pytest.approx(level, rel=0.03)


def test_the_same_seed_gives_the_same_recording(model: Model, chain: ChainParameters) -> None:
    manoeuvre = short("steps")
    one = simulate_recording(model, chain, manoeuvre, seed=5)
    two = simulate_recording(model, chain, manoeuvre, seed=5)
    other = simulate_recording(model, chain, manoeuvre, seed=6)
    assert tuple(one.columns) == ("time_s", *REPORTED)
    for name in REPORTED:
        assert np.array_equal(one.columns[name], two.columns[name])
    assert not np.array_equal(one.columns["rack_force_n"], other.columns["rack_force_n"])
    assert np.array_equal(one.truth["rack_force_n"], other.truth["rack_force_n"])


class TestSensors:
    def test_every_signal_is_late_by_its_delay(self, model: Model, chain: ChainParameters) -> None:
        recording = simulate_recording(model, chain, short("steps"), sensors=QUIET)
        for name, late_ms in (
            ("motor_speed_rad_s", 4),
            ("motor_angle_rad", 4),
            ("motor_torque_nm", 1),
            ("torque_sensor_nm", 0),
            ("rack_force_n", 0),
        ):
            truth = recording.truth[name]
            told = recording.columns[name][late_ms:]
            assert np.array_equal(told, truth[: len(truth) - late_ms]), name

    def test_noise_has_the_size_that_was_asked_for(self, sweep: SimulatedRecording) -> None:
        for name, late in (("motor_speed_rad_s", 4), ("rack_force_n", 0)):
            truth, told = sweep.truth[name], sweep.columns[name]
            error = told[late:] - truth[: len(truth) - late]
            assert error.std() == pytest.approx(NOISE_RMS[name], rel=0.03)
            assert abs(error.mean()) < 0.02 * NOISE_RMS[name]

    def test_a_filter_is_part_of_the_delay(self, model: Model, chain: ChainParameters) -> None:
        filtered = SensorSettings(
            noise=False, quantise=False, filters_s={"motor_speed_rad_s": 0.002}
        )
        recording = simulate_recording(model, chain, short("weave"), sensors=filtered)
        truth = recording.truth["motor_speed_rad_s"]
        told = recording.columns["motor_speed_rad_s"]
        error = told[4:] - truth[:-4]
        assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(truth**2))
        assert not np.array_equal(told[4:], truth[:-4])

    def test_a_filter_later_than_the_delay_is_refused(self, model: Model) -> None:
        settings = SensorSettings(filters_s={"rack_force_n": 0.01})
        with pytest.raises(InputError, match=r"filters_s\.rack_force_n"):
            Sensors(model, settings, seed=0)

    def test_an_unknown_signal_is_refused(self, model: Model) -> None:
        with pytest.raises(InputError, match=r"noise_rms\.speed"):
            Sensors(model, SensorSettings(noise_rms={"speed": 1.0}), seed=0)

    def test_live_and_offline_are_the_same_sensors(
        self, model: Model, chain: ChainParameters
    ) -> None:
        table = load_manoeuvre("steps").table()[:3001]
        truth = Plant(model, chain, 5, table).run()
        whole = Sensors(model, SensorSettings(), seed=9).run(truth)
        live, out = Sensors(model, SensorSettings(), seed=9), np.zeros(len(REPORTED))
        plant, row = Plant(model, chain, 5, table), np.zeros(truth.shape[1])
        for k in range(3000):
            plant.step(row)
            live.step(row, out)
            assert np.array_equal(row, truth[k])
            assert np.array_equal(out, whole[k])

    def test_values_come_in_the_steps_of_the_database(
        self, model: Model, chain: ChainParameters
    ) -> None:
        database = load_database([REPOSITORY / "dbc" / "eps_rig.dbc"])
        mapping = load_mapping(REPOSITORY / "configs" / "eps_rig_signals.yaml")
        steps = resolutions(database, mapping)
        assert set(steps) == set(REPORTED)
        recording = simulate_recording(model, chain, short("weave"), resolution=steps)
        for name in ("motor_speed_rad_s", "rack_force_n", "steering_wheel_angle_rad"):
            counts = recording.columns[name] / steps[name][0]
            assert np.abs(counts - np.round(counts)).max() < 1e-4
