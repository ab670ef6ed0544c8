"""Before and after on the recording that was not fitted, and the hidden force opened at the end."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.axis.augment import Augmented, Say, augment
from eps_hil.axis.emps import ARM_M, AxisRecord, published_model
from eps_hil.axis.findings import entries_of, findings
from eps_hil.axis.free_run import (
    FreeRun,
    free_run,
    friction_apart_n,
    friction_course_n,
    replayed_rmse_mm,
    with_more_friction,
)
from eps_hil.axis.identify import axis_numbers
from eps_hil.axis.phase import rephased
from eps_hil.diagnosis.data.prepare import EDGE_S, SMOOTH_HZ, STEP_S, prepare
from eps_hil.estimation import batch
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.identification.butterworth import low_pass
from eps_hil.physics.balance import residual_nm
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

BAND_HZ = SMOOTH_HZ
"""Forces are compared below this frequency: the band in which the motion itself is taken."""
_BEFORE_EDGE, _AFTER_EDGE = 50, 100
"""Milliseconds around an edge of the wave that do not count as its plateau."""


@dataclass(frozen=True)
class Judged:
    """One model on the held-out recording; arrays in N, shape (n,).

    ``hidden_force_rmse_n`` lets the hidden force reach the axis as late as the motor's own (it
    enters in front of the same drive), ``unshifted_rmse_n`` does not.
    """

    heldout_force_error_percent: float
    hidden_force_rmse_n: float
    unshifted_rmse_n: float
    hidden_force_n: Floats
    hidden_error_n: Floats
    balance_error_n: Floats
    plateau_rmse_n: float
    online_rmse_n: float
    online_plateau_rmse_n: float


@dataclass(frozen=True)
class Proof:
    """The result as JSON-ready ``content``, and what a figure draws."""

    content: dict[str, Any]
    heldout: AxisRecord
    before: Judged
    after: Judged
    run: FreeRun
    """Of the held-out recording, with the ripple's phase as the fitted one had it."""


def prove(fitted: AxisRecord, heldout: AxisRecord, say: Say | None = None) -> Proof:
    """Fit on ``fitted`` alone; judge the published and the augmented model on ``heldout``.

    Of ``heldout`` the augmented model is told nothing but its ripple's phase, which the recording
    itself shows with the hidden force unknown (:mod:`eps_hil.axis.phase`).
    """
    published = published_model()
    augmented = augment(fitted, published, say)
    model = rephased(heldout, augmented.model)
    before, after = judge(heldout, published), judge(heldout, model)
    content = _content(heldout, published, augmented, model, before, after)
    run = free_run(heldout, augmented.model)
    content["free_run_position_rmse_mm"] = {
        "before": free_run(heldout, published).rmse_mm,
        "after": run.rmse_mm,
        "identified_only": free_run(heldout, augmented.identified).rmse_mm,
    }
    ways = ("forward", "backward")
    judged = (("fitted", fitted, augmented.model), ("held_out", heldout, model))
    apart = {name: friction_apart_n(one, its) for name, one, its in judged}
    content["friction_more_than_modelled_n"] = {
        name: dict(zip(ways, two, strict=True)) for name, two in apart.items()
    }
    content["friction_more_than_modelled_by_quarter_n"] = {
        name: [dict(zip(ways, two, strict=True)) for two in friction_course_n(one, its)]
        for name, one, its in judged
    }
    own = with_more_friction(augmented.model, *apart["held_out"])
    content["free_run_position_rmse_mm"] |= {
        "after_with_its_own_friction": free_run(heldout, own).rmse_mm,
        "with_1_n_more_than_its_own": free_run(heldout, with_more_friction(own, 1.0, 1.0)).rmse_mm,
        "fitted_record_replayed": replayed_rmse_mm(heldout, fitted),
    }
    return Proof(content, heldout, before, after, run)


def judge(record: AxisRecord, model: Model) -> Judged:
    """Force error with the hidden force known; hidden force without, by balance and on line."""
    known = replace(record, force_n=record.force_n - record.hidden_force_n)
    inside = _inside(record)
    error = balance_n(known, model)
    hidden = balance_n(record, model)
    missed = hidden - low_pass(_at_shaft(record.hidden_force_n, model), BAND_HZ)
    unshifted = hidden - low_pass(record.hidden_force_n, BAND_HZ)
    plateau = inside & _plateau(record.hidden_force_n)
    online = online_error_n(record, model)
    seen = np.isfinite(online) & inside
    return Judged(
        heldout_force_error_percent=100 * _rms(error[inside]) / _rms(known.force_n[inside]),
        hidden_force_rmse_n=_rms(missed[inside]),
        unshifted_rmse_n=_rms(unshifted[inside]),
        hidden_force_n=hidden,
        hidden_error_n=missed,
        balance_error_n=error,
        plateau_rmse_n=_rms(missed[plateau]),
        online_rmse_n=_rms(online[seen]),
        online_plateau_rmse_n=_rms(online[seen & plateau]),
    )


