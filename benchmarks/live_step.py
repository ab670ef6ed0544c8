#!/usr/bin/env python3
"""One step of the live service with what it publishes, without a bus.

    python benchmarks/live_step.py                    1 kHz
    python benchmarks/live_step.py --rate 10000

The frames of a cycle (torques, rig, motor state, which clocks it) go through the service's core:
counters and CRC checked, signals decoded, the estimator stepped, the estimate encoded. Nothing is
sent, nothing waits. The mapping says the rate, as it must beyond 1 kHz. Printed: the call by the
clock, and processor time a cycle; at 10 kHz a cycle has 100 us. Exit status 1 if the median is
above --limit.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from batch_estimator import ROOT

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.service.config import load_config
from eps_hil.service.setup import prepare

CONFIG = """bus: {{interface: virtual, channel: none}}
dbc: {root}/dbc/eps_rig.dbc
signals: {signals}
model: {root}/configs/reference_rig.yaml
estimator: {{step_s: {step}}}
"""
START_NS = 1_757_617_431_000_000_000


def cycles(number: int, step_ns: int) -> list[list[Frame]]:
    """The frames of each cycle."""
    database = load_database([ROOT / "dbc/eps_rig.dbc"])
    torques, rig, motor = (
        FrameEncoder(database, name) for name in ("EPS_Torques", "RIG_State", "EPS_MotorState")
    )
    found = []
    for k in range(number):
        t_ns, t_s = START_NS + k * step_ns, k * step_ns * 1e-9
        wave, other = float(np.sin(3.0 * t_s)), float(np.cos(0.7 * t_s))
        early = t_ns - step_ns // 4
        values = {"MotorTorque": wave, "TorsionBarTorque": 0.5 * other}
        frames = [torques.frame(values, early)]
        frames.append(rig.frame({"RackForce": 500 * wave, "RackPosition": 0.01 * other}, early))
        frames.append(motor.frame({"MotorSpeed": 20 * wave, "MotorAngle": 9 * other}, t_ns))
        found.append(frames)
    return found


def main() -> int:
    """Run it, say what came out."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--rate", type=int, default=1000, help="cycles a second")
    ask.add_argument("--cycles", type=int, default=20_000)
    ask.add_argument("--limit", type=float, default=float("inf"), help="exit 1 above so many us")
    chosen = ask.parse_args()
    step_ns = 1_000_000_000 // chosen.rate
    with tempfile.TemporaryDirectory() as folder:
        path, signals = Path(folder) / "service.yaml", Path(folder) / "signals.yaml"
        mapping = (ROOT / "configs/eps_rig_signals.yaml").read_text(encoding="utf-8")
        cycle = f"clock: counter, cycle_time_s: {step_ns * 1e-9:g}}}"
        signals.write_text(mapping.replace("clock: counter}", cycle), encoding="utf-8")
        text = CONFIG.format(root=ROOT, signals=signals, step=step_ns * 1e-9)
        path.write_text(text, encoding="utf-8")
        parts = prepare(load_config(path), path)
    parts.warm_up()
    core, took, answers = parts.core, [], 0
    work = cycles(chosen.cycles, step_ns)
    begun = time.process_time()
    for frames in work:
        before = time.perf_counter_ns()
        answers += len(core.on_frames(frames))
        took.append(time.perf_counter_ns() - before)
    processor = (time.process_time() - begun) / len(work) * 1e6
    p50, p99 = np.percentile(np.array(took[len(took) // 10 :]) * 1e-3, [50, 99])
    print(f"{chosen.rate} Hz, {len(work)} cycles of 3 frames, {answers} published")
    print(f"p50 {p50:.1f} us, p99 {p99:.1f} us, processor {processor:.1f} us a cycle")
    print(f"that is {processor * chosen.rate * 1e-4:.1f} % of a core")
    return int(answers < 0.99 * len(work) or p50 > chosen.limit)


if __name__ == "__main__":
    sys.exit(main())
