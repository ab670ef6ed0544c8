"""Rack force over a whole manoeuvre and in zooms, by variant, as the paper's fig. 11 has it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.physics.model import Model
from eps_hil.report import figures
from eps_hil.report.comparison import LIVE, Candidate
from eps_hil.series import Series

_LABELS = {
    LIVE: "2Q-fa, published live",
    "2Q-fa": "2Q-fa",
    "no exten": "2Q-fa, no dead zone and limiter",
    "w/o FC": "without friction compensation",
    "bristle filter": "bristle filter",
    "smoother": "smoother",
}
_STYLES = {
    "w/o FC": {"color": figures.COLOURS[2], "linewidth": 1.0},
    "no exten": {"color": figures.COLOURS[1], "linewidth": 1.0},
    "2Q-fa": {"color": figures.COLOURS[0], "linewidth": 1.3},
    LIVE: {"color": figures.COLOURS[0], "linewidth": 1.3},
    "smoother": {"color": figures.COLOURS[4], "linewidth": 1.0},
    "bristle filter": {"color": figures.COLOURS[3], "linewidth": 1.1},
}
_REAL = {"color": "black", "linewidth": 1.0, "linestyle": (0, (4, 2)), "label": "load cell"}

Zoom = tuple[float, float]


def draw(
    candidates: Sequence[Candidate],
    load_cell: Series,
    model: Model,
    path: str | Path,
    *,
    begin_ns: int,
    zooms: Sequence[Zoom] = (),
    title: str = "",
) -> Path:
    """As :func:`figure`, to a file."""
    drawn = figure(candidates, load_cell, model, begin_ns=begin_ns, zooms=zooms, title=title)
    return save(drawn, path)


def save(drawn: Any, path: str | Path) -> Path:
    """Write the figure; a PNG in few colours."""
    where = figures.save(drawn, path)
    if where.suffix.lower() == ".png":
        _shrink(where)
    return where


def figure(
    candidates: Sequence[Candidate],
    load_cell: Series,
    model: Model,
    *,
    begin_ns: int,
    zooms: Sequence[Zoom] = (),
    title: str = "",
) -> Any:
    """One panel over everything and one for each zoom (from, to; s after ``begin_ns``).

    A live estimate takes the place of the same estimate computed afterwards.
    """
    shown = {one.name: one for one in candidates}
    if LIVE in shown:
        shown.pop("2Q-fa", None)
    panels = 1 + len(zooms)
    drawn, axes = figures.subplots(panels, 1, width_cm=25.0, height_cm=2.0 + 7.5 * panels)
    whole = (0.0, (int(load_cell.t_ns[-1]) - begin_ns) * 1e-9)
    for axis, (since, until) in zip(axes[:, 0], (whole, *zooms), strict=True):
        for name in _STYLES:
            if name in shown:
                _plot(axis, shown[name], begin_ns, since, until)
        cell_ns = load_cell.t_ns - round(model.delays_s.of("rack_force_n") * 1e9)
        _line(axis, cell_ns, load_cell.value, begin_ns, (since, until), _REAL)
        axis.set_xlim(since, until)
        axis.set_ylabel("rack force in N")
    axes[0, 0].legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False, fontsize="small"
    )
    for axis, zoom in zip(axes[1:, 0], zooms, strict=True):
        axes[0, 0].axvspan(*zoom, color="0.92", zorder=0)
        axis.set_title(f"{zoom[0]:g} to {zoom[1]:g} s", fontsize="small", loc="left")
    axes[-1, 0].set_xlabel("time in s")
    if title:
        drawn.suptitle(title)
    return drawn


def _shrink(path: Path) -> None:
    """To a palette: a third of the size for a report or a page, and lines lose nothing."""
    from PIL import Image

    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(256)
    small.save(path, optimize=True)


def _plot(axis: Any, one: Candidate, begin_ns: int, since: float, until: float) -> None:
    value = np.where(one.trace.valid, one.trace.rack_force_n, np.nan)
    style = _STYLES[one.name] | {"label": _LABELS[one.name]}
    _line(axis, one.trace.t_ns, value, begin_ns, (since, until), style)


def _line(axis: Any, t_ns: Any, value: Any, begin_ns: int, span: Zoom, style: Any) -> None:
    """Only what lies in the panel, so that its limits fit what it shows."""
    seconds = (t_ns - begin_ns) * 1e-9
    here = (seconds >= span[0]) & (seconds <= span[1])
    axis.plot(seconds[here], value[here], **style)
