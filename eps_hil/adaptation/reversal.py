"""Reversal adaptation: friction levels from every change of direction, in ordinary driving.

Each stretch of driving gives information on k0+ and k0− (reversal_fit.py); a recursive estimator
adds it up, forgets at the rate at which friction drifts, and knows what it does not know: without a
load cell only the sum of both levels is seen, and their difference stays as uncertain as it was. No
I/O, no clock; nothing is ever applied by this class. A stretch costs some milliseconds of
computing; for a loop that has no such time to spare it is done in slices (``sliced``).
"""

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field, with_config

from eps_hil.adaptation.aligned import Aligned
from eps_hil.adaptation.gates import InjectionInputs, NotNegative, Positive
from eps_hil.adaptation.reversal_fit import (
    Blocks,
    Evidence,
    Floats,
    Stretch,
    blocks_in_slices,
    evidence_in_slices,
    finished,
)
from eps_hil.estimation.levels import FrictionLevels
from eps_hil.physics.model import Model

_STEP_NS = 1_000_000
_ROUNDS = 3
_LEAST_FED = 0.5
"""Share of the friction's work, by the present levels, that the drive must do."""
_COMMON = 0.5
"""Correlation of both levels' errors: wear and warmth change them alike, tolerances do not."""
_LEAST_SUM, _MOST_SUM = 0.4, 2.5  # of the model's sum, for one stretch to be believed
_TIGHT, _LOOSE = 0.1, 5.0  # bounds of the levels, in the model's


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class ReversalSettings:
    """Settings of :class:`ReversalAdaptation`; speeds and torques at the rotor."""

    stretch_s: Annotated[float, Field(ge=1, le=20)] = 6.0
    """After how much driving its evidence is added up."""
    lead_s: Annotated[float, Field(ge=0.2, le=5)] = 0.5
    """Overlap that brings the bristle into its state."""
    spread: Annotated[float, Field(gt=0, le=1)] = 0.4
    """Standard deviation of unbelieved levels, as a share of the model's."""
    drift_per_sqrt_hour: NotNegative = 0.2
    """How fast friction wanders (random walk, as a share of the model's): the forgetting."""
    noise_nm: Positive = 1.5e-3
    """Least residual that a fit is believed to have."""
    outlier_sigma: Positive = 3.0
    """Stretches that disagree by more than this are taken with less weight."""
    confident_share: Positive = 0.05
    """Standard deviation of the sum, as a share of it, below which it is called confident."""
    flag_share: Positive = 0.05
    """Deviation of the sum from the model's that is worth a flag."""
    load_cell: bool = True
    """Use the rig's load cell where there is one; both levels are then seen."""


class ReversalState(NamedTuple):
    """What is known after some reversals.

    ``sum_std_nm`` and ``asymmetry_std_nm`` are standard deviations of k0+ + k0− and k0+ − k0−;
    ``asymmetry_known`` says whether the latter was seen at all. ``used``: reversals that counted;
    ``left_out``: stretches that did not (no reversal, or the road drove the rack and not the
    driver). ``flag``: a sentence where the model's levels should be looked at, else empty.
    """

    t_ns: int
    levels: FrictionLevels
    sum_std_nm: float
    asymmetry_std_nm: float
    used: int
    left_out: int
    confident: bool
    asymmetry_known: bool
    flag: str

    @property
    def sum_nm(self) -> float:
        """k0+ + k0−."""
        return self.levels.positive_nm + self.levels.negative_nm

    @property
    def asymmetry_nm(self) -> float:
        """k0+ − k0−."""
        return self.levels.positive_nm - self.levels.negative_nm


