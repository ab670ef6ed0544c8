"""Speed as ratios to a named peer in the same run: ``.venv/bin/python benchmarks/compare.py``.

Ratios travel between machines, seconds do not. Each line: what, ours, the peer, peer / ours.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from eps_hil.bus.codec import FrameDecoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import load_mapping
from eps_hil.estimation.observer_design import design
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.stream import StreamEstimator
from eps_hil.physics.model import load_model
from eps_hil.recordings.read import read_recording

ROOT = Path(__file__).parents[1]
REPEATS = 5


def best_s(work: Callable[[], object]) -> float:
    """Shortest of a few runs, in seconds."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def say(what: str, ours_s: float, peer: str, peer_s: float, per: int, unit: str) -> None:
    """One line of the table, microseconds per item and the ratio."""
    ours, theirs = 1e6 * ours_s / per, 1e6 * peer_s / per
    print(f"{what:34} {ours:8.2f} µs/{unit:6} {peer:38} {theirs:8.2f}  x{theirs / ours:.1f}")


def estimator() -> None:
    """One live millisecond (three samples pushed, one step) against a numpy Kalman step alone."""
    model, settings = load_model(ROOT / "configs" / "reference_rig.yaml"), EstimatorSettings()
    names = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s")
    stream = StreamEstimator(model, settings, dict.fromkeys(names, 1e-3))
    inside = StreamEstimator(
        model, EstimatorSettings(kind="bristle_filter"), dict.fromkeys(names, 1e-3)
    )
    stream.warm_up()
    inside.warm_up()
    found = design(model, settings, angle=False, speed=True, dt=1e-3)
    c = np.array([[0.0, 1.0, 0.0]])
    gain = found.gain[:, 1:]
    n, clock = 2000, [0]

    def run(one: StreamEstimator) -> None:
        for _ in range(n):
            clock[0] += 1_000_000
            for name in names:
                one.push(name, clock[0], 0.1)
            one.advance(clock[0])

    def ours() -> None:
        run(stream)

    def peer() -> None:
        x = np.zeros(3)
        for _ in range(n):
            x = found.transition @ x + found.input * 0.1
            x = x + gain @ (np.array([0.1]) - c @ x)

    say("live millisecond, all blocks", best_s(ours), "numpy: 3-state Kalman step, no friction",
        best_s(peer), n, "step")  # fmt: skip
    say("the same with the bristle inside", best_s(lambda: run(inside)),
        "the paper's estimator, all blocks", best_s(ours), n, "step")  # fmt: skip


def decoder() -> None:
    """A protected frame to samples (CRC, counter, clock) against cantools' decode alone."""
    database = load_database([ROOT / "dbc" / "eps_rig.dbc"])
    mapping = load_mapping(ROOT / "configs" / "eps_rig_signals.yaml")
    message = database.get_message_by_name("EPS_MotorState")
    frames = [Frame(k * 1_000_000, message.frame_id, bytes(8)) for k in range(5000)]

    def ours() -> None:
        each = FrameDecoder(database, mapping)
        for frame in frames:
            each.decode(frame)

    def peer() -> None:
        for frame in frames:
            message.decode(frame.data, decode_choices=False)

    say("decode a protected frame", best_s(ours), "cantools: decode alone", best_s(peer),
        len(frames), "frame")  # fmt: skip


def reader() -> None:
    """A CSV of a minute at 1 kHz, checked cell by cell, against numpy.loadtxt."""
    rows = np.column_stack(
        [np.arange(60_000) * 1e-3, *np.random.default_rng(0).normal(size=(4, 60_000))]
    )
    header = "time_s,motor_torque_nm,torque_sensor_nm,motor_speed_rad_s,rack_force_n"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "minute.csv"
        np.savetxt(path, rows, delimiter=",", header=header, comments="")
        ours = best_s(lambda: read_recording(path))
        peer = best_s(lambda: np.loadtxt(path, delimiter=",", skiprows=1))
    say("read a CSV recording", ours, "numpy.loadtxt", peer, len(rows), "row")


if __name__ == "__main__":
    estimator()
    decoder()
    reader()
