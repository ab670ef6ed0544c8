"""Measured frequency responses of a rig to its motor torque (seed paper, fig. 5).

Welch's method: recordings are cut into overlapping Hann windows, cross-spectra are averaged over
all windows of all recordings, and the response, its coherence and its 95 % confidence radius follow
from them (Bendat and Piersol, *Random Data*, 4th ed., sections 6.1 and 9.2). Signals are first put
back to their physical instants, so a sensor's delay is no phase of the plant.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field, with_config

from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Estimator = Literal["h1", "h2", "hv"]
ESTIMATORS: tuple[str, ...] = get_args(Estimator)

INPUT = "motor_torque_nm"
OUTPUTS: Mapping[str, str] = {
    "motor_speed_rad_s": "rotor speed",
    "rack_position_m": "rack position",
    "steering_wheel_speed_rad_s": "steering-wheel speed",
    "rack_force_n": "rack force",
}
"""Outputs of fig. 5 by canonical name, in the figure's order."""

_DERIVED = {
    "motor_speed_rad_s": "motor_angle_rad",
    "steering_wheel_speed_rad_s": "steering_wheel_angle_rad",
}
_STEP_NS = 1_000_000
_GAP_PERIODS = 5
_OVERLAP = 0.5
_WINDOWS_SHARED = 1.0 + 2.0 / 36.0
"""Hann windows at half overlap correlate by 1/6: n of them average like n/(1 + 2/36) (Welch)."""
_CONFIDENCE = 0.95


class BandError(ValueError):
    """A band in which no response can be had, whatever was recorded."""


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class ResponseSettings:
    """Band, resolution and estimator of a frequency response.

    ``h1`` takes noise as the output's (right where the torque is commanded), ``h2`` as the input's,
    ``hv`` shares it between both: |Hv|² = |H1|·|H2|, all with the phase of the cross-spectrum.
    """

    from_hz: Annotated[float, Field(gt=0)] = 0.5
    to_hz: Annotated[float, Field(gt=0)] = 8.0
    resolution_hz: Annotated[float, Field(gt=0, le=5)] = 0.25
    estimator: Estimator = "h1"


@dataclass(frozen=True, slots=True)
class Stretch:
    """Signals of one recording between two gaps, at physical instants 1 ms apart, each (n,)."""

    columns: Mapping[str, Floats]

    @property
    def rows(self) -> int:
        """Milliseconds."""
        return len(self.columns[INPUT])


@dataclass(frozen=True, slots=True)
class Response:
    """One response, arrays (m,): ``gain`` in output unit per Nm at the rotor.

    ``radius``: with 95 % probability the true gain lies within it of ``gain`` in the complex plane
    (for random excitation; for one sweep it is a guide). ``trusted``: coherence above what
    unrelated signals reach in 5 of 100 cases.
    """

    output: str
    frequency_hz: Floats
    gain: Complexes
    coherence: Floats
    radius: Floats
    averages: float

    @property
    def trusted(self) -> npt.NDArray[np.bool_]:
        """Lines whose coherence tells input and output apart from strangers."""
        return np.asarray(self.coherence > coherence_limit(self.averages))

    @property
    def magnitude_band(self) -> tuple[Floats, Floats]:
        """95 % band of the magnitude, (lower, upper)."""
        size = np.abs(self.gain)
        return np.maximum(size - self.radius, 0.0), size + self.radius

    @property
    def phase_deg(self) -> Floats:
        """Phase in degrees, unwrapped from the first line on."""
        return np.degrees(np.unwrap(np.angle(self.gain)))

    @property
    def phase_band_deg(self) -> Floats:
        """Half width of the phase's 95 % band in degrees; 180 where nothing is known."""
        share = self.radius / np.maximum(np.abs(self.gain), 1e-300)
        return np.degrees(np.where(share < 1.0, np.arcsin(np.minimum(share, 1.0)), np.pi))


def coherence_limit(averages: float) -> float:
    """Coherence that unrelated signals exceed with 5 % probability: 1 − 0.05^(1/(n−1))."""
    if averages <= 1.0:
        return 1.0
    return float(1.0 - (1.0 - _CONFIDENCE) ** (1.0 / (averages - 1.0)))


def stretches(series: Mapping[str, Series], model: Model) -> list[Stretch]:
    """The recording on a 1 kHz grid of physical instants, cut at gaps (5 periods of a signal).

    A speed that is missing is taken from its angle by central difference. The model's effects on
    delays act. ``ValueError`` where the motor torque or every output is missing.
    """
    model = with_model_effects(model)
    if INPUT not in series:
        raise ValueError(f"{INPUT} is missing")
    used = {INPUT: series[INPUT]}
    for name in OUTPUTS:
        if name in series:
            used[name] = series[name]
        elif (angle := _DERIVED.get(name)) in series:
            used[name] = series[str(angle)]
    if len(used) == 1:
        raise ValueError(f"none of {', '.join(OUTPUTS)} is there")
    parts = {name: _physical(name, one, series, model) for name, one in used.items()}
    return [
        Stretch({name: _on_grid(name, *parts[name], grid, series) for name in parts})
        for grid in _grids(list(parts.values()))
    ]


