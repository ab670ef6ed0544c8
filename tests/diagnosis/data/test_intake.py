"""What a diagnosis refuses to take, by name."""

import numpy as np
import pytest

from eps_hil.diagnosis.data.intake import BELIEVABLE, RecordingError, prepared, split, unseen
from eps_hil.series import Series


def signals(n: int = 5000) -> dict[str, Series]:
    t_ns = np.arange(n, dtype=np.int64) * 1_000_000
    wave = np.sin(1e-3 * np.arange(n))
    return {name: Series(t_ns, wave) for name in BELIEVABLE}


@pytest.mark.parametrize("signal", BELIEVABLE)
def test_what_no_drive_does_is_refused_by_name(signal: str) -> None:
    """A log gone wild, or a scaling that is off by powers of ten."""
    recording = signals()
    assert prepared("weave", recording, 0.0).name == "weave"
    value = recording[signal].value.copy()
    value[100:200] = -1e20
    value[300] = np.nan
    wild = {**recording, signal: Series(recording[signal].t_ns, value)}
    with pytest.raises(RecordingError, match=f"{signal} reaches 1e[+]20.*unit and scaling") as said:
        prepared("weave", wild, 0.0)
    assert said.value.recording == "weave"


def test_a_motion_in_five_values_is_said_to_be_one() -> None:
    recording = {name: one for name, one in signals().items() if name != "motor_speed_rad_s"}
    angle = recording["motor_angle_rad"]
    coarse = Series(angle.t_ns, np.round(2.5 * angle.value))
    problem = r"motor_angle_rad takes 5 different values in 5000 samples: too few"
    with pytest.raises(RecordingError, match=problem):
        prepared("weave", {**recording, "motor_angle_rad": coarse}, 0.0)


def test_the_last_part_of_a_recording_knows_when_it_begins() -> None:
    """A clock that drifts goes on drifting."""
    whole = {"weave": signals(9000)}
    first, last = split(whole, {})
    assert prepared("weave", first["weave"], 0.0, whole).begins_s == 0.0
    part = prepared("weave", last["weave"], 0.0, whole)
    assert part.begins_s == pytest.approx(6.0, abs=0.01)
    assert part.since_start_s[0] == pytest.approx(6.0, abs=0.01)
    assert prepared("weave", whole["weave"], 0.0).begins_s == 0.0


@pytest.mark.parametrize("signal", ["motor_torque_nm", "motor_speed_rad_s"])
def test_a_signal_of_one_value_is_asked_for(signal: str) -> None:
    recording = signals()
    one = recording[signal]
    single = Series(one.t_ns[:1], one.value[:1])
    rest = {name: one for name, one in recording.items() if name != "motor_angle_rad"}
    with pytest.raises(RecordingError, match="a diagnosis needs"):
        prepared("weave", {**rest, signal: single}, 0.0)


def test_a_motor_torque_of_one_value_is_said() -> None:
    moving, still = signals(), signals()
    torque = still["motor_torque_nm"]
    still["motor_torque_nm"] = Series(torque.t_ns, np.full(len(torque.value), 0.7))
    both = [prepared("moving", moving, 0.0), prepared("still", still, 0.0)]
    (said,) = [one for one in unseen(both) if "one value" in one]
    assert said.startswith("motor_torque_nm has one value throughout (still). If")
