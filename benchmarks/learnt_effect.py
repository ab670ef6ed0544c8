#!/usr/bin/env python3
"""What a learnt effect costs the live estimator: steps of 1 ms with and without it, in one run.

    python benchmarks/learnt_effect.py [--seconds 20]

A step is what `eps-hil run` does between a sync frame and its estimate: the samples of 1 ms are
pushed, `advance` runs what is due, and the newest estimate is read. The models take turns of 250
steps, so that a busy machine slows all of them; the ratio to the model file without an effect is
what counts, not the microseconds. Allocated: blocks that Python holds more at the end of a turn
than at its start, least of all turns (an estimate that is kept is one).
"""

import argparse
import gc
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.stream import StreamEstimator
from eps_hil.physics.model import load_model

ROOT = Path(__file__).resolve().parents[1]
TURN, STEP_NS = 250, 1_000_000
SIGNALS = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
_AXES = [np.linspace(-100.0, 100.0, 8).tolist(), np.linspace(-6.0, 6.0, 8).tolist()]
LAW: Mapping[str, Any] = {
    "effect": "empirical", "form": "law", "where": "rotor", "how": "sum",
    "inputs": ["motor_speed_rad_s", "motor_speed_rad_s"], "memory": ["none", "none"],
    "shapes": ["linear", "rational"], "size": 6e-3, "width_2": 18.0,
    "range": {"motor_speed_rad_s": [-240.0, 240.0]},
}  # fmt: skip
LEARNT: Mapping[str, list[Mapping[str, Any]]] = {
    "a law of speed": [LAW],
    "a law with memory (heat of T²)": [{
        "effect": "empirical", "form": "dynamic", "where": "motor", "how": "factor",
        "inputs": ["motor_torque_nm"], "memory": ["heat"], "shapes": ["linear"],
        "size": -0.02, "memory_1": 21.0,
    }],
    "a map of 8 x 8 knots": [{
        "effect": "empirical", "form": "map", "where": "friction", "how": "sum",
        "inputs": ["motor_speed_rad_s", "torque_sensor_nm"], "knots": _AXES,
        "values": [[1e-3 * ((i + j) % 3) for j in range(8)] for i in range(8)],
    }],
}  # fmt: skip


def columns(steps: int) -> list[tuple[float, ...]]:
    """A weave of 60 rad/s at the rotor, in the order of SIGNALS, a row a millisecond."""
    t = np.arange(steps) * 1e-3
    speed = 60.0 * np.sin(4.0 * t)
    rows = (0.5 * np.sin(4.0 * t), 2.0 * np.sin(4.0 * t), speed, 15.0 * (1.0 - np.cos(4.0 * t)))
    return [tuple(row) for row in np.column_stack(rows).tolist()]


def turn(estimator: StreamEstimator, rows: list[tuple[float, ...]], first: int) -> tuple[Any, int]:
    """Microseconds (n,) of each step, and the blocks allocated and kept meanwhile."""
    took = np.empty(len(rows))
    gc.collect()
    before = sys.getallocatedblocks()
    for k, row in enumerate(rows):
        t_ns = (first + k) * STEP_NS
        since = time.perf_counter_ns()
        for name, value in zip(SIGNALS, row, strict=True):
            estimator.push(name, t_ns, value)
        estimator.advance(t_ns)
        estimator.latest  # noqa: B018 (read as the service does)
        took[k] = 1e-3 * (time.perf_counter_ns() - since)
    return took, sys.getallocatedblocks() - before


def main() -> None:
    """Print a line for each model."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of samples, each model")
    steps = max(round(1e3 * parser.parse_args().seconds) // TURN, 2) * TURN
    model = load_model(ROOT / "configs" / "reference_rig.yaml")
    models = {"no learnt effect": model}
    models |= {name: replace(model, effects=tuple(some)) for name, some in LEARNT.items()}
    models["all three of them"] = replace(
        model, effects=tuple(one for some in LEARNT.values() for one in some)
    )
    periods = dict.fromkeys(SIGNALS, 1e-3)
    estimators = {
        name: StreamEstimator(one, EstimatorSettings(), periods) for name, one in models.items()
    }
    for one in estimators.values():
        one.warm_up()
    rows = columns(steps)
    took: dict[str, list[Any]] = {name: [] for name in models}
    kept: dict[str, list[int]] = {name: [] for name in models}
    for first in range(0, steps, TURN):
        for name, one in estimators.items():
            each, blocks = turn(one, rows[first : first + TURN], first)
            took[name].append(each)
            kept[name].append(blocks)
    plain = float(np.median(np.concatenate(took["no learnt effect"][1:])))
    print("| model | step, median µs | 99.9 % µs | ratio | of 1 ms | allocated |")
    print("|---|---|---|---|---|---|")
    for name in models:
        values = np.concatenate(took[name][1:])
        median, high = float(np.median(values)), float(np.percentile(values, 99.9))
        print(
            f"| {name} | {median:.1f} | {high:.1f} | {median / plain:.2f} "
            f"| {median / 10:.1f} % | {min(kept[name][1:])} |"
        )


if __name__ == "__main__":
    main()
