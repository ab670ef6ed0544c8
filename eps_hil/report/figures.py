"""How this project's figures look, and how they reach a file."""

import importlib.util
from pathlib import Path
from typing import Any

from eps_hil.errors import InputError
from eps_hil.recordings.files import check_writable

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Okabe and Ito's palette: told apart by every eye and in grey print."""

SUFFIXES = (".png", ".svg", ".pdf")


def check(path: Path) -> None:
    """Refuse, before any work, a figure that could not be drawn or written after it."""
    if importlib.util.find_spec("matplotlib") is None:
        raise _extra_missing()
    if path.suffix.lower() not in SUFFIXES:
        raise _no_figure(path)
    check_writable(path)


def _extra_missing() -> InputError:
    remedy = 'pip install "eps_hil[report]"'
    return InputError("figure", "", "figures need the 'report' extra", remedy)


def _no_figure(path: Path) -> InputError:
    return InputError(path, "", "not a kind of figure", f"name it {', '.join(SUFFIXES)}")


def subplots(rows: int, columns: int, *, width_cm: float = 30.0, height_cm: float = 18.0) -> Any:
    """A matplotlib figure and its axes, shape (rows, columns), that needs no display."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise _extra_missing() from None
    figure = Figure(figsize=(width_cm / 2.54, height_cm / 2.54), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.grid(True, color="0.9", linewidth=0.8)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    return figure, axes


def save(figure: Any, path: str | Path, *, dpi: int = 110) -> Path:
    """Write the figure; :class:`InputError` for a suffix or folder that will not do."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise _no_figure(path)
    try:
        figure.savefig(path, dpi=dpi)
    except OSError as error:
        problem = f"cannot be written: {error.strerror or error}"
        raise InputError(path, "", problem, "choose another place") from None
    return path
