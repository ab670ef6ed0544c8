"""Channels that are not what their names say are refused by name; honest ones, however odd, not."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis import against
from eps_hil.diagnosis.against import diagnose_against
from eps_hil.diagnosis.data import channels
from eps_hil.diagnosis.data.channels import channels_in_doubt, check_channels
from eps_hil.diagnosis.data.intake import RecordingError
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model
from eps_hil.series import Series

Signals = Mapping[str, Series]
Record = Callable[..., Mapping[str, Signals]]

TORQUE, SENSOR, LOAD = "motor_torque_nm", "torque_sensor_nm", "rack_force_n"
SPEED, ANGLE, PLACE = "motor_speed_rad_s", "motor_angle_rad", "rack_position_m"


@pytest.fixture(scope="module")
def weave(record: Record) -> Signals:
    return record({}, ("weave",), seconds=12.0)["weave_1"]


def times(series: Signals, factors: Mapping[str, float]) -> Signals:
    return {
        name: Series(one.t_ns, factors.get(name, 1.0) * one.value) for name, one in series.items()
    }


def swapped(series: Signals, one: str, other: str) -> Signals:
    return {**series, one: series[other], other: series[one]}


def slower_by(series: Signals, factor: int) -> Signals:
    return {name: Series(one.t_ns * factor, one.value) for name, one in series.items()}


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ({SENSOR: -1.0}, "torque_sensor_nm has the wrong sign; turn it"),
        ({LOAD: -1.0}, "rack_force_n has the wrong sign; turn it"),
        ({SPEED: -1.0}, "opposite signs; turn the sign of one"),
        ({SPEED: -1.0, ANGLE: -1.0}, r"motor_speed_rad_s \(and motor_angle_rad\) has the wrong"),
        ({PLACE: -1.0}, "rack_position_m: turns the other way than motor_angle_rad"),
        ({TORQUE: 1e3}, "motor_torque_nm: is about 1000 times too large: in mNm.*give it in Nm"),
        ({SENSOR: 1e3}, "torque_sensor_nm: is about 1000 times too large: in mNm"),
        ({LOAD: 1e-3}, "rack_force_n: is about 1000 times too small: in kN"),
        ({SPEED: 30 / np.pi}, "motor_speed_rad_s: is 9.55 times .* in rpm.*give it in rad/s"),
        ({PLACE: 1e3}, "rack_position_m: is in mm"),
        ({ANGLE: 180 / np.pi}, "motor_speed_rad_s: is 0.0175 times the derivative"),
    ],
)
def test_wrong_signs_and_units_are_named(
    weave: Signals, reference_model: Model, factors: Mapping[str, float], words: str
) -> None:
    with pytest.raises(RecordingError, match=words) as said:
        check_channels({"weave": times(weave, factors)}, reference_model)
    assert said.value.recording == "weave"


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        (TORQUE, SENSOR, "looks like motor_torque_nm: the two columns are swapped"),
        (TORQUE, LOAD, "looks like motor_torque_nm: the two columns are swapped"),
        (SPEED, ANGLE, "looks like the angle of motor_angle_rad: they are swapped"),
    ],
)
def test_swapped_columns_are_named(
    weave: Signals, reference_model: Model, one: str, other: str, words: str
) -> None:
    with pytest.raises(RecordingError, match=words):
        check_channels({"weave": swapped(weave, one, other)}, reference_model)


def test_an_angle_that_starts_anew_every_turn_is_named(
    weave: Signals, reference_model: Model
) -> None:
    angle = weave[ANGLE]
    turned = Series(angle.t_ns, (angle.value + np.pi) % (2 * np.pi) - np.pi)
    with pytest.raises(RecordingError, match=r"jumps by 2π .*unwrap it"):
        check_channels({"weave": {**weave, ANGLE: turned}}, reference_model)


def test_a_time_in_ms_is_refused_before_anything_is_made_of_it(
    weave: Signals, reference_model: Model
) -> None:
    """A grid over it would have a thousand times the samples."""
    words = r"a value every 1 s, 11999 s \(3.33 h\) in all, .* is the time in ms.*give the time in"
    slow = {"weave": slower_by(weave, 1000)}
    for recordings, holdouts in ((slow, {}), ({"good": weave}, slow)):
        with pytest.raises(RecordingError, match=words) as said:
            diagnose(reference_model, recordings, holdouts)
        assert said.value.recording == "weave"
    with pytest.raises(RecordingError, match=words):
        diagnose_against({"traces": weave}, reference_model, slow, {})


def test_a_rotor_that_its_load_drives_is_given_in_rad_per_second(
    record: Record, reference_model: Model
) -> None:
    """With the motor off and no torsion bar the load opposes all that friction and inertia do.

    Friction that grows with the load could then be the whole of it, and the inertia nothing; and
    the motor's torque is noise, which has no unit.
    """
    rng, kernel = np.random.default_rng(4), np.hanning(31)
    for seed in (1, 2, 3):
        series = record({}, ("steps",), seed=seed, seconds=15.0)[f"steps_{seed}"]
        motor = series[TORQUE]
        drive = np.interp(motor.t_ns + 1e6, motor.t_ns, motor.value)  # it is told 1 ms late
        drive += reference_model.sensor_to_rotor * series[SENSOR].value
        drive = np.convolve(drive, kernel / kernel.sum(), mode="same")
        force = series[LOAD].value - reference_model.rack_to_rotor_ratio_rad_per_m * drive
        off = {
            **{name: one for name, one in series.items() if name != SENSOR},
            LOAD: Series(motor.t_ns, force),
            TORQUE: Series(motor.t_ns, 3e-3 * rng.standard_normal(len(drive))),
        }
        check_channels({"steps": off}, reference_model)
        with pytest.raises(RecordingError, match="rpm"):
            check_channels({"steps": times(off, {SPEED: 30 / np.pi})}, reference_model)


def test_a_blunder_is_no_finding(weave: Signals, reference_model: Model) -> None:
    """Not even where only the hold-out has it."""
    wrong = times(weave, {TORQUE: 1e3})
    with pytest.raises(RecordingError, match="in mNm") as said:
        diagnose(reference_model, {"fit": weave}, {"kept": wrong})
    assert said.value.recording == "kept"


HONEST: Mapping[str, Mapping[str, float]] = {
    "as it is": {},
    "gain 0.7": {TORQUE: 0.7},
    "gain 2.9": {TORQUE: 2.9},
    "sensor at half": {SENSOR: 0.5},
    "load a half too large": {LOAD: 1.5},
    "ratio ten per cent off": {PLACE: 1.1},
    "motor off": {TORQUE: 0.0},
}


@pytest.mark.parametrize("what", HONEST)
def test_strong_effects_are_left_to_the_diagnosis(
    weave: Signals, reference_model: Model, what: str
) -> None:
    check_channels({"weave": times(weave, HONEST[what])}, reference_model)


@pytest.mark.parametrize(
    "lost", [(SENSOR,), (LOAD,), (SPEED,), (ANGLE,), (PLACE,), (SPEED, SENSOR), (ANGLE, PLACE)]
)
def test_what_was_not_recorded_is_no_blunder(
    weave: Signals, reference_model: Model, lost: tuple[str, ...]
) -> None:
    kept = {name: one for name, one in weave.items() if name not in lost}
    check_channels({"weave": kept}, reference_model)


STRONG: Mapping[str, Mapping[str, float]] = {
    "drag": {"QUAD": 2e-5},
    "viscous friction": {"VISC": 3e-3},
    "friction at a place": {"POSF": 0.3, "POSC": 0.0, "POSW": 0.005},
    "saturation": {"SAT": 0.3},
    "spring": {"SPRING": 0.02},
    "stiff spring": {"SPRING": 0.05},
    "end stop": {"STOP_X": 0.004, "STOP_K": 2e5},
    "inertia": {"INERTIA": 4.0e-4},
    "offset": {"EM_OFF": 0.3},
    "friction twice": {"K0P": 0.11, "K0N": 0.25},
    "no hands": {"HAND": 0.0},
}


@pytest.mark.slow
@pytest.mark.parametrize("what", STRONG)
def test_strong_physics_is_no_blunder(
    record: Record, reference_model: Model, other_rig: Any, what: str
) -> None:
    plant = {getattr(other_rig, key): value for key, value in STRONG[what].items()}
    manoeuvres = ("sweep", "weave", "slow", "free", "steps")
    check_channels(record(plant, manoeuvres, noise=3.0), reference_model)


def test_a_wrong_model_file_is_no_blunder(weave: Signals, reference_model: Model) -> None:
    for factor in (0.3, 3.0):
        inertia = factor * reference_model.inertia_kg_m2
        check_channels({"weave": weave}, replace(reference_model, inertia_kg_m2=inertia))


def with_late(series: Signals, name: str, seconds: Callable[[Any], Any]) -> Signals:
    t_ns = series[name].t_ns
    late = np.round(1e9 * seconds(1e-9 * t_ns)).astype(np.int64)
    return {**series, name: Series(t_ns + late, series[name].value)}


def test_a_late_or_drifting_clock_is_no_blunder(weave: Signals, reference_model: Model) -> None:
    for name in (TORQUE, SENSOR, LOAD, SPEED):
        late = with_late(weave, name, lambda t: 0.02 + 0 * t)
        check_channels({"weave": late}, reference_model)
    drifting = with_late(weave, ANGLE, lambda t: 2e-3 * t)
    check_channels({"weave": drifting}, reference_model)


@pytest.mark.parametrize("name", [TORQUE, SENSOR, LOAD, SPEED, ANGLE])
def test_a_signal_that_sticks_or_is_lost_for_seconds_is_no_blunder(
    weave: Signals, reference_model: Model, name: str
) -> None:
    one = weave[name]
    stuck, lost = one.value.copy(), one.value.copy()
    stuck[4000:7000] = stuck[4000]
    lost[4000:5000] = np.nan
    for value in (stuck, lost):
        check_channels({"weave": {**weave, name: Series(one.t_ns, value)}}, reference_model)


def test_of_a_long_recording_the_liveliest_stretch_is_looked_at(
    weave: Signals, reference_model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(channels, "LONGEST_S", 12.0)
    monkeypatch.setattr(channels, "LEAST_S", 12.0)
    rest = {name: np.full(20_000, one.value[0]) for name, one in weave.items()}
    t_ns = np.arange(32_000, dtype=np.int64) * 1_000_000
    long = {name: Series(t_ns, np.append(rest[name], one.value)) for name, one in weave.items()}
    check_channels({"long": long}, reference_model)
    with pytest.raises(RecordingError, match="torque_sensor_nm has the wrong sign"):
        check_channels({"long": times(long, {SENSOR: -1.0})}, reference_model)


def test_trusted_channels_are_doubted_in_words_only(weave: Signals, reference_model: Model) -> None:
    wrong = {"weave": times(weave, {SENSOR: 1e3})}
    with pytest.raises(RecordingError, match="in mNm"):
        channels_in_doubt(wrong, reference_model, trusted=False)
    (said,) = channels_in_doubt(wrong, reference_model, trusted=True)
    assert said.startswith("weave: torque_sensor_nm: is about 1000 times too large: in mNm")
    assert channels_in_doubt({"weave": weave}, reference_model, trusted=True) == []


@pytest.mark.parametrize("plant", ["SAT", "STOP_X"])
def test_strong_physics_elsewhere_makes_no_channel_too_large(
    record: Record, reference_model: Model, other_rig: Any, plant: str
) -> None:
    """Nobody steers with some mNm, whatever else would then balance."""
    strong = {
        "SAT": {other_rig.SAT: 2.0},
        "STOP_X": {other_rig.STOP_X: 2e-3, other_rig.STOP_K: 3e5},
    }
    made = record({**strong[plant], other_rig.HAND: 3.0}, ("weave", "sweep"), seconds=12.0)
    check_channels(made, reference_model)


def test_an_angle_that_starts_anew_after_any_range_is_told(
    weave: Signals, reference_model: Model
) -> None:
    """Motors that report 16 bits over 25 rad."""
    angle = weave[ANGLE]
    wrapped = Series(angle.t_ns, (angle.value + 12.5) % 25.0 - 12.5)
    with pytest.raises(RecordingError, match=r"motor_angle_rad: jumps by 2[45]\S* rad \d+ times"):
        check_channels({"w": {**weave, ANGLE: wrapped}}, reference_model)


def test_a_value_that_was_read_wrong_is_no_new_turn(weave: Signals, reference_model: Model) -> None:
    angle = weave[ANGLE]
    value = np.clip(angle.value, -5.0, 5.0)
    value[[2000, 5000]] = 200.0
    channels.check_turning_on("w", Series(angle.t_ns, value))


@pytest.mark.parametrize("trusted", [False, True])
def test_a_simulator_is_asked_of_channels_that_are_trusted_too(
    trusted: bool, reference_model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bool] = []

    def doubts(_recordings: object, _model: object, trust: bool) -> list[str]:
        asked.append(trust)
        raise RecordingError("a.csv", "is in doubt")

    monkeypatch.setattr(against, "channels_in_doubt", doubts)
    with pytest.raises(RecordingError):
        against.diagnose_against({}, reference_model, {}, {}, trust_channels=trusted)
    assert asked == [trusted]
