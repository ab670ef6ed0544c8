"""Fig. 12: step-like rack force with standstill: drift, settling and the way back to zero."""

from pathlib import Path

import numpy as np

from eps_hil.reproduction import force_plot
from eps_hil.reproduction.measures import (
    Estimated,
    drift_per_s,
    estimated,
    rms,
    settling_s,
)
from eps_hil.reproduction.result import Result, Statement, Table, at_least, at_most
from eps_hil.reproduction.workbench import STEP_LEVELS_N, STEP_S, Workbench

_REST_S = 2.0
_BAND_N = 20.0


def make(bench: Workbench, folder: Path) -> Result:
    """Steps of the rack force; EPS motor as spring-damper, hands off."""
    made = estimated(bench.recording("steps"), bench.identified)
    zooms = [(STEP_S - 1.0, STEP_S + 3.0), (2 * STEP_S - 0.2, 2 * STEP_S + 1.3)]
    names = ("w/o FC", "no exten", "2Q-fa")
    picture = force_plot.draw(folder / "fig12.png", made, names, zooms)
    drifts = {name: [_drift(made, name, k) for k in _RESTS] for name in names}
    return Result(
        "fig12",
        "Fig. 12: rack force on the rig, step-like excitation",
        f"{len(STEP_LEVELS_N)} steps of {STEP_S:g} s; drift is the slope over the last "
        f"{_REST_S:g} s of each, settling the time until the estimate stays within "
        f"{_BAND_N:g} N of where it ends.",
        [_rests(made), _summary(made, drifts)],
        _statements(made, drifts),
        picture,
    )


_RESTS = range(len(STEP_LEVELS_N))


def _span(made: Estimated, k: int, since_s: float) -> slice:
    """Samples of step k from ``since_s`` after its start to shortly before the next."""
    first, last = np.searchsorted(made.time_s, (k * STEP_S + since_s, (k + 1) * STEP_S - 0.03))
    return slice(int(first), int(last))


def _drift(made: Estimated, name: str, k: int) -> float:
    part = _span(made, k, STEP_S - _REST_S)
    return drift_per_s(made.time_s[part], made.force_n[name][part])


def _settling(made: Estimated, name: str, k: int) -> float:
    part = _span(made, k, 0.05)
    return settling_s(made.time_s[part], made.force_n[name][part], _BAND_N)


def _end(made: Estimated, name: str, k: int) -> float:
    return float(np.mean(made.force_n[name][_span(made, k, STEP_S - _REST_S)]))


def _rests(made: Estimated) -> Table:
    columns = (
        "real force in N", "w/o FC: estimate in N", "no exten: estimate in N",
        "2Q-fa: estimate in N", "no exten: drift in N/s", "2Q-fa: drift in N/s",
        "no exten: settling in s", "2Q-fa: settling in s",
    )  # fmt: skip
    rows = tuple(
        (
            f"{STEP_LEVELS_N[k]:g}",
            *(_end(made, name, k) for name in ("w/o FC", "no exten", "2Q-fa")),
            *(_drift(made, name, k) for name in ("no exten", "2Q-fa")),
            *(_settling(made, name, k) for name in ("no exten", "2Q-fa")),
        )
        for k in _RESTS
    )
    return Table("each standstill", columns, rows)


def _summary(made: Estimated, drifts: dict[str, list[float]]) -> Table:
    rows = tuple(
        (name, float(np.max(np.abs(drifts[name]))), _rest_error(made, name, False),
         _rest_error(made, name, True))
        for name in drifts
    )  # fmt: skip
    columns = (
        "estimate", "largest drift in N/s", "rms error at rest under load in N",
        "rms error at rest without load in N",
    )  # fmt: skip
    return Table("all standstills", columns, rows)


def _rest_error(made: Estimated, name: str, zero: bool) -> float:
    errors = [
        _end(made, name, k) - STEP_LEVELS_N[k] for k in _RESTS if (STEP_LEVELS_N[k] == 0.0) == zero
    ]
    return rms(np.array(errors))


def _statements(made: Estimated, drifts: dict[str, list[float]]) -> list[Statement]:
    worst = {name: float(np.max(np.abs(values))) for name, values in drifts.items()}
    slow = max(_settling(made, "2Q-fa", k) for k in _RESTS)
    loaded = {name: _rest_error(made, name, False) for name in drifts}
    return [
        at_least(
            "without dead zone and limiter the estimate does not settle on a constant value",
            "largest drift at standstill of 'no exten'",
            worst["no exten"], "N/s", (10.0, 5.0),
        ),
        at_most(
            "with them it has a constant value at standstill",
            "largest drift at standstill of 2Q-fa",
            worst["2Q-fa"], "N/s", (5.0, 10.0),
            f"each estimate is within {_BAND_N:g} N of its last value after {slow:.2g} s at most",
        ),
        at_most(
            "the error is very small compared to no friction compensation",
            "rms error at rest under load: 2Q-fa ÷ w/o FC",
            loaded["2Q-fa"] / loaded["w/o FC"], "", (0.33, 0.67),
            "the remaining error is the friction band: at rest the bristle's deflection is only as "
            "well known as the way in which the rack came to rest",
        ),
        at_most(
            "when rack force and motor torque go to zero, so does the estimate",
            "rms of 2Q-fa at the standstills without load",
            _rest_error(made, "2Q-fa", True), "N", (20.0, 50.0),
        ),
    ]  # fmt: skip
