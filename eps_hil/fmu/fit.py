"""An FMU's own parameters fitted to recordings, before physics is blamed.

The FMU is driven by the recorded inputs and kept at the recorded motion (``drive.py``): the torque
that this takes is what the simulator lacks, and the parameters are those that leave least of it.
Only as fast as the simulator is brought back: beyond that it is the recorded speed's noise times
the damping, which a heavier simulator makes less of, and least squares would take that for weight.
What is left of a simulation hangs together over seconds: intervals come from how the pulls of
blocks of that length scatter (a sandwich), not from counting samples.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.fmu.drive import FOLLOW_RAD_S, FmuError, Follow, Signals, Simulator, physical
from eps_hil.fmu.mapping import variable
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
Samples = npt.NDArray[np.bool_]
WINDOW_S = 2.0
_SETTLE_S = 0.3
"""After the start, until the simulator has found the recorded motion, nothing is judged."""
_KEPT = 4
"""Without hold-outs, every fourth stretch is kept from the fit."""
_UNBOUNDED = 1e9
_FAR = 1e3
"""Times a number's size: a bound beyond it does not count as one."""
_FAILED = 1e3
_STEP = 1e-3
"""Of a finite difference, in units of a number's size: a simulator's solver is not smooth below."""


@dataclass(frozen=True, slots=True)
class Free:
    """A parameter to be fitted, in the FMU's unit, and between what."""

    name: str
    unit: str
    start: float
    low: float
    high: float

    @property
    def scale(self) -> float:
        """A size to count it in."""
        return abs(self.start) if self.start else self.high - self.low


@dataclass(frozen=True, slots=True)
class Fitted:
    """What was found; torque (Nm, rms at the rotor) that the simulator lacks on what was kept."""

    parameters: Mapping[str, Mapping[str, Any]]
    before_nm: float
    after_nm: float
    kept: str
    notes: tuple[str, ...]

    def content(self) -> dict[str, Any]:
        """As JSON."""
        gain = 1.0 - (self.after_nm / self.before_nm) ** 2 if self.before_nm > 0.0 else None
        return {
            "schema": "eps-hil/simulator-fit/1",
            "parameters": {name: dict(one) for name, one in self.parameters.items()},
            "holdout": {
                "kept": self.kept,
                "torque_rms_nm": {"before": self.before_nm, "after": self.after_nm},
                "share_removed": gain,
            },
            "notes": list(self.notes),
        }


@dataclass(frozen=True, slots=True)
class _Run:
    """A recording as the FMU is given it, and which of its samples are fitted and judged."""

    inputs: Floats
    begin: Mapping[str, float]
    follow: Follow
    fitted: Samples
    judged: Samples


def free_of(simulator: Simulator, names: Sequence[str]) -> list[Free]:
    """``NAME`` or ``NAME=low:high`` for each parameter; :class:`InputError` if there is none."""
    found = []
    there = simulator.fmu.of("parameter")
    for text in names:
        name, _, range_ = text.partition("=")
        one = variable(simulator.fmu, name, there, "no parameter")
        low, high = (-np.inf if one.bounds[0] is None else one.bounds[0],
                     np.inf if one.bounds[1] is None else one.bounds[1])  # fmt: skip
        if range_:
            try:
                low, high = (float(end) for end in range_.split(":"))
            except ValueError:
                raise InputError(
                    "--free", text, "is no NAME=low:high", "give two numbers"
                ) from None
            if low >= high:
                raise InputError("--free", text, f"has its bounds the wrong way round: {low:g} is "
                                 f"not below {high:g}", f"say {name}=low:high")  # fmt: skip
        start = one.start if one.start is not None else 0.0
        if not low <= start <= high:
            raise InputError("--free", text, f"starts at {start:g}, expected between {low:g} and "
                             f"{high:g}", "give NAME=low:high around it")  # fmt: skip
        if start == 0.0 and high - low > _UNBOUNDED:
            raise InputError("--free", text, "starts at 0 and has no bounds",
                             f"say how large it may be: {name}=low:high")  # fmt: skip
        found.append(Free(name, one.unit, start, low, high))
    if not found:
        raise InputError("--free", "", "names no parameter", f"there are: {', '.join(there)}")
    return found


