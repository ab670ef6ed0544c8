"""Fig. 4: the measured friction map over speed and load (2Q-map), and what the paper says of it."""

from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.identification.constant_speed import FrictionMap
from eps_hil.report import figures
from eps_hil.reproduction.result import Result, Statement, Table, at_least, at_most
from eps_hil.reproduction.workbench import Workbench

_CAUTION = "the simulated rig obeys table 2, so this shows that the procedure finds what is there"


def make(bench: Workbench, folder: Path) -> Result:
    """Constant speeds at preloads, robot and motor as in the paper; friction read off as a mean."""
    found = bench.map
    picture = draw_maps(
        folder / "fig4.png", found, found.level_nm, "measured friction map (2Q-map)"
    )
    columns = ("rotor speed in rad/s", *(f"{load:g} N" for load in found.load_n))
    rows = tuple(
        (float(round(speed, 2)), *map(float, level))
        for speed, level in zip(found.speed_rad_s, found.level_nm, strict=True)
    )
    return Result(
        "fig4",
        "Fig. 4: friction measured in two quadrants",
        f"{len(bench.cells)} constant-speed passes: the robot holds the speed, the linear motor "
        "the preload, the EPS motor carries the preload; friction is the mean torque residual.",
        [Table("friction level |T_f| in Nm at the rotor, by speed and preload", columns, rows)],
        _statements(found),
        picture,
    )


def draw_maps(path: Path, found: FrictionMap, level: Any, title: str) -> Path:
    """A surface as in the paper, and friction over load for every speed; written to ``path``."""
    figure, axes = figures.subplots(1, 2, width_cm=30.0, height_cm=13.0)
    axes[0, 0].remove()
    surface = figure.add_subplot(1, 2, 1, projection="3d")
    load, speed = np.meshgrid(found.load_n, found.speed_rad_s)
    for rows in (found.speed_rad_s < 0, found.speed_rad_s > 0):
        surface.plot_surface(load[rows], speed[rows], level[rows], cmap="viridis", alpha=0.9)
    surface.set_xlabel("rack force in N")
    surface.set_ylabel("rotor speed in rad/s")
    surface.set_zlabel("friction torque in Nm")
    surface.set_title(title, fontsize="medium")
    surface.view_init(elev=22, azim=-125)
    axis = axes[0, 1]
    for side, colour, sign in (("v > 0", figures.COLOURS[0], 1), ("v < 0", figures.COLOURS[1], -1)):
        speeds = found.speed_rad_s[found.speed_rad_s * sign > 0]
        for k, at in enumerate(speeds[np.argsort(np.abs(speeds))]):
            row = level[found.speed_rad_s == at][0]
            shade = 0.35 + 0.65 * (k + 1) / len(speeds)
            label = f"{side}: {np.abs(speeds).min():.0f} to {np.abs(speeds).max():.0f} rad/s"
            axis.plot(
                found.load_n, row, "o-", color=colour, alpha=shade, linewidth=1.1, markersize=3,
                label=label if k == len(speeds) - 1 else None,
            )  # fmt: skip
    axis.set_xlabel("rack force in N")
    axis.set_ylabel("friction torque in Nm")
    axis.set_ylim(bottom=0.0)
    axis.legend(frameon=False)
    axis.set_title("one line a speed", fontsize="medium")
    return figures.save(figure, path)


def load_effect_nm(found: FrictionMap) -> tuple[float, float]:
    """How much the level moves over the whole load range, mean over speeds: (v > 0, v < 0), Nm."""
    rise = np.abs(found.level_nm[:, -1] - found.level_nm[:, 0])
    return float(np.mean(rise[found.speed_rad_s > 0])), float(np.mean(rise[found.speed_rad_s < 0]))


def speed_effect_nm(found: FrictionMap) -> tuple[float, float]:
    """How much the level moves over the whole speed range, mean over loads: (v > 0, v < 0), Nm."""
    effects = []
    for rows in (found.speed_rad_s > 0, found.speed_rad_s < 0):
        level = found.level_nm[rows]
        effects.append(float(np.mean(level.max(axis=0) - level.min(axis=0))))
    return effects[0], effects[1]


def _statements(found: FrictionMap) -> list[Statement]:
    fits = [np.corrcoef(found.load_n, row)[0, 1] ** 2 for row in found.level_nm]
    speed, load = max(speed_effect_nm(found)), min(load_effect_nm(found))
    return [
        at_least(
            "the friction varies almost linearly with preload",
            "worst R² of a straight line over the load, all speeds",
            min(fits), "", (0.98, 0.9), _CAUTION,
        ),
        at_most(
            "the speed has no clear influence",
            "largest change over all speeds ÷ smallest change over all loads",
            speed / load, "", (0.2, 0.5), _CAUTION,
        ),
        at_least(
            "the friction level is asymmetric with direction",
            "|level(v < 0) − level(v > 0)| ÷ mean level, without preload",
            _asymmetry(found), "", (0.2, 0.05), _CAUTION,
        ),
        at_most(
            "there are no clear Stribeck effects",
            "rise of the level towards the lowest speed ÷ level, worst load and direction",
            _stribeck(found), "", (0.03, 0.1), _CAUTION,
        ),
        at_most(
            "friction lies between 0.05 and 0.3 Nm up to 3000 N",
            "farthest level outside that range",
            float(max(0.05 - found.level_nm.min(), found.level_nm.max() - 0.3, 0.0)),
            "Nm", (0.0, 0.03), _CAUTION,
        ),
    ]  # fmt: skip


def _asymmetry(found: FrictionMap) -> float:
    level = found.level_nm[:, 0]
    one, other = (np.mean(level[rows]) for rows in (found.speed_rad_s > 0, found.speed_rad_s < 0))
    return float(abs(one - other) / np.mean(level))


def _stribeck(found: FrictionMap) -> float:
    """How much higher the slowest speed's level is than the least of the others."""
    worst = 0.0
    for sign in (1.0, -1.0):
        rows = np.flatnonzero(found.speed_rad_s * sign > 0)
        level = found.level_nm[rows[np.argsort(np.abs(found.speed_rad_s[rows]))]]
        worst = max(worst, float(np.max((level[0] - level[1:].min(axis=0)) / level[0])))
    return max(worst, 0.0)
