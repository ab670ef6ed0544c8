#!/usr/bin/env python3
"""All speed figures in one run, as a page: `docs/speed.md`.

    python benchmarks/speed_page.py --out docs/speed.md
    python benchmarks/speed_page.py --only candump blf

Each row is a command of this folder with its peer in the same run; what it printed stands below the
table. A row whose command fails says so and stays. Takes about ten minutes on two cores, which
should have nothing else to do.
"""

import argparse
import os
import platform
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from eps_hil.version import VERSION

HERE = Path(__file__).resolve().parent


class Row(NamedTuple):
    """One figure: where it is found in what its command prints, and what it is measured against.

    ``goal``: the figure at which it is reached; ``more``: whether more is better.
    """

    name: str
    what: str
    peer: str
    command: str
    figure: str
    unit: str
    goal: float
    more: bool
    limit: str


ROWS = (
    Row(
        "estimator", "batch estimator, 624 s in memory", "the same by hand in C, -O3",
        "batch_estimator.py --seconds 624", r"ratio ([\d.]+)", "times its time", 1.5, False,
        "checks of plausibility, holes and torque jumps, which the C program does not have",
    ),
    Row(
        "candump", "candump log to signals, counters and CRC checked",
        "python-can and cantools, unchecked",
        "decode_log.py --seconds 120", r"ratio ([\d.]+)", "times as fast", 20.0, True,
        "reading characters: the text is three times as long as what it says",
    ),
    Row(
        "blf", "BLF to signals, counters and CRC checked", "python-can and cantools, unchecked",
        "decode_log.py --seconds 120 --suffix .blf", r"ratio ([\d.]+)", "times as fast", 10.0, True,
        "zlib",
    ),
    Row(
        "mf4", "MF4 bus logging to signals, counters and CRC checked",
        "asammdf extract_bus_logging, unchecked",
        "decode_log.py --seconds 300 --suffix .mf4", r"ratio ([\d.]+)", "times as fast", 1.0, True,
        "asammdf reads the records for both",
    ),
    Row(
        "csv", "`estimate` on a CSV of 624 s", "pyarrow's read and write of the same tables",
        "estimate_csv.py", r"ratio ([\d.]+)", "times its time", 2.0, False,
        "stamps kept to the nanosecond, each cell checked, and the estimate itself",
    ),
    Row(
        "first", "first `estimate` after installation", "–",
        "first_estimate.py", r"first +([\d.]+) s", "s", 5.0, False,
        "compiling; later ones find it in the cache",
    ),
    Row(
        "latency", "sync frame to estimate frame, p50", "bare python-can loop",
        "latency.py", r"ratio +([\d.]+)", "times its time", 2.0, False,
        "decoding, checks and encoding in Python around the compiled step",
    ),
    Row(
        "diagnose", "diagnosis of 60 min in 78 recordings", "–",
        "diagnose_cost.py --minutes 60", r"min: +([\d.]+) s wall", "s", 20.0, False,
        "the search for physics without a name on what is left",
    ),
    Row(
        "fleet", "`batch estimate` of 2,000 recordings of 20 s on all cores", "one process",
        "fleet.py --recordings 2000 --seconds 20", r"speed-up a core ([\d.]+)",
        "of each core used", 0.9, True,
        "starting a process, and the memory that both cores share",
    ),
)  # fmt: skip


class Told(NamedTuple):
    """What a command printed, its figure (None: it failed) and how long it took."""

    row: Row
    text: str
    figure: float | None
    seconds: float


def measured(row: Row) -> Told:
    """Run a row's command."""
    begun = time.perf_counter()
    words = row.command.split()
    done = subprocess.run(
        [sys.executable, str(HERE / words[0]), *words[1:]],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    found = re.search(row.figure, done.stdout)
    return Told(
        row, done.stdout.strip(), float(found[1]) if found else None, time.perf_counter() - begun
    )


def page(told: list[Told]) -> str:
    """The page, in Markdown."""
    lines = [
        "# Speed, measured",
        "",
        "Made by `python benchmarks/speed_page.py --out docs/speed.md`: "
        "every figure beside its peer in the same run.",
        "",
        f"eps_hil {VERSION}, Python {platform.python_version()}, {os.cpu_count()} cores "
        f"({_processor()}), load {os.getloadavg()[0]:.1f} at the end.",
        "",
        "| what | peer | figure | goal | reached | in the way of more |",
        "|---|---|---|---|---|---|",
    ]
    for one in told:
        row = one.row
        if one.figure is None:
            figure, reached = "the command failed", "no"
        else:
            figure = f"{one.figure:g} {row.unit}"
            good = one.figure >= row.goal if row.more else one.figure <= row.goal
            reached = "yes" if good else "**no**"
        sign = "≥" if row.more else "≤"
        lines.append(
            f"| {row.what} | {row.peer} | {figure} | {sign} {row.goal:g} | {reached} | "
            f"{row.limit} |"
        )
    for one in told:
        lines += [
            "", f"## {one.row.what[0].upper()}{one.row.what[1:]}", "",
            f"    python benchmarks/{one.row.command}", "", "```text", one.text, "```",
        ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.machine()
    found = re.search(r"model name\s*: (.*)", text)
    return found[1].strip() if found else platform.machine()


def main() -> int:
    """Measure, and write the page."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--out", type=Path, help="the page; without it, it is printed")
    ask.add_argument("--only", nargs="+", choices=[row.name for row in ROWS])
    chosen = ask.parse_args()
    told = []
    for row in ROWS:
        if chosen.only and row.name not in chosen.only:
            continue
        told.append(measured(row))
        figure = "failed" if told[-1].figure is None else f"{told[-1].figure:g}"
        print(f"{row.name:10} {figure} {row.unit}, {told[-1].seconds:.0f} s", file=sys.stderr)
    text = page(told)
    if chosen.out:
        chosen.out.write_text(text, encoding="utf-8")
    else:
        print(text, end="")
    return int(any(one.figure is None for one in told))


if __name__ == "__main__":
    sys.exit(main())