def responses(
    parts: Sequence[Stretch], settings: ResponseSettings | None = None
) -> dict[str, Response]:
    """Responses of every output that all stretches hold, averaged over all their windows.

    ``ValueError`` where the band holds no line, no stretch is as long as one window, or fewer than
    two windows fit in all.
    """
    s = settings or ResponseSettings()
    if not s.from_hz < s.to_hz < 500.0:
        raise BandError(f"the band {s.from_hz:g} to {s.to_hz:g} Hz is empty or beyond 500 Hz")
    window = round(1000.0 / s.resolution_hz)
    lines_hz = np.asarray(1000.0 / window * np.arange(window // 2 + 1), dtype=np.float64)
    if not _in_band(lines_hz, s).any():
        raise BandError(
            f"the band {s.from_hz:g} to {s.to_hz:g} Hz holds no line, {1000.0 / window:g} Hz apart"
        )
    long_enough = [part for part in parts if part.rows >= window]
    windows = sum(_windows(part.rows, window) for part in long_enough)
    if windows < 2:
        raise ValueError(
            f"{windows} windows of {window / 1000:g} s between gaps are too few to average"
        )
    averages = windows / (_WINDOWS_SHARED if windows > 1 else 1.0)
    found = {}
    for name in OUTPUTS:
        if all(name in part.columns for part in long_enough):
            found[name] = _response(name, long_enough, window, averages, s)
    return found


def _response(
    name: str, parts: Sequence[Stretch], window: int, averages: float, s: ResponseSettings
) -> Response:
    from scipy.signal import csd, welch

    options = {"fs": 1000.0, "window": "hann", "nperseg": window, "detrend": "linear"}
    total = [0.0, 0.0, 0.0]
    frequency: Floats = np.zeros(0)
    for part in parts:
        x, y, weight = part.columns[INPUT], part.columns[name], _windows(part.rows, window)
        frequency, s_xx = welch(x, **options)
        total[0] = total[0] + weight * s_xx
        total[1] = total[1] + weight * welch(y, **options)[1]
        total[2] = total[2] + weight * csd(x, y, **options)[1]
    keep = _in_band(frequency, s)
    s_xx, s_yy, s_xy = (np.asarray(each)[keep] for each in total)
    return _from_spectra(name, frequency[keep], s_xx.real, s_yy.real, s_xy, averages, s.estimator)


def _from_spectra(
    name: str,
    frequency_hz: Floats,
    s_xx: Floats,
    s_yy: Floats,
    s_xy: Complexes,
    averages: float,
    estimator: str,
) -> Response:
    from scipy.stats import f as f_distribution

    tiny = np.finfo(np.float64).tiny
    s_xx, s_yy = np.maximum(s_xx, tiny), np.maximum(s_yy, tiny)
    coherence = np.clip(np.abs(s_xy) ** 2 / (s_xx * s_yy), 0.0, 1.0)
    size = np.maximum(np.abs(s_xy), tiny)
    gain = {
        "h1": s_xy / s_xx,
        "h2": s_xy / size * s_yy / size,
        "hv": s_xy / size * np.sqrt(s_yy / s_xx),
    }[estimator]
    # Circle of confidence: |H − Ĥ|² ≤ 2/(n − 2) F(2, n − 2) (1 − γ²) S_yy/S_xx with n = 2 n_d.
    degrees = 2.0 * averages - 2.0
    factor = 2.0 / degrees * f_distribution.ppf(_CONFIDENCE, 2, degrees) if degrees > 0 else np.inf
    radius = np.sqrt(factor * (1.0 - coherence) * s_yy / s_xx)
    return Response(name, frequency_hz, gain, coherence, radius, averages)


def _in_band(frequency_hz: Floats, s: ResponseSettings) -> npt.NDArray[np.bool_]:
    return np.asarray((frequency_hz >= s.from_hz - 1e-9) & (frequency_hz <= s.to_hz + 1e-9))


def _windows(rows: int, window: int) -> int:
    hop = window - int(window * _OVERLAP)
    return 1 + (rows - window) // hop if rows >= window else 0


def _physical(
    name: str, one: Series, series: Mapping[str, Series], model: Model
) -> tuple[npt.NDArray[np.int64], Floats]:
    """Good samples of a signal and the physical instants that they speak of, in ns.

    A shaft that follows the motor torque late is in the chain (a negative delay): not here too.
    """
    source = name if name in series else _DERIVED[name]
    good, late_s = np.isfinite(one.value), model.delays_s.of(source)
    if name == INPUT:
        late_s = max(late_s, 0.0)
    return one.t_ns[good] - round(late_s * 1e9), one.value[good]


def _grids(signals: Sequence[tuple[npt.NDArray[np.int64], Floats]]) -> list[npt.NDArray[np.int64]]:
    """Millisecond grids on which every signal is there, without the gaps of any of them."""
    if any(len(t_ns) < 4 for t_ns, _ in signals):
        return []
    first = max(int(t_ns[0]) for t_ns, _ in signals)
    last = min(int(t_ns[-1]) for t_ns, _ in signals)
    bad = []
    for t_ns, _ in signals:
        step = np.diff(t_ns)
        holes = np.flatnonzero(step > _GAP_PERIODS * np.median(step))
        bad += [(int(t_ns[k]), int(t_ns[k + 1])) for k in holes]
    grids, start = [], first
    for begin, end in [*sorted(bad), (last, last)]:
        if begin - start >= _STEP_NS:
            grids.append(np.arange(start, min(begin, last) + 1, _STEP_NS))
        start = max(start, end)
    return grids


def _on_grid(
    name: str,
    t_ns: npt.NDArray[np.int64],
    value: Floats,
    grid: npt.NDArray[np.int64],
    series: Mapping[str, Series],
) -> Floats:
    """Cubic spline: a straight line through 10 ms samples would lose 2 % at 8 Hz."""
    from scipy.interpolate import make_interp_spline

    around = slice(
        max(int(np.searchsorted(t_ns, grid[0])) - 3, 0), int(np.searchsorted(t_ns, grid[-1])) + 4
    )
    seconds = (t_ns[around] - grid[0]) * 1e-9
    spline = make_interp_spline(seconds, value[around], k=3)
    if name not in series:  # an angle that stands in for its speed
        spline = spline.derivative()
    return np.asarray(spline((grid - grid[0]) * 1e-9), dtype=np.float64)