class LevelFilter:
    """Kalman filter over (k0+, k0−): a random walk, observed by each stretch's evidence."""

    def __init__(self, model: Model, settings: ReversalSettings) -> None:
        f = model.friction
        self.model_nm = np.array([f.offset_pos_nm, f.offset_neg_nm])
        self.levels_nm = self.model_nm.copy()
        self._settings = settings
        self.covariance = settings.spread**2 * self._alike()

    def _alike(self) -> Floats:
        """Covariance (2, 2) of levels that are off by a share of 1, partly in common."""
        alike = np.array([[1.0, _COMMON], [_COMMON, 1.0]])
        return np.asarray(alike * np.outer(self.model_nm, self.model_nm))

    def copy(self) -> tuple[Floats, Floats]:
        """Levels and covariance, for :meth:`restore`."""
        return self.levels_nm.copy(), self.covariance.copy()

    def restore(self, kept: tuple[Floats, Floats]) -> None:
        """Go back to what :meth:`copy` gave."""
        self.levels_nm, self.covariance = kept[0].copy(), kept[1].copy()

    def drift(self, seconds: float) -> None:
        """Let time pass; friction may have wandered, but no further than it spreads."""
        share = self._settings.drift_per_sqrt_hour * math.sqrt(seconds / 3600.0)
        self.covariance = self.covariance + share**2 * self._alike()
        most = (self._settings.spread * self.model_nm) ** 2
        shrink = np.sqrt(np.minimum(1.0, most / np.diag(self.covariance)))
        self.covariance = self.covariance * np.outer(shrink, shrink)

    def take(self, found: Evidence) -> bool:
        """Add one stretch; False where it disagreed and was taken with less weight."""
        weight = self._weight(found)
        before = np.linalg.inv(self.covariance)
        self.covariance = np.asarray(np.linalg.inv(before + weight * found.matrix), np.float64)
        pull = weight * found.pull + before @ (self.levels_nm - found.at_nm)
        moved = found.at_nm + self.covariance @ pull
        bounds = _TIGHT * self.model_nm, _LOOSE * self.model_nm
        self.levels_nm = np.asarray(np.clip(moved, *bounds), np.float64)
        return weight == 1.0

    def _weight(self, found: Evidence) -> float:
        """Less than 1 (Huber) where the best seen direction disagrees beyond its errors."""
        values, vectors = np.linalg.eigh(found.matrix)
        seen, best = float(values[-1]), vectors[:, -1]
        if seen <= 0.0:
            return 0.0
        off = float(best @ found.pull) / seen - float(best @ (self.levels_nm - found.at_nm))
        expected = math.sqrt(1.0 / seen + float(best @ self.covariance @ best))
        limit = self._settings.outlier_sigma * expected
        return 1.0 if abs(off) <= limit else limit / abs(off)


