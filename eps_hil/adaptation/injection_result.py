"""What a torque injection found: repetitions, levels of both directions, and what is doubtful."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eps_hil.adaptation.unknown_force import NOT_SEEN, Shift, shift_of
from eps_hil.estimation.levels import FrictionLevels
from eps_hil.physics.model import Model

Seen = Literal["speed", "driver_torque"]

_NORMAL_MAD = 1.4826
_OUTLIER_SIGMA = 4.0
_DRIFT_SIGMA = 4.0
_LEAST_RISE = 0.05
"""Share of the level that a rise along the slide must reach to be worth a word."""
LEAST_LENGTHS = 2.0
"""A slide shorter than this many presliding lengths T_fs/σ0 says too little about the level."""


@dataclass(frozen=True, slots=True)
class Repetition:
    """One ramp of one direction (+1 or −1).

    ``offset_nm`` is k0 of this slide; ``detection_nm`` the uncorrected torque |T_1m| at detection,
    what the paper takes; ``seen``: how break-away showed; ``lengths``: ``travel_rad`` in
    presliding lengths; ``drift_nm_per_rad``: how the level rose along the way, with its error;
    ``form_nm``: how far k0 depends on the form of presliding friction; ``bent_rad``: the presliding
    length that the ramp showed (NaN: none).
    """

    number: int
    direction: int
    offset_nm: float
    standard_error_nm: float
    detection_nm: float
    seen: Seen
    lengths: float
    travel_rad: float
    drift_nm_per_rad: float
    drift_error_nm_per_rad: float
    form_nm: float = 0.0
    bent_rad: float = math.nan
    outlier: bool = False


@dataclass(frozen=True, slots=True)
class Level:
    """k0 of one direction (Nm, at the rotor) with its 95 % interval over the repetitions."""

    offset_nm: float
    ci95_nm: tuple[float, float]
    repetitions: int
    outliers: tuple[int, ...]
    """Numbers of the repetitions that were left out."""
    seen: tuple[Seen, ...]


@dataclass(frozen=True, slots=True)
class InjectionResult:
    """Both levels, every repetition, and what speaks against believing them.

    ``sum_nm`` holds at (nearly) any rack force; ``asymmetry_nm`` (k0+ − k0−) only if the rack force
    was zero: a force F changes it by 2 F/i_APA (``shift``). Nothing is ever applied by this class.
    """

    positive: Level
    negative: Level
    repetitions: tuple[Repetition, ...]
    problems: tuple[str, ...]
    shift: Shift = NOT_SEEN
    """What presliding says of a force that was there all the same."""

    @property
    def accepted(self) -> bool:
        """Whether nothing speaks against the levels."""
        return not self.problems

    @property
    def sum_nm(self) -> float:
        """k0+ + k0−."""
        return self.positive.offset_nm + self.negative.offset_nm

    @property
    def asymmetry_nm(self) -> float:
        """k0+ − k0−."""
        return self.positive.offset_nm - self.negative.offset_nm


def student_t95(freedom: int) -> float:
    """Two-sided 95 % point of Student's t."""
    table = (math.inf, 12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)
    if freedom < len(table):
        return table[max(freedom, 0)]
    z = 1.95996
    return z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)


def mark_outliers(repetitions: Sequence[Repetition], share: float) -> list[Repetition]:
    """The same repetitions (of one direction), those marked that lie apart from the others."""
    from dataclasses import replace

    values = np.array([one.offset_nm for one in repetitions])
    middle = float(np.median(values))
    scatter = _NORMAL_MAD * float(np.median(np.abs(values - middle)))
    errors = np.array([one.standard_error_nm for one in repetitions])
    apart = np.abs(values - middle)
    bad = (apart > share * middle) & (apart > _OUTLIER_SIGMA * np.hypot(scatter, errors))
    return [replace(one, outlier=bool(o)) for one, o in zip(repetitions, bad, strict=True)]