def balance_n(record: AxisRecord, model: Model) -> Floats:
    """The force (N, opposing the motor) that the model is short of, below BAND_HZ without phase."""
    motion = prepare(record.name, record.series()).motion(model)
    return low_pass(residual_nm(model, motion)[0] / ARM_M, BAND_HZ)


def _at_shaft(force_n: Floats, model: Model) -> Floats:
    """A force that enters in front of the drive reaches the axis as late as the motor's own."""
    late = -with_model_effects(model).delays_s.motor_torque
    time = np.arange(len(force_n)) * STEP_S
    return np.interp(time - late, time, force_n)


def online_error_n(
    record: AxisRecord, model: Model, settings: EstimatorSettings | None = None
) -> Floats:
    """What the rack-force estimator itself makes of the record, less the hidden force (N); (n,).

    NaN where there is no estimate.
    """
    trace = batch.estimate(record.series(), model, settings)
    error = np.full(len(record.force_n), np.nan)
    index = np.rint(trace.t_ns * 1e-9 / STEP_S).astype(int)
    good = trace.valid & (index >= 0) & (index < len(error))
    truth = _at_shaft(record.hidden_force_n, model)
    error[index[good]] = trace.rack_force_n[good] - truth[index[good]]
    return error


def _inside(record: AxisRecord) -> npt.NDArray[np.bool_]:
    edge = round(EDGE_S / STEP_S)
    inside = np.zeros(len(record.force_n), dtype=bool)
    inside[edge:-edge] = True
    return inside


def _plateau(force_n: Floats) -> npt.NDArray[np.bool_]:
    flat = np.ones(len(force_n), dtype=bool)
    for edge in np.flatnonzero(np.diff(force_n)):
        flat[max(0, edge - _BEFORE_EDGE) : edge + _AFTER_EDGE] = False
    return flat


def _content(
    heldout: AxisRecord,
    published: Model,
    augmented: Augmented,
    model: Model,
    before: Judged,
    after: Judged,
) -> dict[str, Any]:
    identified = judge(heldout, augmented.identified)
    told = augmented.diagnosis.content["findings"]
    shares: list[Mapping[str, float]] = []
    own_phase = judge(heldout, augmented.model)
    for one in told:
        its = entries_of(one, model)
        without = judge(heldout, replace(model, effects=_but(model.effects, its)))
        shares.append(
            {
                "heldout_force_error_percent": without.heldout_force_error_percent,
                "hidden_force_rmse_n": without.hidden_force_rmse_n,
            }
        )

    def pair(name: str) -> dict[str, float]:
        return {
            "before": getattr(before, name),
            "after": getattr(after, name),
            "identified_only": getattr(identified, name),
        }

    return {
        "schema": "eps-hil/proof-emps/1",
        "heldout_force_error_percent": pair("heldout_force_error_percent"),
        "hidden_force_rmse_n": pair("hidden_force_rmse_n"),
        "hidden_force_without_drive_delay_rmse_n": pair("unshifted_rmse_n"),
        "hidden_force_plateau_rmse_n": pair("plateau_rmse_n"),
        "online_hidden_force_rmse_n": pair("online_rmse_n"),
        "online_hidden_force_plateau_rmse_n": pair("online_plateau_rmse_n"),
        "with_the_fitted_recording_s_ripple_phase": {
            "heldout_force_error_percent": own_phase.heldout_force_error_percent,
            "hidden_force_rmse_n": own_phase.hidden_force_rmse_n,
        },
        "band_hz": BAND_HZ,
        "verdict": augmented.diagnosis.content["verdict"],
        "fit": augmented.diagnosis.content["fit"]["holdout"],
        "parameters": {
            "published": axis_numbers(published),
            "identified": axis_numbers(augmented.identified),
            "augmented": axis_numbers(augmented.model),
        },
        "findings": findings(told, augmented.model, shares),
    }


def _but(effects: Sequence[Mapping[str, Any]], some: Sequence[Mapping[str, Any]]) -> Any:
    """The effects without ``some`` of them."""
    return tuple(one for one in effects if not any(one is other for other in some))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
