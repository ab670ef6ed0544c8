"""The observer's noise over its delay, with its bandwidth, and the present setting marked."""

from collections.abc import Callable, Sequence
from pathlib import Path

from eps_hil.estimation.tuning import Point
from eps_hil.report import figures

_AXES: tuple[tuple[str, Callable[[Point], float]], ...] = (
    ("delay of observer and low-pass in ms", lambda p: 1e3 * p.delay_s),
    ("bandwidth (−3 dB) in Hz", lambda p: p.bandwidth_hz),
)
_LINES: tuple[tuple[str, str, Callable[[Point], float]], ...] = (
    ("noise", "-", lambda p: p.noise_n),
    ("from the speed", "--", lambda p: p.speed_share_n),
    ("from the torque", ":", lambda p: p.torque_share_n),
)


def draw(
    points: Sequence[Point],
    now: Point,
    checked: Sequence[tuple[Point, float]],
    origin: str,
    path: str | Path,
) -> Path:
    """Left: N rms over ms; right: N rms over the −3 dB bandwidth. ``checked``: by simulation."""
    from matplotlib.ticker import LogLocator, NullFormatter

    figure, axes = figures.subplots(1, 2, width_cm=28.0, height_cm=12.0)
    hollow = {"color": figures.COLOURS[0], "markerfacecolor": "white", "label": "by simulation"}
    for axis, (label, value) in zip(axes[0], _AXES, strict=True):
        for k, (name, style, height) in enumerate(_LINES):
            x, y = [value(p) for p in points], [height(p) for p in points]
            axis.plot(x, y, linestyle=style, color=figures.COLOURS[k], label=name)
        axis.plot([value(p) for p, _ in checked], [found for _, found in checked], "o", **hollow)
        axis.plot(value(now), now.noise_n, "*", color="black", markersize=13, label="now")
        axis.set_xscale("log")
        axis.set_yscale("log")
        for side in (axis.xaxis, axis.yaxis):
            side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            side.set_major_formatter("{x:g}")
            side.set_minor_formatter(NullFormatter())
        axis.set_xlabel(label)
        axis.set_ylabel("noise of the rack force in N rms")
        axis.grid(True, which="minor", color="0.95", linewidth=0.5)
    axes[0, 0].legend(fontsize="small")
    figure.suptitle(f"observer: bandwidth against noise; noise from {origin}", fontsize="medium")
    return figures.save(figure, path)
