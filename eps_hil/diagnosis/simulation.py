"""Anybody's simulator: its traces reduced to a model of ours, with which recordings are diagnosed.

The traces come from Simulink, CarMaker, an FMU: other rates, other start times, perhaps fewer
columns. They are put beside the recordings of the same manoeuvres (``align.py``), dressed in the
recordings' sensor noise so that both are seen through the same glasses, and explained: first by the
model file's own friction and inertia, moved as far as the traces ask for, then by effects of the
catalogue. What comes out is a model that does what the simulator does; the diagnosis then asks what
the recordings hold beyond it, in its usual words.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.align import Match, pair
from eps_hil.diagnosis.fit import Fit, ablated, fit
from eps_hil.diagnosis.leftover import LEAST_EXCESS
from eps_hil.diagnosis.parameters import Reduction, reduce_parameters
from eps_hil.diagnosis.prepare import Prepared, prepare
from eps_hil.diagnosis.problem import Problem, clipped, knee
from eps_hil.diagnosis.select import LEAST_GAIN, Say, select
from eps_hil.physics.model import Delays, Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
Signals = Mapping[str, Series]

_INPUTS = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")
_TIMING = ("motor_torque_delay", "speed_sensor_delay")
_PARAMETERS = (
    "coulomb_level",
    "friction_asymmetry",
    "viscous_friction",
    "load_dependent_friction",
    "inertia",
)
"""Effects that are nothing but the model file's own numbers moved."""
_AT_REST = ("presliding_hysteresis",)
_STEP_NS = 1_000_000
_QUIET = 1e-4
"""Least noise of a trace, as a share of the signal's deviation: a step of its file."""
_SAME_TIME_S = 0.75e-3
"""Delays of the traces that are this near to the model file's are the same."""
_LEAST_PART = 0.02
"""Least part of what the parameters leave that an effect of the traces explains."""
_REACH_S = 0.03
"""How far off the correlation may have placed a trace."""
_WIDER = 1.2
"""A recording that goes this much further than the traces asks more than they can tell."""


@dataclass(frozen=True)
class Simulated:
    """Somebody's traces, explained.

    ``model`` does what they do; ``unexplained_nm`` (rms, at the rotor) is what it does not reach:
    a difference smaller than that cannot be told from our reduction of the simulator.
    ``content`` is for the JSON; ``problem`` holds the traces as they were fitted.
    """

    model: Model
    unexplained_nm: float
    content: dict[str, Any]
    problem: Problem


def explain(
    traces: Mapping[str, Signals],
    recordings: Mapping[str, Signals],
    model: Model,
    say: Say | None = None,
) -> Simulated:
    """Reduce ``traces`` to a model; ``recordings`` (hold-outs too) lend noise and missing columns.

    ``ValueError`` names the trace and what is wrong with it.
    """
    if say:
        say("aligning the simulator's traces", 0.0)
    matches = pair(traces, recordings, model)
    noise = _noise(recordings)
    physical = replace(model, delays_s=Delays())
    made = []
    for seed, (name, one) in enumerate(traces.items()):
        tried = [
            (place, _dressed(name, one, place, recordings, model, noise, seed))
            for place in _places(one, matches[name], recordings)
        ]
        matches[name], dressed = min(tried, key=lambda pair: _left(pair[1], physical))
        made.append(dressed)
    problem = _placed(Problem(made, physical), traces)
    made = list(problem.recordings)
    if np.sum(problem.sliding) < 200:
        raise ValueError(f"{', '.join(traces)}: moves for less than 2 s")
    if say:
        say("explaining the simulator's traces", 0.1)
    reduction, entries = _reduced(problem)
    problem = Problem(made, replace(reduction.model, effects=model.effects))
    fitted = problem.with_entries(entries)
    entries = [entry for entry in entries if entry["effect"] not in _TIMING]
    left = problem.residual(fitted)
    unexplained = _unexplained(problem, left)
    result = replace(reduction.model, effects=(*model.effects, *entries))
    lent = any(_lent(trace) for trace in traces.values())
    late, delays = _timing(reduction.model.delays_s, model.delays_s, lent)
    result = replace(result, delays_s=delays)
    problem = Problem(made, fitted)
    content = {
        "traces": [_about(name, one, matches[name], model) for name, one in traces.items()],
        "timing": "as reported" if late else "physical instants",
        "parameters": reduction.content(),
        "effects": entries,
        "unexplained_nm": unexplained,
        "caveats": _caveats(traces, recordings, matches, reduction, unexplained, problem, left),
    }
    return Simulated(result, unexplained, content, problem)


