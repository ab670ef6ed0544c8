"""Pictures of a proof: who was taken for whom, stated confidence, concealment, the closed loop."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.proof.goals import Scored
from eps_hil.proof.judge import Judgement
from eps_hil.proof.plans import LEVELS
from eps_hil.proof.score import Share
from eps_hil.report import figures

_BLUE = figures.COLOURS[0]
_UNKNOWN, _NOTHING, _NO_ANSWER = "unknown", "nothing", "no answer"
_OTHERS = ("rates", "sizes", "behind")
_GROUPS = {"decoys": "(decoys)", "aliens": "(aliens)", "missing": "(family withheld)"}


def alone(judged: Sequence[Judgement]) -> tuple[str, ...]:
    """Kinds that hide one effect, which the recordings show: the singles, others without them."""
    kinds = {j.kind for j in judged}
    return ("singles",) if "singles" in kinds else tuple(k for k in _OTHERS if k in kinds)


def said(j: Judgement) -> str:
    """The first thing that a diagnosis said, in a word."""
    if not j.answered:
        return _NO_ANSWER
    return j.first or (_UNKNOWN if j.said_unknown else _NOTHING)


def confusion(judged: Sequence[Judgement], path: Path) -> Path:
    """Counts of hidden effect (rows) against the first name said (columns)."""
    pairs = [(j.truths[-1], said(j)) for j in judged if j.kind in alone(judged) and j.truths]
    groups = [(_GROUPS[j.kind], said(j)) for j in judged if j.kind in _GROUPS]
    hidden = sorted({truth for truth, _ in pairs})
    rows = hidden + [name for name in _GROUPS.values() if any(name == g for g, _ in groups)]
    names = {name for _, name in (*pairs, *groups)}
    last = [name for name in (_UNKNOWN, _NOTHING, _NO_ANSWER) if name in names]
    columns = sorted((names | set(hidden)) - set(last)) + last
    counts = np.zeros((len(rows), len(columns)), dtype=int)
    for truth, name in (*pairs, *groups):
        counts[rows.index(truth), columns.index(name)] += 1
    figure, axes = figures.subplots(
        1, 1, width_cm=9.0 + 0.75 * len(columns), height_cm=8.0 + 0.62 * len(rows)
    )
    axis = axes[0, 0]
    axis.grid(False)
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    if counts.size:
        axis.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            colour = "white" if share[row, column] > 0.6 else "black"
            axis.text(column, row, str(count), ha="center", va="center", color=colour, fontsize=8)
    axis.set_xticks(range(len(columns)), columns, rotation=90, fontsize=8)
    axis.set_yticks(range(len(rows)), rows, fontsize=8)
    axis.set_xlabel("first name that the diagnosis gave")
    axis.set_ylabel("hidden")
    axis.set_title("number of cases; blue: share of the row")
    return figures.save(figure, path)


def reliability(table: Sequence[tuple[float, float, int]], path: Path) -> Path:
    """How often findings were right, over the confidence that was stated."""
    figure, axes = figures.subplots(1, 1, width_cm=13.0, height_cm=12.0)
    axis = axes[0, 0]
    axis.plot([0, 1], [0, 1], color="0.6", linestyle="--", label="as stated")
    for stated, right, count in table:
        low, high = Share("", round(right * count), count).interval
        axis.errorbar(
            [stated],
            [right],
            [[max(right - low, 0.0)], [max(high - right, 0.0)]],
            color=figures.COLOURS[0],
            marker="o",
            capsize=3,
        )
        axis.annotate(f"{count}", (stated, right), xytext=(6, -12), textcoords="offset points")
    axis.plot([], [], "o", color=figures.COLOURS[0], label="found, 95 % interval, findings")
    axis.set_xlim(0, 1.03)
    axis.set_ylim(0, 1.03)
    axis.set_xlabel("stated confidence in the name")
    axis.set_ylabel("share of findings that are hidden effects")
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    return figures.save(figure, path)


def concealment(lines: Sequence[dict[str, Any]], judged: Sequence[Judgement], path: Path) -> Path:
    """How well the cases hide what is in them, and who finds it nevertheless."""
    figure, axes = figures.subplots(1, 3, width_cm=34.0, height_cm=11.0)
    singles = [k for k, j in enumerate(judged) if j.kind in alone(judged)]
    for colour, level in zip(figures.COLOURS, LEVELS, strict=False):
        at = [lines[k]["answer"]["concealment"] for k in singles if judged[k].level == level]
        label = f"effect/noise {level:g}"
        for axis, name, bins in (
            (axes[0, 0], "wrong_model_fit_percent", np.linspace(90, 100, 41)),
            (axes[0, 1], "seconds_above_noise", np.linspace(0, 1, 21)),
        ):
            values = np.clip([one[name] for one in at], bins[0], bins[-1])
            axis.hist(values, bins=bins, histtype="step", color=colour, label=label, linewidth=1.5)
    axes[0, 0].set_xlabel("fit of the refitted wrong model in % (rms)")
    axes[0, 1].set_xlabel("share of seconds with the effect above the noise")
    for axis in axes[0, :2]:
        axis.set_ylabel("cases")
        axis.legend(loc="best")
    _named_first(axes[0, 2], judged)
    return figures.save(figure, path)


def _named_first(axis: Any, judged: Sequence[Judgement]) -> None:
    methods = (
        ("ERR", lambda j: j.naive_err[:1] == j.truths[-1:]),
        ("STLSQ", lambda j: j.naive_stlsq[:1] == j.truths[-1:]),
        ("eps-hil diagnose", lambda j: j.right_first),
    )
    kinds = alone(judged)
    at_level = {x: [j for j in judged if j.kind in kinds and j.level == x] for x in LEVELS}
    shown = [level for level in LEVELS if at_level[level]]
    for k, (name, hit) in enumerate(methods):
        for level in shown:
            place, at = LEVELS.index(level), at_level[level]
            share = Share("", sum(map(hit, at)), len(at))
            value, (low, high) = share.hits / share.cases, share.interval
            axis.bar(
                place + 0.27 * (k - 1),
                value,
                0.25,
                color=figures.COLOURS[k],
                yerr=[[max(value - low, 0.0)], [max(high - value, 0.0)]],
                capsize=3,
                label=name if level == shown[0] else None,
            )
    axis.set_xticks(range(len(LEVELS)), [f"{level:g}" for level in LEVELS])
    axis.set_xlabel("effect/noise")
    axis.set_ylabel("right name first, share of singles")
    axis.set_ylim(0, 1.25)
    if shown:
        axis.legend(loc="upper left", ncols=3, fontsize="small")


def closed_loop(cases: Sequence[Scored], path: Path) -> Path:
    """Rack-force error and torque residual with augmented and true model over those before."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    figure, axes = figures.subplots(1, 2, width_cm=28.0, height_cm=12.0)
    kinds = (*alone([one.judged for one in cases]), "pairs")
    known = [
        one
        for one in cases
        if {"baseline", "augmented", "oracle"} <= set(one.worth) and one.judged.kind in kinds
    ]
    titles = {
        "rack_force_rmse_n": "error of the rack-force estimate, moving, in N",
        "residual_nm": "torque residual, sliding, in mNm at the rotor",
    }
    for axis, (name, words) in zip(axes[0], titles.items(), strict=True):
        scale = 1e3 if name == "residual_nm" else 1.0
        for model, label, look in (
            ("oracle", "with the true model", {"marker": "o", "color": "0.6", "fillstyle": "none"}),
            ("augmented", "augmented by the diagnosis", {"marker": ".", "color": _BLUE}),
        ):
            points = [(o.worth["baseline"][name], o.worth[model][name]) for o in known]
            whole = scale * np.array([p for p in points if None not in p], float).reshape(-1, 2)
            axis.loglog(whole[:, 0], whole[:, 1], linestyle="", label=label, markersize=5, **look)
        low, high = axis.get_ylim()[0], axis.get_xlim()[1]
        axis.plot([low, high], [low, high], color="0.6", linestyle="--", label="no gain")
        for direction in (axis.xaxis, axis.yaxis):
            direction.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            direction.set_major_formatter(StrMethodFormatter("{x:g}"))
            direction.set_minor_formatter(NullFormatter())
        axis.set_title(words, fontsize="medium")
        axis.set_xlabel("with the baseline model")
        axis.set_ylabel("with the better model")
        axis.legend(loc="upper left")
    return figures.save(figure, path)
