"""A real car: what a parked steering must look like, whatever the rough model's numbers are."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.bus.database import load_database
from eps_hil.bus.mapping import load_mapping
from eps_hil.estimation import batch
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.physics.model import load_model
from eps_hil.recordings.can_log import read_frames
from eps_hil.recordings.read import read_recording
from eps_hil.report.rack_force_loop import (
    Estimates,
    Loop,
    SteeringTrace,
    enclosed_work_j,
    loops_by_mode,
    read_steering,
    sliding_force_n,
    strokes,
)
from eps_hil.service.setup import derived_settings

pytestmark = pytest.mark.real_data

ROOT = Path(__file__).parents[2]
DBC = ROOT / "dbc" / "ford_gt350.dbc"
SIGNALS = ROOT / "configs" / "ford_gt350" / "signals.yaml"
MODEL = ROOT / "configs" / "ford_gt350" / "model.yaml"

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Drive:
    """Estimates of the whole log, beside the pinion angle at the same instants."""

    estimates: Estimates
    steering: SteeringTrace
    loops: dict[str, Loop]
    t_s: Floats
    angle_deg: Floats
    mode: npt.NDArray[np.int64]

    def strokes(self) -> list[slice]:
        """From one turning point of the wheel to the next, where it turned more than 30 deg."""
        return strokes(self.t_s, self.angle_deg)


@pytest.fixture(scope="module")
def drive(ford_log: Path) -> Drive:
    recording = read_recording(ford_log, dbc=[DBC], signals=SIGNALS)
    assert recording.notes == ()
    settings = derived_settings(EstimatorSettings(), load_mapping(SIGNALS))
    trace = batch.estimate(recording.series, load_model(MODEL), settings)
    estimates = Estimates(trace.t_ns, trace.rack_force_n, trace.valid)
    steering = read_steering(ford_log, DBC)
    angle = steering.angle_deg
    mode = steering.mode.value[np.searchsorted(steering.mode.t_ns[1:], trace.t_ns, side="right")]
    return Drive(
        estimates,
        steering,
        {loop.name: loop for loop in loops_by_mode(steering, estimates)},
        (trace.t_ns - angle.t_ns[0]) * 1e-9,
        np.interp(trace.t_ns, angle.t_ns, angle.value),
        mode.astype(np.int64),
    )


def test_every_frame_carries_counter_and_checksum_as_the_dbc_says(ford_log: Path) -> None:
    pinion = load_database([DBC]).get_message_by_name("SteeringPinion_Data_Alt")
    counters = []
    for frame in read_frames(ford_log, ids=[pinion.frame_id]):
        values = pinion.decode(frame.data, decode_choices=False)
        data = frame.data
        total = data[0] + data[1] + data[6] + data[7] + values["StePinAn_No_Cnt"]
        assert values["StePinAn_No_Cs"] == (255 - total) % 256
        counters.append(values["StePinAn_No_Cnt"])
    assert len(counters) == 2687
    assert set(np.diff(counters) % 16) == {1}


def test_rates_are_those_of_the_dbc(drive: Drive) -> None:
    assert np.median(np.diff(drive.steering.angle_deg.t_ns)) == pytest.approx(10e6, rel=0.01)
    assert np.median(np.diff(drive.steering.torque_nm.t_ns)) == pytest.approx(20e6, rel=0.01)


def test_current_is_the_supply_s_not_the_phase_s(drive: Drive) -> None:
    """It has no sign: drawn in both directions of assist, given back only while braking."""
    current, torque = drive.steering.current_a, drive.steering.torque_nm
    speed = np.gradient(drive.steering.angle_deg.value, drive.steering.angle_deg.t_ns * 1e-9)
    pushing = np.interp(torque.t_ns, drive.steering.angle_deg.t_ns, speed) * torque.value > 500
    left = current.value[pushing & (torque.value < 0)]
    right = current.value[pushing & (torque.value > 0)]
    assert len(left) > 100
    assert len(right) > 100
    assert np.median(left) > 5
    assert np.median(right) > 5
    assert current.value.min() > -5


def test_driver_torque_and_motion_have_one_sign(drive: Drive) -> None:
    """CONTRACT 1: positive torque-sensor torque and positive motion turn the same way."""
    torque = drive.steering.torque_nm
    driven = np.interp(drive.estimates.t_ns, torque.t_ns, torque.value)
    for stroke in drive.strokes():
        way = np.sign(drive.angle_deg[stroke.stop] - drive.angle_deg[stroke.start])
        assert np.median(driven[stroke]) * way > 1.0


def test_the_estimate_is_valid_and_finite(drive: Drive) -> None:
    assert np.isfinite(drive.estimates.rack_force_n).all()
    started = drive.t_s > 1.0  # parked: its friction is unknown before the rotor has slid
    assert drive.estimates.valid[started].all()
    assert not drive.estimates.valid[drive.t_s < 0.5].any()
    assert drive.estimates.valid.mean() > 0.96


def test_sliding_tyres_push_back_with_kilonewtons(drive: Drive) -> None:
    """Two tyres of this car scrubbing on the spot: 2 to 3 kN at the rack, by Gough's formula."""
    assert len(drive.strokes()) >= 25
    for stroke in drive.strokes():
        push_back = sliding_force_n(drive.angle_deg[stroke], drive.estimates.rack_force_n[stroke])
        assert 1_500 < push_back < 6_000, f"at {drive.t_s[stroke.start]:.2f} s"
    assert np.abs(drive.estimates.rack_force_n).max() < 10_000


