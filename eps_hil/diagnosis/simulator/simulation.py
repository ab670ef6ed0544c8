"""Anybody's simulator: its traces reduced to a model of ours, with which recordings are diagnosed.

The traces come from Simulink, CarMaker, an FMU: other rates, other start times, perhaps fewer
columns. They are put beside the recordings of the same manoeuvres (``align.py``), dressed in the
recordings' sensor noise so that both are seen through the same glasses, and explained: first by the
model file's own friction and inertia, moved as far as the traces ask for, then by effects of the
catalogue. What comes out is a model that does what the simulator does; the diagnosis then asks what
the recordings hold beyond it, in its usual words.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.holdout_support import BRISTLE_HALVES
from eps_hil.diagnosis.attribute.scoring import LEAST_GAIN
from eps_hil.diagnosis.attribute.select import Say, select
from eps_hil.diagnosis.balance.baseline import STIFFNESS
from eps_hil.diagnosis.balance.fit import BRISTLE, Fit, ablated, fit, matters
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee, plain
from eps_hil.diagnosis.balance.turning import half_widths_off
from eps_hil.diagnosis.mismatch.leftover import LEAST_EXCESS
from eps_hil.diagnosis.simulator.align import Match, pair
from eps_hil.diagnosis.simulator.caveats import about, caveats
from eps_hil.diagnosis.simulator.parameters import Reduction, reduce_parameters
from eps_hil.diagnosis.simulator.traces import (
    Signals,
    dressed,
    left_nm,
    lent,
    placed,
    places,
    usual_noise,
)
from eps_hil.physics.model import Delays, Model

Floats = npt.NDArray[np.float64]

_TIMING = ("motor_torque_delay", "speed_sensor_delay")
_PARAMETERS = (
    "coulomb_level",
    "friction_asymmetry",
    "viscous_friction",
    "load_dependent_friction",
    "inertia",
)
"""Effects that are nothing but the model file's own numbers moved."""
_STIFFER = 2.0
"""Times the model file's stiffness, where the search for the traces' begins."""
_SAME_TIME_S = 0.75e-3
"""Delays of the traces that are this near to the model file's are the same."""
_LEAST_PART = 0.02
"""Least part of what the parameters leave that an effect of the traces explains."""


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
    matches, problem = _beside(traces, recordings, model)
    made = problem.recordings
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
    effects = [plain(entry) for entry in entries if entry["effect"] != BRISTLE]
    result = replace(reduction.model, effects=(*model.effects, *effects))
    for entry in entries:
        if entry["effect"] == BRISTLE:  # a number of the model, which recordings may ask for anew
            result = replace(
                result, friction=replace(result.friction, **{STIFFNESS: entry[STIFFNESS]})
            )
    borrowed = any(lent(trace) for trace in traces.values())
    late, delays = _timing(reduction.model.delays_s, model.delays_s, borrowed)
    result = replace(result, delays_s=delays)
    problem = Problem(made, fitted)
    noise_nm = float(np.median(problem.scale[problem.sliding]))
    content = {
        "traces": [about(name, one, matches[name]) for name, one in traces.items()],
        "timing": "as reported" if late else "physical instants",
        "parameters": reduction.content(),
        "effects": [plain(entry) for entry in entries],
        "unexplained_nm": unexplained,
        "caveats": caveats(traces, recordings, matches, reduction, unexplained, noise_nm),
    }
    return Simulated(result, unexplained, content, problem)


def _beside(
    traces: Mapping[str, Signals], recordings: Mapping[str, Signals], model: Model
) -> tuple[dict[str, Match | None], Problem]:
    """Each trace's place in a recording, and the traces made comparable."""
    matches = dict(pair(traces, recordings, model))
    noise = usual_noise(recordings)
    physical = replace(model, delays_s=Delays())
    made = []
    for seed, (name, one) in enumerate(traces.items()):
        tried = [
            (place, dressed(name, one, place, recordings, model, noise, seed))
            for place in places(one, matches[name], recordings)
        ]
        matches[name], best = min(tried, key=lambda pair: left_nm(pair[1], physical))
        made.append(best)
    return matches, placed(Problem(made, physical), traces)


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
        return reduction, _presliding(Problem(problem.recordings, reduction.model))
    found = select(Problem(problem.recordings, reduction.model)).found
    entries = [dict(one) for one in found.entries if one["effect"] not in _PARAMETERS]
    for _ in range(2):
        beside = replace(nominal, effects=(*nominal.effects, *map(plain, entries)))
        reduction = reduce_parameters(Problem(problem.recordings, beside))
        bare = Problem(problem.recordings, replace(reduction.model, effects=nominal.effects))
        entries = _needed(bare, fit(bare, entries), max(LEAST_GAIN, _LEAST_PART * excess))
    return reduction, entries


def _presliding(problem: Problem) -> list[dict[str, Any]]:
    """The bristle's stiffness where traces that slide as the model does turn round otherwise."""
    start = {"effect": BRISTLE, STIFFNESS: _STIFFER * problem.model.friction.sigma0_nm_per_rad}
    found = fit(problem, [start])
    at_rest = _needed(problem, found, LEAST_GAIN)
    half_width = next(iter(found.half_width.values()))
    clear = half_widths_off(found.entries[0], half_width, problem) > BRISTLE_HALVES
    return at_rest if clear and matters(found.entries[0], problem) else []


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
            losses.append(whole if entry["effect"] == BRISTLE else min(whole, slid))
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


def _timing(fitted: Delays, file: Delays, borrowed: bool) -> tuple[bool, Delays]:
    """Whether the traces are as late as the rig's sensors, and the delays to judge recordings by.

    A simulator mostly writes physical instants: then the recordings' sensors are as late as the
    model file says. One that has the sensors' delays in it has its own. Inputs that were taken
    from a recording say nothing of it.
    """
    names = ("motor_speed", "motor_torque")
    mine = [float(getattr(fitted, name)) for name in names]
    theirs = [float(getattr(file, name)) for name in names]
    late = not borrowed and sum(abs(a - b) for a, b in zip(mine, theirs, strict=True)) < sum(
        abs(a) for a in mine
    )
    if not late:
        return False, file
    own = {
        name: max(a, 0.0)  # no sensor is early: a model file has no place for that
        for name, a, b in zip(names, mine, theirs, strict=True)
        if abs(a - b) > _SAME_TIME_S
    }
    return True, replace(file, **own)


def _unexplained(problem: Problem, residual: Floats) -> float:
    """Rms (Nm) of what is left beyond the noise while sliding."""
    cut = clipped(residual, knee(residual))[problem.sliding]
    excess = max(0.0, float(np.mean(cut**2)) - 1.0)
    return float(np.sqrt(excess) * np.median(problem.scale[problem.sliding]))
