"""The error budget: each source alone, all together, and what a calibration would gain.

Three figures for each phase (moving, reversal, rest), all in N rms at the rack:

* *alone*: the change of the estimate that one source of one standard deviation makes;
* *total*: the same for all sources drawn together, many times (Monte Carlo). Where sources neither
  interact nor correlate it is the root of the sum of squares of the ones alone;
* *gain*: how far the total falls when a group of sources is put right, with the same draws: what an
  hour of calibration buys.

"Method" is what is left with every source at zero: the estimator's own error on this rig.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.budget.sources import JOBS, Group, Samples, Source, recorded, wrong_model
from eps_hil.estimation import batch
from eps_hil.estimation.phases import Phases, phases
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
Progress = Callable[[float], None]

PHASES = Phases._fields
_SETTLED_S = 0.5
_TRIES = 200
AGREES = 0.15
"""The root of squares and the total may differ by this share before interactions are named."""


@dataclass(frozen=True, slots=True)
class World:
    """A simulated rig's error-free samples, and the truth at 1 kHz that an estimate is held to."""

    model: Model
    settings: EstimatorSettings
    clean: Samples
    rack_force_n: Floats
    speed_rad_s: Floats
    periods_s: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Line:
    """One source, or one group: N rms by phase, NaN where a phase does not occur."""

    name: str
    alone_n: Mapping[str, float]
    gain_n: Mapping[str, float] | None = None
    source: Source | None = None


@dataclass(frozen=True, slots=True)
class Budget:
    """The whole: N rms at the rack by phase. ``share`` is the part of the time in each phase."""

    share: Mapping[str, float]
    force_n: Mapping[str, float]
    method_n: Mapping[str, float]
    total_n: Mapping[str, float]
    total_error_n: Mapping[str, float]
    root_sum_n: Mapping[str, float]
    with_method_n: Mapping[str, float]
    sources: Sequence[Line]
    groups: Sequence[Line]
    draws: int

    def interacts(self, phase: str) -> bool:
        """Whether the sum of squares does not explain the total in this phase.

        By more than :data:`AGREES`, and by more than two standard errors of the total.
        """
        root, total = self.root_sum_n[phase], self.total_n[phase]
        least = max(AGREES * total, 2.0 * self.total_error_n[phase])
        return bool(np.isfinite(total) and abs(root - total) > least)


