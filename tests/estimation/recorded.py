"""Recordings of the simulated rig as its bus carries them, and estimates judged by them."""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.bus.database import load_database
from eps_hil.bus.mapping import load_mapping
from eps_hil.estimation.batch import estimate
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import Model
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.frames import resolutions
from eps_hil.rig.offline import simulate_recording
from eps_hil.rig.sensors import SensorSettings
from eps_hil.series import Series

ROOT = Path(__file__).resolve().parents[2]
INPUTS = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
_T0_NS = 1_000_000_000


class Recorded(NamedTuple):
    """Signals at 1 kHz by name, (n,) each, with their stamps (ns) and times (s) from the start."""

    t_ns: npt.NDArray[np.int64]
    time_s: npt.NDArray[np.float64]
    signals: dict[str, npt.NDArray[np.float64]]
    model: Model

    def estimate(self, **other: npt.NDArray[np.float64]) -> Trace:
        """With ``other`` signals in place of those that were recorded."""
        signals = {name: self.signals[name] for name in INPUTS} | other
        series = {name: Series(self.t_ns, value) for name, value in signals.items()}
        return estimate(series, self.model)

    def longest_wrong_s(self, trace: Trace, reference_n: npt.NDArray[np.float64]) -> float:
        """Longest time valid and off by over 100 N; spells less than 20 ms apart are one."""
        off = trace.valid & (np.abs(trace.rack_force_n - reference_n) > 100.0)
        at = trace.t_ns[off] * 1e-9
        if not len(at):
            return 0.0
        begins = np.flatnonzero(np.diff(at, prepend=-1.0) > 0.02)
        ends = np.append(begins[1:], len(at)) - 1
        return float(np.max(at[ends] - at[begins]) + 1e-3)

    def load_n(self, trace: Trace) -> npt.NDArray[np.float64]:
        """What the load cell says at the instants of an estimate (N)."""
        return np.interp(trace.t_ns, self.t_ns, self.signals["rack_force_n"])


@cache
def recorded(manoeuvre: str, seed: int = 0) -> Recorded:
    """A manoeuvre of the simulated rig, with its sensors' noise and the bus's resolution."""
    setup = load_rig_setup(ROOT / "configs/demo_udp.yaml", manoeuvre)
    steps = resolutions(
        load_database([ROOT / "dbc/eps_rig.dbc"]),
        load_mapping(ROOT / "configs/eps_rig_signals.yaml"),
    )
    made = simulate_recording(
        setup.model, setup.chain, setup.manoeuvre, order=2, seed=seed,
        sensors=SensorSettings(noise=True), resolution=steps,
    )  # fmt: skip
    time_s = np.array(made.columns["time_s"], float)
    signals = {
        name: np.array(value, float) for name, value in made.columns.items() if name != "time_s"
    }
    return Recorded(np.round(time_s * 1e9).astype(np.int64) + _T0_NS, time_s, signals, setup.model)
