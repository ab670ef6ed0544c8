"""The picture of the adaptation study: convergence, spread, drift, violated assumptions."""

from pathlib import Path
from typing import Any

import numpy as np

COLOURS = {
    "torque injection": "#1f77b4",
    "error injection": "#ff7f0e",
    "reversal": "#2ca02c",
    "reversal, load cell": "#9467bd",
}


def draw(
    path: Path,
    found: list[Any],
    levels: dict[str, np.ndarray],
    tracks: dict[str, np.ndarray],
) -> None:
    """Four panels into a PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11, 7.5), constrained_layout=True)
    _convergence(axes[0, 0], tracks)
    _units(axes[0, 1], found)
    _drift(axes[1, 0], levels)
    _violated(axes[1, 1], found)
    figure.savefig(path, dpi=90)


def _convergence(ax: Any, tracks: dict[str, np.ndarray]) -> None:
    for name, track in tracks.items():
        if name == "reversal":
            ax.step(track[:, 0], 100 * track[:, 3], color=COLOURS[name], where="post",
                    label="reversal: sum")  # fmt: skip
            continue
        for column, style, sign in ((1, "-", "k0+"), (2, "--", "k0−")):
            ax.step(track[:, 0], 100 * track[:, column], style, color=COLOURS[name], where="post",
                    label=f"{name}: {sign}")  # fmt: skip
    ax.axhspan(-3, 3, color="0.9", zorder=0)
    ax.set(xlabel="time of the course, s", ylabel="error, %", ylim=(-45, 70),
           title="One gear, 40 % off both ways")  # fmt: skip
    ax.legend(fontsize=8)


def _units(ax: Any, found: list[Any]) -> None:
    bins = np.linspace(-6, 6, 61)
    shown = (
        ("parked, hands off", "torque injection", ("positive", "negative"), "k0±"),
        ("near centre, no load", "error injection", ("positive", "negative"), "k0±"),
        ("driving, smooth road", "reversal", ("total",), "sum"),
    )
    for case, method, names, what in shown:
        values = [
            100 * getattr(o, name)
            for o in found
            if (o.case, o.method) == (case, method) and o.claimed
            for name in names
        ]
        ax.hist(np.clip(values, bins[0], bins[-1]), bins, histtype="step", lw=1.5,
                color=COLOURS[method], label=f"{method}, {what}: {case}")  # fmt: skip
    ax.axvspan(-3, 3, color="0.9", zorder=0)
    ax.set(xlabel="error after adaptation, %", ylabel="levels, or sums",
           title="Gears with ±40 % friction spread, two rigs")  # fmt: skip
    ax.set_ylim(0, 1.35 * ax.get_ylim()[1])
    ax.legend(fontsize=8, loc="upper left")


def _drift(ax: Any, levels: dict[str, np.ndarray]) -> None:
    def total(name: str) -> np.ndarray:
        return np.asarray(1e3 * levels[name][:, 1:].sum(axis=1))

    ax.plot(levels["truth"][:, 0], total("truth"), "k-", lw=2, label="truth")
    for name, marker in (("torque injection", "o"), ("error injection", "-"), ("reversal", "--")):
        ax.plot(levels[name][:, 0], total(name), marker, color=COLOURS[name], label=name)
    ax.set(xlabel="time, min", ylabel="k0+ + k0−, mNm", ylim=(0, None),
           title="Friction that loses 35 % in an hour")  # fmt: skip
    ax.legend(fontsize=8)


def _violated(ax: Any, found: list[Any]) -> None:
    rows = [
        (case, method)
        for case, method in dict.fromkeys((o.case, o.method) for o in found)
        if any(word in case for word in ("40 N", "spring", "rms", "alone"))
        and (method == "torque injection" or _stood(found, case, method))
    ]
    for place, (case, method) in enumerate(reversed(rows)):
        group = [o for o in found if (o.case, o.method) == (case, method)]
        for one in group:
            value = one.total if method == "reversal" else _largest(one)
            ax.plot(100 * value, place, "o" if one.claimed else "x", color=COLOURS[method],
                    ms=4, alpha=0.6)  # fmt: skip
    ax.set_yticks(range(len(rows)), [f"{case}: {method}" for case, method in reversed(rows)],
                  fontsize=7)  # fmt: skip
    ax.axvspan(-3, 3, color="0.9", zorder=0)
    ax.set(xlabel="largest error, % (● claimed, × not claimed)",
           title="Assumptions violated")  # fmt: skip


def _stood(found: list[Any], case: str, method: str) -> bool:
    return any(o.claimed for o in found if (o.case, o.method) == (case, method))


def _largest(one: Any) -> float:
    return max((one.positive, one.negative), key=abs)