class _Trials:
    """Runs the estimator under chosen errors; errors of phases against the error-free run."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._parts = phases(world.speed_rad_s)
        self.base = self._estimate({}, 0)
        self.end = len(self.base)

    def _estimate(self, errors: Mapping[str, float], seed: int) -> Floats:
        """Estimate at 1 kHz (n,), NaN where there is none."""
        w = self._world
        series = recorded(w.clean, errors, w.periods_s, seed)
        periods = {name: w.periods_s.get(name, 1e-3) for name in series}
        trace = batch.estimate(series, wrong_model(w.model, errors), w.settings, periods)
        result = np.full(len(w.clean.time_s), np.nan)
        t_s = trace.t_ns[trace.valid] * 1e-9
        if len(t_s) < 2:
            return result
        inside = (w.clean.time_s >= t_s[0]) & (w.clean.time_s <= t_s[-1])
        inside &= w.clean.time_s > _SETTLED_S
        at = w.clean.time_s[inside]
        result[inside] = np.interp(at, t_s, trace.rack_force_n[trace.valid])
        return result

    def change(self, errors: Mapping[str, float], seed: int) -> Floats:
        """Mean square of the change that ``errors`` make, by phase (3,) in N²."""
        return self.square(self._estimate(errors, seed) - self.base)

    def both(self, errors: Mapping[str, float], seed: int) -> tuple[Floats, Floats]:
        """Mean squares of the change and of the error itself, by phase."""
        found = self._estimate(errors, seed)
        return self.square(found - self.base), self.square(found - self._world.rack_force_n)

    def square(self, values: Floats) -> Floats:
        """Mean square by phase (3,); NaN where the phase does not occur."""
        means = []
        for part in self._parts:
            chosen = values[part & np.isfinite(values)]
            means.append(float(np.mean(chosen**2)) if len(chosen) else np.nan)
        return np.array(means)


def budget(
    world: World,
    sources: Sequence[Source],
    *,
    draws: int = 24,
    seed: int = 0,
    on_progress: Progress | None = None,
) -> Budget:
    """Work the budget out; the same arguments give the same figures."""
    trials = _Trials(world)
    groups = [group for group in Group if any(s.group is group for s in sources)]
    todo, done = 2 * len(sources) + draws * (1 + len(groups)), 0

    def tick(n: int) -> None:
        nonlocal done
        done += n
        if on_progress is not None:
            on_progress(done / todo)

    alone: dict[str, Floats] = {}
    for source in sources:
        signs = (1.0, 1.0) if source.random else (1.0, -1.0)
        squares = [
            trials.change({source.name: sign * source.size}, seed + k)
            for k, sign in enumerate(signs)
        ]
        alone[source.name] = np.mean(squares, axis=0)
        tick(2)
    scores = _scores(len(sources), draws, seed + 1)
    changes, error = np.zeros((draws, 3)), np.zeros(3)
    without = {group: np.zeros(3) for group in groups}
    for k in range(draws):
        drawn = {
            s.name: s.size * (1.0 if s.random else float(scores[k, place]))
            for place, s in enumerate(sources)
        }
        one, whole = trials.both(drawn, seed + 100 + k)
        changes[k], error = one, error + whole / draws
        tick(1)
        for group in groups:
            kept = {s.name: drawn[s.name] for s in sources if s.group is not group}
            without[group] += trials.change(kept, seed + 100 + k) / draws
            tick(1)
    change = np.mean(changes, axis=0)
    spread = np.std(changes, axis=0, ddof=1) / np.sqrt(draws) / (2.0 * np.sqrt(change))
    lines = [Line(s.name, _named(np.sqrt(alone[s.name])), None, s) for s in sources]
    return Budget(
        share=_named([float(np.mean(part)) for part in phases(world.speed_rad_s)]),
        force_n=_named(np.sqrt(trials.square(np.where(np.isfinite(trials.base),
                                                      world.rack_force_n, np.nan)))),
        method_n=_named(np.sqrt(trials.square(trials.base - world.rack_force_n))),
        total_n=_named(np.sqrt(change)),
        total_error_n=_named(spread),
        root_sum_n=_named(np.sqrt(np.sum(list(alone.values()), axis=0))),
        with_method_n=_named(np.sqrt(error)),
        sources=_ranked(lines),
        groups=_ranked([
            Line(
                group.value,
                _named(np.sqrt(np.sum([alone[s.name] for s in sources if s.group is group], 0))),
                _named(np.sqrt(change) - np.sqrt(without[group])),
            )
            for group in groups
        ]),
        draws=draws,
    )  # fmt: skip


def _scores(count: int, draws: int, seed: int) -> Floats:
    """Standard normal numbers (draws, count) by Latin hypercube, each column of mean square 1.

    Every source then visits its whole distribution in a few dozen draws, so that the total can be
    held against the sources alone without hundreds of them. Of some arrangements the least
    correlated is taken.
    """
    from scipy.special import ndtri

    rng = np.random.default_rng(seed)
    levels = ndtri((np.arange(draws) + 0.5) / draws)
    levels /= np.sqrt(np.mean(levels**2))
    tries = (
        np.column_stack([rng.permutation(levels) for _ in range(count)]) for _ in range(_TRIES)
    )
    return min(tries, key=lambda z: float(np.sum((z.T @ z / draws - np.eye(count)) ** 2)))


def _named(values: Any) -> dict[str, float]:
    return dict(zip(PHASES, (float(v) for v in values), strict=True))


def _ranked(lines: list[Line]) -> list[Line]:
    """Largest while moving first; where nothing moves, by what comes next."""

    def size(line: Line) -> tuple[float, ...]:
        return tuple(v if np.isfinite(v) else -1.0 for v in line.alone_n.values())

    return sorted(lines, key=size, reverse=True)


def advice(found: Budget) -> list[str]:
    """Sentences that follow from the figures: what to calibrate next, by phase, and caveats."""
    said = []
    for phase in PHASES:
        total = found.total_n[phase]
        if not np.isfinite(total):
            said.append(f"{phase}: does not occur in this manoeuvre.")
            continue
        gains = [(line.gain_n[phase], line) for line in found.groups if line.gain_n is not None]
        gain, best = max(gains, key=lambda pair: pair[0])
        if gain < 0.02 * total:
            said.append(
                f"{phase}: no single group is worth an hour; putting any one right lowers the "
                f"total of {total:.1f} N by less than {max(gain, 0.0) + 0.05:.1f} N."
            )
        else:
            said.append(
                f"{phase}: {best.name} first: {JOBS[Group(best.name)]}; "
                f"{total:.1f} N would become {total - gain:.1f} N."
            )
        if found.method_n[phase] > total:
            said.append(
                f"{phase}: the estimator's own error, {found.method_n[phase]:.1f} N, is larger "
                f"than all these together: no calibration lowers it."
            )
        if found.interacts(phase):
            more = "more" if found.root_sum_n[phase] > total else "less"
            said.append(
                f"{phase}: sources interact: alone they make {found.root_sum_n[phase]:.1f} N "
                f"(root of squares), {more} than the {total:.1f} N together; trust the gains, "
                f"not the sum."
            )
    return said


def content(found: Budget) -> dict[str, Any]:
    """JSON-ready (``eps-hil/budget/1``)."""
    return {
        "schema": "eps-hil/budget/1",
        "draws": found.draws,
        "phases": {
            phase: {
                "share_of_time": found.share[phase],
                "rack_force_rms_n": found.force_n[phase],
                "method_n": found.method_n[phase],
                "total_n": found.total_n[phase],
                "total_standard_error_n": found.total_error_n[phase],
                "root_of_squares_n": found.root_sum_n[phase],
                "error_with_method_n": found.with_method_n[phase],
                "sources_interact": found.interacts(phase),
            }
            for phase in PHASES
        },
        "groups": [
            {"group": line.name, "alone_n": dict(line.alone_n), "gain_n": dict(line.gain_n or {})}
            for line in found.groups
        ],
        "sources": [
            {
                "source": line.name,
                "group": line.source.group.value if line.source else "",
                "standard_deviation": line.source.size if line.source else None,
                "unit": line.source.unit if line.source else "",
                "alone_n": dict(line.alone_n),
            }
            for line in found.sources
        ],
        "advice": advice(found),
    }
