"""The laws that are tried: where × what it depends on × shape × memory, each a column.

Not a list of effects: every product that makes sense in the units of the place. One input through
any shape (and memory), by itself, as a relative change, or times a second input that makes it a
drag (speed), a flank's friction (torque, load) or a centrifugal force (speed squared).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.physics.empirical_entry import SIGNS

Floats = npt.NDArray[np.float64]

_BETWEEN = 0.05
ORDERS = np.arange(_BETWEEN, 40.01, _BETWEEN)
MOST_ORDERS = 3
MOST_LOCAL = 6
"""Sines that are strong in one part of the travel only, of each place where they act; as many
whose strength fades with an amount."""
_FILTER_HZ, _FEWEST, _APART = 30.0, 100, 0.15
_LAGS_S = (0.05, 0.2, 0.8, 3.0, 12.0)
_HEATS_S = (1.5, 4.0, 10.0, 25.0, 60.0)
_WAYS = (0.02, 0.06, 0.2, 0.5)
"""Of an input's span: half widths of play, lengths over which a hysteresis turns."""
_LAGGED = (
    "motor_speed_rad_s",
    "abs_motor_speed_rad_s",
    "abs_motor_torque_nm",
    "abs_rack_force_n",
    "abs_torque_sensor_nm",
)
_HEATED = ("motor_torque_nm", "motor_speed_rad_s")
_WAYED = ("motor_angle_rad", "rack_force_n", "motor_torque_nm", "torque_sensor_nm")
_FADING = ("exponential", "saturating", "rational")
_AMOUNTS = ("abs_motor_speed_rad_s", "abs_motor_torque_nm", "abs_rack_force_n")
"""With which the strength of a sine may fade."""
PLACES = (
    ("rotor", "sum"),
    ("friction", "sum"),
    ("friction", "factor"),
    ("motor", "sum"),
    ("motor", "factor"),
    ("load", "factor"),
    ("torsion_bar", "factor"),
)
"""Where and how a torque may act, as ``Sight.places`` has it."""
_BASES: Mapping[tuple[str, str], tuple[tuple[str, str], ...]] = {
    ("rotor", "sum"): (
        ("motor_speed_rad_s", "linear"),
        ("motor_speed_rad_s", "square"),
        ("rack_force_n", "linear"),
        ("torque_sensor_nm", "linear"),
    ),
    ("friction", "sum"): (
        ("abs_motor_speed_rad_s", "linear"),
        ("abs_rack_force_n", "linear"),
        ("abs_motor_torque_nm", "linear"),
        ("abs_torque_sensor_nm", "linear"),
    ),
}
"""Second inputs beside a place's own."""


