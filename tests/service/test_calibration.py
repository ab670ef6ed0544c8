"""Torque injection through session, guard and simulated ECU, in lock-step; the sources alone."""

import math
from dataclasses import replace

import pytest

from eps_hil.adaptation.injection_settings import InjectionSettings
from eps_hil.adaptation.torque_injection import Phase
from eps_hil.errors import InputError
from eps_hil.physics.chain import HAND_TORQUE
from eps_hil.physics.model import load_model
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.manoeuvre import VEHICLE_SPEED
from eps_hil.service.calibration import (
    CalibrationSettings,
    ErrorInjectionSource,
    TorqueInjectionSource,
    calibration_settings,
)
from eps_hil.service.config import load_config
from eps_hil.service.latest import LatestValues
from eps_hil.service.override import State

from .lockstep import CONFIG, MS, ROOT, Lockstep, parts_of

MODEL = load_model(ROOT / "configs" / "reference_rig.yaml")


def injecting(manoeuvre: str, repetitions: int = 1) -> tuple[Lockstep, TorqueInjectionSource]:
    source = TorqueInjectionSource(InjectionSettings(repetitions=repetitions), MODEL)
    bench = Lockstep(parts_of(), source, load_rig_setup(CONFIG, manoeuvre))
    bench.rig._plant._table = bench.rig._plant._table.copy()
    bench.arm()
    return bench, source


def until(bench: Lockstep, source: TorqueInjectionSource, phase: Phase, most_ms: int) -> None:
    for _ in range(most_ms):
        if source.injection.phase is phase:
            return
        bench.step()
    pytest.fail(f"{source.injection.phase} {source.injection.reason} {bench.story()}")


@pytest.mark.slow
@pytest.mark.parametrize("manoeuvre", ["parked", "parked_hands_on"])
def test_the_levels_of_the_rig_are_found_through_guard_and_bus(manoeuvre: str) -> None:
    bench, source = injecting(manoeuvre, repetitions=2)
    until(bench, source, Phase.DONE, 30_000)
    bench.step(5)
    assert bench.state is State.ARMED, "no torque wanted any more"
    result = source.injection.result
    assert result is not None
    assert result.accepted, result.problems
    assert result.positive.offset_nm == pytest.approx(MODEL.friction.offset_pos_nm, rel=0.03)
    assert result.negative.offset_nm == pytest.approx(MODEL.friction.offset_neg_nm, rel=0.03)
    assert max(abs(tick.applied_nm) for tick in bench.ticks) < 0.2


@pytest.mark.parametrize("gate", ["vehicle_speed_m_s", "torque_sensor_nm"])
def test_a_gate_that_opens_ends_it_cleanly(gate: str) -> None:
    bench, source = injecting("parked")
    until(bench, source, Phase.RAMP, 3000)
    bench.step(300)
    assert bench.state is State.INJECTING
    column, value = {
        "vehicle_speed_m_s": (VEHICLE_SPEED, 25.0),
        "torque_sensor_nm": (HAND_TORQUE, 1.6),
    }[gate]
    bench.rig._plant._table[:, column] = value
    until(bench, source, Phase.ABORTED, 500)
    bench.step(3)
    assert bench.state is not State.INJECTING
    assert bench.ticks[-1].applied_nm == 0.0
    assert gate in source.aborted
    assert bench.core.override.guard.trips == 0, "the algorithm let go before the guard had to"
    bench.rig._plant._table[:, column] = 0.0
    bench.step(1000)
    assert max(abs(tick.applied_nm) for tick in bench.ticks[-1000:]) == 0.0


def test_before_it_is_engaged_only_the_gates_live() -> None:
    source = TorqueInjectionSource(InjectionSettings(), MODEL)
    values = {"vehicle_speed_m_s": 0.0, "torque_sensor_nm": 2.0, "rack_position_m": 0.0}
    for k in range(5):
        assert source.step(k * MS, values, engaged=False, now_ns=k * MS) is None
    met = {gate.name: gate.met for gate in source.gates}
    assert met["vehicle_speed_m_s"]
    assert met["rack_position_m"]
    assert not met["torque_sensor_nm"]
    assert not met["yaw_rate_rad_s"], "a missing signal meets no gate"
    assert (source.over, source.aborted) == (False, "")


def test_a_silent_signal_is_no_value() -> None:
    latest = LatestValues({"fast": 0.001, "slow": 0.1})
    latest.take("fast", 0, 1.0)
    latest.take("slow", 0, 2.0)
    assert latest.at(50 * MS) == {"fast": 1.0, "slow": 2.0}
    late = latest.at(51 * MS)
    assert math.isnan(late["fast"])
    assert late["slow"] == 2.0
    assert math.isnan(latest.at(501 * MS)["slow"])


def test_a_clock_that_was_set_back_keeps_no_signal_alive() -> None:
    latest = LatestValues({"fast": 0.001})
    latest.take("fast", 1000 * MS, 1.0)
    assert latest.at(950 * MS) == {"fast": 1.0}, "messages may overtake each other"
    assert math.isnan(latest.at(949 * MS)["fast"])
    latest.take("fast", 900 * MS, 2.0)
    assert latest.at(900 * MS) == {"fast": 2.0}


def test_settings_are_checked_with_their_place() -> None:
    config = load_config(CONFIG)
    assert calibration_settings(config, CONFIG) == CalibrationSettings()
    given = replace(config, calibration={"torque_injection": {"repetitions": 3}})
    assert calibration_settings(given, CONFIG).torque_injection.repetitions == 3
    # a gate that opens ends the torque, which such a rate would keep for minutes
    for name, value in {"repetitions": 0, "abort_nm_per_s": 0.001}.items():
        wrong = replace(config, calibration={"torque_injection": {name: value}})
        with pytest.raises(InputError, match=rf"calibration\.torque_injection\.{name}"):
            calibration_settings(wrong, CONFIG)


def test_error_injection_counts_its_sliding() -> None:
    source = ErrorInjectionSource(CalibrationSettings(error_sliding_s=0.2), MODEL)
    assert not source.over
    values = {"motor_torque_nm": 0.0, "torque_sensor_nm": 0.0, "vehicle_speed_m_s": 0.0}
    values |= {"yaw_rate_rad_s": 0.0, "lateral_acceleration_m_s2": 0.0, "rack_position_m": 0.0}
    for k in range(2000):
        sign = 1.0 if k % 1000 < 500 else -1.0
        level = 0.0599 if sign > 0 else -0.1265
        source.step(k * MS, values | {"motor_speed_rad_s": 10.0 * sign, "motor_torque_nm": level})
    assert source.over
    assert source.state is not None
    assert source.state.time_pos_s > 0.2
    assert all(gate.met for gate in source.gates)
