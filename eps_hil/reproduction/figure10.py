"""Figs 10 and 11: rack force of the sine sweep, without and with the sensors of the rig."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.reproduction import force_plot
from eps_hil.reproduction.measures import Estimated, delay_s, estimated
from eps_hil.reproduction.result import Result, Statement, Table, at_least, at_most
from eps_hil.reproduction.workbench import Workbench

_BINS_N = ((0.0, 100.0), (100.0, 250.0), (250.0, 500.0), (500.0, 750.0))
_SWEEP_HZ = 4.0


def make(bench: Workbench, folder: Path) -> Result:
    """Fig. 10: sensors without noise, 2Q-fa and no compensation."""
    made = _sweep(bench, sensors=False)
    picture = force_plot.draw(folder / "fig10.png", made, ("w/o FC", "2Q-fa"), _zooms(made))
    gain = made.rmse_n("w/o FC", made.moving) / made.rmse_n("2Q-fa", made.moving)
    return Result(
        "fig10",
        "Fig. 10: rack force in simulation, sine sweep of 750 N, 0 to 4 Hz",
        "Sensors without noise and resolution; the model is the one identified for table 2.",
        [force_plot.error_table(made, "rms error against the real rack force")],
        [
            at_least(
                "without friction compensation the estimate deviates largely; with 2Q-fa it is "
                "close to the real force",
                "rms error moving: w/o FC ÷ 2Q-fa",
                gain, "", (10.0, 3.0),
            ),
            at_most(
                "2Q-fa is close to the real rack force",
                "rms error moving ÷ rms force",
                made.rmse_n("2Q-fa", made.moving) / float(np.std(made.real_n)), "", (0.05, 0.1),
            ),
            at_least(
                "2Q-fa is close to the real force at rest too (ours: the paper shows no number)",
                "rms error at rest: w/o FC ÷ 2Q-fa",
                made.rmse_n("w/o FC", ~made.moving) / made.rmse_n("2Q-fa", ~made.moving),
                "", (5.0, 1.5),
                "at rest friction and rack force cannot be told apart: the error lies in the "
                "friction band, with any estimator of this kind",
            ),
        ],
        picture,
    )  # fmt: skip


def make_rig(bench: Workbench, folder: Path) -> Result:
    """Fig. 11: late, noisy and stepped sensors; with and without dead zone and limiter."""
    made, ideal = _sweep(bench, sensors=True), _sweep(bench, sensors=False)
    names = ("w/o FC", "no exten", "2Q-fa")
    picture = force_plot.draw(folder / "fig11.png", made, names, _zooms(made))
    unfiltered = _sweep(bench, sensors=True, low_pass=False)
    lags = [_lag(one, name) for one, name in ((made, "2Q-fa"), (unfiltered, "2Q-fa"))]
    lag_columns = (
        "estimate", "on physical instants in ms", "when published in ms",
        f"when published, phase at {_SWEEP_HZ:g} Hz in deg",
    )  # fmt: skip
    lag_rows = tuple(
        (name, lag[0], lag[1], 0.360 * _SWEEP_HZ * lag[1])
        for name, lag in zip(("2Q-fa", "2Q-fa without low-pass"), lags, strict=True)
    )
    return Result(
        "fig11",
        "Fig. 11: rack force on the rig, sine sweep of 750 N, 0 to 4 Hz",
        "Sensors with delay, noise and resolution of the bus. Dead zone and limiter are what "
        "'no exten' goes without.",
        [
            force_plot.error_table(made, "rms error against the real rack force"),
            Table("delay in the last fifth of the sweep", lag_columns, lag_rows),
            _by_force(made),
        ],
        [*_sweep_statements(made, ideal), *_delay_statements(lags)],
        picture,
    )


def _sweep(bench: Workbench, *, sensors: bool, low_pass: bool = True) -> Estimated:
    made = bench.recording("sine_sweep", sensors=sensors)
    return estimated(made, bench.identified, EstimatorSettings(low_pass=low_pass))


def _zooms(made: Estimated) -> list[tuple[float, float]]:
    """The paper's zooms, 3 to 8 s and 29 to 30 s of 40 s, as shares of this sweep."""
    whole = float(made.time_s[-1]) / 40.0
    return [(3.0 * whole, 8.0 * whole), (29.0 * whole, 29.0 * whole + max(whole, 1.0))]


