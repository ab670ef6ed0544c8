"""Rack force over pinion angle: the hysteresis loop of a steering, one panel per steering mode.

A parked car's tyres first twist and then slide, so the rack force over the angle is a loop: steep
after each reversal, flat while the tread slides. Torque and current over the same angle stand
below for comparison: the loop is what the estimate makes of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.bus.database import load_database
from eps_hil.errors import InputError
from eps_hil.recordings.can_log import read_frames
from eps_hil.report import figures
from eps_hil.series import Series

_VALID = 2  # EstimateStatus of EPSHIL_Estimate

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class SteeringSignals:
    """Which DBC signals the figure shows, as ``Message.Signal``: deg, Nm, A and the mode."""

    angle: str = "SteeringPinion_Data_Alt.StePinRelInit_An_Sns"
    torque: str = "EPAS_INFO.SteeringColumnTorque"
    current: str = "EPAS_INFO.SteMdule_I_Est"
    mode: str = "EPAS_INFO.SteeringEffortMode"


@dataclass(frozen=True, slots=True)
class SteeringTrace:
    """What a CAN log holds for the figure; ``mode_names`` by value, from the DBC."""

    angle_deg: Series
    torque_nm: Series
    current_a: Series
    mode: Series
    mode_names: Mapping[int, str]


@dataclass(frozen=True, slots=True)
class Estimates:
    """Rack-force estimates: stamps in ns on the log's clock, N, validity; all shape (n,)."""

    t_ns: npt.NDArray[np.int64]
    rack_force_n: Floats
    valid: Bools


@dataclass(frozen=True, slots=True)
class Loop:
    """One mode's estimates over the pinion angle; NaN separates stretches. Shape (n,)."""

    name: str
    t_s: Floats
    angle_deg: Floats
    rack_force_n: Floats

    @property
    def duration_s(self) -> float:
        """Time in this mode with a valid estimate."""
        shown = np.isfinite(self.rack_force_n)
        step = np.median(np.diff(self.t_s)) if len(self.t_s) > 1 else 0.0
        return float(np.count_nonzero(shown) * step)


def read_steering(log: Path, dbc: Path, signals: SteeringSignals | None = None) -> SteeringTrace:
    """Read the figure's signals from a CAN log of any format.

    :class:`InputError` where log or DBC does not hold them.
    """
    wanted = signals or SteeringSignals()
    names = (wanted.angle, wanted.torque, wanted.current, wanted.mode)
    database = load_database([dbc])
    places = [_find(database, dbc, name) for name in names]
    by_id = {message.frame_id: message for message, _ in places}
    rows: dict[str, list[tuple[int, float]]] = {name: [] for name in names}
    for frame in read_frames(log, ids=list(by_id)):
        values = by_id[frame.can_id].decode(frame.data, decode_choices=False)
        for name, (message, signal) in zip(names, places, strict=True):
            if message.frame_id == frame.can_id:
                rows[name].append((frame.t_ns, float(values[signal.name])))
    angle, torque, current, mode = (_series(log, name, rows[name]) for name in names)
    choices = places[-1][1].choices or {}
    mode_names = {int(k): str(v) for k, v in choices.items()}
    return SteeringTrace(angle, torque, current, mode, mode_names)


def read_published(log: Path, dbc: Path, *, sync_id: int, latency_s: float) -> Estimates:
    """The estimates that the service published, from a recording of its bus.

    ``dbc`` holds ``EPSHIL_Estimate``. Each estimate follows a frame ``sync_id`` and speaks of
    ``latency_s`` before it. (The message's own age ends at 25.5 ms,
    which a bus of 50 Hz signals exceeds.)
    """
    message = load_database([dbc]).get_message_by_name("EPSHIL_Estimate")
    stamp: int | None = None
    rows: list[tuple[int, float, bool]] = []
    for frame in read_frames(log, ids=[sync_id, message.frame_id]):
        if frame.can_id == sync_id:
            stamp = frame.t_ns
        elif stamp is not None:
            values = message.decode(frame.data, decode_choices=False)
            valid = values["EstimateStatus"] == _VALID
            rows.append((stamp, float(values["RackForceEstimate"]), valid))
            stamp = None
    if not rows:
        raise InputError(log, "EPSHIL_Estimate", "no estimate follows a sync frame", "was it run?")
    stamps, forces, valid_rows = zip(*rows, strict=True)
    t_ns = np.array(stamps, np.int64) - round(latency_s * 1e9)
    return Estimates(t_ns, np.array(forces), np.array(valid_rows))


def _find(database: Any, dbc: Path, name: str) -> tuple[Any, Any]:
    message_name, _, signal_name = name.partition(".")
    for message in database.messages:
        if message.name == message_name:
            for signal in message.signals:
                if signal.name == signal_name:
                    return message, signal
    raise InputError(dbc, name, "no such signal", "name it as Message.Signal of the DBC")


