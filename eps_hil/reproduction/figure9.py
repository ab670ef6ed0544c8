"""Fig. 9: friction during the sweep: observed, by the measured map, and by its linear fit."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.estimation import batch
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.physics.friction import (
    FrictionLaw,
    bristle_step,
    friction_law,
    friction_torque_nm,
    static_level_nm,
)
from eps_hil.physics.model import Friction, Model
from eps_hil.report import figures
from eps_hil.reproduction.measures import at, estimated, rms
from eps_hil.reproduction.result import Result, Statement, Table, at_least, at_most
from eps_hil.reproduction.workbench import Workbench, series

Floats = npt.NDArray[np.float64]

_SHARES = (0.5, 0.8, 1.25, 2.0)
_MOVING_RAD_S = 1.0


@dataclass(frozen=True, slots=True)
class Curves:
    """Friction torques (Nm, rotor) at common instants, all (n,)."""

    time_s: Floats
    speed_rad_s: Floats
    curves: dict[str, Floats]


def make(bench: Workbench, folder: Path) -> Result:
    """The observer gives the friction where the load cell gives the force; models beside it."""
    found = _curves(bench)
    moving = np.abs(found.speed_rad_s) > _MOVING_RAD_S
    first = int(np.argmax(moving))
    size = rms(found.curves["real"][moving])
    pairs = (("LDO", "real"), ("2Q-map", "LDO"), ("2Q-fa", "LDO"), ("2Q-fa", "2Q-map"))
    rows = []
    for one, other in pairs:
        away = found.curves[one] - found.curves[other]
        rows.append((f"{one} against {other}", rms(away[moving]), 100 * rms(away[moving]) / size))
    columns = ("curves", "rms difference moving in Nm", "% of the rms friction")
    varied = _sensitivity(bench)
    return Result(
        "fig9",
        "Fig. 9: friction estimation, sine sweep of 750 N, 0 to 4 Hz",
        "LDO: the disturbance observer asked for the friction, the load cell being known. 2Q-map "
        "and 2Q-fa: LuGre with the measured map and with eq. 3, from measured speed and force.",
        [Table("friction curves", columns, tuple(rows)), varied],
        _statements(found, moving, first, varied, bench),
        _draw(found, folder / "fig9.png"),
    )


def _curves(bench: Workbench) -> Curves:
    made = bench.recording("sine_sweep")
    model = bench.identified
    signals = series(made.columns)
    trace = batch.estimate(signals, model, EstimatorSettings(quantity="friction"))
    keep = trace.valid & (trace.t_ns * 1e-9 < made.truth["time_s"][-1])
    time_s = trace.t_ns[keep] * 1e-9
    speed = _measured(made.columns, model, "motor_speed_rad_s", time_s)
    force = _measured(made.columns, model, "rack_force_n", time_s)
    law = friction_law(model.friction)
    flat = np.array([static_level_nm(v, f, law) for v, f in zip(speed, force, strict=True)])
    return Curves(
        time_s,
        at(time_s, made, "motor_speed_rad_s"),
        {
            "real": at(time_s, made, "friction_torque_nm"),
            "LDO": trace.friction_torque_nm[keep],
            "2Q-map": modelled(speed, bench.map.level(speed, force), model.friction),
            "2Q-fa": modelled(speed, flat, model.friction),
        },
    )


def _measured(columns: Mapping[str, Floats], model: Model, name: str, time_s: Floats) -> Floats:
    """A measured signal at physical instants, averaged over 10 ms without phase."""
    late = columns["time_s"] - model.delays_s.of(name)
    calm = np.convolve(np.pad(columns[name], 5, mode="edge"), np.full(11, 1 / 11), "valid")
    return np.asarray(np.interp(time_s, late, calm))


def modelled(speed_rad_s: Floats, level_nm: Floats, friction: Friction) -> Floats:
    """Eq. 2 at 1 kHz with a given static level; Nm, (n,)."""
    out = np.empty_like(speed_rad_s)
    _lugre(friction_law(friction), speed_rad_s, level_nm, out)
    return out


@njit
def _lugre(law: FrictionLaw, speed: Floats, level: Floats, out: Floats) -> None:
    bristle = 0.0
    for k in range(speed.size):
        travel = speed[k] * 1e-3
        bristle = bristle_step(bristle, travel, abs(travel), level[k], law.sigma0_nm_per_rad)
        out[k] = friction_torque_nm(bristle, speed[k], level[k], law)


def _sensitivity(bench: Workbench) -> Table:
    """Rack-force error of the sweep with one bristle parameter off."""
    made, model = bench.recording("sine_sweep"), bench.identified
    base = estimated(made, model)
    basic = base.rmse_n("2Q-fa", base.moving)
    rows: list[tuple[str | float, ...]] = [("as given", 1.0, basic, 0.0)]
    for symbol, name in (("σ0", "sigma0_nm_per_rad"), ("σ1,0", "sigma1_nm_s_per_rad")):
        for share in _SHARES:
            value = share * getattr(model.friction, name)
            changed = replace(model, friction=replace(model.friction, **{name: value}))
            one = estimated(made, changed)
            error = one.rmse_n("2Q-fa", one.moving)
            # Another bristle is known a little sooner or later: the instants that both have.
            _, of_one, of_base = np.intersect1d(one.time_s, base.time_s, return_indices=True)
            both = one.force_n["2Q-fa"][of_one] - base.force_n["2Q-fa"][of_base]
            away = rms(both[base.moving[of_base]])
            rows.append((symbol, share, error, away))
    columns = ("parameter", "× its value", "rms error moving in N", "rms change moving in N")
    return Table("sensitivity of the rack force to the bristle's parameters", columns, tuple(rows))


def _statements(
    found: Curves, moving: npt.NDArray[np.bool_], first: int, varied: Table, bench: Workbench
) -> list[Statement]:
    ratio = bench.model.rack_to_rotor_ratio_rad_per_m
    fastest = float(bench.map.speed_rad_s.max())
    known = np.abs(found.speed_rad_s) < fastest
    real, ldo = found.curves["real"], found.curves["LDO"]
    size = rms(real[moving])
    worst = max(float(row[3]) for row in varied.rows)
    level_n = size * ratio
    before = rms((found.curves["2Q-fa"] - real)[: max(first, 2)])
    after = rms((found.curves["2Q-fa"] - real)[moving])
    return [
        at_most(
            "map and approximation give an excellent friction estimate in the sweep",
            "rms of 2Q-fa against the observed friction, moving ÷ rms friction",
            rms((found.curves["2Q-fa"] - ldo)[moving]) / size, "", (0.1, 0.2),
        ),
        at_most(
            "map and linear approximation agree with each other",
            f"rms of 2Q-fa against 2Q-map at 1 to {fastest:.0f} rad/s ÷ rms friction",
            rms((found.curves["2Q-fa"] - found.curves["2Q-map"])[moving & known]) / size,
            "", (0.05, 0.1),
        ),
        at_most(
            "map and linear approximation agree in the whole sweep",
            "rms of 2Q-fa against 2Q-map, moving ÷ rms friction",
            rms((found.curves["2Q-fa"] - found.curves["2Q-map"])[moving]) / size, "", (0.05, 0.1),
            f"the sweep reaches {np.abs(found.speed_rad_s).max():.0f} rad/s, the map was measured "
            f"to {fastest:.0f} rad/s and is held there; eq. 3 goes on rising, as the rig does",
        ),
        at_least(
            "before the rack first moves the estimated friction is not realistic",
            "rms error of 2Q-fa before the first movement ÷ while moving",
            before / after, "", (2.0, 1.2),
        ),
        at_most(
            "minor sensitivity to σ0 and σ1 around their values",
            "largest rms change of the rack force with one of them halved to doubled ÷ rms "
            "friction at the rack",
            worst / level_n, "", (0.1, 0.2),
        ),
    ]  # fmt: skip


def _draw(found: Curves, path: Path) -> Path:
    figure, axes = figures.subplots(2, 2, width_cm=30.0, height_cm=18.0)
    end = float(found.time_s[-1])
    share = end / 40.0
    late = (30.0 * share, 30.0 * share + max(2.0 * share, 1.0))
    spans = ((axes[0, 0], (0.0, end)), (axes[0, 1], late), (axes[1, 1], (0.0, 10.0 * share)))
    styles = {
        "LDO": {"color": figures.COLOURS[2], "linewidth": 1.0, "label": "LDO (observed)"},
        "2Q-map": {"color": figures.COLOURS[1], "linewidth": 1.2, "label": "2Q-map"},
        "2Q-fa": {"color": figures.COLOURS[0], "linewidth": 1.0, "label": "2Q-fa"},
        "real": {"color": "black", "linewidth": 0.9, "linestyle": (0, (4, 2)), "label": "real"},
    }
    for axis, (since, until) in spans:
        here = (found.time_s >= since) & (found.time_s <= until)
        for name, style in styles.items():
            axis.plot(found.time_s[here], found.curves[name][here], **style)
        axis.set_xlim(since, until)
        axis.set_ylabel("friction torque in Nm")
        axis.set_title(
            "friction estimation" + (f", {since:.1f} to {until:.1f} s" if until < end else ""),
            fontsize="medium",
        )
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    axes[1, 0].plot(found.time_s, found.speed_rad_s, color=figures.COLOURS[0], linewidth=0.8)
    axes[1, 0].set_ylabel("rotor speed in rad/s")
    axes[1, 0].set_title("rotor speed", fontsize="medium")
    for axis in axes[1]:
        axis.set_xlabel("time in s")
    return figures.save(figure, path)