def _lag(made: Estimated, name: str) -> tuple[float, float]:
    """Delay in ms near the end of the sweep: on physical instants, and when it is published."""
    late = made.time_s > 0.8 * made.time_s[-1]
    away_s = delay_s(made.time_s[late], made.force_n[name][late], made.real_n[late])
    return 1e3 * away_s, 1e3 * (away_s + made.latency_s)


def _inside(made: Estimated, bounds: tuple[float, float]) -> npt.NDArray[np.bool_]:
    size = np.abs(made.real_n)
    return np.asarray((size >= bounds[0]) & (size < bounds[1]) & made.moving)


def _relative(made: Estimated, name: str, bounds: tuple[float, float]) -> float:
    """Rms error ÷ mean force while moving, in one range of the rack force; percent."""
    keep = _inside(made, bounds)
    return 100.0 * made.rmse_n(name, keep) / float(np.mean(np.abs(made.real_n[keep])))


def _by_force(made: Estimated) -> Table:
    rows = []
    for bounds in _BINS_N:
        keep = _inside(made, bounds)
        rows.append(
            (f"{bounds[0]:g} to {bounds[1]:g}", made.rmse_n("w/o FC", keep),
             made.rmse_n("2Q-fa", keep), _relative(made, "w/o FC", bounds),
             _relative(made, "2Q-fa", bounds))
        )  # fmt: skip
    columns = (
        "rack force in N", "w/o FC: rms error in N", "2Q-fa: rms error in N",
        "w/o FC: % of the force", "2Q-fa: % of the force",
    )  # fmt: skip
    return Table("error by rack force, moving", columns, tuple(rows))


def _sweep_statements(made: Estimated, ideal: Estimated) -> list[Statement]:
    low, high = _relative(made, "w/o FC", _BINS_N[0]), _relative(made, "w/o FC", _BINS_N[-1])
    moving = {name: made.rmse_n(name, made.moving) for name in made.force_n}
    return [
        at_least(
            "the compensation matters most at low rack force",
            "error without compensation in % of the force, below 100 N ÷ above 500 N",
            low / high, "", (3.0, 1.5),
        ),
        at_most(
            "the rig gives the same performance range as the simulation",
            "rms error moving of 2Q-fa ÷ that of fig. 10",
            moving["2Q-fa"] / ideal.rmse_n("2Q-fa", ideal.moving), "", (2.0, 4.0),
        ),
        at_most(
            "dead zone and limiter act only at small speed and standstill: 'no exten' is the same "
            "while moving",
            "|rms error moving of 'no exten' − 2Q-fa| ÷ that of w/o FC",
            abs(moving["no exten"] - moving["2Q-fa"]) / moving["w/o FC"], "", (0.02, 0.1),
        ),
    ]  # fmt: skip


def _delay_statements(lags: list[tuple[float, float]]) -> list[Statement]:
    (dated, published), (_, unfiltered) = lags
    return [
        at_most(
            "at higher frequency a small delay is seen",
            "delay of 2Q-fa when published, at the end of the sweep",
            published, "ms", (25.0, 50.0),
            "limits: a tenth and a fifth of the period at 4 Hz",
        ),
        at_least(
            "the delay is caused by the low-pass filter",
            "share of the published delay that goes when the low-pass is switched off",
            (published - unfiltered) / published, "", (0.5, 0.25),
            "observer and sensors are the rest; each estimate carries the instant that it speaks "
            f"of, and on that time axis {dated:.2g} ms are left",
        ),
    ]  # fmt: skip
