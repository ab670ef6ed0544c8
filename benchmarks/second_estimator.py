"""The paper's estimator and those beside it on the same recordings: tables for the docs.

    .venv/bin/python benchmarks/second_estimator.py            the comparison (evaluation seeds)
    .venv/bin/python benchmarks/second_estimator.py --tune     how both were tuned (other seeds)
    .venv/bin/python benchmarks/second_estimator.py --each     recording by recording
    .venv/bin/python benchmarks/second_estimator.py --write DIR   the recordings as CSV

Three rigs: the simulated five-mass rig; the rig of tests/estimation/independent_rig.py (other
code, explicit integration at 100 kHz); the truth plant of the proof (Maxwell-slip friction, five
masses, other manoeuvres), which neither estimator's model matches. Errors in N rms at the rack.
"""

import argparse
import importlib.util
import itertools
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.estimation import batch
from eps_hil.estimation.bristle_smoother import smooth
from eps_hil.estimation.phases import phases
from eps_hil.estimation.settings import BristleSettings, EstimatorSettings
from eps_hil.estimation.stream import StreamEstimator
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import Model, load_model
from eps_hil.proof import manoeuvres
from eps_hil.proof.sensors import measured, reported
from eps_hil.proof.world import World
from eps_hil.recordings.write import write_table
from eps_hil.rig.manoeuvre import load_manoeuvre
from eps_hil.rig.offline import simulate_recording
from eps_hil.series import Series

ROOT = Path(__file__).parents[1]
MODEL = load_model(ROOT / "configs" / "reference_rig.yaml")
BASE = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s")
ANGLE = (*BASE, "motor_angle_rad")
DEVELOPMENT, EVALUATION = 11, 2026
LONGEST_S = 0.0175
"""Delay that a tuned observer may have: that of the defaults, and of the filter's fixed lag."""

Recording = tuple[Mapping[str, Any], Any, Any]  # columns, true rack force, true speed at 1 kHz


