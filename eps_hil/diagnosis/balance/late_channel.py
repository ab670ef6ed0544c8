"""A channel of one recording that is a good part of a second off the others, by the balance.

``data/far_off.py`` asks without a model; a rough balance leaves too much to see a small torque by.
Here the balance's residual of one recording, below 10 Hz, is held against every torque that was
measured: one that is τ late leaves c(t + τ) − c(t) of its part c. The alternative is that the
model's own numbers are off, or a spring is missing: in slow motion they do nearly as well, but only
by errors that no file has. So both are weighed by evidence, n/2 ln of the mean square that is left
and half the squared errors in units of their usual size (the prior of ``baseline.py``).
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import ALL, SPRING
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.far_off import ELSEWHERE, FARTHEST_S, NEAREST_S
from eps_hil.diagnosis.data.intake import RecordingError
from eps_hil.diagnosis.data.prepare import STEP_S, THIN, Prepared
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

LOADS = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")
BLOCK = 6
"""Thinned samples that are averaged: 48 ms, the step of the lags."""
TOGETHER = 5
"""Blocks that are one independent observation of what a model leaves: a quarter of a second."""
LONGEST_S = 120.0
"""Of a recording that is looked at, from its middle."""
NATS = 30.0
"""Evidence for a shift beyond that for other numbers, after the choice among lags."""
ALIKE = 3.0
"""Nats that do not tell one lag from another."""
ABOUT = 6
"""Lags from one to another that are the same shift."""
_GAIN, _STEP = 0.01, 0.05
"""Of a channel, and of a usual error of a number: small changes, for a difference."""
_FEWEST = 200
_ROUNDS = 4


def late_channels(recordings: Sequence[Prepared], model: Model, *, trusted: bool) -> list[str]:
    """A sentence for every such channel; :class:`RecordingError` unless they are ``trusted``."""
    every = each(lambda one: _said(one, model), recordings)
    told = [said for said in every if said is not None]
    if told and not trusted:
        name, words = told[0]
        raise RecordingError(name, f"{words}: put all channels on one clock")
    return [f"{name}: {words}. The channels were trusted all the same." for name, words in told]


def _said(one: Prepared, model: Model) -> tuple[str, str] | None:
    found = late_channel(one, model)
    if found is None:
        return None
    channel, late_s = found
    word = "later" if late_s > 0.0 else "earlier"
    words = f"{channel} comes some {abs(late_s):.1f} s {word} than the other channels"
    return one.name, words


def late_channel(one: Prepared, model: Model) -> tuple[str, float] | None:
    """(channel, s by which it is late) where that is likelier than other numbers, or None."""
    n, most = len(one.time_s), round(LONGEST_S / STEP_S)
    if n > most:
        one = one.cut((n - most) // 2, (n + most) // 2)
    step_s = BLOCK * THIN * STEP_S
    far = round(FARTHEST_S / step_s)
    if len(one.thin_time_s) // BLOCK - 2 * far < _FEWEST:
        return None
    problem = Problem([one.alone()], model)
    names = [name for name in LOADS if name in one.raw and np.any(one.raw[name])]
    recorded = problem.recordings[0].left_over(model)
    residual = _averaged(recorded)
    weight = 1.0 / _averaged(problem.scale)
    parts = [_averaged(_part(problem, model, name, recorded)) for name in names]
    inside = slice(far, len(residual) - far)
    own = np.column_stack([_moves(problem, name, recorded) for name in (*ALL, SPRING)])
    columns = np.column_stack([_averaged(one) for one in own.T]) * weight[:, None]
    refit = _Refit(columns[inside])

    def moved(k: int, by: int) -> Floats:
        late = parts[k][far + by : len(residual) - far + by] - parts[k][inside]
        return (residual[inside] + late) * weight[inside]

    shifts = range(-far + 1, far)
    lags = [(k, by) for k in range(len(names)) for by in shifts if abs(by) * step_s >= NEAREST_S]
    as_it_is = moved(0, 0)
    (before,), _ = refit.believed(as_it_is[None, :])
    nats, _ = refit.believed(np.array([moved(*lag) for lag in lags]))
    if before - nats.min() < NATS + np.log(len(lags)):
        return None
    alike = [lag for lag, one in zip(lags, nats, strict=True) if one < nats.min() + ALIKE]
    k, near = min(alike, key=lambda lag: abs(lag[1]))  # periodic motion: a period later, too
    about = [lag for lag in lags if lag[0] == k and abs(lag[1] - near) < ABOUT]
    k, by = min(about, key=lambda lag: nats[lags.index(lag)])
    left, beside = refit.left(moved(k, by)), refit.left(as_it_is)
    half = len(left) // 2
    for part in (slice(None, half), slice(half, None)):  # or it explains one event by chance
        if np.sum(left[part] ** 2) > ELSEWHERE * np.sum(beside[part] ** 2):
            return None
    return names[k], by * step_s


class _Refit:
    """The model's own numbers refitted, each column what a usual error of one does.

    In the directions in which they do not depend on one another: what a refit leaves of many lags
    then follows from sums, without a residual of each.
    """

    def __init__(self, columns: Floats) -> None:
        curvature, directions = np.linalg.eigh(columns.T @ columns)
        self.curvature: Floats = np.maximum(curvature, 0.0)
        self.columns: Floats = columns @ directions

    def believed(self, values: Floats) -> tuple[Floats, Floats]:
        """(minus the log evidence (k,), errors (k, p)) by the numbers that are likeliest.

        Of each row of ``values`` (k, n): all lags at once.
        """
        samples = values.shape[1]
        variance, slope = np.ones(len(values)), values @ self.columns
        energy = np.einsum("ij,ij->i", values, values)
        for _ in range(_ROUNDS):
            errors = slope / (self.curvature + (variance * TOGETHER)[:, None])
            taken = np.sum((2.0 * slope - self.curvature * errors) * errors, axis=1)
            variance = np.maximum((energy - taken) / samples, 1.0)
        evidence = 0.5 * samples / TOGETHER * np.log(variance)
        return evidence + 0.5 * np.sum(errors**2, axis=1), errors

    def left(self, values: Floats) -> Floats:
        """What that leaves of one row (n,)."""
        _, (errors,) = self.believed(values[None, :])
        return np.asarray(values - self.columns @ errors)


def _part(problem: Problem, model: Model, name: str, recorded: Floats) -> Floats:
    """What a channel does to the residual, Nm, (n,), which is ``recorded`` as it is."""
    (one,) = problem.recordings
    more = one.changed(raw={**one.raw, name: (1.0 + _GAIN) * one.raw[name]})
    return np.asarray((more.left_over(model) - recorded) / _GAIN)


def _moves(problem: Problem, name: str, recorded: Floats) -> Floats:
    """What a usual error of a number of the model's own does to the residual, Nm, (n,)."""
    model = problem.with_entries([], {name: _STEP})
    return np.asarray((problem.left(problem.recordings[0], model) - recorded) / _STEP)


def _averaged(values: Floats) -> Floats:
    return np.asarray(values[: len(values) // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1))
