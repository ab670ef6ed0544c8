"""Physics without a name, modelled by this tool and by what people would use in its place.

    python benchmarks/arena.py [--families …] [--size 3] [--seed 61] [--decoys 4] [--out FILE]

Cases are those of ``benchmarks/nameless.py``: rigs of the proof's truth plant, each of which hides
a family that no catalogue holds. Every method but the tool is handed what the tool has to make
first: the torque that the right nominal model leaves (bristle simulated, filtered without phase,
sliding samples only) and the signals beside it; it has to find the model of that torque. Its
settings are chosen on the last third of the fitted recordings. Printed as a Markdown table:

*share*: of the hold-out's excess that is gone (1: the same rig with nothing hidden). *worse*: cases
in which more is left than without a model. *free run*: the rotor's angle over the whole hold-out,
simulated from its first state, ÷ the error without a model. *decoys*: with nothing hidden, those
whose hold-out a model changes by more than a tenth of the noise. *s*: processor time of the fit.

Needs ``pip install eps_hil[arena]``. ``--out`` keeps a line of JSON for each case, and goes on.
"""

import argparse
import importlib
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parent))
from arena_methods import METHODS, Learnt
from nameless import nominal, series_of

from eps_hil.diagnosis.accept.free_run import simulated
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.data.intake import prepared
from eps_hil.diagnosis.data.prepare import STEP_S, THIN, Prepared
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.friction import friction_law, static_level_nm
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import simulate
from eps_hil.proof.cases import make
from eps_hil.proof.effects import NAMELESS
from eps_hil.proof.plans import Plan

Floats = npt.NDArray[np.float64]

TOOL = "eps-hil"
QUIET = ("nothing", "noise_x3", "heavy_tails", "coarse_encoder")
"""Decoys in which the nominal model is right."""
WINDOW_S, SWEEPS = 0.25, 3
"""A free run with a model that is no simulator: windows, in each of which its torque along the
trajectory and the trajectory under that torque are made in turn."""
CLAIMED = 0.1


@dataclass(frozen=True)
class Seen:
    """One recording under the nominal model: all at 1 kHz, and where to judge at 125 Hz."""

    prepared: Prepared
    signals: Floats
    """(n, 6): speed, angle, motor torque, torsion-bar torque, rack force, friction's side."""
    left_nm: Floats
    """(m,) thinned."""
    sliding: npt.NDArray[np.bool_]

    @property
    def rows(self) -> Floats:
        """Signals (m, 6) as the filter leaves them."""
        return np.column_stack([self.prepared.thin(column) for column in self.signals.T])


def seen(one: Prepared, model: Model) -> Seen:
    """What a method is handed of a recording."""
    motion = one.motion(model)
    signals = features(motion, motion.speed_rad_s, motion.angle_rad)
    return Seen(one, signals, one.left_over(model), Holdout(one, {}).judging(model))


def features(motion: Any, speed: Floats, angle: Floats) -> Floats:
    """The signals that a model may depend on, (n, 6)."""
    torques = motion.motor_torque_nm, motion.torque_sensor_nm, motion.rack_force_n
    return np.column_stack([speed, angle, *torques, np.tanh(speed / 0.5)])


def free_run_rad(one: Prepared, model: Model, learnt: Learnt | None) -> float:
    """Rms error (rad) of the angle over the whole recording; ``learnt`` is taken off the torque."""
    motion = one.motion(model)
    if learnt is None:
        run = simulated(motion, model, slice(None)).angle_rad
        return float(np.sqrt(np.mean((run - motion.angle_rad) ** 2)))
    law, n = friction_law(model.friction), round(WINDOW_S / STEP_S)
    speed, angle = float(motion.speed_rad_s[0]), float(motion.angle_rad[0])
    level = static_level_nm(speed, float(motion.rack_force_n[0]), law)
    bristle = float(np.sign(speed) * level / law.sigma0_nm_per_rad)
    error = np.zeros(len(motion.time_s))
    inputs = motion.motor_torque_nm, motion.torque_sensor_nm, motion.rack_force_n
    past = np.zeros((0, 6))
    for first in range(0, len(error) - 1, n):
        part = slice(first, min(first + n + 1, len(error)))
        motor, sensor, force = (one[part] for one in inputs)
        time_s, here = motion.time_s[part], motion_part(motion, part)
        more = np.full(len(motor), 0.0)
        for _ in range(SWEEPS):
            run = simulate(
                model, time_s, motor - more, sensor, force,
                speed_rad_s=speed, angle_rad=angle, bristle_rad=bristle,
            )  # fmt: skip
            more, told = along(learnt, features(here, run.speed_rad_s, run.angle_rad), past)
        past = told[-learnt.memory :] if learnt.memory else past
        error[part] = run.angle_rad - motion.angle_rad[part]
        speed, angle = float(run.speed_rad_s[-1]), float(run.angle_rad[-1])
        if not np.isfinite(angle) or abs(speed) > 1e4:
            return float("inf")
        level = static_level_nm(speed, float(force[-1]), law)
        fade = law.sigma1_nm_s_per_rad * np.exp(-((speed / law.sigma1_speed_rad_s) ** 2))
        kept = float(run.friction_torque_nm[-1]) - fade * speed
        bristle = kept / (law.sigma0_nm_per_rad * (1.0 - fade * abs(speed) / level))
    return float(np.sqrt(np.mean(error**2)))


