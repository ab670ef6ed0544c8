"""A load cell that is late or reads too much is said to be that, not the motor or the encoder."""

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.attribute.channel_fault import (
    ChannelFault,
    _Compared,
    held_out_energy,
    with_channel_fault,
)
from eps_hil.diagnosis.attribute.numbers import SCALES
from eps_hil.diagnosis.balance.fit import fit
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model
from eps_hil.series import Series

Recordings = Mapping[str, Mapping[str, Series]]


def later(recordings: Recordings, signal: str, late_s: float) -> Recordings:
    def moved(one: Mapping[str, Series]) -> Mapping[str, Series]:
        late_ns = round(1e9 * late_s)
        return {**one, signal: Series(one[signal].t_ns + late_ns, one[signal].value)}

    return {name: moved(one) for name, one in recordings.items()}


@pytest.mark.slow
def test_a_late_signal_is_named_with_its_time(
    record: Callable[..., Any], reference_model: Model
) -> None:
    signal, key, late_s = "rack_force_n", "rack_force", 0.012
    given = getattr(reference_model.delays_s, key)
    train, holdout = (later(one, signal, late_s) for one in (record({}), record({}, ("weave",), 2)))
    told = diagnose(reference_model, train, holdout)
    assert told.content["verdict"] == "unknown_effect"
    (finding,) = told.content["findings"]
    assert finding["effect"] == "unknown"
    assert finding["kind"] == "instrument"
    assert f"{signal} is reported" in finding["summary"]
    assert f"delays_s.{key}" in finding["summary"]
    assert getattr(told.model.delays_s, key) == pytest.approx(given + late_s, abs=5e-4)
    error = {k: one["torque_nrmse"] for k, one in told.content["fit"]["holdout"].items()}
    assert error["baseline"] > 1.2 * error["noise_floor"]
    assert error["augmented"] < 1.05 * error["noise_floor"]
    assert told.model.delays_s.motor_torque == pytest.approx(
        reference_model.delays_s.motor_torque, abs=1e-3
    )


@pytest.mark.slow
def test_a_load_cell_that_reads_wrong_is_no_ratio(
    record: Callable[..., Any], reference_model: Model
) -> None:
    gain = 0.97

    def wrong(recordings: Recordings) -> Recordings:
        return {
            name: {**one, "rack_force_n": Series(force.t_ns, gain * force.value)}
            for name, one in recordings.items()
            for force in [one["rack_force_n"]]
        }

    told = diagnose(reference_model, wrong(record({})), wrong(record({}, ("weave",), 2)))
    (finding,) = told.content["findings"]
    assert finding["effect"] == "unknown"
    said = re.search(r"rack_force_n reads ([\d.]+) times what it should", finding["summary"])
    assert said
    assert float(said[1]) == pytest.approx(gain, abs=0.003)
    error = {k: one["torque_nrmse"] for k, one in told.content["fit"]["holdout"].items()}
    assert error["put_right"] < 1.05 * error["noise_floor"] < error["baseline"]
    assert told.model == reference_model  # no entry of a model file says that
    assert error["augmented"] == error["baseline"]
    assert any("which no model file does" in one for one in told.content["limits"])


@pytest.mark.slow
def test_a_late_motor_torque_keeps_its_name(
    record: Callable[..., Any], reference_model: Model
) -> None:
    train, holdout = (
        later(one, "motor_torque_nm", 0.004) for one in (record({}), record({}, ("weave",), 2))
    )
    told = diagnose(reference_model, train, holdout).content
    assert "motor_torque_delay" in [one["effect"] for one in told["findings"]]