def _reduced(problem: Problem) -> tuple[Reduction, list[dict[str, Any]]]:
    """Parameters, and the effects that the traces need where those alone leave much of them.

    What an effect says that the parameters can say too is left to the parameters, which are fitted
    again beside the effects.
    """
    nominal = problem.model
    reduction = reduce_parameters(problem)
    cut = clipped(reduction.residual, knee(reduction.residual))[problem.sliding]
    excess = float(np.sum(cut**2 - 1.0))
    if excess < LEAST_EXCESS * len(cut):
        return reduction, []
    found = select(Problem(problem.recordings, reduction.model)).found
    entries = [dict(one) for one in found.entries if one["effect"] not in _PARAMETERS]
    for _ in range(2):
        beside = replace(nominal, effects=(*nominal.effects, *entries))
        reduction = reduce_parameters(Problem(problem.recordings, beside))
        bare = Problem(problem.recordings, replace(reduction.model, effects=nominal.effects))
        entries = _needed(bare, fit(bare, entries), max(LEAST_GAIN, _LEAST_PART * excess))
    return reduction, entries


def _needed(problem: Problem, found: Fit, least: float) -> list[dict[str, Any]]:
    """The effects without which the others leave more while sliding.

    At rest, solvers differ as much as physics does.
    """
    while found.entries:
        losses = []
        for k, entry in enumerate(found.entries):
            without = ablated(problem, found, k)
            whole = float(np.sum(without.residual**2 - found.residual**2))
            slid = float(np.sum((without.residual**2 - found.residual**2)[problem.sliding]))
            losses.append(whole if entry["effect"] in _AT_REST else min(whole, slid))
        weakest = int(np.argmin(losses))
        if losses[weakest] > least:
            break
        found = ablated(problem, found, weakest)
    return [dict(entry) for entry in found.entries]


def silent_on(simulated: Simulated, entry: Mapping[str, Any]) -> bool:
    """Whether the traces would look the same if the simulator had this effect."""
    problem = simulated.problem
    without = problem.residual(problem.model)
    changed = problem.residual(problem.with_entries([dict(entry)]))
    return float(np.sum((changed - without) ** 2)) < LEAST_GAIN


def _noise(recordings: Mapping[str, Signals]) -> dict[str, float]:
    """Each signal's usual noise over the recordings (its own unit)."""
    found: dict[str, list[float]] = {}
    for name, one in recordings.items():
        for signal, sigma in prepare(name, one).noise.items():
            found.setdefault(signal, []).append(sigma)
    return {signal: float(np.median(sigmas)) for signal, sigmas in found.items()}


