#!/usr/bin/env python3
"""A learnt effect on the bus at 1 kHz: lateness and processor time beside the same without it.

    python benchmarks/learnt_on_bus.py [--cycles 10000]

Two `eps-hil run` on UDP multicast, one with the model file alone and one with the three learnt
effects of `learnt_effect.py` in it (a law, a law with memory, a map), are sent the same frames by
turns, half a millisecond apart: each gets a sync frame every millisecond. Late: from just before
that is handed over to the stamp of the answer. Processor time is the service's own, by the kernel.
Figures of a busy machine are noisy; the ratios of one run are what counts.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import yaml
from latency import GROUP, ROOT, SLOT_NS, Stimulus, ask, started
from learnt_effect import LEARNT

from eps_hil.bus.port import open_port

CONFIG = """bus: {{interface: udp_multicast, channel: {group}, options: {options}, fd: true}}
dbc: {root}/dbc/eps_rig.dbc
signals: {root}/configs/eps_rig_signals.yaml
model: {model}
service: {{realtime: "off"}}
"""
PORT = 47331
NAMES = ("model file alone", "with three learnt effects")


def cpu_s(process: subprocess.Popen[str]) -> float:
    """Processor time (s) that a process has used."""
    words = Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def models(folder: Path) -> list[Path]:
    """The reference rig's model file, and the same with what was learnt."""
    known = yaml.safe_load((ROOT / "configs" / "reference_rig.yaml").read_text(encoding="utf-8"))
    learnt = [dict(one) for some in LEARNT.values() for one in some]
    made = []
    for k, effects in enumerate(([], learnt)):
        file = folder / f"model{k}.yaml"
        content = {**known, "model": {**known["model"], "effects": effects}}
        file.write_text(yaml.safe_dump(content), encoding="utf-8")
        made.append(file)
    return made


def main() -> int:
    """Start both services, measure, end them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=10_000)
    parser.add_argument("--warm-up", type=int, default=2000)
    asked = parser.parse_args()
    options = [{"port": PORT + k, "hop_limit": 0} for k in (0, 1)]
    processes: list[subprocess.Popen[str]] = []
    with tempfile.TemporaryDirectory() as folder:
        try:
            for k, model in enumerate(models(Path(folder))):
                config = Path(folder) / f"c{k}.yaml"
                config.write_text(
                    CONFIG.format(group=GROUP, options=options[k], root=ROOT, model=model),
                    encoding="utf-8",
                )
                run = ["-m", "eps_hil.cli", "run", "--no-status-line", "--config", str(config)]
                processes.append(started([sys.executable, *run]))
            measure(asked, processes, options)
        finally:
            for process in processes:
                process.terminate()
                process.wait()
    return 0


def measure(
    asked: argparse.Namespace,
    processes: list[subprocess.Popen[str]],
    options: list[dict[str, int]],
) -> None:
    """Send, wait for the answers, print."""
    ports = [open_port("udp_multicast", GROUP, options=one) for one in options]
    stimulus = [Stimulus(), Stimulus()]
    took: list[list[int]] = [[], []]
    missing, used = [0, 0], [0.0, 0.0]
    next_ns = time.monotonic_ns()
    for k in range(asked.warm_up + asked.cycles):
        if k == asked.warm_up:
            used = [cpu_s(one) for one in processes]
        for which in (k % 2, 1 - k % 2):
            time.sleep(max(0, next_ns - time.monotonic_ns()) * 1e-9)
            next_ns = max(next_ns + SLOT_NS, time.monotonic_ns())
            got = ask(ports[which], stimulus[which].frames(k))
            if k >= asked.warm_up:
                if got is None:
                    missing[which] += 1
                else:
                    took[which].append(got)
    used = [cpu_s(one) - before for one, before in zip(processes, used, strict=True)]
    print(f"{asked.cycles} cycles of 1 ms, load {os.getloadavg()[0]:.1f}\n")
    print("| | late p50, µs | p90 | p99 | no answer | processor, µs a cycle |")
    print("|---|---|---|---|---|---|")
    rows = []
    for name, each, lost, cpu in zip(NAMES, took, missing, used, strict=True):
        late = [float(np.percentile(each, q)) * 1e-3 for q in (50, 90, 99)]
        rows.append([*late, 1e6 * cpu / asked.cycles])
        told = " | ".join(f"{one:.0f}" for one in late)
        print(f"| {name} | {told} | {lost} | {rows[-1][-1]:.0f} |")
    ratios = [other / one for one, other in zip(*rows, strict=True)]
    print(f"| ratio | {' | '.join(f'{one:.2f}' for one in ratios[:3])} | | {ratios[3]:.2f} |")


if __name__ == "__main__":
    sys.exit(main())
