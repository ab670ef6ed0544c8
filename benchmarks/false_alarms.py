#!/usr/bin/env python3
"""False alarms of the plausibility tests per hour, on healthy recordings with wrong models.

    python benchmarks/false_alarms.py [--seeds N] [--holes MS] [--parts N]

Recordings are of the rig of other code (tests/estimation/independent_rig.py): sweep, weave and
steps of the load, with sensor noise of its seed. Each is estimated with the model as it is and with
one of inertia, friction, ratio, bristle stiffness and delays 20 % off either way. ``--holes`` takes
all frames out for 1 to MS milliseconds, some ten times a second. ``--parts``: N parts of 1.5 to 6 s
that begin anywhere, with the model as it is, instead: little is learnt at the start.
"""

import argparse
import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from eps_hil.estimation.batch import estimate  # noqa: E402
from eps_hil.estimation.validity import Reason  # noqa: E402
from eps_hil.physics.model import Model, load_model  # noqa: E402
from eps_hil.series import Series  # noqa: E402

NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
TESTS = (Reason.RANGE, Reason.RATE, Reason.FROZEN, Reason.INCONSISTENT, Reason.IMPLAUSIBLE)


def rig() -> Any:
    """The rig of other code."""
    spec = importlib.util.spec_from_file_location(
        "independent_rig", ROOT / "tests" / "estimation" / "independent_rig.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def models(model: Model) -> Iterator[tuple[str, Model]]:
    """The model, and with one thing 20 % off."""
    yield "as it is", model
    f, d = model.friction, model.delays_s
    for factor in (0.8, 1.2):
        said = f"x {factor}"
        yield f"inertia {said}", replace(model, inertia_kg_m2=factor * model.inertia_kg_m2)
        offsets = {n: factor * getattr(f, n) for n in ("offset_pos_nm", "offset_neg_nm")}
        yield f"friction {said}", replace(model, friction=replace(f, **offsets))
        stiff = replace(f, sigma0_nm_per_rad=factor * f.sigma0_nm_per_rad)
        yield f"bristle {said}", replace(model, friction=stiff)
        ratio = factor * model.rack_to_rotor_ratio_rad_per_m
        yield f"ratio {said}", replace(model, rack_to_rotor_ratio_rad_per_m=ratio)
        late = replace(d, motor_speed=factor * d.motor_speed, motor_torque=factor * d.motor_torque)
        yield f"delays {said}", replace(model, delays_s=late)


def with_holes(series: dict[str, Series], longest: int) -> dict[str, Series]:
    """The recording with a hole of 1 to ``longest`` samples after every 80 to 120."""
    rng, kept = np.random.default_rng(1), np.ones(len(series[NAMES[0]].value), bool)
    at = 0
    while longest and at < len(kept):
        at += int(rng.integers(80, 121))
        kept[at : at + int(rng.integers(1, longest + 1))] = False
    return {name: Series(one.t_ns[kept], one.value[kept]) for name, one in series.items()}


def parts(whole: list[dict[str, Series]], count: int) -> Iterator[dict[str, Series]]:
    """So many parts of the recordings, of 1.5 to 6 s, that begin anywhere."""
    rng = np.random.default_rng(1)
    for _ in range(count):
        series = whole[int(rng.integers(len(whole)))]
        length = int(rng.integers(1500, 6000))
        since = int(rng.integers(len(series[NAMES[0]].value) - length))
        part = slice(since, since + length)
        yield {name: Series(one.t_ns[part], one.value[part]) for name, one in series.items()}


def main() -> int:
    """Print a line for each model; exit status 1 where anything was told."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument(
        "--holes",
        type=int,
        default=0,
        metavar="MS",
        help="lose all frames for 1 to MS now and then",
    )
    parser.add_argument("--parts", type=int, default=0, metavar="N", help="N parts instead")
    asked = parser.parse_args()
    seeds = asked.seeds
    plant, recordings = rig(), []
    for seed in range(1, seeds + 1):
        for force in (plant.sweep(), plant.weave(), plant.steps()):
            driver = 0.8 * np.sin(2 * np.pi * 0.25e-3 * np.arange(len(force)))
            columns = plant.run(force, driver, seed=seed).columns
            t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
            series = {n: Series(t_ns, columns[n]) for n in NAMES}
            recordings.append(with_holes(series, asked.holes))
    tried = list(models(load_model(ROOT / "configs" / "reference_rig.yaml")))
    if asked.parts:
        recordings, tried = list(parts(recordings, asked.parts)), tried[:1]
    hours = sum(len(series[NAMES[0]].value) for series in recordings) / 3.6e6
    total = 0
    print(f"{len(recordings)} recordings, {hours:.2f} h for each model; alarms")
    for name, model in tried:
        found = dict.fromkeys(TESTS, 0)
        for series in recordings:
            reason = estimate(series, model).reason
            for bit in TESTS:
                told = (reason & int(bit)) != 0
                found[bit] += int(np.count_nonzero(told[1:] & ~told[:-1]))
        total += sum(found.values())
        said = ", ".join(f"{bit.name.lower()} {n}" for bit, n in found.items() if n and bit.name)
        print(f"  {name:14} {said or 'none'}")
    hours *= len(tried)
    print(f"{total} alarms in {hours:.2f} h: {total / hours:.1f} per hour")
    return 1 if total else 0


if __name__ == "__main__":
    sys.exit(main())