@dataclass(frozen=True)
class Input:
    """One factor of a law: an input, its memory, its shape and their numbers."""

    name: str
    shape: str
    memory: str = "none"
    numbers: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Law:
    """A law of the grammar; ``size`` as fitted to the column of its place."""

    where: str
    how: str
    inputs: tuple[Input, ...]
    size: float = 0.0

    @property
    def price(self) -> float:
        """Share of its gain that a law has to be better by than the simplest one."""
        memory = sum(one.memory != "none" for one in self.inputs)
        numbers = sum(len(one.numbers) for one in self.inputs)
        return 0.02 * (len(self.inputs) - 1) + 0.01 * memory + 0.004 * numbers

    @property
    def of_time(self) -> bool:
        """Whether it depends on the time since a recording began, which is no state of a rig."""
        return any(one.name == "time_s" for one in self.inputs)

    @property
    def family(self) -> tuple[Any, ...]:
        """What makes it another law than one with other numbers or shapes."""
        return (self.where, self.how, *((one.name, one.memory) for one in self.inputs))

    def entry(self, ranges: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
        """The law as a model file holds it (``effects/empirical.py``)."""
        dynamic = any(one.memory != "none" or one.name == "since_reversal_s" for one in self.inputs)
        found: dict[str, Any] = {
            "effect": "empirical",
            "form": "dynamic" if dynamic else "law",
            "where": self.where,
            "how": self.how,
            "inputs": [one.name for one in self.inputs],
            "memory": [one.memory for one in self.inputs],
            "shapes": [one.shape for one in self.inputs],
            "size": self.size,
        }
        for i, one in enumerate(self.inputs, 1):
            found |= {f"{name}_{i}": value for name, value in one.numbers.items()}
        seen = {
            one.name: list(ranges[one.name])
            for one in self.inputs
            if one.name in ranges and one.shape != "sine"
        }
        return found | ({"range": seen} if seen else {})

    def with_numbers(self, numbers: Mapping[tuple[int, str], float]) -> "Law":
        """The same with other numbers, by (input, name)."""
        inputs = tuple(
            replace(
                one,
                numbers={n: numbers.get((i, n), value) for n, value in one.numbers.items()},
            )
            for i, one in enumerate(self.inputs)
        )
        return replace(self, inputs=inputs)


def laws(sight: Sight, left: Floats) -> Iterator[list[Law]]:
    """All laws; orders are looked for in ``left`` (n,), Nm.

    In groups of what they depend on, so that nothing has to be kept for the next one.
    """
    bases = {
        place: [Input(*one) for one in _BASES.get(place, ()) if one[0] in sight.inputs]
        for place in sight.places
    }
    for factors in _factors(sight):
        group = []
        for (where, how), before in bases.items():
            group += [
                Law(where, how, (one,)) for one in factors if not _says_nothing(where, how, one)
            ]
            group += [
                Law(where, how, (base, one))
                for base in before
                for one in factors
                if not (one.name == base.name and one.shape in ("linear", "square"))
            ]
        yield group
    # the same everywhere: rotor against rack may know that no ratio is off
    group = [Law(*place, (Input("rack_force_n", "one"),)) for place in bases if place[0] == "load"]
    for (where, how), before in bases.items():
        group += [
            Law(where, how, (one,)) for one in before if (where, one.shape) != ("rotor", "linear")
        ]
    yield group
    for (where, how), before in bases.items():
        if where in ("rotor", "motor"):
            yield _waves(sight, left, Law(where, how, ()))
        if where == "rotor":
            for base in before:
                yield _waves(sight, left, Law(where, how, (base,)))


def rank(law: Law) -> tuple[int, int]:
    """Of laws that do as well: those of an earlier place first, then those of an earlier base.

    Torque times speed is speed times torque.
    """
    place = law.where, law.how
    bases = [Input(*one) for one in _BASES.get(place, ())]
    own = len(law.inputs) > 1 and law.inputs[0] in bases
    return PLACES.index(place), 1 + bases.index(law.inputs[0]) if own else 0


def _says_nothing(where: str, how: str, one: Input) -> bool:
    """What the baseline's own numbers are, or what is the same as at another place."""
    if one.name in SIGNS and where != "friction":  # |T| times it is friction
        return True
    if where == "friction" and how == "sum" and one.memory == "none":
        return one.shape == "linear" and one.name in ("motor_speed_rad_s", "motor_angle_rad")
    return where == "motor" and how == "sum" and "torque" not in one.name


def _factors(sight: Sight) -> Iterator[list[Input]]:
    """Every input, remembered or not, through every shape."""
    use = sight.use
    for name, values in sight.inputs.items():
        if name in SIGNS:
            yield [
                Input(name, "linear"),
                Input(name, "above", numbers={"centre": 0.0}),
                Input(name, "below", numbers={"centre": 0.0}),
            ]
            continue
        shapes = [*_shapes(values[use])]
        if name == "since_reversal_s":  # anything else is a place in the programme, not a memory
            shapes = [one for one in shapes if one[0] in _FADING]
        if name == "motor_angle_rad":
            shapes = [one for one in shapes if one[0] in ("linear", "square")]
        yield [Input(name, shape, numbers=numbers) for shape, numbers in shapes]
    for name, memory, number in _memories(sight):
        values = sight.remembered(name, memory, number)
        if np.ptp(values[use]) < 1e-9:
            continue
        own = {"memory": number}
        found = [Input(name, "linear", memory, own)]
        if memory in ("lag", "heat", "play"):
            few = [one for one in _shapes(values[use]) if one[0] in ("saturating", "exponential")]
            found += [Input(name, shape, memory, {**own, **numbers}) for shape, numbers in few[:3]]
        yield found


def _memories(sight: Sight) -> Iterator[tuple[str, str, float]]:
    rows = sight.inputs
    for name in _LAGGED:
        yield from ((name, "lag", t) for t in _LAGS_S if name in rows and t < sight.longest_s)
    for name in _HEATED:
        yield from ((name, "heat", t) for t in _HEATS_S if name in rows and t < sight.longest_s)
    for name in _WAYED:
        if name not in rows:
            continue
        span = float(np.ptp(np.percentile(rows[name][sight.use], [2, 98])))
        for share in _WAYS:
            yield name, "stop", share * span
            yield name, "hysteresis", share * span


def _shapes(values: Floats) -> Iterator[tuple[str, dict[str, float]]]:
    """Shapes with starting numbers that between them cover what values (k,) do."""
    low, q1, middle, q3, high = np.percentile(values, [2, 25, 50, 75, 98]).tolist()
    span = max(high - low, 1e-9)
    yield "linear", {}
    yield "square", {}
    far = max(abs(low), abs(high))
    for share in (0.05, 0.2, 0.6):
        yield "saturating", {"width": share * far}
        yield "rational", {"width": share * far}
    for centre in (q1, middle, q3):
        yield "above", {"centre": centre}
        yield "below", {"centre": centre}
        for share in (0.03, 0.15):  # at once, or over a good part of the range
            yield "step", {"centre": centre, "width": share * span}
    for centre in (low, q1, middle, q3, high):
        for share in (0.1, 0.3):
            yield "gaussian", {"centre": centre, "width": share * span}
    if low < 0.0 < high:
        for share in (0.05, 0.15):
            yield "gaussian", {"centre": 0.0, "width": share * span}
    for share in (0.1, 0.3, 1.0):
        yield "exponential", {"centre": low, "width": share * span}


_SHAPED: Mapping[str, Callable[[Floats, float, float], Any]] = {
    "one": lambda x, _c, _w: np.ones_like(x),
    "linear": lambda x, _c, _w: x,
    "square": lambda x, _c, _w: x * x,
    "saturating": lambda x, _c, w: np.tanh(x / w),
    "above": lambda x, c, _w: np.maximum(x - c, 0.0),
    "below": lambda x, c, _w: np.maximum(c - x, 0.0),
    "gaussian": lambda x, c, w: np.exp(-np.minimum(((x - c) / w) ** 2, 60.0)),
    "exponential": lambda x, c, w: np.exp(np.clip(-(x - c) / w, -60.0, 20.0)),
    "step": lambda x, c, w: 1.0 / (1.0 + np.exp(-np.clip((x - c) / w, -40.0, 40.0))),
    "rational": lambda x, _c, w: 1.0 / (1.0 + (x / w) ** 2),
}


def shaped(x: Floats, shape: str, numbers: Mapping[str, float]) -> Floats:
    """The shapes of ``empirical.py`` over (n,) values, but for waves, whose phase is open."""
    return np.asarray(_SHAPED[shape](x, numbers.get("centre", 0.0), numbers.get("width", 1.0)))


def columns_of(law: Law, sight: Sight) -> Floats | None:
    """What a law of size one does to the residual (Nm) at ``sight.rows``, (k, 1).

    (k, 2) for the quadratures of a wave; None if the recordings lack an input.
    """
    rows = rows_of(law, sight)
    return None if rows is None else np.ascontiguousarray(rows.T)


def rows_of(law: Law, sight: Sight) -> Floats | None:
    """The same lying down: (1, k), or (2, k)."""
    place = sight.places.get((law.where, law.how))
    if place is None or any(one.name not in sight.inputs for one in law.inputs):
        return None
    row, wave = sight.once((law.where, law.how), lambda: place.effect[sight.rows]), None
    for one in law.inputs:
        if one.shape == "sine":
            angle = sight.inputs[one.name][sight.rows]
            wave = one.numbers["order"] * angle
            rate = one.numbers["order"] * sight.inputs["abs_motor_speed_rad_s"][sight.rows]
            row = row * np.clip(1.5 - rate / (2 * np.pi * _FILTER_HZ), 0.0, 1.0)
            continue
        key = (one.name, one.memory, one.shape, *one.numbers.items())
        lasts = not one.numbers  # a base, or as cheap
        row = row * sight.once(key, partial(_at, one, sight), lasts=lasts)
    if wave is None:
        return row[None, :]
    return np.stack([np.sin(wave), np.cos(wave)]) * row


def _at(one: Input, sight: Sight) -> Floats:
    values = sight.remembered(one.name, one.memory, one.numbers.get("memory", 1.0))
    return shaped(values[sight.rows], one.shape, one.numbers)


def _waves(sight: Sight, left: Floats, law: Law) -> list[Law]:
    """``law`` times sines of the rotor's angle at the orders that stand out of what is left.

    Where it has no second input of its own, also sines that are strong in one part of the travel
    only, or whose strength fades with an amount.
    """
    own = columns_of(law, sight)
    if "motor_angle_rad" not in sight.inputs or own is None:
        return []
    kinds = [] if law.inputs else [_stretches(sight), _fading(sight)]
    alone = [(k, replace(law, inputs=(one,))) for k, kind in enumerate(kinds) for one in kind]
    power = _spectrum(sight, left, [own, *(columns_of(one, sight) for _, one in alone)])
    found = [_with_sine(law, order) for order, _ in _peaks(power[0])]
    for kind in range(len(kinds)):
        local = [
            (worth, _with_sine(one, order))
            for (of, one), seen in zip(alone, power[1:], strict=True)
            for order, worth in (_peaks(seen) if of == kind else ())
        ]
        found += [one for _, one in sorted(local, key=lambda pair: -pair[0])[:MOST_LOCAL]]
    return found


def _stretches(sight: Sight) -> list[Input]:
    """Parts of the travel, as many and as wide as between them hold any place on it."""
    if "rack_position_m" not in sight.inputs:
        return []
    low, high = np.percentile(sight.inputs["rack_position_m"][sight.rows], [2, 98]).tolist()
    return [
        Input(
            "rack_position_m",
            "gaussian",
            numbers={"centre": low + at * (high - low), "width": width * (high - low)},
        )
        for width, centres in ((0.1, (0.1, 0.3, 0.5, 0.7, 0.9)), (0.25, (0.2, 0.5, 0.8)))
        for at in centres
    ]


def _fading(sight: Sight) -> list[Input]:
    """Strengths that fade with an amount, soon or late."""
    found = []
    for name in _AMOUNTS:
        if name in sight.inputs:
            low, high = np.percentile(sight.inputs[name][sight.rows], [2, 98]).tolist()
            found += [
                Input(name, "exponential", numbers={"centre": low, "width": share * (high - low)})
                for share in (0.05, 0.15, 0.45)
                if high > low
            ]
    return found


def _spectrum(sight: Sight, left: Floats, effects: Sequence[Floats | None]) -> Floats:
    """Energy of ``left`` (n,) that a sine of each order times each effect takes, (k, orders)."""
    rows = sight.rows
    rate = sight.inputs["abs_motor_speed_rad_s"][rows]
    by_rate = np.argsort(rate, kind="stable")  # what is slow enough for an order comes first
    rate, rows = rate[by_rate], rows[by_rate]
    angle = sight.inputs["motor_angle_rad"][rows]
    columns = [np.zeros(len(rows)) if one is None else one[by_rate, 0] for one in effects]
    scaled = np.column_stack(columns) / sight.scale[rows, None]
    seen = scaled * (left[rows] / sight.scale[rows])[:, None]
    norms = np.cumsum(scaled**2, axis=0)
    step = np.exp(-1j * _BETWEEN * (angle - np.mean(angle)))
    wave = np.ones(len(rows), complex)
    power = np.zeros((len(columns), len(ORDERS)))
    for k, slow in enumerate(np.searchsorted(rate, 2 * np.pi * _FILTER_HZ / ORDERS).tolist()):
        if slow <= _FEWEST:
            break
        wave[:slow] *= step[:slow]  # the exponential of one order more
        parts = wave[:slow].view(np.float64).reshape(-1, 2).T @ seen[:slow]
        norm = norms[slow - 1]
        power[:, k] = np.sum(parts**2, axis=0) / np.maximum(norm, 1e-300) * (norm > 0.0)
    return power


def _peaks(power: Floats) -> list[tuple[float, float]]:
    """The highest peaks of a spectrum over ``ORDERS`` that stand apart: (order, energy)."""
    found: list[tuple[float, float]] = []
    for k in np.argsort(-power):
        order = float(ORDERS[k])
        if len(found) == MOST_ORDERS or power[k] <= 0.0:
            break
        if all(abs(order - other) > _APART * max(order, 1.0) for other, _ in found):
            found.append((order, float(power[k])))
    return found


def _with_sine(law: Law, order: float) -> Law:
    sine = Input("motor_angle_rad", "sine", numbers={"order": order, "phase": 0.0})
    return replace(law, inputs=(*law.inputs, sine))
