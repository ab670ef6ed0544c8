#!/usr/bin/env python3
"""The same recordings said otherwise: whether a diagnosis gives them the same names.

    python benchmarks/said_otherwise.py [--seed 1] [--keep DIR] [--only VARIANT ...] [CASE ...]

Cases are rigs of ``eps_hil.proof`` (development seeds). Variants: positions and angles counted
from another zero, a later clock, every 2nd, 5th and 10th sample, noise added or a channel held,
recordings cut and joined, signs turned, and the same machine behind another notional gear, in other
units of the rack, or of another strength. Each line: names, and which numbers left the intervals.
"""

import argparse
import pickle
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model, load_model
from eps_hil.proof.cases import make
from eps_hil.proof.plans import Plan
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
Columns = Mapping[str, Floats]
Record = Mapping[str, Columns]
Said = tuple[Record, Model, Mapping[str, float]]
"""Recordings, the model that goes with them, and what a unit of a parameter has become."""

CASES: Mapping[str, tuple[tuple[str, float], ...]] = {
    "nothing": (),
    "gain_stribeck": (("motor_torque_gain", 3.0), ("stribeck", 1.5)),
    "place_cogging": (("position_dependent_friction", 1.5), ("cogging_torque", 1.5)),
    "spring_delay": (("unmodelled_spring", 1.5), ("motor_torque_delay", 1.5)),
    "dwell_drag": (("breakaway_dwell", 1.5), ("quadratic_drag", 1.5)),
}
NOISE = {"motor_torque_nm": 8e-3, "motor_speed_rad_s": 0.5, "rack_force_n": 6.0}
_OF_RACK = ("rack_position_m",)


def each(change: Callable[[Columns], Columns]) -> Callable[[Record, Model], Said]:
    """A variant that does the same to every recording and leaves the model."""
    return lambda record, model: ({k: change(one) for k, one in record.items()}, model, {})


def zero_moved(one: Columns) -> Columns:
    """Counted from another zero: 0.4 m, and 700 rad."""
    moved = {"rack_position_m": 0.4, "motor_angle_rad": 700.0}
    return {n: c + moved.get(n, 0.0) for n, c in one.items()}


def every(k: int) -> Callable[[Columns], Columns]:
    """Every k-th sample."""
    return lambda one: {n: c[::k] for n, c in one.items()}


def later(one: Columns) -> Columns:
    """The recorder was started long ago."""
    return {**one, "time_s": one["time_s"] + 1234.567}


def noisier(one: Columns) -> Columns:
    """Twice the sensors' noise on top."""
    rng = np.random.default_rng(5)
    return {n: c + NOISE.get(n, 0.0) * rng.standard_normal(len(c)) for n, c in one.items()}


