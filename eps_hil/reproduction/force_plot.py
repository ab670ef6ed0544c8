"""Rack force over time with zooms, in the colours and labels that figs 10 to 12 share."""

from collections.abc import Sequence
from pathlib import Path

from eps_hil.report import figures
from eps_hil.reproduction.measures import Estimated
from eps_hil.reproduction.result import Table

STYLES = {
    "w/o FC": (figures.COLOURS[2], "w/o FC: no friction compensation"),
    "no exten": (figures.COLOURS[1], "no exten: without dead zone and limiter"),
    "2Q-fa": (figures.COLOURS[0], "2Q-fa"),
}


def draw(
    path: Path, made: Estimated, names: Sequence[str], zooms: Sequence[tuple[float, float]]
) -> Path:
    """The whole run above, its zooms below it side by side."""
    figure, axes = figures.subplots(2, len(zooms), width_cm=30.0, height_cm=18.0)
    grid = axes[0, 0].get_gridspec()
    for axis in axes[0]:
        axis.remove()
    whole = figure.add_subplot(grid[0, :])
    whole.grid(True, color="0.9", linewidth=0.8)
    whole.spines[["top", "right"]].set_visible(False)
    spans = [(float(made.time_s[0]), float(made.time_s[-1])), *zooms]
    for axis, (since, until) in zip([whole, *axes[1]], spans, strict=True):
        here = (made.time_s >= since) & (made.time_s <= until)
        for name, (colour, label) in STYLES.items():
            if name in names:
                axis.plot(
                    made.time_s[here], made.force_n[name][here], color=colour, linewidth=1.1,
                    label=label,
                )  # fmt: skip
        axis.plot(
            made.time_s[here], made.real_n[here], color="black", linewidth=1.0,
            linestyle=(0, (4, 2)), label="real (the plant's rack force)",
        )  # fmt: skip
        axis.set_xlim(since, until)
        axis.set_xlabel("time in s")
    whole.set_ylabel("rack force in N")
    axes[1, 0].set_ylabel("rack force in N")
    whole.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False, fontsize="small"
    )
    for axis, (since, until) in zip(axes[1], zooms, strict=True):
        whole.axvspan(since, until, color="0.92", zorder=0)
        axis.set_title(f"zoom: {since:.1f} to {until:.1f} s", fontsize="small", loc="left")
    return figures.save(figure, path)


def error_table(made: Estimated, title: str) -> Table:
    """Rms errors of every variant: overall, moving, at rest."""
    return Table(
        title,
        ("estimate", "overall in N", "moving in N", "at rest in N"),
        tuple(
            (name, made.rmse_n(name), made.rmse_n(name, made.moving),
             made.rmse_n(name, ~made.moving))
            for name in made.force_n
        ),
    )  # fmt: skip
