#!/usr/bin/env python3
"""Sync frame to estimate frame with no page of `eps-hil dashboard` open, and with twenty.

    python benchmarks/pages_latency.py                      UDP multicast, 20 pages
    python benchmarks/pages_latency.py --pages 5 --cycles 5000

One `eps-hil run` and one `eps-hil dashboard` on one bus; this process sends the rig's frames each
millisecond and takes the time from just before the sync frame is handed to the bus to the kernel's
stamp of the answer, as benchmarks/latency.py does. Without and with pages by turns, --turns times,
so that both see the same machine. A page is a websocket that takes every message and says at once
that it is drawn: the most that a page can ask for (drawing itself costs the machine with the
browser). Exit status 1 if p99 with pages is above --limit times p99 without.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from latency import CONFIG, ROOT, Stimulus, ask, started

from eps_hil.bus.port import Port, open_port

GROUP, PORT, PERIOD_NS = "239.74.163.118", 47331, 1_000_000

PAGES = """
import asyncio, json, struct, sys, os
import websockets
address, number = sys.argv[1], int(sys.argv[2])
os.nice(5)
got = [0]
async def page():
    async with websockets.connect(address, compression=None, max_size=None) as socket:
        await socket.send(json.dumps({"view": {"length_s": 10, "pixels": 1000}}))
        async for message in socket:
            if isinstance(message, bytes):
                got[0] += 1
                await socket.send(json.dumps({"drawn": struct.unpack_from("<I", message, 8)[0]}))
async def main():
    tasks = [asyncio.ensure_future(page()) for _ in range(number)]
    while got[0] < number:
        await asyncio.sleep(0.1)
    print("READY", flush=True)
    begin, at = got[0], asyncio.get_running_loop().time()
    await asyncio.to_thread(sys.stdin.read)
    print((got[0] - begin) / (asyncio.get_running_loop().time() - at) / number, flush=True)
    os._exit(0)
asyncio.run(main())
"""


def turn(port: Port, stimulus: Stimulus, cycles: int) -> tuple[list[int], int]:
    """Answers' times in ns, and how often none came."""
    took, missing = [], 0
    next_ns = time.monotonic_ns()
    for k in range(cycles + 200):
        time.sleep(max(0, next_ns - time.monotonic_ns()) * 1e-9)
        next_ns = max(next_ns + PERIOD_NS, time.monotonic_ns())
        got = ask(port, stimulus.frames(k))
        if k < 200:
            continue
        if got is None:
            missing += 1
        else:
            took.append(got)
    return took, missing


def row(name: str, took: list[int], missing: int, more: str = "") -> float:
    """Print one line; p99 in µs."""
    p50, p90, p99 = (float(np.percentile(took, q)) * 1e-3 for q in (50, 90, 99))
    print(f"{name:22}{p50:8.0f} us{p90:8.0f} us{p99:8.0f} us   {missing:5d}   {more}", flush=True)
    return p99


def measure(asked: argparse.Namespace, config: Path, processes: list[subprocess.Popen[str]]) -> int:
    """Start all, measure by turns, print, judge."""
    verb = [sys.executable, "-m", "eps_hil.cli"]
    processes.append(started([*verb, "run", "--no-status-line", "--config", str(config)]))
    port = open_port("udp_multicast", GROUP, options={"port": PORT, "hop_limit": 0})
    stimulus = Stimulus()
    print(f"{asked.turns} turns of {asked.cycles} cycles at 1 kHz, load {os.getloadavg()[0]:.1f}")
    print("                           p50        p90        p99   no answer")
    row("no dashboard", *turn(port, stimulus, asked.cycles))
    page = subprocess.Popen(
        [*verb, "dashboard", "--config", str(config), "--port", "0"],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    processes.append(page)
    assert page.stderr is not None
    address = page.stderr.readline().split()[1].replace("http", "ws") + "feed"
    took: dict[int, list[int]] = {0: [], asked.pages: []}
    missing, rates = dict.fromkeys(took, 0), []
    turn(port, stimulus, asked.warm_up)
    for _ in range(asked.turns):
        for pages in took:
            clients = None
            if pages:
                clients = subprocess.Popen(
                    [sys.executable, "-c", PAGES, address, str(pages)],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
                )  # fmt: skip
                processes.append(clients)
                assert clients.stdout is not None
                while True:  # a page has something to show only while frames come
                    turn(port, stimulus, 500)
                    if os.read(clients.stdout.fileno(), 64).startswith(b"READY"):
                        break
            found, none = turn(port, stimulus, asked.cycles)
            took[pages] += found
            missing[pages] += none
            if clients is not None:
                rates.append(float(clients.communicate("")[0]))
    before = row("dashboard, 0 pages", took[0], missing[0])
    said = f"{np.mean(rates):.1f} messages a second and page"
    after = row(f"dashboard, {asked.pages} pages", took[asked.pages], missing[asked.pages], said)
    port.close()
    return int(after > asked.limit * before)


def main() -> int:
    """Read the command line, and leave nothing running."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pages", type=int, default=20)
    parser.add_argument("--cycles", type=int, default=5000)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--warm-up", type=int, default=20000, help="cycles after the first start")
    parser.add_argument("--limit", type=float, default=1.5, help="highest ratio of p99")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "c.yaml"
        config.write_text(
            CONFIG.format(
                interface="udp_multicast", channel=GROUP, root=ROOT, fd="true", realtime="auto",
                options={"port": PORT, "hop_limit": 0},
            )
        )  # fmt: skip
        processes: list[subprocess.Popen[str]] = []
        try:
            return measure(asked, config, processes)
        finally:
            for process in processes:
                process.terminate()
                process.wait()


if __name__ == "__main__":
    sys.exit(main())
