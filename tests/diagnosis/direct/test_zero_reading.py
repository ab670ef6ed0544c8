"""Which of the three constants it is, where a sensor is seen with nothing on it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.direct.zero_reading import (
    ZeroReading,
    ZeroReadings,
    _together,
    zero_readings,
)
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model
from eps_hil.proof import sensors
from eps_hil.proof.programmes import programme
from eps_hil.proof.world import World
from eps_hil.series import Series

Diagnosed = Callable[..., Diagnosis]


@pytest.fixture(scope="module")
def diagnosed(reference_model: Model) -> Diagnosed:
    """A diagnosis of a world of the proof's plant, driven through a programme."""

    def at(world: World, name: str = "training", model: Model = reference_model) -> Diagnosis:
        rng = np.random.default_rng(8)
        made = {}
        for role, program in zip(("a", "b", "kept"), programme(name, rng), strict=True):
            clean = sensors.reported(world.run(program), world.instruments)
            columns = sensors.measured(clean, world.instruments, rng)
            t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
            made[role] = {key: Series(t_ns, value) for key, value in columns.items()}
        return diagnose(model, {k: made[k] for k in "ab"}, {"kept": made["kept"]})

    return at


PLAIN = World(simple=True)
OFF_MOTOR = replace(PLAIN, hidden=PLAIN.hidden._replace(motor_offset_nm=0.008))
OFF_SENSOR = replace(PLAIN, instruments=replace(PLAIN.instruments, sensor_offset_nm=-0.1))
UNEVEN = replace(
    PLAIN,
    drive=PLAIN.drive._replace(
        k0_pos=PLAIN.drive.k0_pos + 0.006, k0_neg=PLAIN.drive.k0_neg - 0.006
    ),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("world", "name", "parameter", "size", "others"),
    [
        (OFF_MOTOR, "motor_torque_offset", "offset_nm", 0.008, []),
        (OFF_SENSOR, "torque_sensor_offset", "offset_nm", -0.1, []),
        (UNEVEN, "friction_asymmetry", "half_difference_nm", 0.006, []),
    ],
)
def test_hands_off_and_motor_off_tell_the_constants(
    diagnosed: Diagnosed, world: World, name: str, parameter: str, size: float, others: list[str]
) -> None:
    result = diagnosed(world)
    (finding,) = result.content["findings"]
    assert finding["effect"] == name
    stated = finding["parameters"][parameter]
    assert stated["value"] == pytest.approx(size, rel=0.05)
    assert stated["ci95"][0] <= size <= stated["ci95"][1]
    assert finding["confusable_with"] == others
    assert [entry["effect"] for entry in result.model.effects] == [name]
    assert result.content["verdict"] == "explained"
    holdout = result.content["fit"]["holdout"]
    force = [holdout[one]["rack_force_rmse_n"] for one in ("baseline", "augmented")]
    assert force[1] < 0.7 * force[0]


@pytest.mark.slow
def test_without_such_stretches_all_three_are_possible(diagnosed: Diagnosed) -> None:
    (finding,) = diagnosed(OFF_SENSOR, "never_free").content["findings"]
    family = {"motor_torque_offset", "torque_sensor_offset", "friction_asymmetry"}
    assert {finding["effect"], *finding["confusable_with"]} == family


@pytest.mark.slow
@pytest.mark.parametrize("world", [OFF_MOTOR, OFF_SENSOR])
def test_an_offset_that_the_model_knows_is_not_found_again(
    diagnosed: Diagnosed, world: World
) -> None:
    written = diagnosed(world).model
    again = diagnosed(world, model=written)
    assert again.content["verdict"] == "no_mismatch"
    assert again.model.effects == written.effects


@pytest.mark.slow
def test_nothing_is_read_where_nothing_is_off(diagnosed: Diagnosed) -> None:
    assert diagnosed(PLAIN).content["verdict"] == "no_mismatch"


def reading(signal: str, value: float, **more: Any) -> ZeroReading:
    return ZeroReading(signal, value, 1e-4, 10.0, gain=1e3, **more)


def test_an_offset_counts_behind_the_gain(problem: Problem) -> None:
    """true = gain · reported + offset; with no torque on it, reported is −offset/gain."""
    one = reading("motor_torque_nm", 0.005)
    gain = {"effect": "motor_torque_gain", "gain": 1.2}
    found = fit(problem, [gain], 0)
    (scaled,) = ZeroReadings((one,)).behind(found).clear
    assert scaled.entry["offset_nm"] == pytest.approx(-0.006)
    assert scaled.finding()["parameters"]["offset_nm"]["ci95"] == pytest.approx(
        [-0.006 - 1.2e-4, -0.006 + 1.2e-4]
    )
    assert ZeroReadings((one,)).behind(fit(problem, [], 0)).clear == [one]
    sensor = reading("torque_sensor_nm", 0.1)
    assert ZeroReadings((sensor,)).behind(found).clear == [sensor]