def _dressed(
    name: str,
    trace: Signals,
    match: Match | None,
    recordings: Mapping[str, Signals],
    model: Model,
    noise: Mapping[str, float],
    seed: int,
) -> Prepared:
    """The trace on our grid, missing inputs taken from its recording, with the sensors' noise."""
    if "motor_speed_rad_s" not in trace and "motor_angle_rad" not in trace:
        raise ValueError(f"{name}: needs motor_speed_rad_s or motor_angle_rad")
    start = _start_ns(trace)
    series = {signal: _resampled(one, start) for signal, one in trace.items() if len(one.t_ns) > 3}
    for signal in _INPUTS:
        if signal in series:
            continue
        if match is None:
            if signal == "torque_sensor_nm":
                continue
            raise ValueError(f"{name}: has no {signal}, and is like no recording to take it from")
        source = recordings[match.recording]
        if signal in source:
            late = model.delays_s.of(signal)
            origin = _start_ns(source)
            shift = round((match.offset_s + late) * 1e9)
            one = source[signal]
            series[signal] = Series(one.t_ns - origin - shift, one.value)
    rng = np.random.default_rng(seed)
    first = prepare(name, series)
    noisy = {}
    for signal, one in series.items():
        least = _QUIET * float(np.nanstd(one.value))
        wanted = max(noise.get(signal, 0.0), least)
        missing = np.sqrt(max(0.0, wanted**2 - first.noise[signal] ** 2))
        noisy[signal] = Series(one.t_ns, one.value + missing * rng.standard_normal(len(one.value)))
    return prepare(name, noisy)


def _lent(trace: Signals) -> list[str]:
    """What drives a model and the trace does not hold."""
    return [signal for signal in _INPUTS if signal not in trace]


def _places(
    trace: Signals, match: Match | None, recordings: Mapping[str, Signals]
) -> list[Match | None]:
    """Where a trace that lacks inputs may lie: as it correlates, the same start, the same clock."""
    if match is None or not _lent(trace):
        return [match]
    places: list[Match | None] = [match]
    for name, one in recordings.items():
        clock = (_start_ns(trace) - _start_ns(one)) * 1e-9
        offsets = {0.0, clock if abs(clock) < 0.5 * match.overlap_s else 0.0}
        places += [replace(match, recording=name, offset_s=offset) for offset in sorted(offsets)]
    return places


def _start_ns(record: Signals) -> int:
    return min(int(one.t_ns[0]) for one in record.values())


def _left(one: Prepared, model: Model) -> float:
    return float(np.mean(np.abs(one.residual(model)[0])))


def _placed(problem: Problem, traces: Mapping[str, Signals]) -> Problem:
    """The same with each trace's lent inputs moved to where the torque balance closes best.

    Correlation places them to a few milliseconds where the motion itself differs; the balance
    feels tenths of one.
    """
    if not any(_lent(trace) for trace in traces.values()):
        return problem
    for _ in range(2):
        model = reduce_parameters(problem, timing=False).model
        moved = [
            _best_shift(one, model, _lent(trace)) if _lent(trace) else one
            for one, trace in zip(problem.recordings, traces.values(), strict=True)
        ]
        problem = Problem(moved, problem.model)
    return problem


def _best_shift(one: Prepared, model: Model, lent: Sequence[str]) -> Prepared:
    """The trace with its lent columns at the shift that leaves least."""
    best, cost = one, np.inf
    for reach in (_REACH_S, _REACH_S / 10, _REACH_S / 100):
        for shift in np.linspace(-reach, reach, 11):
            raw = dict(best.raw if reach < _REACH_S else one.raw)
            for name in lent:
                if name in raw:
                    raw[name] = np.interp(one.time_s + shift, one.time_s, raw[name])
            trial = one.changed(raw=raw)
            new = _left(trial, model)
            if new < cost:
                cost, found = new, trial
        best = found
    return best


