"""Programme files (configs/programmes): which cells are run, how long, in which order."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, with_config

from eps_hil import yaml_file
from eps_hil.errors import InputError
from eps_hil.physics.model import Model

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class Plan:
    """Every speed in both directions at every preload, ``repetitions`` times.

    ``speeds_rad_s`` are at the rotor and positive. Each repetition is a block of all cells, in an
    order of its own (``random``, by ``seed``), so that warming up does not look like speed or load.
    A pass counts for ``run_s``, after ``settle_s`` plus the time for ``settle_rad`` of rotor: slow
    passes first have to wind up the torsion bar. The rack stays within ``rack_travel_m`` of its
    centre. ``sensor_torque_nm``: the torsion-bar torque that ends it (null: what preload and
    friction of the model make of it, with a margin). ``motor_share`` of earlier files is refused
    unless it is 0 (:func:`load_plan`).
    """

    name: str
    speeds_rad_s: Annotated[tuple[Positive, ...], Field(min_length=1)]
    preloads_n: Annotated[tuple[Finite, ...], Field(min_length=1)]
    description: str = ""
    repetitions: Annotated[int, Field(ge=1, le=100)] = 2
    order: Literal["random", "as_written"] = "random"
    seed: Annotated[int, Field(ge=0)] = 0
    run_s: Annotated[float, Field(gt=0.1, le=60)] = 1.0
    settle_s: Annotated[float, Field(ge=0, le=10)] = 0.4
    settle_rad: NotNegative = 2.0
    motor_share: Annotated[float, Field(ge=0, le=1)] = 0.0
    rack_travel_m: Annotated[float, Field(gt=0, le=0.1)] = 0.05
    attempts: Annotated[int, Field(ge=1, le=10)] = 3
    sensor_torque_nm: Annotated[float, Field(gt=0, le=100)] | None = None

    def settling_s(self, speed_rad_s: float) -> float:
        """Time at constant speed before a pass counts."""
        return self.settle_s + self.settle_rad / abs(speed_rad_s)

    def cells(self) -> list["PlannedCell"]:
        """All cells in the order in which they are run."""
        random = np.random.default_rng(self.seed)
        planned: list[PlannedCell] = []
        for repetition in range(1, self.repetitions + 1):
            block = [
                (sign * speed, preload)
                for preload in self.preloads_n
                for speed in self.speeds_rad_s
                for sign in (1.0, -1.0)
            ]
            places: Sequence[int] = range(len(block))
            if self.order == "random":
                places = random.permutation(len(block)).tolist()
            for place in places:
                planned.append(PlannedCell(len(planned) + 1, *block[place], repetition))
        return planned

    def content(self) -> dict[str, Any]:
        """JSON-ready; two plans with the same content are the same programme."""
        return {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in asdict(self).items()
            if value is not None
        }


@dataclass(frozen=True, slots=True)
class PlannedCell:
    """One pass: its place in the order, signed rotor speed, preload, repetition."""

    number: int
    speed_rad_s: float
    preload_n: float
    repetition: int

    @property
    def name(self) -> str:
        """Name of the cell's files."""
        return (
            f"cell_{self.number:03d}_{self.speed_rad_s:+g}rad_s_{self.preload_n:g}N"
            f"_r{self.repetition}"
        )


def load_plan(path: str | Path, model: Model) -> Plan:
    """Read a programme file; :class:`InputError` names line and field of the first mistake.

    A speed whose pass does not fit into the travel is refused, and so is a share of the preload for
    the EPS motor: that would be a torque which no guard has judged.
    """
    plan = yaml_file.load(path, Plan, section="programme")
    if plan.motor_share:
        raise InputError(
            path, "programme.motor_share",
            "asks for a torque of the EPS motor, and only an armed override commands one",
            "leave it out, and set the share at the rig (the simulated one: rig.motor_share)",
        )  # fmt: skip
    for name in ("speeds_rad_s", "preloads_n"):
        values = getattr(plan, name)
        if len(set(values)) != len(values):
            raise InputError(path, f"programme.{name}", "holds a value twice", "name each once")
    for speed in plan.speeds_rad_s:
        way = way_m(plan, speed, model)
        if way > 2.0 * plan.rack_travel_m:
            raise InputError(
                path,
                "programme.speeds_rad_s",
                f"a pass at {speed:g} rad/s takes {1e3 * way:.0f} mm of rack, rack_travel_m allows "
                f"{2e3 * plan.rack_travel_m:.0f} mm",
                "shorten run_s or settle_s, or raise rack_travel_m",
            )
    return plan


RAMP_S = 0.5
"""Allowed for speeding up and slowing down at both ends of a pass."""


def way_m(plan: Plan, speed_rad_s: float, model: Model) -> float:
    """Rack travel of one pass with its ramps."""
    seconds = plan.settling_s(speed_rad_s) + plan.run_s + RAMP_S
    return abs(speed_rad_s) * seconds / model.rack_to_rotor_ratio_rad_per_m
