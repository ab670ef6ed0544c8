"""Manoeuvres: what rig, driver and EPS motor do, as YAML files of segments (configs/manoeuvres).

A file is turned into one table of set-points at 1 kHz before anything runs; the plant
interpolates between its rows, so a load never moves in steps of a millisecond.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, ConfigDict, Field, with_config

from eps_hil import yaml_file
from eps_hil.errors import InputError
from eps_hil.examples import CONFIGS
from eps_hil.physics import chain as columns
from eps_hil.rig.profile import ZERO, Finite, NotNegative, Positive, Profile, constant, points

Floats = npt.NDArray[np.float64]

# Columns of the set-point table after those of the chain.
(
    MOTOR_TORQUE,  # Nm
    MOTOR_STIFFNESS,  # Nm/rad
    MOTOR_DAMPING,  # Nms/rad
    MOTOR_CENTRE,  # rad
    PRELOAD_COMPENSATION,  # share of the programmed rack force that the motor carries
    ASSIST_GAIN,  # Nm at the rotor per Nm of torsion-bar torque
    VEHICLE_SPEED,
    LATERAL_ACCELERATION,
    YAW_RATE,
) = range(columns.INPUTS, columns.INPUTS + 9)
COLUMNS = columns.INPUTS + 9

ROWS_PER_S = 1000
FOLDER = CONFIGS / "manoeuvres"

_STRICT = ConfigDict(extra="forbid")


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Rig:
    """The linear motor as a spring-damper about a position, beside its force profile."""

    stiffness_n_per_m: NotNegative = 0.0
    damping_n_s_per_m: NotNegative = 0.0
    position_m: Profile = ZERO


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Driver:
    """Driver or steering robot: a torque, and a spring-damper about an angle (or its rate).

    ``speed_rad_s`` is integrated into the angle, which carries on from segment to segment: a
    stiff spring-damper on it is a robot that holds a constant speed. All zero: hands off.
    """

    torque_nm: Profile = ZERO
    angle_rad: Profile = ZERO
    speed_rad_s: Profile = ZERO
    stiffness_nm_per_rad: NotNegative = 0.0
    damping_nm_s_per_rad: NotNegative = 0.0


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Motor:
    """What the ECU asks of the EPS motor: T_em = torque − c (φ − φ0) − d ω + preload + assist."""

    torque_nm: Profile = ZERO
    stiffness_nm_per_rad: NotNegative = 0.0
    damping_nm_s_per_rad: NotNegative = 0.0
    centre_rad: Finite = 0.0
    preload_compensation: Annotated[float, Field(ge=0, le=1)] = 0.0
    assist_nm_per_nm: NotNegative = 0.0


def _hands_off(content: Any) -> Any:
    return {} if content == "hands_off" else content


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class ConstantSpeedGrid:
    """The paper's friction identification: every speed, both ways, at every preload.

    The robot turns the wheel by ±``travel_rad`` at each speed while the linear motor holds the
    preload, which is changed over ``change_s`` with the wheel at rest.
    """

    wheel_speeds_rad_s: Annotated[tuple[Positive, ...], Field(min_length=1)]
    preloads_n: Annotated[tuple[Finite, ...], Field(min_length=1)]
    travel_rad: Positive = 2.0
    change_s: Positive = 1.0
    turn_s: Positive = 0.2


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of time; what is not given is zero."""

    duration_s: Annotated[float, Field(gt=0, le=3600)] | None = None
    rack_force_n: Profile = ZERO
    rig: Rig = field(default_factory=Rig)
    driver: Annotated[
        Driver,
        BeforeValidator(_hands_off, json_schema_input_type=Driver | Literal["hands_off"]),
    ] = field(default_factory=Driver)
    motor: Motor = field(default_factory=Motor)
    vehicle_speed_m_s: Profile = ZERO
    lateral_acceleration_m_s2: Profile = ZERO
    yaw_rate_rad_s: Profile = ZERO
    constant_speed_grid: ConstantSpeedGrid | None = None
    repeat: Annotated[int, Field(ge=1, le=1000)] = 1


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """A named sequence of segments; ``seed`` fixes the phases of multisines."""

    name: str
    segments: Annotated[tuple[Segment, ...], Field(min_length=1)]
    description: str = ""
    seed: int = 0

    @property
    def duration_s(self) -> float:
        """Length of the whole sequence in seconds (whole milliseconds)."""
        return sum(_rows(piece) for piece in self._pieces()) / ROWS_PER_S

    def table(self) -> Floats:
        """Set-points at 1 kHz, shape (milliseconds + 1, COLUMNS); the last row ends the run."""
        hand_angle, parts = 0.0, []
        for number, piece in enumerate(self._pieces()):
            rows, hand_angle = _sample(piece, hand_angle, self.seed + number)
            parts.append(rows)
        return np.concatenate([*parts, parts[-1][-1:]])

    def _pieces(self) -> list[Segment]:
        pieces: list[Segment] = []
        for segment in self.segments:
            one = [segment] if segment.constant_speed_grid is None else _grid(segment)
            pieces += one * segment.repeat
        return pieces


