"""The population as one self-contained page: every quantity over its units, outliers, failures."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eps_hil.fleet.batch import Batch
from eps_hil.fleet.changed import NOTHING
from eps_hil.fleet.job import Row
from eps_hil.fleet.population import FEWEST, Quantity, population
from eps_hil.report import page
from eps_hil.unit_words import of

_MOST_LABELS = 40
_MOST_NOTES = 100
_MOST_UNITS = 20
"""Of very many that have one change in common, or none."""


def write(batch: Batch, path: Path, title: str) -> Path:
    """Write the page whole or not at all."""
    quantities = population(batch.rows)
    verdicts: dict[str, int] = {}
    for row in batch.rows:
        if (said := row.get("verdict")) and batch.changes is None:
            verdicts[said] = verdicts.get(said, 0) + 1
    html = page.fill(
        "population.html.jinja",
        package="eps_hil.fleet",
        title=title,
        css=page.asset("page.css"),
        recordings=len(batch.rows),
        units=len({row["unit"] for row in batch.rows}),
        failed=batch.failed,
        verdicts=verdicts,
        changes=None if batch.changes is None else _changes(batch.rows),
        notes=_notes(batch.rows),
        noted=sum(bool(row.get("notes")) for row in batch.rows),
        undated=sum(row["state"] == "done" and row["start_s"] is None for row in batch.rows),
        quantities=[(one, _figure(one)) for one in quantities],
        outliers=[(one, p) for one in quantities for p in one.points if p.outlier],
    )
    page.write(path, html)
    return path


def _changes(rows: Sequence[Row]) -> dict[str, Any]:
    """Of units in two states: which change how many of them have, each of its numbers, and of how
    many nothing is told.
    """
    every = [(row["unit"], one) for row in rows for one in row["changes"]]
    units: dict[tuple[str, str], list[str]] = {}
    for unit, one in every:
        of_it = units.setdefault((one["effect"], one["change"]), [])
        if unit not in of_it:
            of_it.append(unit)
    nothing = units.pop(("", NOTHING), [])
    summary = sorted(units.items(), key=lambda item: (-len(item[1]), item[0]))
    return {
        "done": sum(row["state"] == "done" for row in rows),
        "nothing": (len(nothing), _some(nothing)),
        "summary": [(*what, len(of_it), _some(of_it)) for what, of_it in summary],
        "numbers": [(unit, one) for unit, one in every if one["change"] != NOTHING],
    }


def _some(units: Sequence[str]) -> str:
    more = len(units) - _MOST_UNITS
    return ", ".join(units[:_MOST_UNITS]) + (f" and {more} more" if more > 0 else "")


def _notes(rows: Sequence[Row]) -> list[tuple[str, list[str]]]:
    """What the reader said, the most frequent first, and of which recordings."""
    found: dict[str, list[str]] = {}
    for row in rows:
        for note in row.get("notes", ()):
            found.setdefault(note, []).append(row["recording"])
    return sorted(found.items(), key=lambda item: -len(item[1]))[:_MOST_NOTES]


def _figure(quantity: Quantity) -> str:
    """Values with their intervals, unit by unit, in each by time; the band is the population."""
    from eps_hil.report import figures

    figure, axes = figures.subplots(1, 1, width_cm=24.0, height_cm=7.0)
    axis = axes[0, 0]
    points = quantity.points
    reach = 3.5 * quantity.spread
    if len(quantity.points) >= FEWEST:  # of fewer, none is called an outlier
        axis.axhspan(quantity.middle - reach, quantity.middle + reach, color="0.92", lw=0)
    axis.axhline(quantity.middle, color="0.6", lw=0.8)
    for outlier in (False, True):
        colour = figures.COLOURS[int(outlier)]
        mine = [(k, point) for k, point in enumerate(points) if point.outlier == outlier]
        bars = [(k, p.low, p.high) for k, p in mine if p.low is not None and p.high is not None]
        if bars:
            axis.vlines(*zip(*bars, strict=True), color=colour, lw=0.9)
        axis.plot([k for k, _ in mine], [p.value for _, p in mine], ".", color=colour, ms=4)
    first, labels = _units([point.unit for point in points])
    axis.set_xticks(first, labels, rotation=60 if len(labels) > 8 else 0, fontsize="small")
    axis.set(ylabel=f"{quantity.name} in {of(quantity.si)}".removesuffix(" in "))
    text = io.StringIO()
    figure.savefig(text, format="svg", bbox_inches="tight")
    svg = text.getvalue()
    return svg[svg.index("<svg") :]


def _units(units: Sequence[str]) -> tuple[list[int], list[str]]:
    """Where each unit begins, and its name; every n-th of very many."""
    first = [k for k, unit in enumerate(units) if k == 0 or units[k - 1] != unit]
    step = -(-len(first) // _MOST_LABELS)
    return first[::step], [units[k] for k in first[::step]]