def held(one: Columns) -> Columns:
    """The load cell at 100 Hz, read with 2 ms of jitter, fills every row."""
    rng = np.random.default_rng(6)
    n = len(one["time_s"])
    at = np.cumsum(np.clip(np.round(rng.normal(10.0, 2.0, n // 5)), 4, 20)).astype(int)
    at = np.concatenate([[0], at[at < n]])
    rows = at[np.searchsorted(at, np.arange(n), side="right") - 1]
    return {**one, "rack_force_n": one["rack_force_n"][rows]}


def held_evenly(one: Columns) -> Columns:
    """The load cell at 100 Hz, without jitter, fills every row."""
    rows = np.arange(len(one["time_s"])) // 10 * 10
    return {**one, "rack_force_n": one["rack_force_n"][rows]}


def cut(record: Record, model: Model) -> Said:
    """Every recording in two files."""
    halves = {}
    for name, one in record.items():
        middle = len(one["time_s"]) // 2
        for part, some in (("a", slice(None, middle)), ("b", slice(middle, None))):
            halves[f"{name}{part}"] = {n: c[some] for n, c in one.items()}
    return halves, model, {}


def joined(record: Record, model: Model) -> Said:
    """The recordings that are fitted in one file, one straight after the other."""
    parts = [one for name, one in record.items() if not name.startswith("holdout")]
    kept = {name: one for name, one in record.items() if name.startswith("holdout")}
    late, whole = 0.0, []
    for one in parts:
        whole.append({**one, "time_s": one["time_s"] + late})
        late = float(whole[-1]["time_s"][-1]) + 1e-3
    both = {n: np.concatenate([one[n] for one in whole]) for n in whole[0]}
    return {"both": both, **kept}, model, {}


def turned(record: Record, model: Model) -> Said:
    """Positive is the other way, of everything."""
    other = {
        name: {n: c if n == "time_s" else -c for n, c in one.items()}
        for name, one in record.items()
    }
    f = model.friction
    swapped = {
        f"{kind}_{to}_{unit}": getattr(f, f"{kind}_{of}_{unit}")
        for kind, unit in (
            ("offset", "nm"),
            ("viscous", "nm_s_per_rad"),
            ("load", "nm_per_n"),
        )
        for to, of in (("pos", "neg"), ("neg", "pos"))
    }
    return other, replace(model, friction=replace(f, **swapped)), {"sign": -1.0}


def resized(
    angle: float = 1.0, torque: float = 1.0, place: float = 1.0
) -> Callable[[Record, Model], Said]:
    """Rotor angles, rotor torques and rack positions so many times as large, power with them."""

    def said(record: Record, model: Model) -> Said:
        power = angle * torque
        factor = {
            "motor_torque_nm": torque,
            "torque_sensor_nm": power,
            "motor_speed_rad_s": angle,
            "motor_angle_rad": angle,
            "rack_force_n": power / place,
            "rack_position_m": place,
        }
        other = {
            name: {n: factor.get(n, 1.0) * c for n, c in one.items()}
            for name, one in record.items()
        }
        f = model.friction
        friction = replace(
            f,
            offset_pos_nm=torque * f.offset_pos_nm,
            offset_neg_nm=torque * f.offset_neg_nm,
            viscous_pos_nm_s_per_rad=torque / angle * f.viscous_pos_nm_s_per_rad,
            viscous_neg_nm_s_per_rad=torque / angle * f.viscous_neg_nm_s_per_rad,
            load_pos_nm_per_n=place / angle * f.load_pos_nm_per_n,
            load_neg_nm_per_n=place / angle * f.load_neg_nm_per_n,
            sigma0_nm_per_rad=torque / angle * f.sigma0_nm_per_rad,
            sigma1_nm_s_per_rad=torque / angle * f.sigma1_nm_s_per_rad,
            sigma1_speed_rad_s=angle * f.sigma1_speed_rad_s,
        )
        changed = replace(
            model,
            inertia_kg_m2=torque / angle * model.inertia_kg_m2,
            pinion_ratio_rad_per_m=model.pinion_ratio_rad_per_m / place,
            rack_to_rotor_ratio_rad_per_m=angle / place * model.rack_to_rotor_ratio_rad_per_m,
            belt_ratio=angle * model.belt_ratio,
            friction=friction,
        )
        return other, changed, {"Nm": torque, "rad": angle, "m": place, "N": power / place}

    return said


VARIANTS: Mapping[str, Callable[[Record, Model], Said]] = {
    "as it is": each(lambda one: one),
    "zero": each(zero_moved),
    "later": each(later),
    "500 Hz": each(every(2)),
    "200 Hz": each(every(5)),
    "100 Hz": each(every(10)),
    "noise": each(noisier),
    "held": each(held),
    "held evenly": each(held_evenly),
    "cut": cut,
    "joined": joined,
    "turned": turned,
    "gear 20": resized(20.0, 1 / 20),
    "gear 4": resized(4.0, 1 / 4),
    "gear 0.1": resized(0.1, 10.0),
    "rack 20": resized(place=20.0),
    "rack 0.1": resized(place=0.1),
    "strong": resized(torque=50.0),
    "weak": resized(torque=0.02),
}
_POWERS: Mapping[str, Mapping[str, int]] = {
    "Nm": {"Nm": 1},
    "Nm/N": {"Nm": 1, "N": -1},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1},
    "Nm/rad": {"Nm": 1, "rad": -1},
    "Nm s/rad": {"Nm": 1, "rad": -1},
    "Nm s²/rad²": {"Nm": 1, "rad": -2},
    "1/Nm²": {"Nm": -2},
    "m": {"m": 1},
    "N/m": {"N": 1, "m": -1},
}


def record_of(case: str, seed: int, keep: Path | None) -> Record:
    """The recordings of a case; kept, so that two versions of the code see the same."""
    path = None if keep is None else keep / f"{case}-{seed}.pickle"
    if path is not None and path.exists():
        found: Record = pickle.loads(path.read_bytes())  # written by this script
        return found
    kind = "pairs" if CASES[case] else "decoys"
    plan = Plan(kind, 700_000 + seed, CASES[case], decoy="" if CASES[case] else "nothing")
    made = make(plan)
    print(f"# {case}: {[one for one in made.answer.get('hidden', [])]}", flush=True)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(dict(made.recordings)))
    return made.recordings


def diagnosed(record: Record, model: Model) -> dict[str, Any]:
    """The JSON of a diagnosis; recordings called holdout… are kept from the fit."""
    read = {}
    for name, columns in record.items():
        t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
        read[name] = {n: Series(t_ns, c) for n, c in columns.items() if n != "time_s"}
    kept = {name: read.pop(name) for name in list(read) if name.startswith("holdout")}
    return diagnose(model, read, kept).content


def main() -> None:
    """Diagnose each case in each variant; one line each, then how many kept their names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=list(CASES))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--only", nargs="*", default=list(VARIANTS))
    asked = parser.parse_args()
    model = load_model(Path(__file__).parents[1] / "configs" / "reference_rig.yaml")
    same = left = total = 0
    for case in asked.cases:
        record = record_of(case, asked.seed, asked.keep)
        first: dict[str, Any] | None = None
        for variant in ("as it is", *(one for one in asked.only if one != "as it is")):
            other, its_model, units = VARIANTS[variant](record, model)
            since = time.monotonic()
            try:
                content = diagnosed(other, its_model)
            except Exception as error:  # printed, and counted as other names
                print(f"{case:14} {variant:12} {type(error).__name__}: {error}", flush=True)
                total += 1
                continue
            if first is None:
                first = content
            names = [one["effect"] for one in content["findings"]]
            wanted = sorted(one["effect"] for one in first["findings"])
            off = outside(first, content, units)
            total += 1
            same += sorted(names) == wanted
            left += len(off)
            shown = "same" if sorted(names) == wanted else "OTHER"
            print(
                f"{case:14} {variant:12} {shown:5} {names} {'; '.join(off)} "
                f"({time.monotonic() - since:.1f} s)",
                flush=True,
            )
    print(f"# {same} of {total} with the same names, {left} numbers outside of intervals")


def outside(
    first: dict[str, Any], content: dict[str, Any], units: Mapping[str, float]
) -> list[str]:
    """Numbers whose intervals do not meet those of ``first``, by name, both values."""
    sign = units.get("sign", 1.0)
    before = {one["effect"]: one["parameters"] for one in first["findings"] if "parameters" in one}
    told = []
    for one in content["findings"]:
        for name, found in one.get("parameters", {}).items():
            was = before.get(one["effect"], {}).get(name)
            if was is None or found.get("ci95") is None or was.get("ci95") is None:
                continue
            if name in ("phase_rad", "order") or not isinstance(found["value"], float):
                continue
            power = _POWERS.get(found["unit"], {})
            factor = float(np.prod([units.get(u, 1.0) ** p for u, p in power.items()]))
            low, high = (factor * end for end in was["ci95"])
            value, mine = found["value"], found["ci95"]
            mirrored = sorted((sign * mine[0], sign * mine[1]))
            meets = (mine[0] <= high and mine[1] >= low) or (
                mirrored[0] <= high and mirrored[1] >= low
            )
            if not meets and name != "centre_m":
                told.append(f"{name} {value / factor:.4g} was {was['value']:.4g}")
    return told


if __name__ == "__main__":
    main()
