"""Which of the model's own numbers are off: the fewest names that do what their refit did.

A refit of all of them at once says that something is off, and spreads it over numbers that the
recordings can hardly tell apart. Here sets of names are tried on the refit's own linear problem, a
name costing what counts as a gain; the best sets are then fitted in earnest. A torque that comes
out later than holding it could make it costs as much: it will be a name, too.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import (
    HOLD,
    HOLD_S,
    OFFSET,
    SIDES,
    STIFFNESS,
    TIMING,
    levels_of,
)
from eps_hil.diagnosis.balance.fit import BRISTLE, Fit, ablated, fit, matters, own_column
from eps_hil.diagnosis.balance.probes import Candidate, neutral_value, probe_step
from eps_hil.diagnosis.balance.problem import Problem, huber
from eps_hil.diagnosis.mismatch.curve import has_curve
from eps_hil.physics.effects.catalogue import catalogue

Floats = npt.NDArray[np.float64]

SPANNED = (
    "coulomb_level",
    "inertia",
    "viscous_friction",
    "load_dependent_friction",
    "friction_asymmetry",
    "motor_torque_offset",
    "torque_sensor_offset",
    "presliding_hysteresis",
    "motor_torque_delay",
)
"""Effects that a refit of the model's own numbers can stand in for."""
SCALES = ("rack_ratio", "motor_torque_gain", "torque_sensor_gain")
"""Not spanned, but each of them looks like another beside several numbers that are off."""
CONSTANTS = ("friction_asymmetry", "motor_torque_offset", "torque_sensor_offset")
"""One constant while sliding; only presliding, where no model is sure, could tell two apart."""
_FRICTION = frozenset({"coulomb_level", "viscous_friction", "load_dependent_friction"})
_FORM = 0.1
_FITTED_SETS = 3
_START = 0.02
"""Of an effect's small change: where a fit begins that knows nothing."""
_SMALL_SETS = 2


@dataclass(frozen=True)
class _Linear:
    """Normalised normal equations: columns to choose from, then always free ones, then the rest."""

    names: Sequence[str]
    gram: Floats
    size: Floats
    prior: Floats
    price: float
    scales: int
    """How many of SCALES may be off at once."""
    held: float
    """How far the first of the free columns moves where it only says how a torque is held."""

    def solved(self, chosen: frozenset[int]) -> tuple[float, Floats]:
        """(cost plus price, coefficients of the chosen columns in order)."""
        named = {self.names[k] for k in chosen}
        too_many = sum(name in SCALES for name in named) > self.scales
        if too_many or sum(name in CONSTANTS for name in named) > 1:
            return np.inf, np.zeros(0)
        last = len(self.size) - 1
        order = sorted(chosen)
        use = [*order, *range(len(self.names), last)]
        normal = self.gram[np.ix_(use, use)] + np.diag(self.prior[use])
        a = np.linalg.solve(normal, self.gram[use, last])
        partners = {name[1:] for name in named if name.startswith("±")} - {"", *named}
        cost = float(self.size[-1] ** 2) * (1.0 - float(a @ self.gram[use, last]))
        late = abs(float(a[len(order)])) * self.size[-1] / self.size[len(self.names)] > self.held
        cost += self.price * (len(chosen) + len(partners) + late)
        return cost, a[: len(order)] * self.size[-1] / self.size[order]


def numbers_off(
    problem: Problem,
    found: Fit,
    pool: Sequence[Candidate],
    price: float,
    *,
    level: bool = True,
) -> Fit:
    """The fit with the model's own numbers back in place, and the fewest names instead.

    Beside a curve over position a constant torque is only that curve's level: it stays a number
    without a name in ``own`` then, but for ``level`` False.
    """
    kept = [entry for entry in found.entries if entry["effect"] not in SCALES]
    level = level and has_curve(found)
    if level:
        pool = [one for one in pool if one.effect.id not in CONSTANTS]
    constant = (OFFSET,) if level else ()
    linear = _linear(problem, found, kept, pool, price, constant)
    fits = []
    for chosen in _best_sets(linear)[:_FITTED_SETS]:
        values = dict(zip(sorted(chosen), linear.solved(chosen)[1].tolist(), strict=True))
        named = {linear.names[k]: value for k, value in values.items()}
        free = [name[1:] for name in named if name.startswith("±")]
        named |= {name: 0.0 for name in free if name and name not in named}
        starts = [
            _start(problem, pool, name, value)
            for name, value in named.items()
            if not name.startswith("±")
        ]
        own = {**TIMING, **problem.tied, **{side: 0.0 for name in free for side in SIDES[name]}}
        own |= dict.fromkeys(constant, 0.0)
        if HOLD in named:
            del own[HOLD]  # two of the same, which would only pull against each other
        one = fit(problem, [*kept, *starts], own=own, like=found)
        small = [
            e
            for e in one.entries[len(kept) :]
            if not matters(e, problem) and e["effect"] not in free
        ]
        if small:
            left = [e for e in one.entries if e not in small]
            seen = any("motor_angle_rad" in made.raw for made in problem.recordings)
            soft = not seen and any(e["effect"] == BRISTLE for e in small)
            free_still = {STIFFNESS: 0.0} if soft else {}  # or others would stand in for it
            one = fit(problem, left, own={**TIMING, **one.own, **free_still}, like=one)
        late = matters(_delay(one), problem)  # and will be a name
        fits.append((one.cost + price * (len(one.entries) + len(free) + late), one))
    best = min(fits, key=lambda pair: pair[0])[1]
    considered = any(one.effect.id == HOLD for one in pool)
    return _with_delay(problem, best) if considered else best


