"""Identification examined on rigs that this project's physics did not simulate.

    .venv/bin/python benchmarks/identify_coverage.py --seeds 50 [--plant full] [--set programme]
        [--can] [--noise 2] [--out lines.jsonl]
    .venv/bin/python benchmarks/identify_coverage.py --time

Each seed is another rig of ``eps_hil/proof`` (its own equations and integrator): friction and
bristle off the model file by up to 40 %, inertia by up to 10 %, speed 0 to 6 ms late, motor
torque 0 to 2 ms. ``--plant simple`` is one mass with LuGre friction, ``full`` five masses with
Maxwell-slip friction (its sliding level is the truth of the offsets; it has no σ0, σ1).
``--set all`` is four minutes: constant speeds under preloads, sweep, slow reversals, multisine,
weave; ``programme`` constant speeds and a sweep; ``free`` no load cell, against a spring.

Printed: error and interval of each parameter, how often the interval holds the truth, and the
limits of the issue; the same for the scatter of the main skew alone, without what the interval
holds for the unknown instant of a sample. The true skews contain what the plant's own 20 kHz step
does (``plant_late_s``).

``--time``: seconds for four minutes of recording, beside scipy's least squares on the same rows.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.identification import filters, kinematics
from eps_hil.identification.balance import cases
from eps_hil.identification.friction_rows import COLUMNS
from eps_hil.identification.identify import METHOD_SAMPLES, identify
from eps_hil.identification.prepare import prepare
from eps_hil.identification.state import State, get, put, sliding_parameters
from eps_hil.physics.model import load_model
from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.can_log import Wire, write_log
from eps_hil.proof.plant import SUBSTEPS
from eps_hil.proof.truth import MOTOR_LAG_S, Drive
from eps_hil.proof.world import Instruments, World
from eps_hil.recordings.read import read_recording
from eps_hil.series import Series

ROOT = Path(__file__).parents[1]
SETS = {
    "all": {"constant_speed": 90, "sweep": 50, "slow_reversals": 50, "multisine": 25, "weave": 25},
    "programme": {"constant_speed": 90, "sweep": 40},
    "few": {"constant_speed": 60, "multisine": 20},
    "mixed": {"weave": 40, "steps": 40, "slow_reversals": 40},
    "free": {"multisine": 40, "weave": 60},
}
STEPS = {
    "motor_torque_nm": 2e-3,
    "torque_sensor_nm": 5e-3,
    "motor_speed_rad_s": 0.05,
    "motor_angle_rad": 1e-3,
    "rack_force_n": 1.0,
}
FRICTION = ("k0_pos", "k0_neg", "kw_pos", "kw_neg", "kr_pos", "kr_neg", "sigma0", "sigma1")
NAMES = COLUMNS[: len(FRICTION)]
MAIN_SKEW = "motor_speed_minus_motor_torque"
SCATTER = MAIN_SKEW + ", scatter alone"
LIMITS = {"inertia": 3.0, "offset": 5.0, "load": 8.0, MAIN_SKEW: 0.5}


def rig(
    seed: int, full: bool, chosen: str, noise: float, can: Path | None
) -> tuple[dict[str, dict[str, Series]], dict[str, float]]:
    """(recordings, true values by name) of one seed; ``can`` is a folder for logs."""
    rng = np.random.default_rng([seed, 1907])
    nominal = Drive()
    drive = nominal._replace(
        inertia_kg_m2=nominal.inertia_kg_m2 * rng.uniform(0.9, 1.1),
        **{name: getattr(nominal, name) * rng.uniform(0.6, 1.4) for name in FRICTION},
    )
    speed_s, torque_s = rng.uniform(0.0, 6e-3), rng.uniform(0.0, 2e-3)
    world = World(simple=not full, drive=drive)
    made = {}
    for name, seconds in SETS[chosen].items():
        truth = world.run(getattr(manoeuvres, name)(rng, float(seconds)))
        instruments = Instruments(speed_late_s=speed_s - sensors.SPEED_LATE_S, noise=noise)
        clean = sensors.reported(truth, instruments)
        clean["motor_torque_nm"] = sensors.late(truth["motor_torque_nm"], torque_s)
        columns = sensors.measured(clean, instruments, rng)
        for signal, step in STEPS.items():
            columns[signal] = np.round(columns[signal] / step) * step
        if chosen == "free":
            del columns["rack_force_n"]
        made[name] = _series(columns) if can is None else _through_can(columns, can / name, rng)
    true = dict(zip(NAMES, (getattr(drive, name) for name in FRICTION), strict=True))
    true["inertia_kg_m2"] = drive.inertia_kg_m2
    late = plant_late_s()
    true[MAIN_SKEW] = speed_s - torque_s - late["motor_torque"]
    true["motor_speed_minus_torque_sensor"] = speed_s - late["torque_sensor"]
    if chosen != "free":
        true["motor_speed_minus_rack_force"] = speed_s - late["rack_force"]
    true["motor_angle_minus_motor_speed"] = late["motor_angle"]
    if full:
        del true["friction.sigma0_nm_per_rad"], true["friction.sigma1_nm_s_per_rad"]
    return made, true


def plant_late_s() -> dict[str, float]:
    """How late the plant's samples are against what acts on its rotor, by its own integration.

    Torques and forces act over the 50 µs step that follows their instant (explicit Euler): they
    are half a step early. The angle moves by the new speed (semi-implicit): half a step early too.
    The motor torque follows a command that is held for 1 ms through a lag (backward Euler: r a
    step), so it saws: its sample, taken after the first step of 20, lags the ramp of the command by
    r / (1 - r^20) ms, and its mean by half the hold and the lag.
    """
    half = 0.5e-3 / SUBSTEPS
    r = MOTOR_LAG_S / (MOTOR_LAG_S + 1e-3 / SUBSTEPS)
    sample = 1e-3 * r / (1.0 - r**SUBSTEPS)
    return {
        "motor_torque": sample - (0.5e-3 + MOTOR_LAG_S),
        "torque_sensor": -half,
        "rack_force": -half,
        "motor_angle": -half,
    }


def _series(columns: dict[str, Any]) -> dict[str, Series]:
    t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
    return {name: Series(t_ns, value) for name, value in columns.items() if name != "time_s"}


def _through_can(
    columns: dict[str, Any], path: Path, rng: np.random.Generator
) -> dict[str, Series]:
    from eps_hil.bus.database import load_database

    log, dbc = path.with_suffix(".log"), ROOT / "dbc" / "eps_rig.dbc"
    write_log(log, columns, load_database([dbc]), Wire(lost_per_frame=2e-5), rng)
    signals = ROOT / "configs" / "eps_rig_signals.yaml"
    return dict(read_recording(log, dbc=[dbc], signals=signals).series)


def examine(seed: int, words: argparse.Namespace) -> dict[str, Any]:
    """Errors, intervals and time of one seed."""
    with tempfile.TemporaryDirectory() as folder:
        recordings, true = rig(
            seed, words.plant == "full", words.set, words.noise, Path(folder) if words.can else None
        )
    model = load_model(ROOT / "configs" / "reference_rig.yaml")
    start, cpu = time.perf_counter(), time.process_time()
    found = identify(recordings, model)
    wall, cpu = time.perf_counter() - start, time.process_time() - cpu
    known = {**found.parameters, **found.skews_s}
    rows = {}
    for name, truth in true.items():
        one = known.get(name)
        if one is None or one.ci95 is None:
            rows[name] = None
            continue
        scale = 1e3 if one.unit == "s" else 100.0 / abs(truth)
        half = 0.5 * (one.ci95[1] - one.ci95[0])
        rows[name] = _row(scale * (one.value - truth), scale * half)
    main = rows.get(MAIN_SKEW)
    if main:
        # 1.98: Student's quantile for the hundred blocks of two seconds and more
        own = 1.98 * METHOD_SAMPLES * filters.STEP_S * 1e3
        rows[SCATTER] = _row(main["error"], float(np.sqrt(max(main["half"] ** 2 - own**2, 0.0))))
    return {"seed": seed, "wall_s": wall, "cpu_s": cpu, "rows": rows,
            "findings": [one.summary for one in found.findings]}  # fmt: skip


def _row(error: float, half: float) -> dict[str, Any]:
    return {"error": error, "half": half, "inside": bool(abs(error) <= half)}


def timed() -> str:
    """Seconds of an identification of four minutes, beside scipy's on the same rows.

    The peer is what one would write instead: scipy.optimize.least_squares over the same filtered
    balance, same parameters of the sliding stage, same start; no intervals, no bristle, no map.
    """
    from scipy.optimize import least_squares

    recordings, _ = rig(1, False, "all", 1.0, None)
    model = load_model(ROOT / "configs" / "reference_rig.yaml")
    identify(recordings, model)  # compiled code is then in the cache, as it is for a user
    start, cpu = time.perf_counter(), time.process_time()
    found = identify(recordings, model)
    ours, ours_cpu = time.perf_counter() - start, time.process_time() - cpu
    ready = [prepare(name, series) for name, series in recordings.items()]
    late = kinematics.skew(ready)
    late_s = late.seconds if late else 0.0
    rows = cases(ready, [kinematics.kinematics(one, late_s) for one in ready])
    first = State(model)
    names = [p.name for p in sliding_parameters(first, {name for one in ready for name in one.raw})]
    size = np.array([p.prior for p in sliding_parameters(first, {n for r in ready for n in r.raw})])
    origin = np.array([get(first, name) for name in names])

    def residual(x: Any) -> Any:
        state = first
        for name, value in zip(names, origin + size * x, strict=True):
            state = put(state, name, float(value))
        return np.concatenate([case.residual(state)[case.good] for case in rows]) / 1e-3

    start, cpu = time.perf_counter(), time.process_time()
    least_squares(residual, np.zeros(len(names)), loss="huber")
    peer, peer_cpu = time.perf_counter() - start, time.process_time() - cpu
    return (
        f"{found.seconds:.0f} s of recording: identify {ours:.1f} s ({ours_cpu:.1f} s of "
        f"processor); scipy.optimize.least_squares, sliding stage alone: {peer:.1f} s "
        f"({peer_cpu:.1f}); peer / ours: {peer_cpu / ours_cpu:.2f} of processor, "
        f"{peer / ours:.2f} of wall time"
    )


def table(results: list[dict[str, Any]]) -> str:
    """The results as a Markdown table."""
    lines = [
        "| parameter | rms error | worst | half interval | inside 95 % interval | limit: held |",
        "|---|---|---|---|---|---|",
    ]
    for name in results[0]["rows"]:
        rows = [one["rows"][name] for one in results if one["rows"][name]]
        if not rows:
            lines.append(f"| `{name}` | not identified | | | | |")
            continue
        unit = "ms" if "minus" in name else "%"
        error = np.array([row["error"] for row in rows])
        inside = sum(row["inside"] for row in rows)
        limit = next((v for key, v in LIMITS.items() if key in name), None)
        held = "" if limit is None else f"{limit:g} {unit}: {np.sum(np.abs(error) <= limit)}"
        held += "" if limit is None else f"/{len(results)}"
        lines.append(
            f"| `{name}` | {np.sqrt(np.mean(error**2)):.2g} {unit} | {np.abs(error).max():.2g} | "
            f"{np.median([row['half'] for row in rows]):.2g} | {inside}/{len(rows)} "
            f"({100 * inside / len(rows):.0f} %) | {held} |"
        )
    seconds = [one["wall_s"] for one in results]
    cpu = [one["cpu_s"] for one in results]
    low, high = expected(len(results))
    lines.append(
        f"\n{len(results)} rigs; an interval that holds the truth in 95 of 100 cases does so in "
        f"{low} to {high} of {len(results)} (95 %); {np.median(seconds):.1f} s each (median), "
        f"{np.median(cpu):.1f} s of processor"
    )
    return "\n".join(lines)


def expected(count: int) -> tuple[int, int]:
    """Between how many of ``count`` an honest 95 % interval holds the truth, in 95 % of cases."""
    from scipy.stats import binom

    return int(binom.ppf(0.025, count, 0.95)), int(binom.ppf(0.975, count, 0.95))


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--plant", choices=("simple", "full"), default="simple")
    parser.add_argument("--set", choices=SETS, default="all")
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--can", action="store_true", help="through CAN logs with jitter and loss")
    parser.add_argument("--out", type=Path, help="one JSON line a rig; read again when it is there")
    parser.add_argument("--time", action="store_true", help="seconds, beside scipy; nothing else")
    words = parser.parse_args()
    if words.time:
        print(timed())
        return 0
    results = []
    if words.out and words.out.exists():
        results = [json.loads(line) for line in words.out.read_text().splitlines()]
    done = {one["seed"] for one in results}
    for seed in range(words.first, words.first + words.seeds):
        if seed in done:
            continue
        results.append(examine(seed, words))
        if words.out:
            with words.out.open("a") as file:
                file.write(json.dumps(results[-1]) + "\n")
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{len(results)}/{words.seeds} rigs")
    print(table(results))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
