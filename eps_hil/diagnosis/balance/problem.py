"""All recordings of a diagnosis as one weighted residual vector, a function of the model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.diagnosis.balance.baseline import turned
from eps_hil.diagnosis.data.prepare import CLEAR_SIGMA, STEP_S, THIN, Prepared
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.data.size import ORDINARY, Size
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
Masks = npt.NDArray[np.bool_]

SLIDING_RAD_S = 1.0
SETTLED_RAD = 0.2
"""Path since the last rest or reversal after which the bristle's history is forgotten."""
PRESLIDING_SIGMA_NM, NOISY_RAD_S = 0.03, 0.2
"""What rest and presliding leave even in a right model, at so much speed noise or less and at
1 kHz: a reversal's instant is known no better than a sample."""
_MUCH, _TAIL = 2.0, 3.0
"""Times the noise from which what is left is more; usual errors of an outlier."""
_MANY = 20_000
"""Thinned samples from which it is worth while to work on several recordings at once."""
TERM = "term"
"""Key that tells an entry from others of the same effect (two cogging orders); no model has it."""
NOTHING_NM = 1e3
"""Deviation of a sample that says nothing."""
BLOCK_S = 2.0
"""Length of the blocks that take turns in fitting and judging."""
STRETCH_S = 10.0
"""Length over which errors are correlated: a manoeuvre, in which the model is wrong in one way."""


class Remainder(Protocol):
    """A covariance that residuals have beyond the sensors' noise."""

    def span(self, problem: "Problem") -> Floats:
        """P (n, r): residuals are whitened by taking P Pᵀ of them off."""


