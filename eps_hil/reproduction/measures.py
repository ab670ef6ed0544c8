"""Numbers that figures share: errors, delay between two curves, drift and settling at rest."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.estimation import batch
from eps_hil.estimation.score import MOVING_RAD_S, VARIANTS, variant
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.stream import StreamEstimator
from eps_hil.physics.model import Model
from eps_hil.reproduction.workbench import series
from eps_hil.rig.offline import SimulatedRecording

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Estimated:
    """Estimates of one recording by variant, and the truth at the same instants; all (n,)."""

    time_s: Floats
    force_n: Mapping[str, Floats]
    real_n: Floats
    speed_rad_s: Floats
    latency_s: float

    def rmse_n(self, name: str, keep: npt.NDArray[np.bool_] | None = None) -> float:
        """Rms error of a variant over the instants that ``keep`` marks."""
        error = self.force_n[name] - self.real_n
        return rms(error if keep is None else error[keep])

    @property
    def moving(self) -> npt.NDArray[np.bool_]:
        """Where the rotor really moves."""
        return np.abs(self.speed_rad_s) > MOVING_RAD_S


def estimated(
    made: SimulatedRecording, model: Model, settings: EstimatorSettings | None = None
) -> Estimated:
    """All of the paper's variants over one recording, on their common valid instants."""
    chosen = settings or EstimatorSettings()
    signals = series(made.columns)
    traces = {name: batch.estimate(signals, model, variant(chosen, name)) for name in VARIANTS}
    valid = np.logical_and.reduce([trace.valid for trace in traces.values()])
    time_s = traces["2Q-fa"].t_ns[valid] * 1e-9
    inside = time_s <= made.truth["time_s"][-1]
    time_s = time_s[inside]
    stream = StreamEstimator(model, chosen, batch.sample_periods_s(signals))
    return Estimated(
        time_s,
        {name: trace.rack_force_n[valid][inside] for name, trace in traces.items()},
        at(time_s, made, "rack_force_n"),
        at(time_s, made, "motor_speed_rad_s"),
        stream.latency_s,
    )


def at(time_s: Floats, made: SimulatedRecording, name: str) -> Floats:
    """True values of a signal at ``time_s``."""
    return np.asarray(np.interp(time_s, made.truth["time_s"], made.truth[name]))


def rms(value: Floats) -> float:
    """Root of the mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(value)))) if len(value) else float("nan")


def delay_s(time_s: Floats, value: Floats, reference: Floats, most_s: float = 0.06) -> float:
    """How late ``value`` is behind ``reference`` (negative: early), by least squares with a gain.

    Both (n,) at equal steps; the shift with the largest correlation, between samples by a parabola.
    """
    step = float(time_s[1] - time_s[0])
    most = round(most_s / step)
    inner = slice(most, len(value) - most)
    y = value[inner] - np.mean(value[inner])
    shifts = np.arange(-most, most + 1)
    quality = []
    for shift in shifts:
        x = reference[most - shift : len(reference) - most - shift]
        x = x - np.mean(x)
        quality.append(float(x @ y) / float(np.linalg.norm(x)))
    k = int(np.clip(np.argmax(quality), 1, len(quality) - 2))
    left, middle, right = quality[k - 1 : k + 2]
    bend = left - 2.0 * middle + right
    part = 0.5 * (left - right) / bend if bend != 0.0 else 0.0
    return float((shifts[k] + part) * step)


def drift_per_s(time_s: Floats, value: Floats) -> float:
    """Slope of a straight line through the values, per second."""
    return float(np.polyfit(time_s - time_s[0], value, 1)[0])


def settling_s(time_s: Floats, value: Floats, band: float) -> float:
    """From the first instant until the value stays within ``band`` of its final mean (0.2 s)."""
    last = float(np.mean(value[time_s > time_s[-1] - 0.2]))
    outside = np.flatnonzero(np.abs(value - last) > band)
    return float(time_s[outside[-1]] - time_s[0]) if len(outside) else 0.0