def _with_delay(problem: Problem, found: Fit) -> Fit:
    """A torque that is later than holding it could make it is a finding, whatever it gains."""
    delay = _delay(found)
    if any(entry["effect"] == HOLD for entry in found.entries) or not matters(delay, problem):
        return found
    own = {name: value for name, value in found.own.items() if name != HOLD}
    return fit(problem, [*found.entries, delay], own=own, like=found)


def _delay(found: Fit) -> dict[str, Any]:
    """How late the motor's torque is where no name says so, as an entry."""
    return {"effect": HOLD, "delay_s": HOLD_S * found.own.get(HOLD, 0.0)}


def levels_first(
    problem: Problem,
    found: Fit,
    least: float,
    considered: Collection[str],
    settled: Collection[str] = (),
) -> Fit:
    """Friction that differs with direction, where friction is off anyway and an offset does no
    better: one cause, not two. And where a sensor with nothing on it has ``settled`` that the
    offset is not its own.

    What tells the constants apart is presliding, whose form no model knows well: what it says of
    them counts only beyond a tenth of what the constant gains, and nothing beside such a sensor.
    """
    asymmetry, *others = CONSTANTS
    names = [str(entry["effect"]) for entry in found.entries]
    offsets = [k for k, name in enumerate(names) if name in others]
    if not offsets or asymmetry not in considered:
        return found
    ruled_out = names[offsets[0]] in settled
    if not ruled_out and not _FRICTION.intersection(names):
        return found
    without = ablated(problem, found, offsets[0])
    margin = max(least, _FORM * (without.cost - found.cost))
    best = _with_constant(problem, without, asymmetry)
    if not ruled_out:
        return best if best.cost < found.cost + margin else found
    for name in (one for one in others if one in considered and one not in settled):
        trial = _with_constant(problem, without, name)
        best = trial if trial.cost < best.cost - margin else best
    return best


def _with_constant(problem: Problem, without: Fit, name: str) -> Fit:
    probe = catalogue()[name].probe
    assert probe is not None
    start = {"effect": name, probe.amplitude: _START * probe_step(catalogue()[name], problem)}
    return fit(problem, [*without.entries, start], own=without.own, like=without)


def _linear(
    problem: Problem,
    found: Fit,
    kept: Sequence[Mapping[str, Any]],
    pool: Sequence[Candidate],
    price: float,
    constant: Sequence[str],
) -> _Linear:
    """The linear problem at the refit, so that no set is judged by how far it bends on the way."""
    some = [one for one in pool if one.effect.id in (*SPANNED, *SCALES)]
    names = [one.effect.id for one in some]
    columns = [_column(problem, one) for one in some]
    for name, sides in SIDES.items():
        if name == HOLD or (name and name not in names):
            continue
        names.append("±" + name)
        columns += [own_column(problem, side) for side in sides]
    own = len(found.own)
    left = found.residual - found.jacobian[:, :own] @ np.array(list(found.own.values()))
    tangents, places, scales = found.jacobian[:, own:], [], 0
    for i, (k, name) in enumerate(found.names):
        entry = found.entries[k]
        if entry in kept:
            places.append(i)
        else:
            probe = catalogue()[entry["effect"]].probe
            assert probe is not None
            left = left - tangents[:, i] * (entry[name] - neutral_value(probe, problem.model))
            scales += 1
    always = [own_column(problem, name) for name in (HOLD, *problem.tied, *constant)]
    free = np.column_stack([*always, tangents[:, places]])
    weight = np.sqrt(huber(found.residual, problem.knee))
    everything = np.column_stack([*columns, free, left]) * weight[:, None]
    size = np.sqrt(np.sum(everything**2, axis=0)) + 1e-150
    prior = np.full(len(size) - 1, 1e-9)
    prior[len(names)] += 1.0 / float(size[len(names)] ** 2)  # of how the torque is held
    gram = (everything / size).T @ (everything / size)
    probe = catalogue()[HOLD].probe
    assert probe is not None
    return _Linear(names, gram, size, prior, price, max(scales, 1), probe.least / HOLD_S)


def _column(problem: Problem, one: Candidate) -> Floats:
    """What one number of an effect does, beside the model file's own numbers.

    Both levels by one factor are each by its own: not those of the refit, which may have bent one
    up and the other down with a constant against the two. Of the sign of a candidate's columns:
    what its amplitude takes off the residual.
    """
    if one.effect.id != "coulomb_level":
        return one.columns[:, 0]
    sides = levels_of(problem.model, problem.size).items()
    return np.asarray(-sum(part * own_column(problem, name) for name, part in sides))


def _best_sets(linear: _Linear) -> list[frozenset[int]]:
    """Sets of columns, best first: all small ones, then what adding, dropping, swapping reaches."""
    n = len(linear.names)
    seen: dict[frozenset[int], float] = {}

    def cost(chosen: frozenset[int]) -> float:
        if chosen not in seen:
            seen[chosen] = linear.solved(chosen)[0]
        return seen[chosen]

    for count in range(_SMALL_SETS + 1):
        for chosen in combinations(range(n), count):
            cost(frozenset(chosen))
    spanned = frozenset(k for k in range(n) if linear.names[k] not in (*SCALES, *CONSTANTS[1:]))
    for start in (min(seen, key=seen.__getitem__), spanned):
        best = start
        while True:
            near = [best ^ {k} for k in range(n)]
            near += [best - {i} | {k} for i in best for k in range(n) if k not in best]
            better = min(near, key=cost)
            if cost(better) >= cost(best):
                break
            best = better
    return sorted(seen, key=seen.__getitem__)


def _start(problem: Problem, pool: Sequence[Candidate], name: str, value: float) -> dict[str, Any]:
    (candidate, *_) = (one for one in pool if one.effect.id == name)
    return candidate.entry(np.array([value]), problem)
