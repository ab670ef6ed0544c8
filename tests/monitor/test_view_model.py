"""Frames in, figures out: a simulated rig and the service in lock-step, healthy and not."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from rich.console import Console

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import BusState, PortCounts
from eps_hil.estimation.validity import Reason
from eps_hil.monitor.figures import Figures
from eps_hil.monitor.text import line, screen
from eps_hil.rig.manoeuvre import load_manoeuvre
from eps_hil.service.core import Status, silent_values
from eps_hil.service.verdict import NEEDED, SignalVerdict

ROOT = Path(__file__).parents[2]
Make = Callable[..., Any]


def written(figures: Figures) -> str:
    out = StringIO()
    Console(file=out, width=120).print(screen(figures))
    return out.getvalue()


@pytest.mark.slow
def test_a_healthy_rig(bench: Make) -> None:
    rig = bench(manoeuvre="weave", after_s=0.0)
    last = rig.run(5_000)
    verdicts = {one.name: one.verdict for one in last.signals}
    assert set(verdicts.values()) == {"fine"}
    rates = {one.name: one.rate_hz for one in last.signals}
    assert rates["motor_speed_rad_s"] == pytest.approx(1_000.0)
    assert rates["vehicle_speed_m_s"] == pytest.approx(50.0)
    assert last.estimate.status == "valid"
    assert last.estimate.rate_hz == pytest.approx(1_000.0)
    assert abs(last.estimate.rack_force_n - last.estimate.load_cell_n) < 150  # not of one instant
    residual = last.residual
    assert residual.rms_moving_n is not None
    assert residual.rms_moving_n < 20.0
    assert residual.balance_nm is not None
    assert residual.balance_floor_nm is not None
    assert 0.3 * residual.balance_floor_nm < residual.balance_nm < 0.01
    assert residual.error_n is not None
    assert abs(residual.error_n) < 60.0
    assert residual.why_not == ""
    assert rig.changes == []
    assert last.bus.frames_per_s == pytest.approx(4_260.0, rel=0.02)
    # docs/reference-bus.md: 48 to 58 % of 1 Mbit/s, with what the service sends besides
    assert last.bus.kbit_per_s == pytest.approx(525.0, rel=0.1)
    assert last.told["EPS_OverrideStatus"]["OverrideState"] == "Released"
    assert "status      valid" in written(last)
    assert json.loads(json.dumps(last.as_json()))["estimate"]["status"] == "valid"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("forth_nm", "back_nm", "alarms"),
    [
        (0.016, 0.0858, {"moving", "torque balance"}),
        (0.096, 0.1658, {"torque balance"}),  # limits grow with the friction of the model
    ],
)
def test_a_model_with_another_friction_level_raises_the_alarm(
    bench: Make, tmp_path: Path, forth_nm: float, back_nm: float, alarms: set[str]
) -> None:
    """The rig obeys the reference model; service and monitor believe in 40 mNm less, or more."""
    good = ROOT / "configs" / "reference_rig.yaml"
    model = tmp_path / "wrong.yaml"
    text = good.read_text()
    text = text.replace("offset_pos_nm: 5.600e-2", f"offset_pos_nm: {forth_nm}")
    model.write_text(text.replace("offset_neg_nm: 1.258e-1", f"offset_neg_nm: {back_nm}"))
    rig = bench(model=model, rig_model=good, manoeuvre="weave", after_s=2.0)
    last = rig.run(7_500)
    raised = {name: at for at, name, on in rig.changes if on}
    assert set(raised) == alarms
    assert min(raised.values()) >= 2_000  # not before the time that was set
    assert last.residual.rms_moving_n == pytest.approx(100.0, rel=0.15)  # 40 mNm at 2513 rad/m
    assert last.residual.balance_nm == pytest.approx(0.04, rel=0.05)
    assert "ALARM: rig and model part: torque balance" in written(last)
    assert "ALARM: rig and model part: torque balance" in line(last)


def test_a_silent_service_has_no_residual_but_a_torque_balance(bench: Make) -> None:
    last = bench(manoeuvre="weave", service=False).run(3_000)
    assert last.estimate.status == "silent"
    assert last.estimate.reasons == "no frame yet"
    assert last.residual.rms_moving_n is None
    assert last.residual.balance_nm is not None
    assert "no estimate on the bus" in last.residual.why_not


def only(ids: set[int]) -> Callable[[int, list[Frame]], list[Frame]]:
    return lambda _, frames: [frame for frame in frames if frame.can_id in ids]


def test_without_a_load_cell_it_says_why_there_is_no_residual(bench: Make) -> None:
    last = bench().run(1_000, only({0x100, 0x101}))
    assert last.residual.why_not == "no load cell (rack_force_n)"
    verdicts = {one.name: one.verdict for one in last.signals}
    assert verdicts["rack_force_n"] == "never seen"
    assert verdicts["motor_speed_rad_s"] == "fine"
    assert last.estimate.status == "valid"
    assert math.isnan(last.estimate.load_cell_n)


def test_a_signal_that_stops_and_damaged_frames_are_told(bench: Make) -> None:
    rig = bench()

    def spoil(k: int, frames: list[Frame]) -> list[Frame]:
        damaged = [
            replace(f, data=bytes([f.data[0] ^ 1]) + f.data[1:]) if f.can_id == 0x110 else f
            for f in frames
        ]
        return damaged if k < 500 else [f for f in frames if f.can_id != 0x101]

    rig.run(500, spoil)
    before = rig.figures[-1]
    assert {s.name: s.verdict for s in before.signals}["rack_force_n"] == "bad sample"
    assert before.bus.crc_errors == 500
    last = rig.run(500, spoil)
    verdicts = {one.name: one.verdict for one in last.signals}
    assert verdicts["motor_torque_nm"] == "silent"
    assert verdicts["rack_force_n"] == "fine"
    assert last.estimate.status == "invalid"
    assert "motor torque" in last.estimate.reasons
    assert "invalid: " in written(last)
    assert "motor_torque_nm" in line(last)


def test_lost_frames_are_counted(bench: Make) -> None:
    rig = bench()
    last = rig.run(500, lambda k, frames: [] if k % 100 == 50 else frames)
    assert last.bus.lost_by_counter == 5 * 3  # three messages each ms; no slower one then


def test_the_ports_counts_and_state_are_shown(bench: Make) -> None:
    rig = bench()
    rig.run(250)
    now = rig.figures[-1].t_ns
    counts = PortCounts(received=1, lost_in_kernel=7, error_frames=3)
    seen = rig.monitor.figures(now, counts, BusState.BUS_OFF)
    assert (seen.bus.lost_in_kernel, seen.bus.error_frames) == (7, 3)
    assert "bus off" in written(seen)
    assert "7 in the kernel" in written(seen)


def test_a_damaged_estimate_is_not_taken(bench: Make) -> None:
    rig = bench()
    rig.run(250)
    told = rig.monitor._estimate
    before = told.t_ns
    assert not told.take(Frame(before + 1, 0x120, bytes(8)))
    assert told.t_ns == before
    assert told.bad == 1
    rig.monitor.take([Frame(before + 1, 0x120, b"", remote=True)])
    assert told.bad == 1, "a request holds no data"


def test_the_labels_of_a_state_are_no_missing_values(bench: Make) -> None:
    """The DBC labels status 3 "invalid": a state, not "signal not available"."""
    rig = bench()
    rig.run(250)
    encoder = rig.core._encoder
    frame = encoder.frame(silent_values(Status.INVALID, Reason.NO_INPUT))
    now = bench_now(rig)
    rig.monitor.take([replace(frame, t_ns=now)])
    seen = rig.monitor.figures(now + 1).estimate
    assert (seen.status, seen.reasons) == ("invalid", "no input")
    assert math.isnan(seen.rack_force_n)  # sent as not available


def bench_now(rig: Any) -> int:
    return int(rig.monitor._estimate.t_ns) + 5_000_000


def test_a_clock_step_empties_the_window(bench: Make, bench_module: ModuleType) -> None:
    rig = bench(service=False, manoeuvre="weave")
    rig.run(3_000)
    back = -10_000_000_000

    def earlier(_: int, frames: list[Frame]) -> list[Frame]:
        return [replace(f, t_ns=f.t_ns + back) for f in frames]

    rig.run(500, earlier)
    now = bench_module.T0_NS + rig.millisecond * bench_module.MS + back
    seen = rig.monitor.figures(now)
    assert seen.residual.balance_nm is None
    assert "less than 2.5 s" in seen.residual.why_not


def test_the_manoeuvre_of_these_tests_moves() -> None:
    assert load_manoeuvre("weave").name == "weave"


def test_the_services_verdict_on_a_signal_stands_beside_the_monitors_own(bench: Make) -> None:
    rig = bench()
    rig.run(300)
    encoder = FrameEncoder(load_database([ROOT / "dbc" / "eps_rig.dbc"]), "EPSHIL_Verdict")
    codes = (SignalVerdict.FROZEN, *[SignalVerdict.FINE] * 3, SignalVerdict.NOT_USED)
    values = dict(zip(NEEDED, (*map(int, codes), int(Reason.FROZEN)), strict=True))
    now_ns = rig.figures[-1].t_ns
    rig.monitor.take([encoder.frame(values, now_ns)])
    figures = rig.monitor.figures(now_ns + 1_000_000)
    said = {one.name: one.service for one in figures.signals}
    assert said["motor_torque_nm"] == "frozen"
    assert said["motor_speed_rad_s"] == "fine"
    assert said["vehicle_speed_m_s"] == "", "the estimator does not read it"
    assert "; the service: frozen" in written(figures)
    assert "EstimateReasons frozen" in written(figures)
    stale = rig.monitor.figures(now_ns + 2_000_000_000)
    assert {one.service for one in stale.signals} == {""}
