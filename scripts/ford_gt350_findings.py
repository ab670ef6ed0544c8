#!/usr/bin/env python3
"""Print the numbers of docs/howto-real-car-log.md from the recording itself.

scripts/ford_gt350_findings.py LOG
"""
# ruff: noqa: T201 - what this script is for

import dataclasses
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.bus.database import load_database
from eps_hil.bus.mapping import SignalMapping, load_mapping
from eps_hil.bus.supply_power import SupplyPower
from eps_hil.errors import InputError
from eps_hil.estimation import batch
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.physics.model import Model, load_model
from eps_hil.recordings.can_log import read_frames
from eps_hil.report import rack_force_loop as loop
from eps_hil.series import Series
from eps_hil.service.setup import derived_settings

ROOT = Path(__file__).resolve().parents[1]
DBC = ROOT / "dbc" / "ford_gt350.dbc"
CONFIG = ROOT / "configs" / "ford_gt350"
STRETCHES_S = ((2.6, 9.4), (13.9, 16.2), (18.3, 20.86), (20.86, 23.46), (23.76, 26.4))
STANDBY_W = 10.0

Floats = npt.NDArray[np.float64]


def read(log: Path) -> tuple[loop.SteeringTrace, Series]:
    """The steering's signals, and the supply voltage in V."""
    volts = loop.SteeringSignals(torque="EPAS_INFO.SteMdule_U_Meas")
    return loop.read_steering(log, DBC), loop.read_steering(log, DBC, volts).torque_nm


def say_rates_and_steps(trace: loop.SteeringTrace) -> None:
    """Frame spacing, steering modes over time, and whether frames repeat old values."""
    for name, series in (("angle", trace.angle_deg), ("torque", trace.torque_nm)):
        gaps = np.diff(series.t_ns) * 1e-6
        print(f"{name}: {len(gaps) + 1} frames, {gaps.min():.1f} to {gaps.max():.1f} ms apart")
    changes = np.flatnonzero(np.diff(trace.mode.value)) + 1
    first = trace.angle_deg.t_ns[0]
    for k in (0, *changes):
        name = trace.mode_names[int(trace.mode.value[k])]
        print(f"mode {name} from {(trace.mode.t_ns[k] - first) * 1e-9:.2f} s")
    turning = np.abs(np.gradient(trace.angle_deg.value, trace.angle_deg.t_ns * 1e-9)) > 100
    stale = np.count_nonzero(np.diff(trace.angle_deg.value)[turning[1:]] == 0)
    print(f"angle repeated while it turns at over 100 deg/s: {stale} of {turning.sum()}")


def say_supply(trace: loop.SteeringTrace, volts: Series) -> None:
    """The current is the supply's: dips, sign, and power against torque times speed by lag."""
    t_s = (trace.torque_nm.t_ns - trace.angle_deg.t_ns[0]) * 1e-9
    amps, torque = trace.current_a.value, trace.torque_nm.value
    first = (t_s > 2.6) & (t_s < 9.3)
    dip = np.polyfit(amps[first], volts.value[first], 1)[0]
    together = np.corrcoef(amps[first], volts.value[first])[0, 1]
    print(f"supply: {amps.min():.1f} to {amps.max():.1f} A, voltage falls {-1e3 * dip:.0f} mV/A, "
          f"correlation {together:.2f}")  # fmt: skip
    angle_t = (trace.angle_deg.t_ns - trace.angle_deg.t_ns[0]) * 1e-9
    slope = np.gradient(np.radians(trace.angle_deg.value), angle_t)
    speed = np.interp(t_s, angle_t, np.convolve(slope, np.full(7, 1 / 7), "same"))
    for a, b in STRETCHES_S:
        rows_here = (t_s > a) & (t_s < b)
        pushing = rows_here & (np.abs(speed) > 2) & (torque * speed > 0)
        print(f"{a:.1f} to {b:.1f} s: driver {np.median(np.abs(torque[pushing])):.1f} Nm, wheel up "
              f"to {np.abs(speed[rows_here]).max():.1f} rad/s, current up to "
              f"{amps[rows_here].max():.0f} A")  # fmt: skip
    for lag_ms in range(0, 52, 4):
        power = np.interp(t_s + lag_ms * 1e-3, t_s, amps * volts.value) - STANDBY_W
        rows = [_fit(power, torque * speed, (t_s > a) & (t_s < b)) for a, b in STRETCHES_S]
        gain, _ = _fit(power, torque * speed, np.abs(speed) > 2)
        fits = "  ".join(f"{g:5.2f} ({r:.2f})" for g, r in rows)
        print(f"lag {lag_ms:2d} ms: power / (torque x speed), all {gain:5.2f}; (R2) {fits}")


