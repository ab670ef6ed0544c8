"""The friction map, measured against its fit (like figs 4 and 7 of the seed paper)."""

import io
from typing import Any

import numpy as np

from eps_hil.identification.result import Identification
from eps_hil.physics.friction import friction_law, static_level_nm
from eps_hil.report.figures import COLOURS, subplots

FEWEST_S = 0.3
"""Cells with less steady sliding than this are not drawn."""


def figure(found: Identification) -> Any:
    """Friction torque over speed, one colour a load, and over load, one colour a speed."""
    figure, axes = subplots(1, 2, width_cm=30.0, height_cm=12.0)
    _over_speed(axes[0, 0], found)
    _over_load(axes[0, 1], found)
    return figure


def svg(found: Identification) -> str:
    """The figure as an SVG element for a page."""
    text = io.StringIO()
    figure(found).savefig(text, format="svg")
    whole = text.getvalue()
    return whole[whole.index("<svg") :]


def _cells(found: Identification) -> list[Any]:
    return [cell for cell in found.map.cells if cell.seconds >= FEWEST_S]


def _over_speed(axis: Any, found: Identification) -> None:
    cells = _cells(found)
    law = friction_law(found.model.friction)
    ranges = sorted({cell.load_range for cell in cells})
    for colour, one in zip(_colours(len(ranges)), ranges, strict=True):
        mine = [cell for cell in cells if cell.load_range == one]
        load = float(np.mean([cell.load_n for cell in mine]))
        _points(axis, [cell.speed_rad_s for cell in mine], mine, colour, f"{load:.0f} N")
        for sign in (-1.0, 1.0):
            sizes = [abs(c.speed_rad_s) for c in mine if np.sign(c.speed_rad_s) == sign]
            if not sizes:
                continue
            speeds = sign * np.linspace(min(sizes), max(sizes), 40)
            levels = [sign * static_level_nm(w, load, law) for w in speeds]
            axis.plot(speeds, levels, color=colour, linewidth=1.2)
    axis.set_xlabel("rotor speed, rad/s")
    axis.set_ylabel("friction torque at the rotor, Nm")
    axis.set_xscale("symlog", linthresh=10.0)
    axis.set_title("over speed; points: measured (2Q-map), lines: eq. 3 (2Q-fa)", fontsize=10)
    axis.legend(title="mean |rack force|", fontsize=8, ncols=2)


def _over_load(axis: Any, found: Identification) -> None:
    cells = _cells(found)
    law = friction_law(found.model.friction)
    ranges = sorted({cell.speed_range for cell in cells})
    for k, (colour, one) in enumerate(zip(_colours(len(ranges)), ranges, strict=True)):
        marker = "o" if k < len(COLOURS) else "s"
        label = f"{one[0]:g} to {one[1]:g}"
        for sign in (-1.0, 1.0):
            mine = [c for c in cells if c.speed_range == one and np.sign(c.speed_rad_s) == sign]
            if not mine:
                continue
            speed = float(np.mean([c.speed_rad_s for c in mine]))
            _points(axis, [c.load_n for c in mine], mine, colour, label, marker)
            label = ""
            loads = np.linspace(min(c.load_n for c in mine), max(c.load_n for c in mine), 20)
            levels = [sign * static_level_nm(speed, load, law) for load in loads]
            axis.plot(loads, levels, color=colour, linewidth=1.2)
    axis.set_xlabel("|rack force|, N")
    axis.set_ylabel("friction torque at the rotor, Nm")
    axis.set_title("over load; above zero: positive speed, below: negative", fontsize=10)
    axis.legend(title="|rotor speed|, rad/s", fontsize=8, ncols=2)


def _points(
    axis: Any, x: list[float], cells: list[Any], colour: str, label: str, marker: str = "o"
) -> None:
    sign = [np.sign(cell.speed_rad_s) for cell in cells]
    y = [s * cell.friction_nm for s, cell in zip(sign, cells, strict=True)]
    half = [0.0 if c.ci95 is None else 0.5 * (c.ci95[1] - c.ci95[0]) for c in cells]
    axis.errorbar(
        x, y, yerr=half, fmt=marker, markersize=4, color=colour, capsize=2, label=label or None
    )


def _colours(count: int) -> list[str]:
    return [COLOURS[k % len(COLOURS)] for k in range(count)]