class ReversalAdaptation:
    """:meth:`step` per sample at 1 kHz of sample time; :attr:`state` is what is known so far.

    ``sliced``: a complete stretch is not evaluated at once but by :meth:`work`, slice by slice.
    """

    def __init__(self, settings: ReversalSettings, model: Model, *, sliced: bool = False) -> None:
        self.settings, self._model, self._sliced = settings, model, sliced
        self._filter = LevelFilter(model, settings)
        self._aligned = Aligned(model)
        rows = round((settings.stretch_s + settings.lead_s) * 1e3)
        self._lead = round(settings.lead_s * 1e3)
        self._columns = np.zeros((5, rows))  # torque, speed, angle, integrated speed, force
        self._stretch = self._columns.copy()  # the one that is being evaluated
        self._work: Generator[None, None, ReversalState] | None = None
        self._used = self._left_out = 0
        self._updated_ns: int | None = None
        self._t_ns: int | None = None
        self._n, self._way = 0, 0.0
        self._there = (False, False)
        self.state = self._state(0)

    def step(self, t_ns: int, inputs: InjectionInputs) -> ReversalState | None:
        """Take the newest values, reported by ``t_ns``; the new state after each stretch."""
        before, self._t_ns = self._t_ns, t_ns
        dt_ns = 0 if before is None else t_ns - before
        if not 0 < dt_ns < 3 * _STEP_NS // 2:
            self._restart()
            self._aligned.clear()
        self._aligned.push(t_ns, inputs)
        at_ns, now = self._aligned.read(t_ns)
        torque = now.motor_torque_nm + self._model.sensor_to_rotor * now.torque_sensor_nm
        return self.take(
            at_ns, torque, now.motor_speed_rad_s, now.motor_angle_rad, now.rack_force_n
        )

    def take(
        self, t_ns: int, torque: float, speed: float, angle: float, force: float
    ) -> ReversalState | None:
        """One millisecond of aligned signals (T_1m in Nm, rad/s, rad, N; NaN: not there)."""
        if not (math.isfinite(torque) and math.isfinite(speed)):
            self._restart()
            return None
        there = (math.isfinite(angle), math.isfinite(force))
        if there != self._there:  # a stretch has its signals from end to end
            self._restart()
            self._there = there
        self._way += speed * 1e-3
        self._columns[:, self._n] = torque, speed, angle, self._way, force
        self._n += 1
        if self._n < self._columns.shape[1]:
            return None
        if self._work is not None:  # a loop that never came to it: the older stretch goes first
            finished(self._work)
        self._stretch[:] = self._columns
        self._columns[:, : self._lead] = self._columns[:, -self._lead :]
        self._n = self._lead
        self._work = self._evaluation(t_ns)
        if self._sliced:
            return None
        state, self._work = finished(self._work), None
        return state

    def work(self) -> ReversalState | None:
        """One slice of what there is to evaluate; the new state when it is complete."""
        if self._work is None:
            return None
        try:
            next(self._work)
        except StopIteration as end:
            self._work = None
            return end.value
        return None

    def _restart(self) -> None:
        self._n, self._way = 0, 0.0

    def _evaluation(self, t_ns: int) -> Generator[None, None, ReversalState]:
        """Evidence of the stretch that is complete now, added to what is known."""
        if self._updated_ns is not None:
            self._filter.drift(max(t_ns - self._updated_ns, 0) * 1e-9)
        self._updated_ns = t_ns
        torque, speed, angle, way, force = self._stretch
        cell = self.settings.load_cell and bool(np.isfinite(force).all())
        measured = bool(np.isfinite(angle).all())
        stretch = Stretch(
            torque, speed, angle if measured else way, self._lead, force if cell else None
        )
        before = self._filter.copy()
        for _ in range(_ROUNDS):  # the bristle's state depends on the levels
            levels = self._filter.levels_nm
            blocks = yield from blocks_in_slices(stretch, self._model, levels)
            found = yield from evidence_in_slices(blocks, self.settings.noise_nm)
            self._filter.restore(before)
            if blocks.reversals == 0 or not self._driven(blocks, found):
                self._left_out += 1
                self.state = self._state(t_ns)
                return self.state
            self._filter.take(found)
        self._used += blocks.reversals
        self.state = self._state(t_ns)
        return self.state

    def _driven(self, blocks: Blocks, found: Evidence) -> bool:
        """Whether motor and driver fed the friction; if the road did, it looks like less of it.

        With the force known that does not matter.
        """
        if not blocks.known and blocks.fed < _LEAST_FED:
            return False
        ones = np.ones(2)
        seen = float(ones @ found.matrix @ ones)
        if seen <= 0.0:
            return False
        total = float(found.at_nm.sum()) + 2.0 * float(ones @ found.pull) / seen
        return _LEAST_SUM < total / float(self._filter.model_nm.sum()) < _MOST_SUM

    def _load_error(self) -> float:
        """What an unknown asymmetry does to the sum: it shifts the rack force that eq. 3 is given.

        Half of it looks like a load, and that load like load-dependent friction of both directions.
        Where the true load goes to both sides it averages out; near zero load it does not.
        """
        f, ratio = self._model.friction, self._model.rack_to_rotor_ratio_rad_per_m
        return 0.5 * ratio * (f.load_pos_nm_per_n + f.load_neg_nm_per_n)

    def _state(self, t_ns: int) -> ReversalState:
        levels, c = self._filter.levels_nm, self._filter.covariance
        s = self.settings
        sum_std, asymmetry_std = (
            math.sqrt(max(float(row @ c @ row), 0.0)) for row in _SUM_AND_DIFFERENCE
        )
        sum_std = math.hypot(sum_std, self._load_error() * asymmetry_std)
        total, own = float(levels.sum()), float(self._filter.model_nm.sum())
        confident = sum_std < s.confident_share * total
        known = asymmetry_std < s.confident_share * total
        flag = ""
        if confident and abs(total - own) > max(s.flag_share * own, 3.0 * sum_std):
            flag = (
                f"friction levels add up to {total:.4f} Nm, the model's to {own:.4f} Nm"
                f" ({(total / own - 1.0) * 100:+.0f} %)"
            )
        return ReversalState(
            t_ns,
            FrictionLevels(float(levels[0]), float(levels[1])),
            sum_std,
            asymmetry_std,
            self._used,
            self._left_out,
            confident,
            known,
            flag,
        )


_SUM_AND_DIFFERENCE: tuple[Floats, Floats] = (np.array([1.0, 1.0]), np.array([1.0, -1.0]))
