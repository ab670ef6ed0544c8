"""Before and after on recordings that were not fitted: torque, speed and rack force."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.free_run import free_run, speed_fit_percent
from eps_hil.diagnosis.balance.problem import sliding
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.diagnosis.data.quality import Quality
from eps_hil.estimation import batch
from eps_hil.estimation.score import score
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

MUCH_MORE = 2.0
"""Times the energy of what was fitted: such a hold-out shows something that nothing else did."""
WORSE = 1.02
"""Times the error that it was, from which a worse estimate is said."""
CLEARLY = 1.3
"""Times the sensors' noise that is left of a hold-out's torque, from which that is said."""

NOISES = "times what the sensors' noise makes"
"""Of how much is left, in the words of every sentence that says so: ``more_than_noise``."""


@dataclass(frozen=True)
class Holdout:
    """A recording kept from the fit, prepared and as it was read; bad data count for nothing."""

    prepared: Prepared
    series: Mapping[str, Series]
    quality: Quality | None = None

    def judging(self, model: Model) -> Flags:
        """Thinned samples (m,) that slide, whose data are good, and beside no open gap."""
        mask = sliding(self.prepared, model)
        if self.prepared.barred is not None:
            mask = mask & ~self.prepared.barred
        return mask if self.quality is None else mask & ~self.quality.barred(self.prepared)

    def estimated(self, model: Model) -> Trace:
        """The estimator's trace of the recording, without the stretches of bad data."""
        trace = batch.estimate(dict(self.series), model)
        if self.quality is None:
            return trace
        good = ~self.quality.bad_at((trace.t_ns - self.quality.start_ns) * 1e-9)
        return Trace(
            trace.t_ns[good],
            trace.rack_force_n[good],
            trace.friction_torque_nm[good],
            trace.reason[good],
        )


def measures(
    holdouts: Sequence[Holdout], common: Model, model: Model, *, simulated: bool = True
) -> dict[str, Any]:
    """torque_nrmse, speed_fit_percent, rack_force_rmse_n, free_run (CONTRACT 7) of ``model``.

    ``common`` decides which samples count as sliding and what torque the residual is divided by,
    so that before, after and the noise floor are parts of the same whole. Not ``simulated``: those
    of the torque balance only, the others null.
    """
    if not simulated:
        nothing = {"speed_rmse_rad_s": None, "angle_rmse_rad": None}
        balance = torque_nrmse(holdouts, common, model)
        unknown = dict.fromkeys(("speed_fit_percent", "rack_force_rmse_n"))
        return {"torque_nrmse": balance, **unknown, "free_run": nothing}
    return {
        "torque_nrmse": torque_nrmse(holdouts, common, model),
        "speed_fit_percent": speed_fit_percent(holdouts, model),
        "rack_force_rmse_n": rack_force_error_n(holdouts, common, model),
        "free_run": free_run(holdouts, model),
    }


def torque_nrmse(holdouts: Sequence[Holdout], common: Model, model: Model) -> float:
    """What ``model`` leaves of the balance while sliding, over what ``common`` explains by it."""
    masks = [one.judging(common) for one in holdouts]
    residual = [one.prepared.left_over(model)[m] for one, m in zip(holdouts, masks, strict=True)]
    torque = [one.prepared.residual(common)[1][m] for one, m in zip(holdouts, masks, strict=True)]
    return _rms(residual) / max(_rms(torque), 1e-12)


def rack_force_error_n(holdouts: Sequence[Holdout], common: Model, model: Model) -> float | None:
    """Rms error (N, at the rack) of ``model``'s estimate while moving; None: no load cell."""
    loaded = [one for one in holdouts if "rack_force_n" in one.series]
    found = [score(one.estimated(model), one.series, common) for one in loaded]
    errors = [one.rmse_moving_n for one in found if one is not None]
    errors = [one for one in errors if np.isfinite(one)]
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else None


def still_left(told: Mapping[str, Mapping[str, float]]) -> list[str]:
    """A sentence where hold-outs (``fit.holdout`` of the JSON) keep clearly more than noise."""
    after = told.get("put_right", told["augmented"])["torque_nrmse"]
    times = after / max(told["noise_floor"]["torque_nrmse"], 1e-300)
    if times < CLEARLY:
        return []
    return [
        f"The hold-outs keep {times:.2g} {NOISES}: for a short while, "
        "or in a way that no finding explains. There the model is no better than that."
    ]


def more_than_noise(limits: Sequence[str]) -> bool:
    """Whether a sentence of the JSON's ``limits`` tells of more than noise that is left."""
    return any(NOISES in one for one in limits)


def beside_a_gap(holdouts: Sequence[Holdout], model: Model) -> list[str]:
    """A sentence where samples of the hold-outs are not judged because a gap was open."""
    sliding_samples = [sliding(one.prepared, model) for one in holdouts]
    judged = sum(int(np.sum(one.judging(model))) for one in holdouts)
    good = [
        mask if one.quality is None else mask & ~one.quality.barred(one.prepared)
        for one, mask in zip(holdouts, sliding_samples, strict=True)
    ]
    lost = sum(int(np.sum(mask)) for mask in good) - judged
    if lost <= 0:
        return []
    share = lost / (lost + judged)
    return [
        f"{100 * share:.0f} % of the hold-outs' sliding is beside an open gap, where the rotor's "
        "torque says nothing of the rack: there they are judged by rotor against rack alone."
    ]


def worse_force(told: Mapping[str, Mapping[str, float]]) -> list[str]:
    """A sentence where the findings make the hold-outs' rack-force estimate worse."""
    before, after = (told[one].get("rack_force_rmse_n") for one in ("baseline", "augmented"))
    if before is None or after is None or after <= WORSE * before:
        return []
    return [
        f"The estimate of the rack force is worse with the findings: {after:.3g} N off on the "
        f"hold-outs, {before:.3g} N without. They hold for the torque balance; try the written "
        "model on recordings of your own use before the estimator takes it."
    ]


def noise_floor(holdouts: Sequence[Holdout], model: Model) -> dict[str, float]:
    """What sensor noise alone would leave of ``torque_nrmse``."""
    torque = [one.prepared.residual(model)[1][one.judging(model)] for one in holdouts]
    floors = [one.prepared.floor_nm(model) for one in holdouts]
    return {"torque_nrmse": float(np.sqrt(np.mean(np.square(floors)))) / max(_rms(torque), 1e-12)}


def _rms(parts: Sequence[Floats]) -> float:
    values = np.concatenate(parts) if parts else np.zeros(0)
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