def test_the_verdict_beside_names_and_alone() -> None:
    late = {"effect": "unknown"}
    alone = with_channel_fault({"verdict": "no_mismatch", "findings": []}, late)
    assert (alone["verdict"], alone["findings"]) == ("unknown_effect", [late])
    named = with_channel_fault({"verdict": "explained", "findings": [{"effect": "stribeck"}]}, late)
    assert named["verdict"] == "partly_explained"
    assert [one["effect"] for one in named["findings"]] == ["stribeck", "unknown"]
    drift = {"effect": "clock_drift"}
    assert (
        with_channel_fault({"verdict": "no_mismatch", "findings": []}, drift)["verdict"]
        == "explained"
    )
    beside = with_channel_fault({"verdict": "unknown_effect", "findings": [late]}, drift)
    assert beside["verdict"] == "partly_explained"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("signals", "ppm"),
    [
        (("motor_torque_nm",), -200.0),
        (("motor_speed_rad_s", "motor_angle_rad"), 150.0),
    ],
)
def test_a_clock_adrift_is_named_where_only_torques_show_it(
    record: Callable[..., Any], reference_model: Model, signals: tuple[str, ...], ppm: float
) -> None:
    def adrift(recordings: Recordings) -> Recordings:
        out = {}
        for name, one in recordings.items():
            there = {key: values for key, values in one.items() if key != "rack_position_m"}
            for signal in signals:
                stamps = there[signal].t_ns
                late_ns = np.round((stamps - stamps[0]) * ppm * 1e-6).astype(np.int64)
                there[signal] = Series(stamps + late_ns, there[signal].value)
            out[name] = there
        return out

    train, holdout = (
        adrift(one) for one in (record({}, seconds=30.0), record({}, ("weave",), 2, seconds=30.0))
    )
    told = diagnose(reference_model, train, holdout).content
    (finding,) = told["findings"]
    assert finding["effect"] == "clock_drift"
    assert finding["signal"] == signals[0]
    number = finding["parameters"]["ppm"]
    assert number["value"] == pytest.approx(ppm, rel=0.1)
    assert told["verdict"] == "explained"
    error = {k: one["torque_nrmse"] for k, one in told["fit"]["holdout"].items()}
    assert error["put_right"] < min(1.05 * error["noise_floor"], error["baseline"])
    assert error["augmented"] == error["baseline"]  # no model file holds a clock


@pytest.mark.slow
def test_a_delay_without_a_name_is_no_drift(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """Most of what a drift does, its mean does."""
    train, holdout = (
        record({}, manoeuvres, seed, speed_late_s=0.004)
        for manoeuvres, seed in ((("sweep", "weave", "slow"), 1), (("weave",), 2))
    )
    without = {"speed_sensor_delay", "motor_torque_delay"}
    told = diagnose(reference_model, train, holdout, without=without).content
    assert "clock_drift" not in [one["effect"] for one in told["findings"]]


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "helps"), [(1.05, True), (0.95, False)])
def test_a_signal_is_put_right_only_where_that_helps_what_was_kept(
    problem: Problem, gain: float, helps: bool
) -> None:
    """One that reads 5 % too much: dividing it by 1.05 lowers the energy, by 0.95 raises it."""
    read = ChannelFault("rack_force_n", gain=1.0 / 1.05)  # puts it wrong
    fitted = problem.over([read.put_right(one) for one in problem.recordings])
    wrong = ChannelFault("rack_force_n", gain=gain)
    right = problem.over([wrong.put_right(one) for one in fitted.recordings])
    before, after = (
        held_out_energy(one, fit(one, [], 0), one.recordings[1:]) for one in (fitted, right)
    )
    assert (after < before) is helps


@pytest.mark.slow
def test_where_noise_hides_everything_no_signal_is_at_fault(
    record: Callable[..., Recordings], reference_model: Model
) -> None:
    """A load cell that reads 2 % too much, in recordings as it is and in noise ten times that."""
    fault = ChannelFault("rack_force_n", gain=1.0 / 1.02)
    recordings = record({}, ("sweep", "weave"), seconds=12.0)
    ready = [fault.put_right(prepare(name, one)) for name, one in recordings.items()]
    loud = [one.changed(noise={k: 10.0 * v for k, v in one.noise.items()}) for one in ready]
    start = ChannelFault("rack_force_n", gain=1.005)
    for these, told in ((ready, True), (loud, False)):
        problem = Problem(these, reference_model)
        found = _Compared(problem, fit(problem, [], 0), SCALES).to(start)
        assert (found is not None) is told
        if found is not None:
            assert found[0].gain == pytest.approx(1.02, abs=0.004)


def test_a_fault_of_no_size_is_none(problem: Problem) -> None:
    assert ChannelFault("rack_force_n", gain=1.02).matters(problem.recordings)
    assert not ChannelFault("rack_force_n", gain=1.0).matters(problem.recordings)