def fit(
    simulator: Simulator,
    recordings: Mapping[str, Signals],
    holdouts: Mapping[str, Signals],
    model: Model,
    names: Sequence[str],
    say: Callable[[float], None] | None = None,
    values: Mapping[str, float] | None = None,
) -> Fitted:
    """Least squares over the parameters ``names``; the model file gives the sensors' delays.

    ``values``: of other parameters and inputs, which stay as they are.
    """
    from scipy.optimize import least_squares

    given = dict(values or {})
    free = free_of(simulator, names)
    runs = [_run_of(simulator, one, model, not holdouts, True) for one in recordings.values()]
    runs += [_run_of(simulator, one, model, False, False) for one in holdouts.values()]
    kept = "the hold-outs" if holdouts else f"every {_KEPT}th stretch of {WINDOW_S:g} s"
    if not (any(one.fitted.any() for one in runs) and any(one.judged.any() for one in runs)):
        raise InputError(
            next(iter(holdouts or recordings)), "", "is too short to fit and to judge by",
            "give a hold-out (--holdout) of a second or more, or one recording of "
            f"{_KEPT * WINDOW_S:g} s or more",
        )  # fmt: skip
    scale = np.array([one.scale for one in free])
    count = [0]

    def lacks(x: Floats, judged: bool) -> Floats:
        now = dict(zip((one.name for one in free), (x * scale).tolist(), strict=True))
        count[0] += 1
        if say:
            say(min(0.95, count[0] / (8.0 * (len(free) + 1))))
        found = []
        for one in runs:
            use = one.judged if judged else one.fitted
            if use.any():
                added = simulator.run(one.inputs, {**given, **now}, one.begin, one.follow)[1]
                found.append(_slow(added, simulator.step_s)[use])
        return np.concatenate(found)

    start = np.array([one.start for one in free]) / scale
    first = lacks(start, False)  # a simulator that cannot run at all says so here

    last = (start, first)  # slopes begin where the function was asked last

    def careful(x: Floats) -> Floats:
        nonlocal last
        if not np.array_equal(x, last[0]):
            try:
                last = (x.copy(), lacks(x, False))
            except FmuError:  # too far from what it can be
                last = (x.copy(), np.full(len(first), _FAILED))
        return last[1].copy()

    low = np.array([one.low for one in free]) / scale
    high = np.array([one.high for one in free]) / scale
    # bounds that are no limit but of what a number can be would scale the trust region away
    low, high = np.where(low < -_FAR, -np.inf, low), np.where(high > _FAR, np.inf, high)
    at, left = start, first
    for _ in range(2):  # what counts as far off is known once most of it is explained
        robust = {"loss": "soft_l1", "f_scale": 2.0 * _robust(left)}
        found = least_squares(
            careful, at, _Slopes(careful, high), bounds=(low, high), x_scale="jac",
            xtol=1e-5, ftol=1e-5, max_nfev=12, **robust,
        )  # fmt: skip
        at, left = found.x, found.fun
    sigma = _sigma(found.jac, found.fun, round(1.0 / simulator.step_s))
    parameters = {
        one.name: {
            "value": float(x * one.scale),
            "before": one.start,
            "unit": one.unit,
            "ci95": _interval(x * one.scale, s * one.scale),
        }
        for one, x, s in zip(free, found.x, sigma, strict=True)
    }
    before, after = _rms(lacks(start, True)), _rms(lacks(found.x, True))
    notes = tuple(_notes(free, found.x * scale, sigma * scale))
    return Fitted(parameters, before, after, kept, notes)


class _Slopes:
    """Differences of a function of (n,) over :data:`_STEP`, however small a number has become.

    scipy's own step is a part of the number; of one that is 0 it is lost in a solver's tolerance.
    """

    def __init__(self, of: Callable[[Floats], Floats], high: Floats) -> None:
        self._of, self._high = of, high

    def __call__(self, x: Floats) -> Floats:
        """The slopes (m, n) at x (n,)."""
        here, columns = self._of(x), []
        for k in range(len(x)):
            there = x.copy()
            there[k] += _STEP if x[k] + _STEP <= self._high[k] else -_STEP
            columns.append((self._of(there) - here) / (there[k] - x[k]))
        return np.column_stack(columns)


def _slow(torque: Floats, step_s: float) -> Floats:
    """What a torque (n,) holds below the frequency of the spring that holds the simulator."""
    from scipy.signal import butter, sosfiltfilt

    sos = butter(2, FOLLOW_RAD_S / (2.0 * np.pi), fs=1.0 / step_s, output="sos")
    return np.asarray(sosfiltfilt(sos, torque))


def _interval(value: float, sigma: float) -> list[float] | None:
    if not np.isfinite(sigma):
        return None
    return [float(value - 1.96 * sigma), float(value + 1.96 * sigma)]


def _run_of(simulator: Simulator, series: Signals, model: Model, cut: bool, fitted: bool) -> _Run:
    t_ns = simulator.grid(series, model)
    follow = simulator.follow(series, model, t_ns)
    begin = {
        one: float(physical(series, one, t_ns[:1], model)[0])
        for one in simulator.mapped.start
        if one in series
    }
    at = np.arange(len(t_ns))
    settled = (at >= round(_SETTLE_S / simulator.step_s)) & (at < len(t_ns) - 1)
    kept = (at // round(WINDOW_S / simulator.step_s)) % _KEPT == _KEPT - 1
    inputs = simulator.inputs(series, model, t_ns)
    if cut:
        return _Run(inputs, begin, follow, settled & ~kept, settled & kept)
    return _Run(inputs, begin, follow, settled & fitted, settled & (not fitted))


def _sigma(jacobian: Floats, residual: Floats, block: int) -> Floats:
    """Deviation of each number, with the pulls added up by blocks before they are squared."""
    pulls = jacobian * residual[:, None]
    edges = np.arange(0, len(pulls), block)
    summed = np.add.reduceat(pulls, edges, axis=0)
    try:
        inverse = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return np.full(jacobian.shape[1], np.inf)
    few = len(edges) / max(len(edges) - jacobian.shape[1], 1)
    return np.asarray(np.sqrt(few) * np.linalg.norm(summed @ inverse, axis=0))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _robust(values: Floats) -> float:
    return max(1e-9, 1.4826 * float(np.median(np.abs(values))))


def _notes(free: Sequence[Free], value: Floats, sigma: Floats) -> list[str]:
    notes = []
    for one, x, s in zip(free, value, sigma, strict=True):
        if not np.isfinite(s) or s > 0.5 * max(abs(x), 1e-300):
            notes.append(f"these recordings hardly tell {one.name}")
        elif x - one.low < 1e-6 * one.scale or one.high - x < 1e-6 * one.scale:
            notes.append(f"{one.name} went to the end of its range")
    return notes
