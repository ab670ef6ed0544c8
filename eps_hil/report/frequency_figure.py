"""Frequency responses as pictures: magnitude, phase, coherence of each output (paper, fig. 5)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.identification.frequency_response import OUTPUTS, Response, coherence_limit
from eps_hil.report import figures

_UNITS = {
    "motor_speed_rad_s": "rad/s per Nm",
    "rack_position_m": "m per Nm",
    "steering_wheel_speed_rad_s": "rad/s per Nm",
    "rack_force_n": "N per Nm",
}
_COLOURS = {order: figures.COLOURS[(order + 2) % 6] for order in range(1, 6)}


def draw(
    measured: Mapping[str, Response],
    chains: Mapping[int, Mapping[str, Response]],
    path: str | Path,
    *,
    title: str = "",
) -> Path:
    """One column an output; the measurement with its 95 % band, one line a chain."""
    names = list(measured)
    figure, axes = figures.subplots(3, len(names), width_cm=3.0 + 8.5 * len(names), height_cm=20.0)
    for column, name in enumerate(names):
        one = measured[name]
        _measured(axes[:, column], one)
        for order, found in sorted(chains.items()):
            if name in found:
                _chain(axes[:, column], found[name], order, one.trusted)
        axes[0, column].set_title(OUTPUTS[name], fontsize="medium")
        axes[0, column].set_ylabel(_UNITS[name])
        # a single trusted line between others is not drawn as a line either
        beside = np.convolve(one.trusted, [1, 0, 1], mode="same") > 0
        shown = np.abs(one.gain)[one.trusted & beside]
        axes[0, column].set_ylim(bottom=0.0, top=1.3 * float(shown.max()) if shown.size else None)
        axes[2, column].set_ylim(0.0, 1.05)
        axes[2, column].set_xlabel("frequency in Hz")
    axes[1, 0].set_ylabel("phase in degrees")
    axes[2, 0].set_ylabel("coherence")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=7, frameon=False)
    if title:
        figure.suptitle(title)
    return figures.save(figure, path)


def _measured(column: Any, one: Response) -> None:
    hertz, keep = one.frequency_hz, one.trusted
    low, high = one.magnitude_band
    size = np.where(keep, np.abs(one.gain), np.nan)
    phase = np.where(keep, one.phase_deg, np.nan)
    style = {"color": "black", "linewidth": 1.6}
    column[0].fill_between(hertz, low, high, where=keep, color="0.85", label="95 % band")
    column[0].plot(hertz, size, **style, label="measured")
    wide = one.phase_band_deg
    column[1].fill_between(hertz, phase - wide, phase + wide, where=keep, color="0.85")
    column[1].plot(hertz, phase, **style)
    column[2].plot(hertz, one.coherence, **style)
    column[2].axhline(coherence_limit(one.averages), color="0.5", linestyle=(0, (2, 2)))


def _chain(column: Any, one: Response, order: int, keep: npt.NDArray[np.bool_]) -> None:
    """The model where the measurement is trusted: elsewhere nothing excites either of them."""
    label = f"{order} mass" if order == 1 else f"{order} masses"
    style = {"color": _COLOURS[order], "linewidth": 1.1, "linestyle": (0, (5, order))}
    column[0].plot(one.frequency_hz, np.where(keep, np.abs(one.gain), np.nan), **style, label=label)
    column[1].plot(one.frequency_hz, np.where(keep, one.phase_deg, np.nan), **style)