def _series(log: Path, name: str, rows: list[tuple[int, float]]) -> Series:
    if len(rows) < 2:
        raise InputError(log, name, "no frame carries it", "is it the log that the DBC is for?")
    stamps, values = zip(*rows, strict=True)
    t_ns = np.array(stamps, np.int64)
    keep = np.concatenate([[True], np.diff(np.maximum.accumulate(t_ns)) > 0])
    return Series(t_ns[keep], np.array(values, np.float64)[keep])


def loops_by_mode(trace: SteeringTrace, estimates: Estimates) -> list[Loop]:
    """The estimates of each mode over the angle at the same instant, modes in numeric order."""
    angle = np.interp(estimates.t_ns, trace.angle_deg.t_ns, trace.angle_deg.value)
    row = np.searchsorted(trace.mode.t_ns, estimates.t_ns, side="right") - 1
    mode = np.where(row >= 0, trace.mode.value[np.maximum(row, 0)], -1).astype(int)
    seconds = (estimates.t_ns - trace.angle_deg.t_ns[0]) * 1e-9
    loops = []
    for value in sorted(set(trace.mode.value.astype(int))):
        shown = (mode == value) & estimates.valid
        if shown.any():
            force = np.where(shown, estimates.rack_force_n, np.nan)
            name = trace.mode_names.get(value, f"mode {value}")
            loops.append(Loop(name, seconds, np.where(shown, angle, np.nan), force))
    return loops


def enclosed_work_j(loop: Loop, rack_m_per_deg: float) -> float:
    """Work that the rack took in over the loop, ∫F dx in J: positive where it brakes the motion.

    For whole cycles it is the area of the loop.
    """
    force = 0.5 * (loop.rack_force_n[1:] + loop.rack_force_n[:-1])
    return float(np.nansum(force * np.diff(loop.angle_deg)) * rack_m_per_deg)


def strokes(t_s: Floats, angle_deg: Floats, *, least_deg: float = 30.0) -> list[slice]:
    """From one turning point of the wheel to the next, where it turned more than ``least_deg``
    and in less than 1.5 s (a rest is no stroke)."""
    turns, direction = [0], 1.0
    for k, angle in enumerate(angle_deg):
        if (angle - angle_deg[turns[-1]]) * direction > 0:
            turns[-1] = k
        elif (angle_deg[turns[-1]] - angle) * direction > least_deg:
            turns.append(k)
            direction = -direction
    return [slice(a, b) for a, b in pairwise(turns) if t_s[b] - t_s[a] < 1.5]


def sliding_force_n(angle_deg: Floats, rack_force_n: Floats) -> float:
    """Median force against the motion over the last 40 % of a stroke, where the tyres slide."""
    way = np.sign(angle_deg[-1] - angle_deg[0])
    travelled = (angle_deg - angle_deg[0]) * way
    return float(np.median(rack_force_n[travelled > 0.6 * travelled.max()]) * way)


def draw(trace: SteeringTrace, loops: list[Loop], path: str | Path, *, title: str) -> Path:
    """The figure: rack force over pinion angle above, torque and current below, by mode."""
    figure, axes = figures.subplots(2, len(loops), width_cm=11.0 * max(2, len(loops)))
    for column, loop in enumerate(loops):
        colour = figures.COLOURS[column % len(figures.COLOURS)]
        _draw_force(axes[0, column], loop, colour)
        _draw_inputs(axes[1, column], trace, loop)
    for line in axes:
        for axis in line[1:]:
            axis.sharex(axes[0, 0])
            axis.sharey(line[0])
    axes[1, 0].sharex(axes[0, 0])
    axes[0, 0].autoscale()
    figure.suptitle(title)
    return figures.save(figure, path)


def _draw_force(axis: Any, loop: Loop, colour: str) -> None:
    axis.axhline(0.0, color="0.6", linewidth=0.8)
    axis.plot(
        loop.angle_deg, loop.rack_force_n * 1e-3, color=colour, linewidth=0.9, label="rack force"
    )
    axis.set_title(f"{loop.name}, {loop.duration_s:.1f} s")
    axis.set_xlabel("pinion angle in degrees")
    axis.set_ylabel("rack force estimate in kN")
    axis.margins(y=0.12)
    axis.legend(loc="upper left", frameon=False)


def _draw_inputs(axis: Any, trace: SteeringTrace, loop: Loop) -> None:
    t_ns = trace.torque_nm.t_ns
    here = np.interp(t_ns, trace.angle_deg.t_ns, trace.angle_deg.value)
    first = trace.angle_deg.t_ns[0]
    row = np.searchsorted(loop.t_s, (t_ns - first) * 1e-9)
    row = np.minimum(row, len(loop.t_s) - 1)
    angle = np.where(np.isfinite(loop.rack_force_n[row]), here, np.nan)
    axis.plot(angle, trace.torque_nm.value, color="0.25", linewidth=0.8, label="column torque, Nm")
    current = np.interp(t_ns, trace.current_a.t_ns, trace.current_a.value)
    axis.plot(
        angle, current / 5, color="#e69f00", linewidth=0.8, label="supply current, 5 A per unit"
    )
    axis.set_xlabel("pinion angle in degrees")
    axis.set_ylabel("column torque in Nm, current in 5 A")
    axis.margins(y=0.25)
    axis.legend(loc="upper left", frameon=False)
