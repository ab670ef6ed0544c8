#!/usr/bin/env python3
"""Put what ``eps-hil reproduce`` made into docs/paper-reproduced.md and docs/images.

eps-hil reproduce --out reproduction --json reproduction/numbers.json
scripts/paper_reproduced.py reproduction
"""

import json
import re
import sys
from pathlib import Path
from typing import Any

from PIL import Image

from eps_hil.reproduction.result import shown

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "paper-reproduced.md"
MARKERS = tuple(
    f"<!-- made by scripts/paper_reproduced.py: {word} -->" for word in ("begin", "end")
)

SHOWN = (
    "parameters of eq. 3, from the constant-speed passes",
    "rms error against the real rack force",
)
"""Tables of the page; the run's own page and JSON hold all."""

DRAWN = ("95 % half width", "off by %")
"""Columns that the picture beside the table shows."""


def main() -> None:
    """Fill the page from the folder of a run."""
    folder = Path(sys.argv[1])
    content = json.loads((folder / "numbers.json").read_text(encoding="utf-8"))
    lines = _verdicts(content)
    for key, figure in content["figures"].items():
        lines += _figure(key, figure)
        _picture(folder / figure["picture"], ROOT / "docs" / "images" / f"paper_{key}.png")
    text = PAGE.read_text(encoding="utf-8")
    begin, end = MARKERS
    made = "\n".join([begin, "", *lines, end])
    pattern = re.compile(re.escape(begin) + ".*" + re.escape(end), re.DOTALL)
    PAGE.write_text(pattern.sub(lambda _: made, text), encoding="utf-8")


def _verdicts(content: dict[str, Any]) -> list[str]:
    """How many statements agree, and those that do not, with what was measured."""
    counts = ", ".join(f"{count} {word}" for word, count in content["outcomes"].items())
    lines = [f"Statements, seed {content['seed']}: {counts}. Not, or partly:", ""]
    for figure in content["figures"].values():
        for one in figure["statements"]:
            if one["outcome"] != "agrees":
                lines.append(
                    f"- {one['claim']} ({one['outcome']}): {one['measure']} {_number(one)};"
                    f" {one['remark']}"
                )
    return [*lines, ""]


def _number(one: dict[str, Any]) -> str:
    unit = f" {one['unit']}" if one["unit"] else ""
    value = "–" if one["value"] is None else f"{one['value']:.3g}"
    sign = {"at least": "≥", "at most": "≤"}[one["limit_is"]]
    return f"{value} where it should be {sign} {one['agrees_limit']:.3g}{unit}"


def _figure(key: str, figure: dict[str, Any]) -> list[str]:
    outcomes = [one["outcome"] for one in figure["statements"]]
    agree = f"{outcomes.count('agrees')} of {len(outcomes)} agree"
    title = figure["title"].split(",")[0]
    lines = [f"## {title}: {agree}", "", f"![{key}](images/paper_{key}.png)", ""]
    for table in figure["tables"]:
        if table["title"] not in SHOWN:
            continue
        columns = tuple(name for name in table["rows"][0] if name not in DRAWN)
        rows = [tuple(_cell(row[column]) for column in columns) for row in table["rows"]]
        lines += [f"**{table['title']}**", "", *_table(columns, rows)]
    return lines


def _cell(value: Any) -> str:
    return "–" if value is None else shown(value)


def _table(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    def line(cells: tuple[str, ...]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return [line(columns), "|" + "---|" * len(columns), *map(line, rows), ""]


def _picture(source: Path, target: Path) -> None:
    with Image.open(source) as picture:
        picture.convert("RGB").quantize(128).save(target, optimize=True)


if __name__ == "__main__":
    main()