def level_of(repetitions: Sequence[Repetition]) -> Level:
    """Mean and interval of the repetitions of one direction, outliers left out.

    The scatter between repetitions gives the interval (Student's t); it is never taken narrower
    than the repetitions' own errors allow. With one repetition there is only its own error. What
    the form of friction may do is common to all repetitions, so it does not average out; the truth
    lies anywhere within ± ``form_nm`` (95 % of a uniform distribution).
    """
    kept = [one for one in repetitions if not one.outlier]
    values = np.array([one.offset_nm for one in kept])
    n = len(values)
    own = math.sqrt(sum(one.standard_error_nm**2 for one in kept)) / n
    half = 1.96 * own
    if n > 1:
        half = max(half, student_t95(n - 1) * float(np.std(values, ddof=1)) / math.sqrt(n))
    half = math.hypot(half, 0.95 * float(np.mean([one.form_nm for one in kept])))
    mean = float(np.mean(values))
    return Level(
        mean,
        (mean - half, mean + half),
        n,
        tuple(one.number for one in repetitions if one.outlier),
        tuple(one.seen for one in repetitions),
    )


def result_of(
    repetitions: Sequence[Repetition], outlier_share: float, model: Model
) -> InjectionResult:
    """The result of a complete run: at least one repetition of each direction."""
    both = [
        mark_outliers([one for one in repetitions if one.direction == sign], outlier_share)
        for sign in (1, -1)
    ]
    marked = tuple(sorted([*both[0], *both[1]], key=lambda one: one.number))
    positive, negative = (level_of(part) for part in both)
    problems = [*_doubts("positive", both[0]), *_doubts("negative", both[1])]
    problems += _spring(marked)
    forth, back = ([one.bent_rad for one in part if not one.outlier] for part in both)
    found = FrictionLevels(positive.offset_nm, negative.offset_nm)
    shift = shift_of(found, forth, back, model.friction.sigma0_nm_per_rad)
    problems += _unknown_force(shift, positive, negative, model)
    return InjectionResult(positive, negative, marked, tuple(problems), shift)


def _unknown_force(shift: Shift, positive: Level, negative: Level, model: Model) -> list[str]:
    if not shift.matters(0.5 * (positive.offset_nm + negative.offset_nm)):
        return []
    force, error = (model.rack_to_rotor_ratio_rad_per_m * x for x in shift)
    return [
        f"the way before sliding says that a rack force of about {force:.0f} N"
        f" (95 %: +- {1.96 * error:.0f} N) was there: without it k0+ would be"
        f" {positive.offset_nm - shift.torque_nm:.4f} and k0-"
        f" {negative.offset_nm + shift.torque_nm:.4f} Nm"
    ]


def _doubts(name: str, part: Sequence[Repetition]) -> list[str]:
    said = []
    outliers = [one for one in part if one.outlier]
    if 3 * len(outliers) > len(part):
        numbers = ", ".join(str(one.number) for one in outliers)
        said.append(f"{name}: {len(outliers)} of {len(part)} repetitions lie apart ({numbers})")
    short = [one for one in part if one.lengths < LEAST_LENGTHS]
    if short:
        numbers = ", ".join(str(one.number) for one in short)
        said.append(f"{name}: the slide was too short in repetition {numbers}")
    if len({one.seen for one in part}) > 1:
        said.append(f"{name}: hands on and hands off in one run")
    return said


def _spring(repetitions: Sequence[Repetition]) -> list[str]:
    """Whether the level rose along the way in both directions: then the rack is not free."""
    kept = [one for one in repetitions if not one.outlier and one.drift_error_nm_per_rad > 0]
    if not kept:
        return []
    weights = np.array([one.drift_error_nm_per_rad**-2 for one in kept])
    drifts = np.array([one.drift_nm_per_rad for one in kept])
    mean = float(weights @ drifts / weights.sum())
    spread = float(np.std(drifts, ddof=1)) / math.sqrt(len(kept)) if len(kept) > 1 else math.inf
    error = max(float(weights.sum()) ** -0.5, spread)
    rise = mean * float(np.median([one.travel_rad for one in kept]))
    level = float(np.mean([one.offset_nm for one in kept]))
    if abs(mean) < _DRIFT_SIGMA * error or abs(rise) < _LEAST_RISE * level:
        return []
    return [
        f"the torque changes by {rise * 1e3:.1f} mNm along the slide: the rack pushes back like a"
        f" spring of {mean:.3g} Nm/rad, so the rack force was not zero"
    ]
