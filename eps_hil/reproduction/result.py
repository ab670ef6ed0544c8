"""What one figure gives: a picture, tables of numbers, and the paper's statements judged by them.

A statement's outcome follows from a number and two limits; no verdict is written by hand.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any


class Outcome(StrEnum):
    """How a statement of the paper fares here."""

    AGREES = "agrees"
    PARTLY = "partly"
    DISAGREES = "does not agree"


@dataclass(frozen=True, slots=True)
class Statement:
    """One sentence of the paper, the number that tests it, its limits and the outcome.

    ``limits``: (agrees, partly). With ``at_most`` the number must not exceed them, otherwise it
    must reach them.
    """

    claim: str
    measure: str
    value: float
    unit: str
    limits: tuple[float, float]
    at_most: bool
    remark: str = ""

    @property
    def outcome(self) -> Outcome:
        """By the number alone; a number that is missing agrees with nothing."""
        if math.isnan(self.value):
            return Outcome.DISAGREES
        for limit, outcome in zip(self.limits, (Outcome.AGREES, Outcome.PARTLY), strict=True):
            if self.value <= limit if self.at_most else self.value >= limit:
                return outcome
        return Outcome.DISAGREES

    @property
    def sentence(self) -> str:
        """Measure, number and limit in words."""
        word = "at most" if self.at_most else "at least"
        unit = f" {self.unit}" if self.unit else ""
        agrees, partly = (f"{limit:.3g}{unit}" for limit in self.limits)
        return (
            f"{self.measure}: {self.value:.3g}{unit} "
            f"(agrees: {word} {agrees}; partly: {word} {partly})"
        )

    def content(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "claim": self.claim,
            "outcome": self.outcome.value,
            "measure": self.measure,
            "value": self.value,
            "unit": self.unit,
            "agrees_limit": self.limits[0],
            "partly_limit": self.limits[1],
            "limit_is": "at most" if self.at_most else "at least",
            "remark": self.remark,
        }


def at_most(
    claim: str, measure: str, value: float, unit: str, limits: tuple[float, float], remark: str = ""
) -> Statement:
    """A statement that holds while the number stays below its limits."""
    return Statement(claim, measure, float(value), unit, limits, True, remark)


def at_least(
    claim: str, measure: str, value: float, unit: str, limits: tuple[float, float], remark: str = ""
) -> Statement:
    """A statement that holds once the number reaches its limits."""
    return Statement(claim, measure, float(value), unit, limits, False, remark)


@dataclass(frozen=True, slots=True)
class Table:
    """Numbers beside a figure; the unit is in the heading of each column."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def cells(self) -> list[list[str]]:
        """Rows as text."""
        return [[shown(cell) for cell in row] for row in self.rows]

    def content(self) -> dict[str, Any]:
        """JSON-ready."""
        rows = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        return {"title": self.title, "rows": rows}


@dataclass(frozen=True, slots=True)
class Result:
    """One figure or table of the paper, made anew."""

    key: str
    title: str
    text: str
    tables: Sequence[Table]
    statements: Sequence[Statement]
    picture: Path | None = None

    def content(self) -> Mapping[str, Any]:
        """JSON-ready."""
        return {
            "title": self.title,
            "picture": self.picture.name if self.picture else None,
            "tables": [table.content() for table in self.tables],
            "statements": [statement.content() for statement in self.statements],
        }


def shown(cell: str | float) -> str:
    """A cell as text: four digits, and a dash where there is no number."""
    if isinstance(cell, str):
        return cell
    if math.isnan(cell):
        return "–"
    if cell == 0.0:
        return "0"
    size = abs(cell)
    if size >= 1e5 or size < 1e-3:
        return f"{cell:.3e}"
    return f"{cell:.4g}"