def _independent() -> Any:
    path = ROOT / "tests" / "estimation" / "independent_rig.py"
    spec = importlib.util.spec_from_file_location("independent_rig", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["independent_rig"] = module
    spec.loader.exec_module(module)
    return module


def recordings(seed: int) -> dict[str, list[Recording]]:
    """Recordings by rig; other noise, and on the truth plant other manoeuvres, for each seed."""
    chain = load_chain(ROOT / "configs" / "reference_chain.yaml")
    five = []
    for name in ("sine_sweep", "steps", "weave", "dwell"):
        made = simulate_recording(MODEL, chain, load_manoeuvre(name), seed=seed)
        five.append((made.columns, made.truth["rack_force_n"], made.truth["motor_speed_rad_s"]))
    rig = _independent()
    other = []
    for force, driver in ((rig.sweep(), 0.0), (rig.steps(), 0.0), (rig.weave(), 0.8)):
        t = np.arange(len(force)) * 1e-3
        truth = rig.run(force, driver * np.sin(2 * np.pi * 0.25 * t + 0.4), seed=seed)
        other.append((truth.columns, truth.rack_force_n, truth.speed_rad_s))
    rng = np.random.default_rng(seed)
    slip = []
    for program in (*manoeuvres.training(rng), manoeuvres.holdout(rng)):
        world = World(False)
        happened = world.run(program)
        columns = measured(reported(happened, world.instruments), world.instruments, rng)
        slip.append((columns, happened["rack_force_n"], happened["motor_speed_rad_s"]))
    return {"five masses": five, "other code": other, "Maxwell-slip": slip}


def series_of(columns: Mapping[str, Any], names: tuple[str, ...]) -> dict[str, Series]:
    """The columns that an estimator is given."""
    t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
    return {n: Series(t_ns, np.asarray(columns[n], dtype=np.float64)) for n in names}


def errors(
    some: list[Recording], names: tuple[str, ...], settings: EstimatorSettings, model: Model
) -> Any:
    """N rms over all recordings, [moving, reversal, rest, all] (4,), without start and end."""
    squares: list[list[Any]] = [[], [], [], []]
    for columns, force, speed in some:
        trace = batch.estimate(series_of(columns, names), model, settings)
        t_s, end = trace.t_ns * 1e-9, (len(force) - 1) * 1e-3
        keep = trace.valid & (t_s > 0.5) & (t_s < end - 0.3)
        at = t_s[keep]
        error = trace.rack_force_n[keep] - np.interp(at, np.arange(len(force)) * 1e-3, force)
        places = np.clip(np.round(at * 1e3).astype(np.int64), 0, len(force) - 1)
        for k, part in enumerate((*phases(speed), np.ones(len(speed), np.bool_))):
            squares[k].append(error[part[places]] ** 2)
    return np.array([np.sqrt(np.mean(np.concatenate(one))) for one in squares])


def candidates() -> Iterator[tuple[str, tuple[str, ...], EstimatorSettings]]:
    """What is compared; each with and without a recorded angle."""
    for names, note in ((BASE, ""), (ANGLE, ", angle")):
        yield f"observer{note}", names, EstimatorSettings()
        yield f"observer, tuned{note}", names, tuned_observer()
        if names is ANGLE:
            yield "observer, angle measured", names, EstimatorSettings(position="measured")
        yield f"bristle filter{note}", names, EstimatorSettings(kind="bristle_filter")
        yield f"smoother{note}", names, EstimatorSettings(kind="smoother")


def tuned_observer() -> EstimatorSettings:
    """The best of ``--tune`` for the paper's observer at the same delay."""
    return EstimatorSettings(
        force_walk_n_per_sqrt_s=TUNED[0], output_low_pass_hz=TUNED[1], dead_zone_sigma=TUNED[2]
    )


TUNED = (70.0, 60.0, 3.0)


def delay_ms(settings: EstimatorSettings) -> float:
    """Observer or lag, without alignment's look-back."""
    if settings.kind == "smoother":
        return float("nan")
    stream = StreamEstimator(MODEL, settings, dict.fromkeys(ANGLE, 1e-3))
    return 1e3 * stream.constants.output_lag_s


def compare() -> None:
    """The tables of docs/theory-second-estimator.md."""
    rigs = recordings(EVALUATION)
    for rig, some in rigs.items():
        print(f"\n{rig}: N rms{'':18}moving reversal    rest     all  delay ms")
        for name, names, settings in candidates():
            found = errors(some, names, settings, MODEL)
            cells = "".join(f"{value:8.1f}" for value in found)
            print(f"  {name:34}{cells}{delay_ms(settings):10.1f}")
    robustness(rigs)
    shorter(rigs)
    standstill(rigs)
    consistency(rigs)
    cost(rigs)


def wrong(percent: float) -> Model:
    """The model with all friction levels off by so much."""
    f, k = MODEL.friction, 1.0 + percent / 100.0
    levels = ("offset_pos_nm", "offset_neg_nm", "load_pos_nm_per_n", "load_neg_nm_per_n")
    return replace(MODEL, friction=replace(f, **{n: k * getattr(f, n) for n in levels}))


def robustness(rigs: dict[str, list[Recording]]) -> None:
    """Friction levels that the model has wrong."""
    some = rigs["other code"]
    print(f"\nother code, wrong friction: N rms{'':3}moving reversal    rest     all")
    for percent in (-20.0, 20.0):
        for kind in ("observer", "bristle_filter", "smoother"):
            found = errors(some, ANGLE, EstimatorSettings(kind=kind), wrong(percent))  # type: ignore[arg-type]
            cells = "".join(f"{value:8.1f}" for value in found)
            print(f"  {percent:+.0f} % {kind:29}{cells}")


def shorter(rigs: dict[str, list[Recording]]) -> None:
    """Less look-ahead for both."""
    some = rigs["other code"] + rigs["Maxwell-slip"]
    print(
        f"\nother code and Maxwell-slip, less delay{'':4}moving reversal    rest     all  delay ms"
    )
    for walk, corner in ((355.7, 75.4), (1124.7, 134.1)):
        fast = EstimatorSettings(force_walk_n_per_sqrt_s=walk, output_low_pass_hz=corner)
        lag = round(delay_ms(fast)) * 1e-3
        filtered = EstimatorSettings(kind="bristle_filter", bristle=BristleSettings(lag_s=lag))
        for name, settings in (("observer, angle", fast), ("bristle filter, angle", filtered)):
            cells = "".join(f"{v:8.1f}" for v in errors(some, ANGLE, settings, MODEL))
            print(f"  {name:34}{cells}{delay_ms(settings):10.1f}")


NAMES = {
    "five masses": ("sweep", "steps", "weave", "dwell", "demo"),
    "other code": ("sweep", "steps", "weave"),
    "Maxwell-slip": ("training 1", "training 2", "hold-out"),
}


def each() -> None:
    """Recording by recording: a mean over manoeuvres hides where which one is better."""
    rigs = recordings(EVALUATION)
    chain = load_chain(ROOT / "configs" / "reference_chain.yaml")
    demo = simulate_recording(MODEL, chain, load_manoeuvre("demo"), seed=EVALUATION)
    rigs["five masses"].append(
        (demo.columns, demo.truth["rack_force_n"], demo.truth["motor_speed_rad_s"])
    )
    for names, note in ((BASE, "no angle"), (ANGLE, "angle")):
        heading = "moving revers.   rest    all"
        print(f"\nN rms, {note:24} observer {heading}   bristle filter {heading}")
        for rig, some in rigs.items():
            for name, one in zip(NAMES[rig], some, strict=True):
                cells = []
                for kind in ("observer", "bristle_filter"):
                    settings = EstimatorSettings(kind=kind)  # type: ignore[arg-type]
                    found = errors([one], names, settings, MODEL)
                    cells.append("".join("      -" if np.isnan(v) else f"{v:7.1f}" for v in found))
                print(f"  {rig + ', ' + name:37}{cells[0]}                 {cells[1]}")


def write(folder: Path) -> None:
    """The evaluation recordings as CSV files, for ``eps-hil compare --second``."""
    folder.mkdir(parents=True, exist_ok=True)
    for rig, some in recordings(EVALUATION).items():
        for k, (columns, _, _) in enumerate(some):
            path = folder / f"{rig.lower().replace(' ', '_').replace('-', '_')}_{k + 1}.csv"
            write_table(path, {name: np.asarray(one) for name, one in columns.items()})
            print(path)


def standstill(rigs: dict[str, list[Recording]]) -> None:
    """Step manoeuvres: how the estimate wanders at rest, and its largest error at all."""
    print("\nsteps, angle recorded       drift at rest: median, largest N/s     largest error N")
    for rig in ("five masses", "other code"):
        columns, force, speed = rigs[rig][1]
        still = np.convolve(np.abs(speed) < 0.05, np.ones(500) / 500, mode="same") > 0.999
        for kind in ("observer", "bristle_filter", "smoother"):
            settings = EstimatorSettings(kind=kind)  # type: ignore[arg-type]
            trace = batch.estimate(series_of(columns, ANGLE), MODEL, settings)
            at = np.arange(500, len(force) - 500)
            found = np.interp(at * 1e-3, trace.t_ns * 1e-9, trace.rack_force_n)
            error = found - force[at]
            slopes = [
                abs(np.polyfit(np.arange(500) * 1e-3, error[k : k + 500], 1)[0])
                for k in range(0, len(at) - 500, 100)
                if np.all(still[at[k : k + 500]])
            ]
            drift = f"{np.median(slopes):22.1f}{np.max(slopes):12.1f}"
            print(f"  {rig + ', ' + kind:30}{drift}{np.max(np.abs(error)):26.0f}")


def consistency(rigs: dict[str, list[Recording]]) -> None:
    """Squared innovations over their variance, with each rig's own sensor noise in the settings."""
    noise = {
        "five masses": (0.25, 0.002, 0.004),
        "other code": (0.3, 1.05e-3, 0.003),
        "Maxwell-slip": (0.25, 0.002, 0.004),
    }
    print("\nmean squared innovation over its variance (1 is consistent)     speed   angle")
    for rig, some in rigs.items():
        speed, angle, torque = noise[rig]
        settings = EstimatorSettings(
            speed_noise_rad_s=speed, angle_noise_rad=angle, torque_noise_nm=torque
        )
        parts = []
        for columns, _, _ in some:
            series = series_of(columns, ANGLE)
            periods = batch.sample_periods_s(series)
            parts.append(smooth(MODEL, settings, periods, batch.events(series)).nis[500:])
        means = np.nanmean(np.concatenate(parts), axis=0)
        print(f"  {rig:60}{means[0]:8.2f}{means[1]:8.2f}")


def cost(rigs: dict[str, list[Recording]]) -> None:
    """Time of one step, alignment included, as a ratio to the paper's estimator."""
    series = series_of(rigs["five masses"][0][0], ANGLE)
    periods = batch.sample_periods_s(series)
    taken = {}
    for kind in ("observer", "bristle_filter"):
        settings = EstimatorSettings(kind=kind)  # type: ignore[arg-type]
        best = float("inf")
        for _ in range(7):
            stream = StreamEstimator(MODEL, settings, periods)
            samples = batch.lanes(series)
            start = time.process_time()
            stream.run(samples)
            best = min(best, time.process_time() - start)
        taken[kind] = best
    ratio = taken["bristle_filter"] / taken["observer"]
    print(
        f"\none step, alignment included: the bristle filter takes {ratio:.1f} times the observer's"
    )


def tune() -> None:
    """Grid search on the development seeds, geometric mean of the three phases, angle recorded."""
    some = list(itertools.chain(*recordings(DEVELOPMENT).values()))

    def score(settings: EstimatorSettings) -> tuple[float, Any]:
        found = errors(some, ANGLE, settings, MODEL)
        return float(np.exp(np.mean(np.log(found[:3])))), found

    print("observer: walk, low-pass, dead zone in σ; N rms moving, reversal, rest; delay")
    rows = []
    for walk, corner, sigma in itertools.product(
        (70.0, 100.0, 150.0, 250.0), (30.0, 40.0, 60.0), (3.0, 4.5)
    ):
        settings = EstimatorSettings(
            force_walk_n_per_sqrt_s=walk, output_low_pass_hz=corner, dead_zone_sigma=sigma
        )
        if delay_ms(settings) <= 1e3 * LONGEST_S:
            rows.append((*score(settings), (walk, corner, sigma), delay_ms(settings)))
    _best(rows)
    print("bristle filter: rate walk, slip in σ, gap in rad; lag 17 ms")
    rows = []
    for walk, sigma, gap in itertools.product((1e4, 2e4, 4e4), (2.0, 3.0, 4.0), (1.3e-3, 1.8e-3)):
        bristle = BristleSettings(rate_walk_n_per_s_per_sqrt_s=walk, slip_sigma=sigma, gap_rad=gap)
        settings = EstimatorSettings(kind="bristle_filter", bristle=bristle)
        rows.append((*score(settings), (walk, sigma, gap), 17.0))
    _best(rows)


def _best(rows: list[Any]) -> None:
    for mean, found, chosen, delay in sorted(rows, key=lambda row: row[0])[:4]:
        cells = " ".join(f"{value:6.1f}" for value in found[:3])
        print(f"  {chosen!s:28} {cells}   mean {mean:5.1f}   {delay:.1f} ms")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tune", action="store_true")
    parser.add_argument("--each", action="store_true")
    parser.add_argument("--write", metavar="FOLDER", help="only write the recordings as CSV")
    given = parser.parse_args()
    if given.tune:
        tune()
    elif given.each:
        each()
    elif given.write:
        write(Path(given.write))
    else:
        compare()
