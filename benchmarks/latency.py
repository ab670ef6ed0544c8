#!/usr/bin/env python3
"""Sync frame to estimate frame, beside a bare python-can loop that receives and sends.

    python benchmarks/latency.py                                    UDP multicast
    python benchmarks/latency.py --interface socketcan --channels vcan0 vcan1

Three processes on this machine: `eps-hil run`, a loop of a dozen lines on python-can that answers
each sync frame with a fixed frame, and this one, which sends both the same frames by turns, half a
millisecond apart, and takes the time from just before the sync frame is handed to the bus to the
kernel's stamp of the answer. Both loops run at the same priority (--realtime: SCHED_FIFO, both)
and on the same processor, the sender on another: a loop that happens to share the sender's
processor is not woken from idle, which is most of what the other waits for.
Figures of a busy machine are noisy; the ratios of one run are what counts. Exit status 1 if a
ratio is above --limit.
"""

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port, open_port

ROOT = Path(__file__).resolve().parents[1]
SYNC, ANSWER = 0x100, 0x120
GROUP = "239.74.163.117"
PRIORITY = 20
SLOT_NS = 500_000
PATIENCE_S = 0.02

BARE = """
import os, sys
import can
interface, channel, options, realtime = sys.argv[1], sys.argv[2], eval(sys.argv[3]), sys.argv[4]
bus = can.Bus(interface=interface, channel=channel, **options)
answer = can.Message(arbitration_id=0x120, data=bytes(8), is_extended_id=False)
if realtime == "1":
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
print("READY", flush=True)
while True:
    message = bus.recv()
    if message is not None and message.arbitration_id == 0x100:
        bus.send(answer)
"""

CONFIG = """bus: {{interface: {interface}, channel: {channel}, options: {options}, fd: {fd}}}
dbc: {root}/dbc/eps_rig.dbc
signals: {root}/configs/eps_rig_signals.yaml
model: {root}/configs/reference_rig.yaml
service: {{realtime: {realtime}}}
"""


class Stimulus:
    """The rig's frames of one millisecond, the sync frame last."""

    def __init__(self) -> None:
        database = load_database([ROOT / "dbc" / "eps_rig.dbc"])
        names = ("EPS_Torques", "RIG_State", "EPS_MotorState")
        self._encoders = [FrameEncoder(database, name) for name in names]

    def frames(self, k: int) -> list[Frame]:
        """Of millisecond ``k``."""
        phase = 2 * math.pi * 2.0 * k * 1e-3
        values = {
            "MotorTorque": 0.4 * math.sin(phase),
            "TorsionBarTorque": 0.1,
            "RackForce": 1000.0 * math.sin(phase),
            "RackPosition": 0.0,
            "MotorSpeed": 8.0 * math.cos(phase),
            "MotorAngle": 0.6 * math.sin(phase),
        }
        return [encoder.frame(values) for encoder in self._encoders]


def ask(port: Port, frames: list[Frame]) -> int | None:
    """ns from handing over the sync frame to the answer's stamp; None where none came."""
    port.recv(0.0)
    for frame in frames[:-1]:
        port.send(frame)
    sent_ns = time.time_ns()
    port.send(frames[-1])
    until_s = time.monotonic() + PATIENCE_S
    while (left_s := until_s - time.monotonic()) > 0:
        for frame in port.recv(left_s):
            if frame.can_id == ANSWER:
                return frame.t_ns - sent_ns
    return None


def started(words: list[str]) -> subprocess.Popen[str]:
    """A process that has said that it is ready."""
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if line.strip() == "READY":
            return process
    raise SystemExit(f"{words[:4]} ended before it was ready")


def apart() -> tuple[set[int], set[int]]:
    """Processors of the loops and of the sender; the same where there is only one."""
    mine = sorted(os.sched_getaffinity(0))
    return {mine[-1]}, {mine[0]}


def measure(asked: argparse.Namespace, channels: list[str], options: list[dict[str, int]]) -> int:
    """Run, print, judge."""
    ports = [
        open_port(asked.interface, channel, options=chosen)
        for channel, chosen in zip(channels, options, strict=True)
    ]
    stimulus = [Stimulus(), Stimulus()]
    took: list[list[int]] = [[], []]
    missing = [0, 0]
    next_ns = time.monotonic_ns()
    for k in range(asked.warm_up + asked.cycles):
        for which in (0, 1):
            time.sleep(max(0, next_ns - time.monotonic_ns()) * 1e-9)
            next_ns = max(next_ns + SLOT_NS, time.monotonic_ns())
            got = ask(ports[which], stimulus[which].frames(k))
            if k < asked.warm_up:
                continue
            if got is None:
                missing[which] += 1
            else:
                took[which].append(got)
    print(f"{asked.interface}, {asked.cycles} cycles, load {os.getloadavg()[0]:.1f}")
    print("                     p50        p90        p99   no answer")
    rows = []
    for name, each, lost in zip(("eps-hil run", "bare loop"), took, missing, strict=True):
        rows.append([float(np.percentile(each, q)) * 1e-3 for q in (50, 90, 99)])
        print(f"{name:13}" + "".join(f"{value:8.0f} us" for value in rows[-1]) + f"   {lost}")
    ratios = [one / other for one, other in zip(*rows, strict=True)]
    print(f"{'ratio':13}" + "".join(f"{ratio:11.2f}" for ratio in ratios))
    return int(ratios[0] > asked.limit or ratios[2] > asked.limit)


def main() -> int:
    """Start both loops, measure, end them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--interface", choices=("udp_multicast", "socketcan"), default="udp_multicast"
    )
    parser.add_argument(
        "--channels", nargs=2, default=None, help="of the service and of the bare loop"
    )
    parser.add_argument("--cycles", type=int, default=5000)
    parser.add_argument("--warm-up", type=int, default=1000)
    parser.add_argument("--realtime", action="store_true", help="SCHED_FIFO for both loops")
    parser.add_argument("--limit", type=float, default=2.0, help="highest ratio at p50 and p99")
    asked = parser.parse_args()
    udp = asked.interface == "udp_multicast"
    channels = asked.channels or ([GROUP, GROUP] if udp else ["vcan0", "vcan1"])
    options = [{"port": 47311 + k, "hop_limit": 0} if udp else {} for k in (0, 1)]
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "c.yaml"
        config.write_text(
            CONFIG.format(
                interface=asked.interface, channel=channels[0], options=options[0], root=ROOT,
                fd=str(udp).lower(), realtime="require" if asked.realtime else "off",
            )
        )  # fmt: skip
        bare = [asked.interface, channels[1], repr(options[1]), str(int(asked.realtime))]
        processes: list[subprocess.Popen[str]] = []
        loops, sender = apart()
        try:
            os.sched_setaffinity(0, loops)  # what is started now stays there
            run = [
                *os.environ.get("EPS_RUN", "-m eps_hil.cli").split(),
                "run",
                "--no-status-line",
                "--config",
                str(config),
            ]
            processes.append(started([sys.executable, *run]))
            processes.append(started([sys.executable, "-c", BARE, *bare]))
            os.sched_setaffinity(0, sender)
            return measure(asked, channels, options)
        finally:
            for process in processes:
                process.terminate()
                process.wait()


if __name__ == "__main__":
    sys.exit(main())
