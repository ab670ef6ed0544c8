"""The budget as bars: sources by phase, with total, root of squares and the method's own error."""

from pathlib import Path

import numpy as np

from eps_hil.budget.budget import PHASES, Budget
from eps_hil.budget.sources import Group
from eps_hil.report import figures

_MOST = 14


def draw(found: Budget, path: str | Path, title: str) -> Path:
    """One panel a phase, its largest sources from the top; N rms at the rack."""
    figure, axes = figures.subplots(1, len(PHASES), width_cm=36.0, height_cm=16.0)
    colours = {group.value: figures.COLOURS[k % 6] for k, group in enumerate(Group)}
    hatches = {group.value: "" if k < 6 else "///" for k, group in enumerate(Group)}
    used = []
    for axis, phase in zip(axes[0], PHASES, strict=True):
        lines = [line for line in found.sources if np.isfinite(line.alone_n[phase])]
        lines = sorted(lines, key=lambda line: line.alone_n[phase], reverse=True)[:_MOST]
        for row, line in enumerate(lines):
            group = line.source.group.value if line.source else ""
            label = group if group not in used else None
            used.append(group)
            axis.barh(row, line.alone_n[phase], color=colours[group], hatch=hatches[group],
                      edgecolor="white", label=label)  # fmt: skip
        axis.set_yticks(range(len(lines)), [line.name for line in lines], fontsize="small")
        axis.invert_yaxis()
        for value, style, name in (
            (found.total_n[phase], "-", "all together"),
            (found.root_sum_n[phase], ":", "root of squares"),
            (found.method_n[phase], "--", "method itself"),
        ):
            if np.isfinite(value):
                label = f"{name}: {value:.1f} N"
                axis.axvline(value, color="black", linestyle=style, linewidth=1.0, label=label)
        share = 100 * found.share[phase]
        axis.set_title(f"{phase} ({share:.0f} % of the time)", fontsize="medium", loc="left")
        axis.set_xlabel("error in N rms at the rack")
        if not lines:
            continue
        axis.legend(fontsize="x-small", loc="lower right", frameon=True, framealpha=0.9)
        axis.set_xlim(left=0.0)
    figure.suptitle(title, fontsize="medium")
    return figures.save(figure, path)