@dataclass
class Problem:
    """Recordings, model and weights; residuals are in units of the sensor-noise floor."""

    recordings: Sequence[Prepared]
    model: Model
    tied: Mapping[str, float] = field(default_factory=dict)
    """Own numbers of the model that are free in every fit, because nobody measured them."""
    either_sign: bool = False
    """Whether shapes may be found upside down, where what matters is the shape, not its name."""
    remainder: Remainder | None = None
    """What is unknown beside the model (``discrepancy.py``): residuals are whitened by it."""
    held_nm: float = 0.0
    """What rest and presliding leave beyond a right model's, for one sample (``resting.py``)."""
    beyond_nm: float = 0.0
    """What sliding leaves that is no noise, of the reported torque (:meth:`weigh`)."""
    sliding: Masks = field(init=False)
    scale: Floats = field(init=False)
    floor: float = field(init=False)
    """The sliding samples' usual noise, Nm."""
    block: npt.NDArray[np.int64] = field(init=False)
    stretch: npt.NDArray[np.int64] = field(init=False)
    knee: float = field(init=False, default=0.0)
    """Beyond this a residual counts as an outlier; 0: set by the first fit (:func:`knee`)."""
    at: Mapping[str, float] = field(init=False, default_factory=dict)
    """Where the sensitivities to the model's own numbers are taken."""
    columns: dict[str, Floats] = field(init=False, default_factory=dict)
    """Sensitivities to the model's own numbers, kept for all fits (they are nearly linear)."""
    ablations: tuple[Any, float, dict[tuple[int, int], Any]] = field(
        init=False, default=(None, 0.0, {})
    )
    """Of the last fit that names were taken off: the fit, the knee then, the fits without one."""
    visited_m: tuple[float, float] = field(init=False)
    """Rack positions (m) between which all but the outermost few percent of the samples are."""
    farthest_m: float = field(init=False)
    """The rack's distance from its middle (m) that only few samples exceed…"""
    extreme_m: float = field(init=False)
    """…and the largest of all."""

    def __post_init__(self) -> None:
        masks, floors, blocks, stretches = [], [], [], []
        number = several = 0
        for recording in self.recordings:
            mask = sliding(recording, self.model)
            barred = np.zeros(len(mask), bool) if recording.barred is None else recording.barred
            mask &= ~barred
            floor = float(np.hypot(recording.floor_nm(self.model), recording.unexplained_nm))
            masks.append(mask)
            speed_noise = recording.noise["motor_speed_rad_s"] / self.size.angle
            slower = float(np.sqrt(recording.interval_s / STEP_S))
            unsure = PRESLIDING_SIGMA_NM * max(1.0, speed_noise / NOISY_RAD_S, slower)
            unsure = float(np.hypot(unsure * self.size.torque, self.held_nm))
            usable = np.where(mask, floor, np.hypot(floor, unsure))
            floors.append(np.where(barred, NOTHING_NM * self.size.torque, usable))
            index = (recording.thin_time_s - recording.thin_time_s[0]) // BLOCK_S
            blocks.append(number + index.astype(np.int64))
            number = int(blocks[-1][-1]) + 1
            stretches.append(several + (index // round(STRETCH_S / BLOCK_S)).astype(np.int64))
            several = int(stretches[-1][-1]) + 1
        position = np.concatenate([one.motion(self.model).position_m for one in self.recordings])
        low, high = np.percentile(position, [3, 97], overwrite_input=True)
        self.visited_m = float(low), float(high)
        away = np.abs(position, out=position)  # of an hour a copy is 29 MB
        self.farthest_m = float(np.percentile(away, 99.5, overwrite_input=True))
        self.extreme_m = float(np.max(away))
        self._masks = masks
        self.sliding = np.concatenate(masks)
        self.scale = np.concatenate(floors)
        self.floor = float(np.median(self.scale[self.sliding])) if self.sliding.any() else 1.0
        self.block = np.concatenate(blocks)
        self.stretch = np.concatenate(stretches)
        self._span = None if self.remainder is None else self.remainder.span(self)

    def over(self, recordings: Sequence[Prepared]) -> "Problem":
        """The same for other recordings: hold-outs."""
        return replace(self, recordings=recordings)

    def apart(self, recordings: Sequence[Prepared]) -> "Problem":
        """Other recordings under the given model alone, to judge laws by."""
        return Problem(recordings, self.model, beyond_nm=self.beyond_nm)

    def beside(self, remainder: Remainder | None) -> "Problem":
        """The same with another remainder."""
        return replace(self, remainder=remainder)

    @property
    def size(self) -> Size:
        """How large the machine is."""
        return self.recordings[0].size if self.recordings else ORDINARY

    @property
    def independent(self) -> float:
        """Independent samples that slide."""
        pairs = zip(self.recordings, self._masks, strict=True)
        return sum(one.independent * float(np.sum(mask)) for one, mask in pairs)

    def residual(self, model: Model, noise_of: Model | None = None) -> Floats:
        """Weighted residual (n,): 1 is the sensor noise.

        The noise is that under this very model (errors in variables): a model that makes all
        torques smaller also makes their noise smaller, and is no better for it. What is left beyond
        noise (an error in the equation) is as large under every model. Two forms of one effect are
        compared in the noise of one, ``noise_of``: the other may not say what becomes of noise.
        """

        few = len(self.scale) < _MANY
        of = [(one, model, noise_of) for one in self.recordings]
        parts = [self.left(*one) for one in of] if few else each(lambda one: self.left(*one), of)
        residual = np.concatenate(parts) / self.scale
        return self.whitened(residual)

    @property
    def hidden(self) -> float:
        """Energy, in noise variances, of what sampling at intervals leaves of the right model.

        It is no noise: where it is most of the floor, a regressor may follow it.
        """
        told = 0.0
        for one, mask in zip(self.recordings, self._masks, strict=True):
            floor = np.hypot(one.floor_nm(self.model), one.unexplained_nm)
            told += float(np.sum(mask)) * float(one.sampled_nm / floor) ** 2
        return told

    def left(self, one: Prepared, model: Model, noise_of: Model | None = None) -> Floats:
        """What the model leaves of one recording, Nm, in proportion to its usual size there."""
        usual = self._usual_nm(one, model if noise_of is None else noise_of)
        return one.left_over(model) * (self._usual_nm(one, self.model) / usual)

    def noise(self, model: Model) -> list[float]:
        """Deviation (Nm) of each recording's sensor noise under ``model``."""
        return [one.floor_nm(self.state_of(one, model)) for one in self.recordings]

    def state_of(self, one: Prepared, model: Model) -> Model:
        """The model of the state in which a recording was made."""
        return model

    def _usual_nm(self, one: Prepared, model: Model) -> float:
        """Deviation of a right model's residual: noise, and what no model explains."""
        floor = one.floor_nm(model)
        return float(np.hypot(floor, one.acting_share(model) * self.beyond_nm))

    def beside_sigma(self, sigma: float) -> "Problem":
        """The same where ``sigma`` times the noise is left; what a remainder holds is not left.

        As :meth:`weigh` has it, of what is left beside a discrepancy. A discrepancy that was taken
        for an error in the equation as well would leave the noise of regressors uncounted.
        """
        share = max((one.acting_share(self.model) for one in self.recordings), default=1.0)
        beyond = float(np.sqrt(max(sigma**2 - _MUCH**2, 0.0))) * self.floor / max(share, 1e-12)
        if beyond == self.beyond_nm:
            return self
        again = replace(self, beyond_nm=beyond)
        again.knee, again.at = self.knee, self.at
        return again

    def weigh(self, model: Model) -> bool:
        """Take what ``model`` leaves beyond noise for an error in the equation; whether it was new.

        With errors in regressors and in the equation (Fuller, Measurement Error Models, 1987, 2.2)
        Σ r²/(σ²(θ) + d²) has its least at the right θ if d is what is left there, and without d
        where σ is large: of r beyond the noise, most would be gained by noise. Up to twice the
        noise there is none, for that may be what is still to be found.
        """
        energy, count = 0.0, 0
        for one, mask in zip(self.recordings, self._masks, strict=True):
            own = self.state_of(one, model)
            share = max(one.acting_share(own), 1e-12)
            left = np.abs(one.left_over(own)[mask]) / share
            noise = _MUCH * float(np.hypot(one.floor_nm(own), one.unexplained_nm)) / share
            most = _TAIL * 1.4826 * float(np.median(left)) if len(left) else 0.0
            energy += float(np.sum(np.minimum(left, most) ** 2 - noise**2))
            count += len(left)
        before, self.beyond_nm = self.beyond_nm, float(np.sqrt(max(energy, 0.0) / max(count, 1)))
        if self.beyond_nm == before:
            return False
        self.columns = {}
        return True

    def whitened(self, values: Floats) -> Floats:
        """Residuals (n,) or sensitivities (n, k) beside the remainder; themselves without one."""
        return values if self._span is None else values - self._span @ (self._span.T @ values)

    def cost(self, residual: Floats) -> float:
        """Twice Huber's loss at the common knee: the sum of squares but for outliers."""
        size = np.abs(residual)
        at = self.knee
        return float(np.sum(np.where(size < at, np.minimum(size, at) ** 2, at * (2.0 * size - at))))

    def with_entries(
        self, entries: Sequence[Mapping[str, Any]], own: Mapping[str, float] | None = None
    ) -> Model:
        """The model with effects added to its own, and its ``own`` numbers moved (see baseline)."""
        entries = [plain(entry) for entry in entries]
        model = replace(self.model, effects=(*self.model.effects, *entries))
        return turned(model, own or {}, self.size)


def term_of(entry: Mapping[str, Any]) -> str:
    """Which term an entry is, whatever its numbers become: of most effects there is only one."""
    return str(entry.get(TERM, entry["effect"]))


def plain(entry: Mapping[str, Any]) -> dict[str, Any]:
    """The entry as a model holds it."""
    return {key: value for key, value in entry.items() if key != TERM}


def knee(residual: Floats) -> float:
    """Beyond this a weighted residual counts as an outlier: 4 noise deviations, or more where the
    residual's typical size is far above the sensors' noise (real hardware, or much to be found).
    """
    return max(4.0, 2.0 * 1.4826 * float(np.median(np.abs(residual))))


def clipped(residual: Floats, at: float) -> Floats:
    """The residual with outliers cut at twice the knee ``at``."""
    return np.clip(residual, -2.0 * at, 2.0 * at)


def huber(residual: Floats, at: float) -> Floats:
    """Weights (n,) of Huber's loss: 1 below the knee ``at``, less for outliers."""
    size = np.abs(residual)
    return np.where(size < at, 1.0, at / np.maximum(size, at))


def sliding(recording: Prepared, model: Model) -> Masks:
    """Thinned samples at which the rotor slides and the bristle has forgotten its history."""
    motion = recording.motion(model)
    speed = motion.speed_rad_s
    since = _since_reversal(speed, motion.slip_rad)
    angle = recording.size.angle
    clear = CLEAR_SIGMA * recording.speed_noise_rad_s
    least = SLIDING_RAD_S * angle
    slides = np.abs(speed) > max(least, clear)
    if clear > least and recording.slow_rate is not None:
        rate, noise = recording.slow_rate
        slides |= (np.abs(rate) > max(least, CLEAR_SIGMA * noise)) & (rate * speed > 0.0)
    good = slides & (since > SETTLED_RAD * angle)
    # the filter spreads what happens at a reversal over its own length
    wide = np.convolve(~good, np.ones(2 * THIN + 1), mode="same") > 0
    edge = (len(speed) - len(recording.thin_time_s) * THIN) // 2
    return np.asarray(~wide[edge : edge + len(recording.thin_time_s) * THIN : THIN])


@njit
def _since_reversal(speed: Floats, slip: Floats) -> Floats:
    """Path (n,) since the last rest or change of direction."""
    path, since = 0.0, np.empty(len(speed))
    for k in range(len(speed)):
        if speed[k] == 0.0 or (k and np.sign(speed[k]) != np.sign(speed[k - 1])):
            path = 0.0
        path += slip[k]
        since[k] = path
    return since