def test_a_reading_that_the_balance_takes_back_is_none(problem: Problem) -> None:
    """A hand that held still: the rig of these recordings has no offset."""
    wrong = ZeroReadings((reading("torque_sensor_nm", 0.3),))
    beside = Problem(problem.recordings, wrong.in_model(problem.model))
    back = {"effect": "friction_asymmetry", "half_difference_nm": -0.01}
    assert wrong.refuted(beside, fit(beside, [back]), problem.recordings)
    assert wrong.refuted(beside, fit(beside, [], 0), problem.recordings)  # hold-outs are worse
    assert not ZeroReadings().refuted(problem, fit(problem, [], 0), problem.recordings)


def test_a_reading_that_does_not_count_settles_its_name_only() -> None:
    nothing = replace(reading("motor_torque_nm", 1e-5), gain=0.1)
    sensor = replace(nothing, signal="torque_sensor_nm")
    both = ZeroReadings((nothing, sensor))
    assert both.clear == []
    assert both.settled == {"motor_torque_offset", "torque_sensor_offset"}
    assert both.possible == set()
    command = replace(nothing, measured=False)
    assert ZeroReadings((command, sensor)).possible == {"motor_torque_offset"}


@pytest.mark.slow
@pytest.mark.parametrize("command", [False, True])
def test_a_command_that_is_none_rules_nothing_out(reference_model: Model, command: bool) -> None:
    """It is none with the motor off, whatever the motor's torque is; a sensor shows its noise."""
    rng = np.random.default_rng(8)
    recordings = []
    for program in programme("training", rng):
        clean = sensors.reported(PLAIN.run(program), PLAIN.instruments)
        columns = sensors.measured(clean, PLAIN.instruments, rng)
        torque = columns["motor_torque_nm"]
        if command:
            off = np.abs(np.convolve(torque, np.ones(101) / 101, mode="same")) < 2e-3
            columns["motor_torque_nm"] = np.where(off, 0.0, np.round(torque, 3))
        t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
        recordings.append(prepare("r", {k: Series(t_ns, v) for k, v in columns.items()}))
    seen = zero_readings(recordings, reference_model, ())
    assert "motor_torque_offset" in seen.settled
    assert ("motor_torque_offset" in seen.possible) is command


NOISE_NM = 2e-4
MOST_NM = 0.5
"""Of one window."""


def agreeing(count: int, at: float = 0.0, scatter: float = 2.0) -> np.ndarray:
    return at + scatter * NOISE_NM * np.random.default_rng(count).standard_normal(count)


def held(count: int, scatter: float = 0.05) -> np.ndarray:
    """Windows in which somebody held what looks like a free wheel."""
    return scatter * np.random.default_rng(7 + count).standard_normal(count)


def test_a_recording_with_the_hands_on_does_not_blur_one_with_the_hands_off() -> None:
    """Each counts by how well its own windows agree; all in one heap said nothing."""
    alone = _together("torque_sensor_nm", [agreeing(10, 0.03)], NOISE_NM, MOST_NM)
    both = _together("torque_sensor_nm", [agreeing(10, 0.03), held(9), held(8)], NOISE_NM, MOST_NM)
    assert alone is not None
    assert both is not None
    assert both.value == pytest.approx(alone.value, abs=alone.half)
    assert both.half < 1.2 * alone.half
    assert both.seconds == alone.seconds


def test_two_recordings_that_are_sure_of_different_torques_are_believed_neither() -> None:
    one = _together("torque_sensor_nm", [agreeing(8), agreeing(9, 0.2)], NOISE_NM, MOST_NM)
    assert one is not None
    assert one.half > 0.1
    assert not one.clear


def test_most_windows_of_a_recording_may_agree_beside_some_that_were_held() -> None:
    mixed = np.concatenate([agreeing(7, 0.01), held(5)])
    one = _together("torque_sensor_nm", [mixed], NOISE_NM, MOST_NM)
    assert one is not None
    assert one.value == pytest.approx(0.01, abs=one.half)
    assert one.half < 2e-3
    nothing = _together("torque_sensor_nm", [held(12)], NOISE_NM, MOST_NM)
    assert nothing is not None
    assert nothing.half > 0.02


@pytest.mark.parametrize("count", [5, 8, 20, 40])
def test_a_scatter_alone_hardly_ever_makes_a_narrow_reading(count: int) -> None:
    """The windows that lie closest together lie closer than all; by chance seldom by so much."""
    narrow, rng = 0, np.random.default_rng(count)
    for _ in range(1000):
        one = _together("torque_sensor_nm", [0.05 * rng.standard_normal(count)], NOISE_NM, MOST_NM)
        narrow += one is not None and one.half <= 0.05 / count
    assert narrow < 15


def test_few_windows_each_go_together() -> None:
    one = _together("torque_sensor_nm", [agreeing(2), agreeing(1), agreeing(2)], NOISE_NM, MOST_NM)
    assert one is not None
    assert one.seconds == 10.0
    assert _together("torque_sensor_nm", [agreeing(1), agreeing(1)], NOISE_NM, MOST_NM) is None
    assert _together("torque_sensor_nm", [], NOISE_NM, MOST_NM) is None
