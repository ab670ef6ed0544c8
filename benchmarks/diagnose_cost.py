"""What a diagnosis with the whole catalogue costs: seconds and memory over minutes of recording.

    .venv/bin/python benchmarks/diagnose_cost.py [--minutes 1.5 3 6] [--out lines.jsonl]
    .venv/bin/python benchmarks/diagnose_cost.py --minutes 60 --one

The rig is the truth plant of ``eps_hil/proof`` (five masses, Maxwell-slip friction) with a Stribeck
effect of 0.03 Nm; its recordings of 40 and 45 s are repeated with new noise until the minutes are
full, one more is the hold-out. ``--one`` strings them together into one recording.

Printed for each length: wall clock and processor seconds of ``eps-hil diagnose``, start and reading
included, the first run thrown away (it may compile); both per minute of recording, and as a ratio
to the first length's, where 1.00 is linear cost; the largest memory; what was named. On a busy
machine the processor seconds are the ones to read.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.proof.effects import find
from eps_hil.proof.model_file import model_yaml
from eps_hil.proof.programmes import programme
from eps_hil.proof.sensors import measured, reported
from eps_hil.proof.truth import Drive, Floats
from eps_hil.proof.world import World
from eps_hil.recordings.write import write_table

WORLD = find("stribeck").apply(World(False), 0.03, {"speed_rad_s": 10.0})


def recorded(program: Floats, rng: np.random.Generator) -> dict[str, Floats]:
    """What the sensors report of one manoeuvre, columns at 1 kHz."""
    clean = reported(WORLD.run(program), WORLD.instruments)
    return dict(measured(clean, WORLD.instruments, rng))


def write(path: Path, columns: dict[str, Floats]) -> None:
    """As Parquet, so that reading text is not what is timed."""
    values = {name: one for name, one in columns.items() if name != "time_s"}
    n = len(next(iter(values.values())))
    write_table(path, values, t_ns=np.arange(n, dtype=np.int64) * 1_000_000)


def strung(parts: list[dict[str, Floats]]) -> dict[str, Floats]:
    """One recording of several; angle and rack position go on where the one before ended."""
    turned = np.zeros(len(parts))
    for k in range(1, len(parts)):
        end = turned[k - 1] + parts[k - 1]["motor_angle_rad"][-1]
        turned[k] = end - parts[k]["motor_angle_rad"][0]
    ratio = {"motor_angle_rad": 1.0, "rack_position_m": Drive().rack_rad_per_m}
    return {
        name: np.concatenate(
            [
                p[name] + (by / ratio[name] if name in ratio else 0.0)
                for p, by in zip(parts, turned, strict=True)
            ]
        )
        for name in parts[0]
    }


def case(folder: Path, minutes: float, one: bool) -> list[str]:
    """Write the recordings; the words of the command that follow ``--recording``."""
    rng = np.random.default_rng(20)
    parts: list[dict[str, Floats]] = []
    while sum(len(p["time_s"]) for p in parts) < 60_000 * minutes:
        *train, last = programme("training", rng)
        parts += [recorded(program, rng) for program in train]
    write(folder / "kept.parquet", recorded(last, rng))
    if one:
        parts = [strung(parts)]
    names = [folder / f"train_{k:03d}.parquet" for k in range(len(parts))]
    for name, part in zip(names, parts, strict=True):
        write(name, part)
    return [str(name) for name in names]


def run(folder: Path, recordings: list[str]) -> dict[str, Any]:
    """One diagnosis in a process of its own: seconds, megabytes, effects named."""
    result = folder / "result.json"
    words = [sys.executable, "-m", "eps_hil.cli", "diagnose", "--model", str(folder / "rig.yaml")]
    words += ["--json", str(result), "--holdout", str(folder / "kept.parquet"), "--recording"]
    start = time.perf_counter()
    process = subprocess.Popen([*words, *recordings], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    if status:
        sys.exit(f"diagnose ended with status {os.waitstatus_to_exitcode(status)}")
    found = json.loads(result.read_text(encoding="utf-8"))["findings"]
    return {
        "wall_s": wall,
        "cpu_s": used.ru_utime + used.ru_stime,
        "memory_mb": used.ru_maxrss / 1e3,
        "named": [one["effect"] for one in found],
    }


def measured_once(minutes: float, one: bool) -> dict[str, Any]:
    """:func:`run` on recordings of so many minutes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.yaml").write_text(model_yaml(Drive()))
        return run(folder, case(folder, minutes, one))


def main() -> None:
    """Every length in turn, a line each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, nargs="+", default=[1.5, 3.0, 6.0])
    parser.add_argument("--one", action="store_true", help="one recording, not many")
    parser.add_argument("--out", type=Path, help="a JSON line for each length")
    chosen = parser.parse_args()
    lines: list[dict[str, Any]] = []
    measured_once(1.0, False)
    for minutes in chosen.minutes:
        lines.append({"minutes": minutes, **measured_once(minutes, chosen.one)})
        first, last = lines[0], lines[-1]
        ratios = [
            last[key] / last["minutes"] * first["minutes"] / first[key]
            for key in ("wall_s", "cpu_s")
        ]
        print(
            f"{minutes:6.1f} min: {last['wall_s']:7.1f} s wall, {last['cpu_s']:7.1f} s processor, "
            f"per minute x {ratios[0]:.2f} and x {ratios[1]:.2f}, {last['memory_mb']:6.0f} MB; "
            f"named {', '.join(last['named']) or 'nothing'}",
            flush=True,
        )
        if chosen.out:
            with chosen.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(last) + "\n")


if __name__ == "__main__":
    main()
