"""Nominal, augmented and true model on one recording that none of them was fitted to.

The true model is what the concealed rig's model file would be if somebody had known; its residual
and its rack force are what a diagnosis can hope for.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.problem import sliding
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.estimation import batch
from eps_hil.estimation.score import score
from eps_hil.physics.model import Model, load_model
from eps_hil.recordings.read import read_recording
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

MODELS = ("baseline", "augmented", "oracle")


@dataclass(frozen=True, slots=True)
class Worth:
    """One model on one recording.

    ``rack_force_rmse_n``: error (N) of the rack-force estimator with it against the true rack
    force, while the rotor moves. ``residual_nm``: rms of the torque balance's residual (Nm at the
    rotor) while it slides; None where no rack force was recorded.
    """

    rack_force_rmse_n: float
    residual_nm: float | None


def closed_loop(
    case: Path, force_n: Floats, models: Mapping[str, Path]
) -> dict[str, dict[str, float | None]]:
    """Each of ``models`` on the hold-out of a case folder, as plain numbers by name.

    ``force_n`` (n,) is the true rack force at 1 kHz from the recording's start.
    """
    series = _holdout(case)
    first = min(int(one.t_ns[0]) for one in series.values())
    truth = Series(first + np.arange(len(force_n), dtype=np.int64) * 1_000_000, force_n)
    nominal = load_model(models["baseline"])
    return {
        name: asdict(worth(series, truth, load_model(path), nominal))
        for name, path in models.items()
    }


def worth(series: Mapping[str, Series], truth: Series, model: Model, nominal: Model) -> Worth:
    """One model; ``nominal`` decides what counts as moving, so that all count the same samples."""
    found = score(batch.estimate(series, model), {**series, "rack_force_n": truth}, nominal)
    assert found is not None
    return Worth(found.rmse_moving_n, _residual_nm(series, model, nominal))


def _residual_nm(series: Mapping[str, Series], model: Model, nominal: Model) -> float | None:
    if "rack_force_n" not in series:
        return None
    prepared = prepare("holdout", series)
    left = prepared.residual(model)[0][sliding(prepared, nominal)]
    return float(np.sqrt(np.mean(left**2)))


def _holdout(case: Path) -> Mapping[str, Series]:
    """The recording as the diagnosis was given it: CSV, or a CAN log with its database."""
    if (case / "holdout.csv").exists():
        return read_recording(case / "holdout.csv").series
    databases: Sequence[Path] = sorted(case.glob("*.dbc"))
    return read_recording(
        case / "holdout.log", dbc=databases, signals=case / "signals.yaml", gaps="mark"
    ).series