def test_after_a_reversal_the_tyres_unwind_before_they_push_back(drive: Drive) -> None:
    """The dead band: the force keeps the old stroke's sign over the first degrees of the new."""
    for stroke in drive.strokes()[1:]:
        angle, force = drive.angle_deg[stroke], drive.estimates.rack_force_n[stroke]
        way = np.sign(angle[-1] - angle[0])
        assert force[0] * way < -1_000, f"at {drive.t_s[stroke.start]:.2f} s"
        crossing = int(np.argmax(force * way > 0))
        assert 3 < (angle[crossing] - angle[0]) * way < 30


def test_each_mode_that_was_steered_has_its_loop(drive: Drive) -> None:
    """Work goes into the tyres in both modes: ∫F dx > 0, of the order force times travel."""
    rack_m_per_deg = np.radians(1) / load_model(MODEL).pinion_ratio_rad_per_m
    for name in ("sport", "comfort"):
        travel_m = np.nansum(np.abs(np.diff(drive.loops[name].angle_deg))) * rack_m_per_deg
        work_j = enclosed_work_j(drive.loops[name], rack_m_per_deg)
        assert 1_000 < work_j / travel_m < 6_000, name


def test_normal_mode_was_hardly_steered(drive: Drive) -> None:
    """What the recording does not hold: in normal the wheel made half a stroke, no loop."""
    angle = drive.loops["normal"].angle_deg
    assert np.nansum(np.abs(np.diff(angle))) < 40
    assert drive.loops["normal"].duration_s < 2.5


def test_the_modes_differ_in_the_driver_s_effort(drive: Drive) -> None:
    """Sport asks for more torque than comfort while both turn the same tyres."""
    torque = drive.steering.torque_nm
    effort = np.abs(np.interp(drive.estimates.t_ns, torque.t_ns, torque.value))
    force = np.abs(drive.estimates.rack_force_n)
    moving = np.zeros(len(force), bool)
    for stroke in drive.strokes():
        middle = (stroke.start + stroke.stop) // 2
        moving[middle : stroke.stop - 60] = True
    sport, comfort = moving & (drive.mode == 1), moving & (drive.mode == 2)
    effort_ratio = np.median(effort[sport]) / np.median(effort[comfort])
    assert 1.15 < effort_ratio < 1.5
    assert np.median(force[sport]) / np.median(force[comfort]) < effort_ratio


def test_rack_work_comes_from_driver_and_supply(drive: Drive, ford_log: Path) -> None:
    """Energy balance over the whole log: less out than in, and more than half of it."""
    rack_m_per_deg = np.radians(1) / load_model(MODEL).pinion_ratio_rad_per_m
    rack_j = sum(enclosed_work_j(loop, rack_m_per_deg) for loop in drive.loops.values())
    info = load_database([DBC]).get_message_by_name("EPAS_INFO")
    power, t_s = [], []
    for frame in read_frames(ford_log, ids=[info.frame_id]):
        values = info.decode(frame.data, decode_choices=False)
        power.append(values["SteMdule_U_Meas"] * values["SteMdule_I_Est"])
        t_s.append(frame.t_ns * 1e-9)
    standby_w = np.median(np.array(power)[500:680])  # 10 to 13.6 s: the wheel rests
    supply_j = np.trapezoid(np.array(power) - standby_w, t_s)
    angle, torque = drive.steering.angle_deg, drive.steering.torque_nm
    held = np.interp(angle.t_ns, torque.t_ns, torque.value)
    driver_j = np.trapezoid(held, np.radians(angle.value))
    assert 0.5 < rack_j / (supply_j + driver_j) < 0.9


def test_mapping_and_model_speak_of_one_gear() -> None:
    """The angle's scale and the model's ratios are two places for one number."""
    model, mapping = load_model(MODEL), load_mapping(SIGNALS)
    scale = np.radians(1) * model.rack_to_rotor_ratio_rad_per_m / model.pinion_ratio_rad_per_m
    assert mapping.signals["motor_angle_rad"].scale == pytest.approx(scale, rel=1e-4)
    power = mapping.signals["motor_torque_nm"].supply_power
    assert power is not None
    assert model.delays_s.motor_torque == power.lag_s
