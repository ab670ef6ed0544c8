"""What a search for a law is given: residual, inputs and where a torque can act, sample by sample.

Everything is at the thinned samples of the torque balance that slide; memory (lags, heat, ways) is
run over all of them. Screening works on these; what it finds is refined by the simulator itself.
"""

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.diagnosis.balance.problem import Problem, huber, knee
from eps_hil.diagnosis.data.prepare import STEP_S, THIN
from eps_hil.physics.empirical_entry import MEMORIES
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

STEP = THIN * STEP_S
"""Between thinned samples, s."""
TURNING_RAD_S = 0.5
_SIGNALS = ("torque_sensor_nm", "rack_force_n")
_OF_MOTOR = (
    "motor_torque_nm",
    "abs_motor_torque_nm",
    "motor_power_sign",
    "motor_power_w",
    "abs_motor_power_w",
)


@dataclass(frozen=True)
class Place:
    """Where a torque may act: what one Nm (or, ``how`` a factor, a change of 1) does there."""

    where: str
    how: str
    effect: Floats
    """Change of the residual (Nm), (n,), per unit."""


class Sight:
    """One problem under one model: (n,) arrays over all thinned samples of all recordings."""

    def __init__(self, problem: Problem, model: Model, *, referenced: bool = True) -> None:
        """``referenced``: whether anything but the motor's torque says what that is worth."""
        self.problem, self.model, self.referenced = problem, model, referenced
        self.residual = problem.residual(model)
        self.use = problem.sliding
        self.block = problem.block
        self.scale = problem.scale
        sizes = [len(one.thin_time_s) for one in problem.recordings]
        ends = np.cumsum([0, *sizes])
        self.parts = [slice(a, b) for a, b in pairwise(ends.tolist())]
        self._lasting: dict[Hashable, Floats] = {}
        self._passing: dict[Hashable, Floats] = {}

    @cached_property
    def longest_s(self) -> float:
        """Of the recordings: what fades more slowly is a clock, by another name."""
        return max(part.stop - part.start for part in self.parts) * STEP

    @cached_property
    def weight(self) -> Floats:
        """Roots of Huber's weights (n,): 0 where nothing slides."""
        return np.sqrt(np.where(self.use, huber(self.residual, knee(self.residual)), 0.0))

    @cached_property
    def rows(self) -> npt.NDArray[np.int64]:
        """Samples that screening looks at: every second that slides (the filter passes 40 Hz)."""
        return np.flatnonzero(self.use)[::2]

    def once(self, key: Hashable, made: Callable[[], Floats], *, lasts: bool = True) -> Floats:
        """What is worked out once for all laws that share it, or that do until :meth:`forget`."""
        values = self._lasting if lasts else self._passing
        found = values.get(key)
        if found is None:
            found = values[key] = made()
        return found

    def forget(self) -> None:
        """Let go of what does not last: of an hour, every shape of every input is a gigabyte."""
        self._passing.clear()

    @cached_property
    def inputs(self) -> Mapping[str, Floats]:
        """Every input that was recorded, by the names of ``effects/empirical.py``."""
        found: dict[str, list[Floats]] = {}
        there = [
            name
            for name in _SIGNALS
            if all(name in one.as_measured().raw for one in self.problem.recordings)
        ]
        for one in self.problem.recordings:
            motion = one.motion(self.model)
            columns = {
                "motor_speed_rad_s": motion.speed_rad_s,
                "motor_angle_rad": motion.angle_rad,
                "rack_position_m": motion.position_m,
                "motor_torque_nm": motion.motor_torque_nm,
                **{name: getattr(motion, name) for name in there},
            }
            for name, column in columns.items():
                found.setdefault(name, []).append(one.thin(column))
            found.setdefault("time_s", []).append(one.thin_time_s)
        rows = {name: np.concatenate(parts) for name, parts in found.items()}
        speed = rows["motor_speed_rad_s"]
        rows["abs_motor_speed_rad_s"] = np.abs(speed)
        turning = speed / np.hypot(speed, TURNING_RAD_S)
        rows["motor_power_sign"] = np.sign(rows["motor_torque_nm"]) * turning
        rows["abs_motor_torque_nm"] = np.abs(rows["motor_torque_nm"])
        rows["motor_power_w"] = rows["motor_torque_nm"] * speed
        rows["abs_motor_power_w"] = np.abs(rows["motor_power_w"])
        for name in there:
            rows[f"abs_{name}"] = np.abs(rows[name])
        if "rack_force_n" in there:
            rows["load_power_sign"] = -np.sign(rows["rack_force_n"]) * turning
        if "torque_sensor_nm" in there:
            rows["torque_sensor_power_sign"] = np.sign(rows["torque_sensor_nm"]) * turning
        rows["since_reversal_s"] = np.concatenate([_since(speed[part]) for part in self.parts])
        unsure = () if self.referenced else _OF_MOTOR
        return {
            name: row
            for name, row in rows.items()
            if name not in unsure and np.ptp(row[self.use]) > 1e-9
        }

    def remembered(self, name: str, memory: str, number: float) -> Floats:
        """An input as a memory of ``empirical.py`` has it, (n,)."""
        if memory == "none":
            return self.inputs[name]

        def run() -> Floats:
            out = np.empty(len(self.residual))
            for part in self.parts:
                out[part] = _run(self.inputs[name][part], MEMORIES.index(memory), number, STEP)
            return out

        return self.once((name, memory, number), run, lasts=False)

    @cached_property
    def places(self) -> Mapping[tuple[str, str], Place]:
        """What acts where, by (where, how)."""
        rows, model = self.inputs, self.model
        one = np.ones(len(self.residual))
        direction = np.sign(rows["motor_speed_rad_s"])
        found = [
            Place("rotor", "sum", -one),
            Place("friction", "sum", -direction),
            Place("friction", "factor", -direction * self._level),
        ]
        if self.referenced:
            found.append(Place("motor", "sum", one))
            if "motor_torque_nm" in rows:  # one that never changes is no input
                found.append(Place("motor", "factor", rows["motor_torque_nm"]))
        if "rack_force_n" in rows:
            load = rows["rack_force_n"] / model.rack_to_rotor_ratio_rad_per_m
            found.append(Place("load", "factor", -load))
        if "torque_sensor_nm" in rows:
            hand = rows["torque_sensor_nm"] * model.sensor_to_rotor
            found.append(Place("torsion_bar", "factor", hand))
        return {(place.where, place.how): place for place in found}

    @cached_property
    def _level(self) -> Floats:
        from eps_hil.physics.balance import sliding_levels_nm

        return np.concatenate(
            [
                one.thin(sliding_levels_nm(self.model, one.motion(self.model)))
                for one in self.problem.recordings
            ]
        )


@njit
def _since(speed: Floats) -> Floats:
    out, since, last = np.empty(len(speed)), 0.0, 0.0
    for k in range(len(speed)):
        now = np.sign(speed[k])
        since += STEP
        if now not in (0.0, last):
            since, last = 0.0, now
        out[k] = since
    return out


@njit
def _run(x: Floats, memory: int, number: float, dt: float) -> Floats:
    """The memories of ``empirical.py`` over a sampled input; same equations, longer steps."""
    out = np.empty(len(x))
    held, before = x[0], x[0]
    if memory in (2, 5):
        held = 0.0
    for k in range(len(x)):
        if memory == 1:
            held -= (x[k] - held) * np.expm1(-dt / number)
        elif memory == 2:
            held -= (x[k] * x[k] - held) * np.expm1(-dt / number)
        elif memory == 5:
            way = x[k] - before
            held -= (np.sign(way) - held) * np.expm1(-abs(way) / number)
            before = x[k]
        else:
            held = min(max(held, x[k] - number), x[k] + number)
        out[k] = (x[k] - held) / number if memory == 4 else held
    return out
