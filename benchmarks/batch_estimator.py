#!/usr/bin/env python3
"""The batch estimator beside the same estimator by hand in C, on one recording in memory.

    python benchmarks/batch_estimator.py --seconds 624

The C peer (batch_estimator.c) is compiled here, by cc -O3, and judges nothing: it has no
plausibility checks, gaps or effects. Both are given the same arrays by turns, in this process; the
shortest of --runs counts for each. Forces are compared: exit status 1 if they differ by more than
a millionth of a newton, or if the ratio is above --limit. One BLAS thread, as every command has:
others spin beside what is timed.
"""

import argparse
import ctypes
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from eps_hil.estimation.batch import estimate, sample_periods_s
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.stream import StreamEstimator
from eps_hil.physics.model import Model, load_model
from eps_hil.series import Series

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
START_NS, STEP_NS = 1_757_617_431_000_000_000, 1_000_000
SAME_N = 1e-6

Rows = tuple[Any, Any, Any]


def recording(model: Model, seconds: float) -> dict[str, Series]:
    """A rotor that sweeps and rests, its torque balance with a spring at the rack, and noise."""
    n = round(seconds / 1e-3)
    rng = np.random.default_rng(11)
    t = np.arange(n) * 1e-3
    drives = 0.5 + 0.5 * np.tanh(5.0 * (np.sin(2 * np.pi * 0.05 * t) + 0.7))
    speed = 20.0 * np.sin(2 * np.pi * 0.4 * t) * drives
    angle = np.cumsum(speed) * 1e-3
    sensor = 0.8 * np.sin(2 * np.pi * 0.4 * t)
    drive = model.inertia_kg_m2 * np.gradient(speed, 1e-3) + 0.002 * angle + 0.05 * np.tanh(speed)
    torque = drive - model.sensor_to_rotor * sensor
    noisy = (
        torque + rng.normal(0, 5e-3, n),
        sensor + rng.normal(0, 5e-3, n),
        speed + rng.normal(0, 0.3, n),
        angle + rng.normal(0, 2e-3, n),
    )
    stamps = START_NS + STEP_NS * np.arange(n)
    return {name: Series(stamps, value) for name, value in zip(NAMES, noisy, strict=True)}


def built(folder: Path) -> Any:
    """The peer's function."""
    library = folder / "batch_estimator.so"
    source = Path(__file__).with_suffix(".c")
    subprocess.run(
        ["cc", "-O3", "-march=native", "-std=c11", "-shared", "-fPIC", "-o", str(library),
         str(source), "-lm"],
        check=True,
    )  # fmt: skip
    found = ctypes.CDLL(str(library)).estimate
    found.restype = ctypes.c_long
    return found


def numbers(model: Model, series: Mapping[str, Series]) -> tuple[Any, Any]:
    """What the peer is told, in the order of its enum, and how late each signal is."""
    stream = StreamEstimator(model, EstimatorSettings(), sample_periods_s(series))
    c, law, timing = stream.constants, stream.physics.law, stream.timing
    told = [
        c.step_s, c.inverse_inertia, c.ratio, c.sensor_to_rotor,
        c.l_phi_phi, c.l_phi_omega, c.l_omega_phi, c.l_omega_omega, c.l_force_phi, c.l_force_omega,
        c.observer_lag_s, c.output_lag_s, c.low_pass, c.acceleration_low_pass, c.slope_low_pass,
        c.dead_zone, c.dead_zone_sigma, c.speed_noise_gain, c.torque_noise_gain, c.angle_low_pass,
        c.limiter_speed, c.limiter_acceleration, *law,
        *timing.first_noise[:4, 0], timing.first_noise[0, 1], timing.noise_memory,
    ]  # fmt: skip
    return np.array(told, dtype=np.float64), timing


def peer(function: Any, model: Model, series: Mapping[str, Series]) -> Callable[[], Rows]:
    """A call without arguments: (stamps, force, friction)."""
    told, timing = numbers(model, series)
    stamps = [np.ascontiguousarray(series[name].t_ns) for name in NAMES]
    values = [np.ascontiguousarray(series[name].value) for name in NAMES]
    many = np.array([len(each) for each in stamps], np.int64)
    room = len(stamps[2]) + 2

    def pointers(arrays: list[Any]) -> Any:
        return (ctypes.c_void_p * len(arrays))(*(each.ctypes.data for each in arrays))

    def call() -> Rows:
        t, force, friction = np.empty(room, np.int64), np.empty(room), np.empty(room)
        rows = function(
            told.ctypes.data_as(ctypes.c_void_p), pointers(stamps), pointers(values),
            many.ctypes.data_as(ctypes.c_void_p), timing.delay.ctypes.data_as(ctypes.c_void_p),
            ctypes.c_int64(timing.lookback), ctypes.c_int64(timing.step_ns),
            *(each.ctypes.data_as(ctypes.c_void_p) for each in (t, force, friction)),
        )  # fmt: skip
        return t[:rows], force[:rows], friction[:rows]

    return call


def shortest_s(calls: list[Callable[[], Any]], runs: int) -> list[float]:
    """The shortest of each, called by turns."""
    best = [float("inf")] * len(calls)
    for _ in range(runs):
        for k, call in enumerate(calls):
            begun = time.perf_counter()
            call()
            best[k] = min(best[k], time.perf_counter() - begun)
    return best


def main() -> int:
    """Run both, say what came out."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--seconds", type=float, default=624.0)
    ask.add_argument("--runs", type=int, default=7)
    ask.add_argument("--limit", type=float, default=float("inf"), help="exit 1 above this ratio")
    chosen = ask.parse_args()
    model = load_model(ROOT / "configs/reference_rig.yaml")
    series = recording(model, chosen.seconds)
    with tempfile.TemporaryDirectory() as folder:
        by_hand = peer(built(Path(folder)), model, series)
        ours = estimate(series, model)
        t, force, friction = by_hand()
        where = np.searchsorted(ours.t_ns, t)
        there = (where < len(ours.t_ns)) & ours.valid[np.minimum(where, len(ours.t_ns) - 1)]
        where = where[there]
        same_t = np.array_equal(ours.t_ns[where], t[there])
        apart_n = float(np.abs(ours.rack_force_n[where] - force[there]).max())
        apart_nm = float(np.abs(ours.friction_torque_nm[where] - friction[there]).max())
        mine_s, peer_s = shortest_s([lambda: estimate(series, model), by_hand], chosen.runs)
    ratio = mine_s / peer_s
    print(f"{chosen.seconds:g} s at 1 kHz, {len(ours.t_ns)} estimates, {len(where)} compared")
    print(f"eps_hil {mine_s * 1e3:8.1f} ms\nC by hand {peer_s * 1e3:6.1f} ms\nratio {ratio:.2f}")
    print(f"largest difference {apart_n:.1e} N, {apart_nm:.1e} Nm")
    return int(not same_t or not apart_n < SAME_N or ratio > chosen.limit)


if __name__ == "__main__":
    sys.exit(main())
