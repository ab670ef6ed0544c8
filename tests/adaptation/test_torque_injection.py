"""Torque injection in closed loop: right levels, clean ends, nothing on bad signals."""

import math
from typing import Any

import numpy as np
import pytest

from eps_hil.adaptation.gates import GateLimit, GateSettings, InjectionInputs
from eps_hil.adaptation.injection_settings import InjectionSettings
from eps_hil.adaptation.slide_record import SlideRecord
from eps_hil.adaptation.torque_injection import Phase, TorqueInjection
from eps_hil.physics.model import Model
from eps_hil.rig.manoeuvre import Segment
from eps_hil.rig.profile import constant

QUICK = InjectionSettings(repetitions=2)


@pytest.mark.slow
@pytest.mark.parametrize("hand", ["off", "on"])
@pytest.mark.parametrize(("positive", "negative"), [(0.6, 1.4), (1.4, 0.6)])
def test_levels_of_a_rig_that_the_model_does_not_know(
    reference_model: Model,
    bench: Any,
    scaled_levels: Any,
    hands: Any,
    hand: str,
    positive: float,
    negative: float,
) -> None:
    """±40 % off, hands on and off: both directions within 3 %, and the interval is honest."""
    true = scaled_levels(reference_model, positive, negative)
    run = bench(true).run(TorqueInjection(InjectionSettings(), reference_model), hands[hand])
    result = run.injection.result
    assert run.injection.phase is Phase.DONE
    assert result is not None
    assert result.problems == ()
    assert abs(result.shift.torque_nm) < 3e-3, "8 N: no force was there, and presliding says so"
    f = true.friction
    for level, right in ((result.positive, f.offset_pos_nm), (result.negative, f.offset_neg_nm)):
        assert level.offset_nm == pytest.approx(right, rel=0.03)
        assert level.repetitions == 5
        assert set(level.seen) == {"speed" if hand == "off" else "driver_torque"}
        assert level.ci95_nm[0] < level.offset_nm < level.ci95_nm[1]
        assert level.ci95_nm[1] - level.ci95_nm[0] < 0.06 * right


@pytest.mark.slow
def test_a_rack_force_that_nobody_measured_is_noticed(
    reference_model: Model, bench: Any, scaled_levels: Any
) -> None:
    force_n = -40.0
    true = scaled_levels(reference_model, 1.3, 0.8)
    pushed = Segment(rack_force_n=constant(force_n))
    run = bench(true).run(TorqueInjection(InjectionSettings(), reference_model), pushed)
    result = run.injection.result
    assert result is not None
    assert not result.accepted
    found = 2513.0 * result.shift.torque_nm
    assert found == pytest.approx(force_n, abs=5.0)
    assert f"a rack force of about {found:.0f} N" in result.problems[0]
    wrong = abs(result.positive.offset_nm / true.friction.offset_pos_nm - 1.0)
    assert wrong > 0.15, "it would have been believed"


@pytest.fixture(scope="module")
def quick(reference_model: Model, bench: Any) -> Any:
    """A run in which nothing is wrong."""
    return bench(reference_model).run(TorqueInjection(QUICK, reference_model))


def test_the_commands_are_the_ramp_that_was_asked_for(quick: Any) -> None:
    run = quick
    torque = np.array([command.torque_nm for command in run.commands])
    ramp = np.array([command.phase is Phase.RAMP for command in run.commands])
    both = ramp[1:] & ramp[:-1]
    assert np.abs(np.diff(torque))[both] == pytest.approx(1e-4, rel=1e-6)
    assert np.abs(torque).max() < QUICK.max_torque_nm
    for command in run.commands:
        assert command.active == command.phase.active
        assert command.active or command.torque_nm == 0.0
        assert command.torque_nm * command.direction >= 0.0
    assert run.commands[-1].phase is Phase.DONE
    assert not run.commands[-1].active
    back = np.abs(run.column("rack_position_m")[-1])
    assert back < 0.5e-3, "the directions alternate, so the rack stays where it is"


def test_the_same_samples_give_the_same_result(
    reference_model: Model, bench: Any, quick: Any
) -> None:
    again = bench(reference_model).run(TorqueInjection(QUICK, reference_model))
    assert again.injection.result == quick.injection.result
    assert again.commands == quick.commands