def along(learnt: Learnt, signals: Floats, past: Floats) -> tuple[Floats, Floats]:
    """The learnt torque (n,) beside ``signals`` (n, 6) at 1 kHz, and all that it was told.

    ``past`` (k, 6): what came before, each 8 ms, for a model that remembers.
    """
    if not learnt.memory:
        return learnt(signals), past
    at = np.linspace(0.0, len(signals) - 1.0, max(1, round(len(signals) / THIN)), endpoint=False)
    told = np.vstack([past, signals[np.rint(at).astype(int)]])
    return np.interp(np.arange(len(signals)), at, learnt(told)[len(past) :]), told


def motion_part(motion: Any, part: slice) -> Any:
    """A stretch of a motion."""
    return type(motion)(*(column[part] for column in motion))


def run(name: str, plan: Plan, methods: Mapping[str, Callable[..., Learnt]]) -> dict[str, Any]:
    """One case: figures of every method."""
    case, model = make(plan), nominal()
    recordings = {one: series_of(columns) for one, columns in case.recordings.items()}
    holdout = {"holdout": recordings.pop("holdout")}
    fitted = [seen(prepared(one, data, 0.0, {}), model) for one, data in recordings.items()]
    kept = seen(prepared("holdout", holdout["holdout"], 0.0, {}), model)
    use, before = kept.sliding, kept.left_nm
    floor = kept.prepared.floor_nm(model) ** 2
    if plan.wanted:
        spared = seen(prepared("holdout", series_of(case.spared), 0.0, {}), model)
        floor = float(np.mean(spared.left_nm[spared.sliding] ** 2))
    energy = float(np.mean(before[use] ** 2))
    start = free_run_rad(kept.prepared, model, None)

    def figures(after: Floats, free: float) -> dict[str, Any]:
        left = float(np.mean(after[use] ** 2))
        return {
            "share": (energy - left) / (energy - floor) if plan.wanted else 0.0,
            "worse": left > energy,
            "changed": float(np.sqrt(np.mean((after - before)[use] ** 2) / floor)),
            "free": free / start,
        }

    since = time.process_time()
    told = diagnose(model, recordings, holdout)
    took = time.process_time() - since
    after = kept.prepared.left_over(told.model)
    free = free_run_rad(kept.prepared, told.model, None)
    said = [one.get("model") or {"law": one["effect"]} for one in told.content["findings"]]
    laws = [one["law"] or one["form"] for one in said]
    found = {TOOL: {**figures(after, free), "s": took, "laws": laws}}
    for method, learn in methods.items():
        since = time.process_time()
        learnt = learn([(one.rows, one.left_nm, one.sliding) for one in fitted])
        took = time.process_time() - since
        after = before - learnt(kept.rows)
        free = free_run_rad(kept.prepared, model, learnt)
        found[method] = {**figures(after, free), "s": took, "terms": learnt.terms}
    return {"hidden": name, "seed": plan.seed, "methods": found}


def table(cases: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a row for each method."""
    hidden = [one for one in cases if not one["hidden"].startswith("decoy")]
    decoys = [one for one in cases if one["hidden"].startswith("decoy")]
    lines = [
        f"{len(hidden)} cases, {len(decoys)} decoys",
        "",
        "| | share, median | lowest | worse | free run, median | highest | decoys | s, median |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for method in cases[0]["methods"] if cases else ():
        these = [one["methods"][method] for one in hidden]
        false = sum(one["methods"][method]["changed"] > CLAIMED for one in decoys)
        share, free, took = ([one[key] for one in these] for key in ("share", "free", "s"))
        worse = sum(one["worse"] for one in these)
        lines.append(
            f"| {method} | {np.median(share):.2f} | {min(share):.2f} | {worse} | "
            f"{np.median(free):.2f} | {max(free):.2f} | {false} of {len(decoys)} | "
            f"{np.median(took):.0f} |"
        )
    return "\n".join(lines)


def absent() -> list[str]:
    """What ``eps_hil[arena]`` brings and is not here."""
    missing = []
    for name in ("sklearn", "pysindy", "sysidentpy"):
        try:
            importlib.import_module(name)
        except ImportError:
            missing.append(name)
    return missing


def main(given: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--families", nargs="+", default=sorted(NAMELESS))
    parser.add_argument("--size", type=float, default=3.0, help="effect to noise")
    parser.add_argument("--seed", type=int, default=61)
    parser.add_argument("--decoys", type=int, default=4)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args(given)
    if missing := absent():
        sys.stderr.write(f"not installed: {', '.join(missing)}; pip install 'eps_hil[arena]'\n")
        return 2
    cases = []
    if chosen.out and chosen.out.exists():
        cases = [json.loads(line) for line in chosen.out.read_text(encoding="utf-8").splitlines()]
    done = {(one["hidden"], one["seed"]) for one in cases}
    plans = [
        (name, Plan("nameless", chosen.seed, ((name, chosen.size),))) for name in chosen.families
    ]
    for k in range(chosen.decoys):
        quiet = Plan("decoys", chosen.seed + k, (), decoy=QUIET[k % len(QUIET)])
        plans.append((f"decoy: {quiet.decoy}", quiet))
    for name, plan in plans:
        if (name, plan.seed) in done:
            continue
        cases.append(run(name, plan, METHODS))
        if chosen.out:
            with chosen.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(cases[-1]) + "\n")
        told = ", ".join(
            f"{method} {one['share']:.2f} {one['free']:.2f} {one['changed']:.2f}"
            for method, one in cases[-1]["methods"].items()
        )
        sys.stderr.write(f"{name}: {told}; {cases[-1]['methods'][TOOL]['laws']}\n")
    sys.stdout.write(f"{table(cases)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
