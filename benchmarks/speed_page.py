#!/usr/bin/env python3
"""All speed figures in one run, as a page: `docs/speed.md`.

    python benchmarks/speed_page.py --out docs/speed.md
    python benchmarks/speed_page.py --only candump blf
    python benchmarks/speed_page.py --quick             small inputs: does every row work?

Each row is a command of this folder with its peer in the same run; what it printed goes into a text
beside the page. A row whose command fails, or takes longer than --patience, says so and stays. Both
are written anew after every row, so that what was measured is kept whatever happens. Takes about
eight minutes on two cores, which should have nothing else to do.
"""

import argparse
import contextlib
import os
import platform
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from eps_hil.version import VERSION

HERE = Path(__file__).resolve().parent


class Row(NamedTuple):
    """One figure: where it is found in what its command prints, and what it is measured against.

    ``goal``: the figure at which it is reached; ``more``: whether more is better; ``quick``: its
    command on small inputs.
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
    quick: str


ROWS = (
    Row(
        "estimator", "batch estimator, 624 s in memory", "the same by hand in C, -O3",
        "batch_estimator.py --seconds 624", r"ratio ([\d.]+)", "times its time", 1.5, False,
        "checks of plausibility, holes and torque jumps",
        "batch_estimator.py --seconds 20 --runs 2",
    ),
    Row(
        "candump", "candump log to checked signals",
        "python-can, cantools, unchecked",
        "decode_log.py --seconds 120", r"ratio ([\d.]+)", "times as fast", 20.0, True,
        "copies on the way from lines to columns",
        "decode_log.py --seconds 5 --runs 1",
    ),
    Row(
        "blf", "BLF to checked signals", "python-can, cantools, unchecked",
        "decode_log.py --seconds 120 --suffix .blf", r"ratio ([\d.]+)", "times as fast", 10.0, True,
        "zlib", "decode_log.py --seconds 5 --runs 1 --suffix .blf",
    ),
    Row(
        "mf4", "MF4 bus logging to checked signals",
        "asammdf extract_bus_logging, unchecked",
        "decode_log.py --seconds 120 --suffix .mf4", r"ratio ([\d.]+)", "times as fast", 1.0, True,
        "asammdf reads the records for both",
        "decode_log.py --seconds 5 --runs 1 --suffix .mf4",
    ),
    Row(
        "csv", "`estimate` on a CSV of 624 s", "pyarrow's read and write",
        "estimate_csv.py", r"ratio ([\d.]+)", "times its time", 2.0, False,
        "nanosecond stamps, checked cells, the estimate",
        "estimate_csv.py --seconds 20 --runs 1",
    ),
    Row(
        "long", "`estimate` on a candump log of 2 GB, a gigabyte", "the same on 0.2 GB",
        "long_log.py --gb 2", r"ratio ([\d.]+)", "times its time", 1.1, False,
        "nothing: 10 GB are `python benchmarks/long_log.py --gb 10`",
        "long_log.py --gb 0.02",
    ),
    Row(
        "first", "first `estimate` after installation", "–",
        "first_estimate.py", r"first +([\d.]+) s", "s", 5.0, False,
        "importing and compiling",
        "first_estimate.py",
    ),
    Row(
        "live", "live step: three frames in, estimate frame out", "a cycle of 1 ms",
        "live_step.py", r"p50 ([\d.]+) us", "us", 25.0, False,
        "Python between the compiled calls",
        "live_step.py --cycles 500",
    ),
    Row(
        "live_10khz", "the same at 10 kHz", "one core",
        "live_step.py --rate 10000", r"that is ([\d.]+) %", "% of a core", 100.0, False,
        "the same", "live_step.py --rate 10000 --cycles 500",
    ),
    Row(
        "latency", "sync frame to estimate frame, p50", "bare python-can loop",
        "latency.py", r"ratio +([\d.]+)", "times its time", 2.0, False,
        "waking up, and Python between the compiled calls",
        "latency.py --cycles 200 --warm-up 100",
    ),
    Row(
        "diagnose", "diagnosis of 60 min in 78 recordings", "–",
        "diagnose_cost.py --minutes 60", r"\d min: +([\d.]+) s wall", "s", 20.0, False,
        "the search for physics without a name",
        "diagnose_cost.py --minutes 1.5",
    ),
    Row(
        "fleet", "`batch estimate` of 2,000 recordings of 20 s on all cores", "one process",
        "fleet.py --recordings 2000 --seconds 20 --tasks 2000", r"speed-up a core ([\d.]+)",
        "of each core used", 0.9, True,
        "starting a process, and the memory that both cores share",
        "fleet.py --recordings 12 --seconds 5 --shell 1 --tasks 100",
    ),
)  # fmt: skip


class Told(NamedTuple):
    """What a command printed, its figure (None: it failed) and how long it took."""

    row: Row
    text: str
    figure: float | None
    seconds: float


def measured(row: Row, patience_s: float) -> Told:
    """Run a row's command, with all that it starts; what takes too long is ended."""
    begun = time.perf_counter()
    words = row.command.split()
    running = subprocess.Popen(
        [sys.executable, str(HERE / words[0]), *words[1:]],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        text = running.communicate(timeout=patience_s)[0]
    except BaseException as error:  # Ctrl-C too: nothing stays behind
        with contextlib.suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
        text = running.communicate()[0]
        if not isinstance(error, subprocess.TimeoutExpired):
            raise
        text += f"\nended after {patience_s:g} s"
    found = re.search(row.figure, text)
    return Told(row, text.strip(), float(found[1]) if found else None, time.perf_counter() - begun)


def page(told: list[Told], quick: bool) -> str:
    """The page, in Markdown."""
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    lines = [
        "# Speed, measured",
        "",
        "`python benchmarks/speed_page.py --out docs/speed.md`, each peer in the same run; "
        "*checked*: counters and CRC. [The commands, and all that they printed](speed.txt).",
        "",
        f"eps_hil {VERSION}, Python {platform.python_version()}, {os.cpu_count()} cores "
        f"({_processor()}), load {load:.1f} a core at the end"
        + (": **the machine was busy**." if load > _BUSY else ".")
        + f" Ten million additions: {_additions_s():.2f} s.",
        *(["", "**Small inputs: this says only that every row works.**"] if quick else []),
        "",
        "| what | peer | figure | goal | reached; else in the way |",
        "|---|---|---|---|---|",
    ]
    for one in told:
        row = one.row
        if one.figure is None:
            figure, reached = "the command failed", "no"
        else:
            figure = f"{one.figure:g} {row.unit}"
            good = one.figure >= row.goal if row.more else one.figure <= row.goal
            reached = "yes" if good else f"**no**: {row.limit}"
        sign = "≥" if row.more else "≤"
        lines.append(f"| {row.what} | {row.peer} | {figure} | {sign} {row.goal:g} | {reached} |")
    return "\n".join(lines) + "\n"


def transcript(told: list[Told]) -> str:
    """What the commands printed, in the order of the table."""
    parts = (f"$ python benchmarks/{one.row.command}\n{one.text}\n" for one in told)
    return "\n".join(parts)


_BUSY = 1.5
"""Programs a core in the last minute, beyond which figures by the clock are of a busy machine."""


def _additions_s() -> float:
    """How fast the machine is: seconds of one plain loop, the best of three."""
    took = []
    for _ in range(3):
        begun = time.perf_counter()
        total = 0
        for k in range(10_000_000):
            total += k
        took.append(time.perf_counter() - begun)
    return min(took)


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
    ask.add_argument("--quick", action="store_true", help="small inputs")
    ask.add_argument("--patience", type=float, default=180.0, help="seconds that a row may take")
    chosen = ask.parse_args()
    told: list[Told] = []
    for row in ROWS:
        if chosen.only and row.name not in chosen.only:
            continue
        told.append(
            measured(row._replace(command=row.quick) if chosen.quick else row, chosen.patience)
        )
        figure = "failed" if told[-1].figure is None else f"{told[-1].figure:g}"
        print(f"{row.name:10} {figure} {row.unit}, {told[-1].seconds:.0f} s", file=sys.stderr)
        if chosen.out:
            chosen.out.write_text(page(told, chosen.quick), encoding="utf-8")
            chosen.out.with_suffix(".txt").write_text(transcript(told), encoding="utf-8")
    if not chosen.out:
        print(page(told, chosen.quick), transcript(told), sep="\n", end="")
    return int(any(one.figure is None for one in told))


if __name__ == "__main__":
    sys.exit(main())