def test_no_step_has_more_than_a_piece_of_the_evaluation_to_do(
    reference_model: Model, bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slide is evaluated while a torque is on, within the millisecond that a step has."""
    injection, sums = TorqueInjection(QUICK, reference_model), []
    real_step, real_sum = TorqueInjection.step, np.linalg.lstsq

    def step(self: TorqueInjection, *words: Any) -> Any:
        sums.append(0)
        return real_step(self, *words)

    def counted(*words: Any, **options: Any) -> Any:
        sums[-1] += 1
        return real_sum(*words, **options)

    monkeypatch.setattr(TorqueInjection, "step", step)
    monkeypatch.setattr(np.linalg, "lstsq", counted)
    bench(reference_model).run(injection)
    assert injection.phase is Phase.DONE
    assert len(injection.repetitions) == 4
    assert sum(sums) >= 4 * 4
    assert max(sums) <= 2


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("vehicle_speed_m_s", 25.0),
        ("lateral_acceleration_m_s2", 3.0),
        ("yaw_rate_rad_s", 0.5),
        ("torque_sensor_nm", -1.5),
        ("rack_position_m", 0.01),
        ("vehicle_speed_m_s", math.nan),
        ("torque_sensor_nm", math.nan),
        ("motor_speed_rad_s", math.nan),
        ("motor_torque_nm", math.inf),
    ],
)
def test_a_gate_that_opens_takes_the_torque_away_for_good(
    reference_model: Model, bench: Any, field: str, value: float
) -> None:
    at = 2600

    def change(k: int, inputs: InjectionInputs) -> InjectionInputs:
        return inputs._replace(**{field: value}) if at <= k < at + 100 else inputs

    injection = TorqueInjection(QUICK, reference_model)
    run = bench(reference_model).run(injection, change=change)
    assert run.commands[at - 1].active
    assert injection.phase is Phase.ABORTED
    assert field in injection.reason or "motor speed or motor torque" in injection.reason
    assert injection.result is None
    torque = np.abs([command.torque_nm for command in run.commands])
    step = QUICK.abort_nm_per_s * 1e-3
    opened = next(k for k, c in enumerate(run.commands) if c.phase is Phase.ABORTING)
    assert opened - at < 120
    assert np.all(np.diff(torque[opened - 1 :]) <= 0.0)
    assert len(torque) - opened <= torque[opened - 1] / step + 3
    assert not run.commands[-1].active
    again = injection.step(10**12, run_inputs())
    assert again.phase is Phase.ABORTED
    assert again.torque_nm == 0.0


def run_inputs() -> InjectionInputs:
    return InjectionInputs(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_it_waits_until_every_gate_has_been_met_for_a_while(reference_model: Model) -> None:
    injection = TorqueInjection(QUICK, reference_model)
    good = run_inputs()
    for k in range(3000):
        missing = good._replace(yaw_rate_rad_s=math.nan)
        command = injection.step(k * 1_000_000, good if k % 400 else missing)
        assert command.phase is Phase.WAITING
        assert not command.active
    states = {state.name: state for state in injection.gates}
    assert states["yaw_rate_rad_s"].met
    assert states["yaw_rate_rad_s"].limit == QUICK.gates.yaw_rate_rad_s.limit
    for k in range(3000, 3600):
        command = injection.step(k * 1_000_000, good)
    assert command.phase is Phase.REST


def test_a_signal_that_the_rig_does_not_have_is_no_hindrance(
    reference_model: Model, bench: Any
) -> None:
    absent = GateLimit(1.0, absent=True)
    gates = GateSettings(
        vehicle_speed_m_s=absent, lateral_acceleration_m_s2=absent, yaw_rate_rad_s=absent
    )
    nothing = dict.fromkeys(
        ("vehicle_speed_m_s", "lateral_acceleration_m_s2", "yaw_rate_rad_s"), math.nan
    )
    injection = TorqueInjection(InjectionSettings(repetitions=1, gates=gates), reference_model)
    run = bench(reference_model).run(injection, change=lambda _, inputs: inputs._replace(**nothing))
    assert run.injection.phase is Phase.DONE


def test_a_rack_that_does_not_move_is_given_up(reference_model: Model, bench: Any) -> None:
    settings = InjectionSettings(max_torque_nm=0.03, failures_allowed=1)
    run = bench(reference_model).run(TorqueInjection(settings, reference_model))
    assert run.injection.phase is Phase.ABORTED
    assert "no break-away up to 0.03 Nm, 2 times" in run.injection.reason
    largest = max(abs(command.torque_nm) for command in run.commands)
    assert largest == settings.max_torque_nm, "no more: the guard may allow just that"


def test_a_rotor_that_turns_against_the_torque_ends_it(reference_model: Model, bench: Any) -> None:
    """A speed or a command of the wrong sign: the ramp drove a rotor on that had broken away."""

    def turned(_: int, inputs: InjectionInputs) -> InjectionInputs:
        return inputs._replace(motor_speed_rad_s=-inputs.motor_speed_rad_s)

    run = bench(reference_model).run(TorqueInjection(QUICK, reference_model), change=turned)
    assert run.injection.phase is Phase.ABORTED
    assert run.injection.reason == "the rotor turns against the torque: a sign is wrong"
    ending = next(k for k, one in enumerate(run.commands) if one.phase is Phase.ABORTING)
    assert run.commands[ending - 1].phase is Phase.RAMP
    fastest = np.abs(run.column("motor_speed_rad_s")).max()
    assert fastest < 3.0 * QUICK.breakaway_speed_rad_s


def test_a_slide_that_turns_back_ends_the_run(reference_model: Model) -> None:
    injection = TorqueInjection(QUICK, reference_model)
    speed, told = 0.0, None
    for k in range(4000):
        inputs = run_inputs()._replace(motor_speed_rad_s=speed)
        told = injection.step(k * 1_000_000, inputs)
        if told.phase is Phase.RAMP and abs(told.torque_nm) > 0.05:
            speed = told.direction * 3.0
        elif told.phase is Phase.SLIDE:
            speed = -told.direction * 3.0
    assert told is not None
    assert told.phase is Phase.ABORTED
    assert "a sign is wrong" in injection.reason


@pytest.mark.parametrize("step_ns", [0, -1_000_000, 30_000_000])
def test_time_that_stops_or_jumps_ends_the_run(reference_model: Model, step_ns: int) -> None:
    injection = TorqueInjection(QUICK, reference_model)
    t_ns = 0
    for _ in range(1500):
        t_ns += 1_000_000
        command = injection.step(t_ns, run_inputs())
    assert command.phase is Phase.RAMP
    command = injection.step(t_ns + step_ns, run_inputs())
    assert command.phase in {Phase.ABORTING, Phase.ABORTED}
    assert "sample time" in injection.reason


@pytest.mark.parametrize("step_ns", [0, -1])
def test_a_torque_is_lowered_where_sample_time_stands_still(
    reference_model: Model, step_ns: int
) -> None:
    injection, t_ns, now_ns = TorqueInjection(QUICK, reference_model), 0, 10**15
    for _ in range(1500):
        t_ns, now_ns = t_ns + 1_000_000, now_ns + 1_000_000
        command = injection.step(t_ns, run_inputs(), now_ns)
    before_nm = abs(command.torque_nm)
    assert before_nm > 0.05
    for _ in range(1 + math.ceil(before_nm / QUICK.abort_nm_per_s * 1e3)):
        t_ns, now_ns = t_ns + step_ns, now_ns + 1_000_000
        last_nm, command = abs(command.torque_nm), injection.step(t_ns, run_inputs(), now_ns)
        assert abs(command.torque_nm) <= max(last_nm - 0.99e-3 * QUICK.abort_nm_per_s, 0.0)
    assert command.phase is Phase.ABORTED
    assert command.torque_nm == 0.0


def test_a_ramp_too_long_to_be_kept_gives_no_level(reference_model: Model) -> None:
    record = SlideRecord(reference_model)
    inputs = run_inputs()
    for k in range(300):
        record.add(k * 1_000_000, inputs)
    record.begin(1)
    for k in range(300, 61_000):
        record.add(k * 1_000_000, inputs._replace(motor_speed_rad_s=5.0, motor_torque_nm=0.1))
    with pytest.raises(StopIteration) as end:
        next(record.level(0.1, positive=True))
    assert end.value.value is None


def test_a_hand_that_holds_from_the_first_step_on_ends_the_run(reference_model: Model) -> None:
    """0.95 Nm keep the gate (1 Nm) closed, and end each ramp before one of its samples came."""
    injection = TorqueInjection(InjectionSettings(), reference_model)
    held = InjectionInputs(0.0, 0.0, 0.95, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for k in range(10_000):
        command = injection.step(k * 1_000_000, held)
        if command.phase.over:
            break
    assert command.phase is Phase.ABORTED
    assert command.reason == "the rotor did not slide, 4 times"
    assert command.torque_nm == 0.0


def test_no_ramp_begins_before_a_gates_low_pass_has_followed() -> None:
    """The gates start anew with each run: a first sample within the limit may be noise."""
    slow = GateSettings(yaw_rate_rad_s=GateLimit(0.01, filter_s=0.6))
    with pytest.raises(ValueError, match=r"gates\.yaw_rate_rad_s\.filter_s 0\.6 is longer than"):
        InjectionSettings(gates=slow)
    assert InjectionSettings(gates=slow, gates_hold_s=0.6).gates == slow