def load_manoeuvre(path_or_name: str | Path) -> Manoeuvre:
    """A manoeuvre by name (configs/manoeuvres/NAME.yaml) or by file.

    :class:`InputError` names file and field, or the known names.
    """
    path = Path(path_or_name)
    if path.suffix not in {".yaml", ".yml"} and not path.exists():
        named = FOLDER / f"{path_or_name}.yaml"
        if not named.exists():
            known = ", ".join(manoeuvre_names())
            raise InputError(
                path_or_name, "", "no such manoeuvre", f"give a YAML file or one of: {known}"
            )
        path = named
    manoeuvre = yaml_file.load(path, Manoeuvre, section="manoeuvre")
    for number, segment in enumerate(manoeuvre.segments):
        place = f"manoeuvre.segments.{number}.duration_s"
        if segment.constant_speed_grid is None and segment.duration_s is None:
            raise InputError(path, place, "is missing", "give the segment's length in seconds")
        if segment.constant_speed_grid is not None and segment.duration_s is not None:
            raise InputError(path, place, "follows from the speeds of the grid", "leave it out")
        if segment.duration_s is not None and segment.duration_s * ROWS_PER_S < 1:
            raise InputError(path, place, "is shorter than a millisecond", "use at least 0.001")
    return manoeuvre


def manoeuvre_names() -> tuple[str, ...]:
    """Names that :func:`load_manoeuvre` knows."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.yaml")))


def _rows(segment: Segment) -> int:
    assert segment.duration_s is not None
    return max(1, round(segment.duration_s * ROWS_PER_S))


def _sample(segment: Segment, hand_angle: float, seed: int) -> tuple[Floats, float]:
    """Rows of one segment, and the robot's angle after it."""
    n = _rows(segment)
    time_s, duration_s = np.arange(n) / ROWS_PER_S, n / ROWS_PER_S
    table = np.zeros((n, COLUMNS))

    def put(column: int, profile: Any) -> None:
        table[:, column] = profile.values(time_s, duration_s, seed)

    put(columns.LOAD_FORCE, segment.rack_force_n)
    table[:, columns.LOAD_STIFFNESS] = segment.rig.stiffness_n_per_m
    table[:, columns.LOAD_DAMPING] = segment.rig.damping_n_s_per_m
    put(columns.LOAD_POSITION, segment.rig.position_m)
    driver, motor = segment.driver, segment.motor
    put(columns.HAND_TORQUE, driver.torque_nm)
    table[:, columns.HAND_STIFFNESS] = driver.stiffness_nm_per_rad
    table[:, columns.HAND_DAMPING] = driver.damping_nm_s_per_rad
    put(columns.HAND_ANGLE, driver.angle_rad)
    speed = driver.speed_rad_s.values(time_s, duration_s, seed)
    turned = np.concatenate([[0.0], np.cumsum(speed) / ROWS_PER_S])
    table[:, columns.HAND_ANGLE] += hand_angle + turned[:-1]
    put(MOTOR_TORQUE, motor.torque_nm)
    table[:, MOTOR_STIFFNESS] = motor.stiffness_nm_per_rad
    table[:, MOTOR_DAMPING] = motor.damping_nm_s_per_rad
    table[:, MOTOR_CENTRE] = motor.centre_rad
    table[:, PRELOAD_COMPENSATION] = motor.preload_compensation
    table[:, ASSIST_GAIN] = motor.assist_nm_per_nm
    put(VEHICLE_SPEED, segment.vehicle_speed_m_s)
    put(LATERAL_ACCELERATION, segment.lateral_acceleration_m_s2)
    put(YAW_RATE, segment.yaw_rate_rad_s)
    return table, hand_angle + float(turned[-1])


def _grid(segment: Segment) -> list[Segment]:
    """The grid written out: to each preload, then half a way out, one back, half one out."""
    grid = segment.constant_speed_grid
    assert grid is not None
    plain = replace(segment, constant_speed_grid=None, repeat=1)
    pieces: list[Segment] = []

    def change(before: float, after: float) -> None:
        ramp = points((0.0, before), (grid.change_s, after))
        pieces.append(replace(plain, duration_s=grid.change_s, rack_force_n=ramp))

    preload = 0.0
    for target in grid.preloads_n:
        change(preload, target)
        preload = target
        for speed in grid.wheel_speeds_rad_s:
            for share in (0.5, -1.0, 0.5):
                pieces.append(_pass(plain, grid, constant(target), speed, share))
    change(preload, 0.0)
    return pieces


def _pass(
    plain: Segment, grid: ConstantSpeedGrid, load: Any, speed: float, share: float
) -> Segment:
    """One constant-speed stretch over ``share`` of twice the travel, with ramps of ``turn_s``."""
    way = abs(share) * 2.0 * grid.travel_rad
    # Ramps up and down together cover speed·turn_s; a pass too short for them is all ramp.
    turn_s = min(grid.turn_s, way / speed)
    hold_s = way / speed - turn_s
    signed = speed if share > 0 else -speed
    shape = points(
        (0.0, 0.0), (turn_s, signed), (turn_s + hold_s, signed), (2 * turn_s + hold_s, 0.0)
    )
    return replace(
        plain,
        duration_s=2 * turn_s + hold_s,
        rack_force_n=load,
        driver=replace(plain.driver, speed_rad_s=shape),
    )