def _resampled(one: Series, start: int) -> Series:
    """The trace at 1 kHz from its own start; smooth between samples, as a simulator's state is."""
    from scipy.interpolate import Akima1DInterpolator

    good = np.isfinite(one.value)
    t_ns, value = one.t_ns[good] - start, one.value[good]
    grid = np.arange(-(-t_ns[0] // _STEP_NS), t_ns[-1] // _STEP_NS + 1, dtype=np.int64) * _STEP_NS
    smooth = Akima1DInterpolator(t_ns * 1e-9, value)(grid * 1e-9)
    return Series(grid, np.asarray(smooth, dtype=np.float64))


def _timing(fitted: Delays, file: Delays, lent: bool) -> tuple[bool, Delays]:
    """Whether the traces are as late as the rig's sensors, and the delays to judge recordings by.

    A simulator mostly writes physical instants: then the recordings' sensors are as late as the
    model file says. One that has the sensors' delays in it has its own. Inputs that were taken
    from a recording say nothing of it.
    """
    names = ("motor_speed", "motor_torque")
    mine = [float(getattr(fitted, name)) for name in names]
    theirs = [float(getattr(file, name)) for name in names]
    late = not lent and sum(abs(a - b) for a, b in zip(mine, theirs, strict=True)) < sum(
        abs(a) for a in mine
    )
    if not late:
        return False, file
    own = {n: a for n, a, b in zip(names, mine, theirs, strict=True) if abs(a - b) > _SAME_TIME_S}
    return True, replace(file, **own)


def _unexplained(problem: Problem, residual: Floats) -> float:
    """Rms (Nm) of what is left beyond the noise while sliding."""
    cut = clipped(residual, knee(residual))[problem.sliding]
    excess = max(0.0, float(np.mean(cut**2)) - 1.0)
    return float(np.sqrt(excess) * np.median(problem.scale[problem.sliding]))


def _about(name: str, trace: Signals, match: Match | None, model: Model) -> dict[str, Any]:
    rates = {s: round(1e9 / float(np.median(np.diff(one.t_ns))), 3) for s, one in trace.items()}
    lent = _lent(trace) if match else []
    return {
        "file": name,
        "recording": match.recording if match else None,
        "offset_s": round(match.offset_s, 6) if match else None,
        "correlation": round(match.correlation, 4) if match else None,
        "rate_hz": rates.get("motor_speed_rad_s", rates.get("motor_angle_rad")),
        "taken_from_recording": lent,
    }


def _caveats(
    traces: Mapping[str, Signals],
    recordings: Mapping[str, Signals],
    matches: Mapping[str, Match | None],
    reduction: Reduction,
    unexplained: float,
    problem: Problem,
    residual: Floats,
) -> list[str]:
    said = [f"{n}: like no recording; used as it is" for n, one in matches.items() if one is None]
    for signal in ("motor_speed_rad_s", "rack_force_n", "rack_position_m", "motor_torque_nm"):
        mine, theirs = _reach(traces.values(), signal), _reach(recordings.values(), signal)
        if mine > 0 and theirs > _WIDER * mine:
            said.append(
                f"the recordings reach {signal} {theirs:.4g}, the traces only {mine:.4g}: what "
                "happens beyond is compared with our reduction of the simulator carried on"
            )
    for name, trace in traces.items():
        if "motor_torque_nm" not in trace:
            said.append(
                f"{name}: motor torque taken from the recording; right only if the simulator was "
                "driven by the recorded torque"
            )
    if reduction.unseen:
        said.append(
            f"the traces do not show {', '.join(reduction.unseen)}; taken from the model file"
        )
    noise = float(np.median(problem.scale[problem.sliding]))
    if unexplained > noise:
        said.append(
            f"our reduction leaves {unexplained:.3g} Nm of the traces unexplained (noise: "
            f"{noise:.3g} Nm); smaller differences are not reported"
        )
    return said + _units(traces, recordings, matches)


def _reach(records: Sequence[Signals] | Any, signal: str) -> float:
    values = [np.abs(one[signal].value) for one in records if signal in one]
    return float(np.nanpercentile(np.concatenate(values), 99)) if values else 0.0


def _units(
    traces: Mapping[str, Signals],
    recordings: Mapping[str, Signals],
    matches: Mapping[str, Match | None],
) -> list[str]:
    """A column whose size or sign is so unlike its recording's that it is hardly the same unit."""
    said = []
    for name, one in matches.items():
        if one is None:
            continue
        for signal in one.signals:
            mine, theirs = (
                float(np.nanstd(r[signal].value)) for r in (traces[name], recordings[one.recording])
            )
            if theirs > 0 and not 0.1 < mine / theirs < 10.0:
                said.append(
                    f"{name}: {signal} is {mine / theirs:.3g} times the recording's; units?"
                )
    return said
