"""Rigs of other code, under their own controllers, that lack nothing: which names are made up.

    python benchmarks/nothing_missing.py [--seed 1] [--count 10] [--no-load-cell] [--every ROWS]

Each rig is drawn at random (a spring, a constant push or a free rack; speed or position loop) and
diagnosed twice: by its own numbers, where every name is wrong, and by a model whose numbers are
each 5 to 40 % off, where names of those numbers are right, and what is said to be
confusable with one. Without a load cell the load is no number of the model's. ``--every`` keeps one
row of so many of the 1 kHz tables.
"""

import argparse
import importlib
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Delays, Friction, Model, load_model
from eps_hil.series import Series

ROOT = Path(__file__).parents[1]
OWN = ("inertia_kg_m2", "levels", "viscous", "load", "sigma0_nm_per_rad")
NUMBERS = {"inertia", "coulomb_level", "viscous_friction", "load_dependent_friction",
           "friction_asymmetry", "presliding_hysteresis"}  # fmt: skip
"""What a model whose numbers are off may rightly be told."""


def drawn(rng: np.random.Generator, rigs: ModuleType) -> tuple[Any, tuple[float, ...]]:
    """A rig, and the noise of its sensors (torque, speed, angle, force)."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    ratio, level, swing = between(350.0, 2500.0), between(0.05, 0.25), between(10.0, 50.0)
    load = str(rng.choice(["spring", "push", "free"]))
    most_n = between(1.0, 6.0) * level * ratio  # the load is some times the friction
    rig = rigs.Rig(
        inertia=between(5e-5, 4e-4),
        level_pos=level * rng.uniform(0.85, 1.15),
        level_neg=level * rng.uniform(0.85, 1.15),
        drag=between(1e-4, 1e-3),
        grows=0.0 if load == "free" else float(rng.uniform(0.0, 0.25)) / ratio,
        stiffness=level * between(20.0, 100.0),
        ratio=ratio,
        spring=most_n * ratio / swing if load == "spring" else 0.0,
        push=most_n if load == "push" else 0.0,
        swing_rad=swing,
        speed_loop=bool(rng.uniform() < 0.5),
    )
    torque = between(2e-3, 1e-2) * level
    return rig, (torque, between(0.01, 0.1), between(1e-4, 1e-3), max(0.3 * torque * ratio, 0.5))


def model_of(rig: Any, reference: Model, off: dict[str, float]) -> Model:
    """What a file says whose numbers are so many times the rig's own."""
    level, load, viscous = off["levels"], off["load"], off["viscous"]
    friction = Friction(
        level * rig.level_pos, level * rig.level_neg, viscous * rig.drag, viscous * rig.drag,
        load * rig.grows, load * rig.grows, off["sigma0_nm_per_rad"] * rig.stiffness, 0.0, 0.75,
    )  # fmt: skip
    return replace(
        reference,
        inertia_kg_m2=off["inertia_kg_m2"] * rig.inertia,
        rack_to_rotor_ratio_rad_per_m=rig.ratio,
        friction=friction,
        delays_s=Delays(),
        effects=(),
    )


def main() -> None:
    """One line for each rig and model, then how many have names that nothing bears."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--no-load-cell", action="store_true")
    parser.add_argument("--every", type=int, default=1, metavar="ROWS")
    asked = parser.parse_args()
    sys.path.insert(0, str(ROOT / "tests" / "diagnosis"))
    rigs = importlib.import_module("closed_loop_rig")
    reference = load_model(ROOT / "configs" / "reference_rig.yaml")
    wrong = {"right": 0, "off": 0}
    for k in range(asked.count):
        rng = np.random.default_rng([asked.seed, k])
        rig, noise = drawn(rng, rigs)
        read = {}
        for name, seconds in (("one", 20.0), ("two", 20.0), ("kept", 16.0)):
            columns = rigs.record(rig, int(rng.integers(1 << 30)), seconds, noise)
            t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
            left_out = {"motor_angle_rad"} if k % 3 == 2 else set()
            left_out |= {"rack_force_n"} if asked.no_load_cell else set()
            some = slice(None, None, asked.every)
            read[name] = {
                n: Series(t_ns[some], c[some]) for n, c in columns.items() if n not in left_out
            }
        kept = {"kept": read.pop("kept")}
        signs = rng.choice([-1.0, 1.0], len(OWN))
        off = 1.0 + signs * rng.uniform(0.05, 0.4, len(OWN))
        for how, factors in (("right", np.ones(len(OWN))), ("off", off)):
            model = model_of(rig, reference, dict(zip(OWN, factors.tolist(), strict=True)))
            since = time.process_time()
            try:
                content = diagnose(model, read, kept).content
            except ValueError as error:
                print(f"{k:3} {how:5} refused: {error}", flush=True)
                continue
            names = [one["effect"] for one in content["findings"]]
            right = NUMBERS if how == "off" else set()
            made_up = {
                one["effect"]
                for one in content["findings"]
                if not right & {one["effect"], *one["confusable_with"]}
            }
            wrong[how] += bool(made_up)
            figures = content["fit"]["holdout"]
            left = [round(figures[m]["torque_nrmse"], 4) for m in ("augmented", "noise_floor")]
            print(
                f"{k:3} {how:5} {'WRONG' if made_up else 'ok':5} {names} left {left} "
                f"{'spring' if rig.spring else 'push' if rig.push else 'free'} "
                f"({time.process_time() - since:.0f} s)",
                flush=True,
            )
    print(f"# {asked.count} rigs: {wrong['right']} with a name by the right model, "
          f"{wrong['off']} with a wrong one by a model off by 5 to 40 %")  # fmt: skip


if __name__ == "__main__":
    main()
