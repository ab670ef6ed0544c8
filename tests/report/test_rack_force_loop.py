"""The loop figure on a made-up steering log: angle a sine, rack force a dry slider's."""

from pathlib import Path

import can
import numpy as np
import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.errors import InputError
from eps_hil.report import figures
from eps_hil.report.rack_force_loop import (
    Estimates,
    Loop,
    SteeringSignals,
    SteeringTrace,
    draw,
    enclosed_work_j,
    loops_by_mode,
    read_published,
    read_steering,
)

DBC = Path(__file__).parents[2] / "dbc" / "ford_gt350.dbc"
START_S = 1_700_000_000.0


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """4 s of turning, ±50 deg at 1 Hz: two cycles in sport, two in comfort."""
    database = load_database([DBC])
    pinion = database.get_message_by_name("SteeringPinion_Data_Alt")
    info = database.get_message_by_name("EPAS_INFO")
    path = tmp_path / "car.log"
    with can.Logger(str(path)) as writer:
        for k in range(401):
            t = k * 0.01
            angle = {signal.name: 0 for signal in pinion.signals}
            angle["StePinRelInit_An_Sns"] = round(50 * np.sin(2 * np.pi * t), 1)
            writer(_frame(pinion, angle, t))
            if k % 2 == 0:
                values = {signal.name: 0 for signal in info.signals} | {
                    "SteeringColumnTorque": 3.0 * np.sign(np.cos(2 * np.pi * t)),
                    "SteMdule_U_Meas": 14.0,
                    "SteeringEffortMode": 1 if t < 2 else 2,
                }
                writer(_frame(info, values, t))
    return path


def _frame(message: object, values: object, t: float) -> can.Message:
    data = message.encode(values, strict=False)  # type: ignore[attr-defined]
    frame_id = message.frame_id  # type: ignore[attr-defined]
    return can.Message(START_S + t, frame_id, is_extended_id=False, data=data)


def _estimates() -> Estimates:
    t = np.arange(0, 4, 1e-3)
    force = 3000.0 * np.sign(np.cos(2 * np.pi * t))
    t_ns = np.round((START_S + t) * 1e9).astype(np.int64)
    return Estimates(t_ns, force, np.ones(len(t), bool))


def test_signals_are_read_with_their_stamps_and_mode_names(log: Path) -> None:
    trace = read_steering(log, DBC)
    assert len(trace.angle_deg.t_ns) == 401
    assert trace.angle_deg.value.max() == pytest.approx(50.0)
    assert trace.mode_names == {0: "normal", 1: "sport", 2: "comfort"}


def test_every_mode_that_was_driven_has_its_loop(log: Path) -> None:
    loops = loops_by_mode(read_steering(log, DBC), _estimates())
    assert [loop.name for loop in loops] == ["sport", "comfort"]
    assert [loop.duration_s for loop in loops] == pytest.approx([2.0, 2.0], abs=0.02)


def test_enclosed_work_is_the_area_of_the_loop(log: Path) -> None:
    """Two cycles of ±3 kN over ±50 deg at 55 mm a turn: 2 · 4 · 3000 N · 7.64 mm."""
    sport, _ = loops_by_mode(read_steering(log, DBC), _estimates())
    expected = 2 * 4 * 3000.0 * 50 * 0.055 / 360
    assert enclosed_work_j(sport, 0.055 / 360) == pytest.approx(expected, rel=0.02)


def test_an_elastic_force_encloses_nothing() -> None:
    t = np.linspace(0, 1, 1001)
    angle = np.sin(2 * np.pi * t)
    assert enclosed_work_j(Loop("spring", t, angle, 100 * angle), 1.0) == pytest.approx(0, abs=1e-9)


def test_invalid_estimates_are_not_shown(log: Path) -> None:
    estimates = _estimates()
    invalid = Estimates(estimates.t_ns, estimates.rack_force_n, estimates.t_ns < 0)
    assert loops_by_mode(read_steering(log, DBC), invalid) == []


@pytest.mark.parametrize(
    "suffix",
    [
        pytest.param(suffix, marks=() if suffix == ".svg" else pytest.mark.slow)
        for suffix in figures.SUFFIXES
    ],
)
def test_figure_is_written(log: Path, tmp_path: Path, suffix: str) -> None:
    trace: SteeringTrace = read_steering(log, DBC)
    path = draw(trace, loops_by_mode(trace, _estimates()), tmp_path / f"f{suffix}", title="made up")
    assert path.stat().st_size > 5_000


def test_wrong_figure_name_signal_and_log_are_refused(log: Path, tmp_path: Path) -> None:
    trace = read_steering(log, DBC)
    with pytest.raises(InputError, match="not a kind of figure"):
        draw(trace, loops_by_mode(trace, _estimates()), tmp_path / "f.xyz", title="")
    with pytest.raises(InputError, match="no such signal"):
        read_steering(log, DBC, SteeringSignals(mode="EPAS_INFO.Mode"))
    empty = tmp_path / "empty.log"
    empty.write_text("(1.0) can0 123#00\n")
    with pytest.raises(InputError, match="no frame carries it"):
        read_steering(empty, DBC)


def test_published_estimates_are_dated_back_from_their_sync_frame(tmp_path: Path) -> None:
    """Force and validity as sent; the time is the sync frame's, less the latency."""
    rig = DBC.with_name("eps_rig.dbc")
    encoder = FrameEncoder(load_database([rig]), "EPSHIL_Estimate")
    path = tmp_path / "bus.log"
    with can.Logger(str(path)) as writer:
        for k in range(3):
            stamp = START_S + 0.01 * k
            writer(can.Message(stamp, 0x85, is_extended_id=False, data=bytes(8)))
            values = {"RackForceEstimate": 1000.0 * k, "EstimateStatus": 2 if k else 1}
            data = encoder.encode(values)
            writer(can.Message(stamp + 3e-4, encoder.can_id, is_extended_id=False, data=data))
    got = read_published(path, rig, sync_id=0x85, latency_s=0.065)
    assert got.rack_force_n.tolist() == [0.0, 1000.0, 2000.0]
    assert got.valid.tolist() == [False, True, True]
    assert (got.t_ns - START_S * 1e9).tolist() == pytest.approx([-65e6, -55e6, -45e6], abs=1e3)
    with pytest.raises(InputError, match="no estimate follows"):
        read_published(path, rig, sync_id=0x86, latency_s=0.065)