def _fit(power: Floats, driver_w: Floats, rows: npt.NDArray[np.bool_]) -> tuple[float, float]:
    p, q = power[rows], driver_w[rows]
    gain = float(p @ q / (q @ q))
    return gain, 1 - float(np.var(p - gain * q) / np.var(p))


def estimate(
    log: Path, mapping: SignalMapping, model: Model, trace: loop.SteeringTrace
) -> tuple[loop.Estimates, dict[str, list[float]]]:
    """Estimates, and the sliding force of each stroke in N by mode."""
    from eps_hil.bus.codec import FrameDecoder

    decoder = FrameDecoder(load_database([DBC]), mapping)
    samples: dict[str, list[tuple[int, float]]] = {}
    for frame in read_frames(log, ids=decoder.receive_ids):
        for signal, t_ns, value in decoder.decode(frame):
            samples.setdefault(signal, []).append((t_ns, value))
    series = {
        name: Series(np.array([t for t, _ in rows], np.int64), np.array([v for _, v in rows]))
        for name, rows in samples.items()
    }
    got = batch.estimate(series, model, derived_settings(EstimatorSettings(), mapping))
    estimates = loop.Estimates(got.t_ns, got.rack_force_n, got.valid)
    angle: Floats = np.interp(got.t_ns, trace.angle_deg.t_ns, trace.angle_deg.value)
    forces: dict[str, list[float]] = {"normal": [], "sport": [], "comfort": []}
    for stroke in loop.strokes(got.t_ns.astype(np.float64) * 1e-9, angle):
        middle = got.t_ns[(stroke.start + stroke.stop) // 2]
        row = np.searchsorted(trace.mode.t_ns, middle, side="right") - 1
        name = trace.mode_names[int(trace.mode.value[row])]
        forces[name].append(loop.sliding_force_n(angle[stroke], got.rack_force_n[stroke]))
    return estimates, forces


def say_force(log: Path, trace: loop.SteeringTrace, volts: Series) -> None:
    """Sliding force as given, the energy balance, and the force for other numbers."""
    mapping, model = load_mapping(CONFIG / "signals.yaml"), load_model(CONFIG / "model.yaml")
    estimates, forces = estimate(log, mapping, model, trace)
    every = [f for rows in forces.values() for f in rows]
    print(f"sliding: {min(every) / 1e3:.2f} to {max(every) / 1e3:.2f} kN in {len(every)} strokes, "
          f"at most {np.abs(estimates.rack_force_n).max() / 1e3:.2f} kN")  # fmt: skip
    angle: Floats = np.interp(estimates.t_ns, trace.angle_deg.t_ns, trace.angle_deg.value)
    crossings = []
    for stroke in loop.strokes(estimates.t_ns.astype(np.float64) * 1e-9, angle)[1:]:
        turned = angle[stroke] - angle[stroke.start]
        way = np.sign(turned[-1])
        crossings.append(turned[np.argmax(estimates.rack_force_n[stroke] * way > 0)] * way)
    print(f"force crosses zero {min(crossings):.0f} to {max(crossings):.0f} deg after a reversal")
    m_per_deg = np.radians(1) / model.pinion_ratio_rad_per_m
    rack_j = sum(loop.enclosed_work_j(x, m_per_deg) for x in loop.loops_by_mode(trace, estimates))
    power = trace.current_a.value * volts.value - STANDBY_W
    supply_j = np.trapezoid(power, trace.current_a.t_ns * 1e-9)
    held = np.interp(trace.angle_deg.t_ns, trace.torque_nm.t_ns, trace.torque_nm.value)
    driver_j = np.trapezoid(held, np.radians(trace.angle_deg.value))
    print(f"energy: supply {supply_j:.0f} J, driver {driver_j:.0f} J, rack {rack_j:.0f} J")
    for name, changed_mapping, changed_model in variants(mapping, model):
        _, forces = estimate(log, changed_mapping, changed_model, trace)
        sport, comfort = np.median(forces["sport"]) / 1e3, np.median(forces["comfort"]) / 1e3
        print(f"{name:28} sport {sport:.2f} kN, comfort {comfort:.2f} kN")


def variants(mapping: SignalMapping, model: Model) -> list[tuple[str, SignalMapping, Model]]:
    """One number changed at a time, and whatever hangs on it."""
    power = mapping.signals["motor_torque_nm"].supply_power
    assert power is not None

    def supply(**changes: Any) -> SignalMapping:
        return with_supply(mapping, dataclasses.replace(power, **changes))

    def friction(factor: float) -> Model:
        levels = ("offset_", "viscous_", "load_")
        values = dataclasses.asdict(model.friction)
        scaled = {k: v * factor for k, v in values.items() if k.startswith(levels)}
        return dataclasses.replace(model, friction=dataclasses.replace(model.friction, **scaled))

    def gear(name: str, pinion_mm: float, lead_mm: float, belt: float) -> Any:
        pinion = 2e3 * np.pi / pinion_mm
        rotor = belt * 2e3 * np.pi / lead_mm
        turns = (rotor / pinion) / (
            model.rack_to_rotor_ratio_rad_per_m / model.pinion_ratio_rad_per_m
        )
        changed = supply(
            assist_gain=power.assist_gain / turns, blend_speed_rad_s=power.blend_speed_rad_s * turns
        )
        angle = changed.signals["motor_angle_rad"]
        angle = dataclasses.replace(angle, scale=angle.scale * turns)
        signals = {**changed.signals, "motor_angle_rad": angle}
        rig = dataclasses.replace(
            model, pinion_ratio_rad_per_m=pinion, rack_to_rotor_ratio_rad_per_m=rotor
        )
        return name, dataclasses.replace(changed, signals=signals), rig

    def lag(seconds: float) -> tuple[str, SignalMapping, Model]:
        delays = dataclasses.replace(model.delays_s, motor_torque=seconds)
        name = f"lag {1e3 * seconds:.0f} ms"
        return name, supply(lag_s=seconds), dataclasses.replace(model, delays_s=delays)

    inertia = model.inertia_kg_m2
    return [
        ("as given", mapping, model),
        ("efficiency 0.7", supply(efficiency=0.7), model),
        ("efficiency 0.9", supply(efficiency=0.9), model),
        gear("60 mm of rack per turn", 60.0, 7.0, 2.8),
        gear("50 mm of rack per turn", 50.0, 7.0, 2.8),
        ("friction 150 %", mapping, friction(1.5)),
        ("friction 50 %", mapping, friction(0.5)),
        ("inertia 50 %", mapping, dataclasses.replace(model, inertia_kg_m2=0.5 * inertia)),
        ("inertia 150 %", mapping, dataclasses.replace(model, inertia_kg_m2=1.5 * inertia)),
        ("assist gain -25 %", supply(assist_gain=0.75 * power.assist_gain), model),
        ("assist gain +25 %", supply(assist_gain=1.25 * power.assist_gain), model),
        lag(0.036),
        lag(0.020),
        gear("screw 10 mm, belt 2.5", 55.0, 10.0, 2.5),
        gear("screw 5 mm, belt 3.5", 55.0, 5.0, 3.5),
    ]


def with_supply(mapping: SignalMapping, power: SupplyPower) -> SignalMapping:
    """The mapping with another ``supply_power`` block."""
    torque = dataclasses.replace(mapping.signals["motor_torque_nm"], supply_power=power)
    return dataclasses.replace(mapping, signals={**mapping.signals, "motor_torque_nm": torque})


def main() -> int:
    """Print everything; 2 for a wrong input."""
    if len(sys.argv) != 2:
        print("usage: scripts/ford_gt350_findings.py LOG", file=sys.stderr)
        return 2
    log = Path(sys.argv[1])
    try:
        trace, volts = read(log)
        say_rates_and_steps(trace)
        say_supply(trace, volts)
        say_force(log, trace, volts)
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
