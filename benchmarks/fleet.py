#!/usr/bin/env python3
"""`eps-hil batch` over many recordings: one process, all cores, a shell loop, Dask's scheduler.

    python benchmarks/fleet.py --recordings 2000 --seconds 20
    python benchmarks/fleet.py --recordings 40 --seconds 60 --job identify

The recordings (Parquet, at 1 kHz, of --rigs rigs) are made here. Each run has an output folder of
its own, so that every recording is done; it begins once a first one has compiled everything. The
loop is `eps-hil estimate` on a few files one after the other, a process each, as a shell would.
Dask: what an empty task costs its scheduler, of --tasks on two worker processes of this machine
(extra `fleet`); a cluster whose workers finish more tasks a second than that waits for it. Last,
what 10^6 such recordings need by these figures. Exit status 1 if a row failed.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from batch_estimator import ROOT, recording

from eps_hil.fleet.batch import run_batch
from eps_hil.fleet.job import Job
from eps_hil.fleet.tasks import Task, tasks_of
from eps_hil.physics.model import load_model
from eps_hil.recordings.write import write_table

MODEL = ROOT / "configs/reference_rig.yaml"
MANY = 1_000_000


def make(folder: Path, number: int, seconds: float, rigs: int) -> int:
    """Write the recordings, ``number`` of them below ``rigs`` folders; their bytes."""
    model = load_model(MODEL)
    one = recording(model, seconds)
    stamps = one["motor_speed_rad_s"].t_ns
    rng = np.random.default_rng(5)
    size = 0
    for k in range(number):
        place = folder / f"rig_{k % rigs:02d}" / f"drive_{k:05d}.parquet"
        place.parent.mkdir(parents=True, exist_ok=True)
        columns = {name: each.value + rng.normal(0, 1e-4) for name, each in one.items()}
        write_table(place, columns, t_ns=stamps + k * 60_000_000_000)
        size += place.stat().st_size
    return size


def timed(job: Job, tasks: list[Task], processes: int) -> tuple[float, int]:
    """Seconds of a batch after its first task, which may compile; and its failed rows."""
    begun: list[float] = []

    def heard(*_: Any) -> None:
        if not begun:
            begun.append(time.perf_counter())

    batch = run_batch(job, tasks, processes=processes, on_row=heard)
    return time.perf_counter() - begun[0], len(batch.failed)


def by_shell(paths: list[Path], verb: str, folder: Path) -> float:
    """Seconds a recording of one process for each."""
    begun = time.perf_counter()
    for path in paths:
        option, suffix = ("--out", "parquet") if verb == "estimate" else ("--json", "json")
        words = [sys.executable, "-m", "eps_hil", verb, str(path), option]
        words.append(str(folder / f"{path.stem}.{suffix}"))
        subprocess.run([*words, "--model", str(MODEL)], check=True, stdout=subprocess.DEVNULL)
    return (time.perf_counter() - begun) / len(paths)


def scheduler_cost(tasks: int) -> float:
    """Seconds a task of Dask's scheduler, workers and client on this machine."""
    from distributed import Client, LocalCluster, as_completed

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        client.gather(client.map(abs, range(-100, 0)))
        begun = time.perf_counter()
        for future in as_completed(client.map(abs, range(1, tasks + 1))):
            future.release()
        return (time.perf_counter() - begun) / tasks


def plan(seconds: float, size: float, task_s: float, written: float) -> None:
    """What 10^6 recordings need, by what one costs a core, its bytes and its scheduling."""
    hours = MANY * seconds / 3600.0
    full = seconds / task_s
    memory_gb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9
    print(
        f"10^6 recordings: {hours:.0f} core hours, {MANY * size / 1e12:.2f} TB read, "
        f"{MANY * written / 1e12:.2f} TB written, {memory_gb:.2f} GB a worker"
    )
    print(
        f"Dask's scheduler is full at {full:.0f} cores; then {size / task_s / 1e6:.0f} MB/s are "
        f"read, and 10^6 take {MANY * task_s / 3600.0:.1f} h; the storage gives "
        f"{size / seconds / 1e6:.1f} MB/s to each core"
    )


def main() -> int:
    """Run all of it, say what came out."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--recordings", type=int, default=200)
    ask.add_argument("--seconds", type=float, default=20.0)
    ask.add_argument("--rigs", type=int, default=20)
    ask.add_argument("--job", choices=("estimate", "identify"), default="estimate")
    ask.add_argument("--shell", type=int, default=5, help="recordings of the shell loop")
    ask.add_argument("--tasks", type=int, default=5000, help="empty tasks for Dask; 0: none")
    chosen = ask.parse_args()
    cores, failed, rate = os.cpu_count() or 1, 0, {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        size = make(folder / "drives", chosen.recordings, chosen.seconds, chosen.rigs)
        tasks = tasks_of(folder / "drives")
        print(
            f"{len(tasks)} recordings of {chosen.seconds:g} s, {size / 1e6:.0f} MB, {chosen.job}, "
            f"load {os.getloadavg()[0]:.1f}",
            flush=True,
        )
        for processes in (1, cores):
            out = folder / f"out_{processes}"
            out.mkdir()
            seconds, wrong = timed(Job(chosen.job, MODEL, out), tasks, processes)
            failed += wrong
            rate[processes] = seconds / (len(tasks) - 1)
            print(f"{processes} processes  {rate[processes] * 1e3:9.1f} ms a recording", flush=True)
            written = sum(one.stat().st_size for one in out.rglob("*") if one.is_file())
        loop = by_shell([task.path for task in tasks[: chosen.shell]], chosen.job, folder)
        print(f"shell loop   {loop * 1e3:9.1f} ms a recording")
    gained = rate[1] / rate[cores] / cores
    print(f"speed-up a core {gained:.2f}; shell loop {loop / rate[cores]:.1f} times the batch")
    if chosen.tasks:
        task_s = scheduler_cost(chosen.tasks)
        print(f"Dask: {task_s * 1e3:.2f} ms a task, {1.0 / task_s:.0f} tasks a second")
        plan(rate[1], size / len(tasks), task_s, written / len(tasks))
    print(f"rows that failed: {failed}")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
