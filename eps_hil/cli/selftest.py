"""``eps-hil selftest``: is this PC good enough for a 1 kHz rig (CONTRACT 6)."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eps_hil.selftest.check import Check


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("selftest")(selftest)


def selftest(
    config: Path = typer.Option(None, help="Measure with this configuration, and on its bus."),
    seconds: float = typer.Option(3.0, min=0.1, max=3600.0, help="Length of each timing."),
    quick: bool = typer.Option(False, "--quick", help="Short timings; for a first look."),
    folder: Path = typer.Option(Path(), help="Where recordings will be written."),
    json: Path = typer.Option(None, help="Write the lines to this file."),
    strict: bool = typer.Option(False, "--strict", help="'limited' is not good enough either."),
) -> None:
    """Is this PC good enough for a 1 kHz rig, and what to change.

    Status 0: good enough ("good" or "limited"); 1: not. Nothing is sent on a bus, nothing is
    changed on the machine.
    """
    from rich.console import Console

    from eps_hil.cli._files import check_kept, write_json
    from eps_hil.selftest.check import Verdict, overall
    from eps_hil.selftest.run import Plan, checks

    check_kept((json,), (config,))
    live = sys.stderr.isatty()

    def began(what: str) -> None:
        if live:
            sys.stderr.write(f"\r\x1b[2Kmeasuring: {what}")
            sys.stderr.flush()

    lines = list(checks(Plan(config, seconds, folder, quick), began))
    if live:
        sys.stderr.write("\r\x1b[2K")
    verdict = overall(lines)
    width = None if sys.stdout.isatty() else 120
    show(Console(width=width, highlight=False, soft_wrap=False), lines, verdict)
    if json is not None:
        write_json(json, content(lines, verdict, seconds, quick))
    if verdict in {Verdict.NOT_GOOD, Verdict.UNKNOWN} or (strict and verdict != Verdict.GOOD):
        raise typer.Exit(1)


def content(
    lines: "Sequence[Check]", verdict: str, seconds: float, quick: bool
) -> dict[str, object]:
    """What ``--json`` writes."""
    from dataclasses import asdict
    from datetime import UTC, datetime

    return {
        "schema": "eps-hil/selftest/1",
        "utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "verdict": str(verdict),
        "seconds": seconds,
        "quick": quick,
        "checks": [asdict(line) for line in lines],
    }


_COLOURS = {"good": "green", "limited": "yellow", "not good": "bold red", "unknown": "cyan"}


def show(console: object, lines: "Sequence[Check]", verdict: str) -> None:
    """The table, what to change, and the verdict in one line."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    assert isinstance(console, Console)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("what", max_width=36)
    table.add_column("measured", overflow="fold")
    table.add_column("limit", max_width=24)
    table.add_column("verdict", no_wrap=True)
    for line in lines:
        told = "" if line.verdict == "told" else str(line.verdict)
        cells = (line.what, line.measured, line.limit, told)
        table.add_row(*(Text(cell, style=_COLOURS.get(told, "") if cell is told else "")
                        for cell in cells))  # fmt: skip
    console.print(table)
    wanting = [line for line in lines if line.verdict in {"limited", "not good", "unknown"}]
    if wanting:
        console.print("\nwhat to change, and why")
    for line in wanting:
        console.print(Text(f"  {line.what}: {line.remedy or 'see the reason'}"))
        if line.reason:
            console.print(Text(f"    {line.reason}", style="dim"))
    meaning = {
        "good": "this PC is good enough for a 1 kHz rig",
        "limited": "good enough for a 1 kHz rig, with the limits above",
        "not good": "NOT good enough for a 1 kHz rig",
        "unknown": "nothing could be measured",
    }[verdict]
    console.print(Text(f"\n{verdict}: {meaning}", style=_COLOURS[verdict]))
