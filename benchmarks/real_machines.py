#!/usr/bin/env python3
"""Recordings of real machines: what `eps-hil diagnose` finds beside a regression made for each.

    python benchmarks/real_machines.py DATA [--keep DIR] [MACHINE ...]

DATA holds what others published, none of it part of this project: `emps/DATA_EMPS.mat`
(nonlinearbenchmark.org), `hsm150/` (malik-robert/HSM150-data), `openarm/` (captures of
YIZHIXIAOCANGSHU/Friction-Identification-for-Manipulators_usb2fdcan, named
RUN_group_0N_motor_0N.npz), `openarm350/` (real_friction_identification_joint_N.npz of
YIZHIXIAOCANGSHU/Friction-Identification-for-Manipulators) and `nnfm/` (the folder
"Comparative data" of longshike/NNFM-…, flat). Machines whose files are not there are left out.

Each gets the model file that one would write from the documentation: the reference rig's with an
inertia and a friction read off a plot, to one digit, and no load cell. The regression is linear,
with columns that somebody who knows the machine would choose; it shares no code with the diagnosis.
Both are judged on the hold-out, on the samples that the diagnosis judges, by the torque that was
reported: a model that takes some of it off is no better for that. `share` is the
diagnosis' gain in rms torque error over the regression's.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import signal

from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.data.prepare import prepare, seen_twice
from eps_hil.diagnosis.data.size import size_of
from eps_hil.physics.model import Friction, Model, load_model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
Columns = Callable[[Floats, Floats, Floats], list[Floats]]

LOW_HZ, GRID_S = 40.0, 1e-3
SMOOTH_STEPS = 20
"""Samples under the polynomials of the regression's own speed and acceleration."""


@dataclass(frozen=True)
class Recording:
    """Columns in SI units; ``speed`` may be missing."""

    time_s: Floats
    angle: Floats
    torque: Floats
    speed: Floats | None = None

    def columns(self) -> dict[str, Floats]:
        """As a table of canonical names."""
        told = {
            "time_s": self.time_s,
            "motor_angle_rad": self.angle,
            "motor_torque_nm": self.torque,
        }
        if self.speed is not None:
            told["motor_speed_rad_s"] = self.speed
        return told


@dataclass(frozen=True)
class Machine:
    """Recordings to fit and to judge, and the regression's columns of (angle, speed, acc.)."""

    fit: Sequence[Recording]
    kept: Sequence[Recording]
    columns: Columns
    stribeck_rad_s: float
    inertia: float | None = None


def by_direction(q: Floats, w: Floats, a: Floats, slow: float) -> list[Floats]:
    """Inertia, level and drag by direction, and what friction does near standstill."""
    up, down = np.clip(np.tanh(w / (0.1 * slow)), 0, 1), np.clip(np.tanh(w / (0.1 * slow)), -1, 0)
    told = [a, up, down, w * up, w * -down]
    for v in (0.5 * slow, 2.0 * slow):
        told += [up * np.exp(-np.abs(w) / v), down * np.exp(-np.abs(w) / v)]
    return told


def plain(slow: float) -> Columns:
    """Friction and a constant."""
    return lambda q, w, a: [*by_direction(q, w, a, slow), np.ones_like(q)]


def hanging(slow: float) -> Columns:
    """Friction and gravity."""
    return lambda q, w, a: [*by_direction(q, w, a, slow), np.ones_like(q), np.sin(q), np.cos(q)]


def hsm150(folder: Path) -> Machine:
    """Two coupled servo motors, turning one way or the other."""
    from scipy.io import loadmat

    def read(name: str) -> Recording:
        path = next(folder.rglob(f"hsm150/**/idf_{name}.mat"))
        x = loadmat(path, squeeze_me=True)["data"].astype(float)
        return Recording(x[:, 0], x[:, 2], x[:, 5], x[:, 3])

    fit = [read(one) for one in ("pos_0.06_1", "neg_0.04_1", "pos_0.065_2", "neg_0.045_2")]
    return Machine(fit, [read("pos_0.065_1"), read("neg_0.045_1")], plain(5.0), 5.0, 1.2e-4)


def openarm(motor: int) -> Callable[[Path], Machine]:
    """A joint's motor on a bench, behind its gear, at 50 Hz; its angle starts anew after 25 rad."""

    def load(folder: Path) -> Machine:
        def read(group: int) -> Recording:
            name = f"20260425_162832-all_group_{group:02d}_motor_{motor:02d}.npz"
            path = folder / "openarm" / name
            d = np.load(path, allow_pickle=True)
            keep = np.concatenate([[True], np.diff(d["time"]) > 0])
            return Recording(
                d["time"][keep],
                np.unwrap(d["position"][keep].astype(float), period=25.0),
                d["torque_feedback"][keep].astype(float),
                d["velocity"][keep].astype(float),
            )

        return Machine([read(1), read(2)], [read(3)], hanging(0.2), 0.2)

    return load


def arm(joint: int) -> Callable[[Path], Machine]:
    """A joint that lifts the arm, samples held; its last third judges."""

    def load(folder: Path) -> Machine:
        d = np.load(folder / "openarm350" / f"real_friction_identification_joint_{joint}.npz")
        t = d["time"] - d["time"][0]
        keep = np.concatenate([[True], np.diff(t) > 0])
        q, w, torque = (d[name][keep, joint - 1] for name in ("q", "qd", "tau_measured"))
        return Machine([Recording(t[keep], q, torque, w)], [], hanging(0.05), 0.05)

    return load


def robot(fit: Sequence[str], kept: Sequence[str], slow: float) -> Callable[[Path], Machine]:
    """A joint of an arm, gravity and inertia taken out by those who recorded it."""

    def read(folder: Path, name: str) -> Recording:
        x = np.genfromtxt(folder / "nnfm" / name, delimiter=",", skip_header=1)[:, :5]
        x = x[np.all(np.isfinite(x), axis=1)]
        x = x[np.concatenate([[True], np.diff(x[:, 0]) > 0])]
        return Recording(x[:, 0] - x[0, 0], x[:, 1], x[:, 4], x[:, 2])

    def load(folder: Path) -> Machine:
        return Machine(
            [read(folder, n) for n in fit], [read(folder, n) for n in kept], hanging(slow), slow
        )

    return load


def emps(folder: Path) -> Machine:
    """A carriage on a ball screw of 10 mm a turn; its last third judges."""
    from scipy.io import loadmat

    d = {k: np.asarray(v, float).ravel() for k, v in loadmat(folder / "emps/DATA_EMPS.mat").items()
         if not k.startswith("__")}  # fmt: skip
    arm = 0.01 / (2 * np.pi)
    torque = float(d["gtau"][0]) * d["vir"] * arm
    angle, n = d["qm"] / arm, len(d["t"])
    cut = 2 * n // 3
    halves = [
        Recording(d["t"][some] - d["t"][some][0], angle[some], torque[some])
        for some in (slice(None, cut), slice(cut, None))
    ]

    def columns(q: Floats, w: Floats, a: Floats) -> list[Floats]:
        turn = np.concatenate(
            [np.cos(np.outer(np.arange(1, 5), q)), np.sin(np.outer(np.arange(1, 5), q))]
        )
        return [*by_direction(q, w, a, 8.0), np.ones_like(q), q, q**2, *turn]  # fmt: skip

    return Machine([halves[0]], [halves[1]], columns, 8.0, 95.0 * arm**2)


MACHINES: Mapping[str, Callable[[Path], Machine]] = {
    "emps": emps,
    "hsm150": hsm150,
    "openarm_1": openarm(1),
    "openarm_3": openarm(3),
    "openarm_5": openarm(5),
    "arm_1": arm(1),
    "arm_2": arm(2),
    "franka_2": robot(["case3_slow.csv", "case3_high.csv"], ["case3_middle.csv"], 0.02),
    "franka_7": robot(["case4_slow.csv", "case4_high.csv"], ["case4_middle.csv"], 0.01),
    "fairino_3": robot(
        ["verify_robot_S_slow_processed.csv"], ["verify_robot_zhixian_slow_processed.csv"], 5e-4
    ),
    "fairino_1": robot(["verify_robot_yuanhu_slow_processed.csv"], [], 5e-4),
    "fairino_2": robot(["verify_robot_luoxuan_slow_processed.csv"], [], 5e-4),
}


@dataclass(frozen=True)
class Motion:
    """A recording on a grid, smoothed by splines of its own."""

    time_s: Floats
    q: Floats
    w: Floats
    a: Floats
    torque: Floats


def motion(one: Recording) -> Motion:
    """Speed and acceleration by Savitzky and Golay's polynomials, on 1 kHz."""
    t = np.arange(one.time_s[0], one.time_s[-1], GRID_S)
    q = np.interp(t, one.time_s, one.angle)
    step = float(np.median(np.diff(one.time_s)))
    half = max(round(SMOOTH_STEPS * step / GRID_S / 2), 2)
    if one.speed is None:
        w = signal.savgol_filter(q, 2 * half + 1, 3, deriv=1, delta=GRID_S)
    else:
        w = np.interp(t, one.time_s, one.speed)
    w = signal.savgol_filter(w, 2 * half + 1, 2)
    a = signal.savgol_filter(w, 2 * half + 1, 2, deriv=1, delta=GRID_S)
    return Motion(t, q, w, a, np.interp(t, one.time_s, one.torque))


def slow(values: Floats) -> Floats:
    """Without phase, as much as is judged."""
    b, a = signal.butter(2, LOW_HZ, fs=1 / GRID_S)
    told: Floats = signal.filtfilt(b, a, values)
    return told


def regression(machine: Machine) -> Callable[[Motion], Floats]:
    """Least squares on the fitted recordings; what it predicts.

    Of the columns for this machine, and of friction alone, those that predict either half of the
    fitted recordings better from the other.
    """
    choices = (machine.columns, plain(machine.stribeck_rad_s))
    moved = [motion(one) for one in machine.fit]

    def solved(parts: Sequence[tuple[Floats, Floats]]) -> Floats:
        x, y = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        scale = np.sqrt(np.mean(x**2, axis=0)) + 1e-300
        x = x / scale
        ridge = 1e-6 * len(x) * np.eye(x.shape[1])
        told: Floats = np.linalg.solve(x.T @ x + ridge, x.T @ y) / scale
        return told

    best, found = np.inf, None
    for columns in choices:
        parts = []
        for one in moved:
            x = np.column_stack([slow(c) for c in columns(one.q, one.w, one.a)])[::8]
            y, half = slow(one.torque)[::8], len(x) // 2
            parts += [(x[:half], y[:half]), (x[half:], y[half:])]
        left = 0.0
        for some, others in ((parts[::2], parts[1::2]), (parts[1::2], parts[::2])):
            numbers = solved(some)
            left += sum(float(np.sum((y - x @ numbers) ** 2)) for x, y in others)
        if left < best:
            best, found = left, (columns, solved(parts))
    assert found is not None
    columns, numbers = found
    return lambda one: np.column_stack(columns(one.q, one.w, one.a)) @ numbers


def digit(value: float) -> float:
    """To one digit, as read off a plot."""
    return float(f"{max(value, 0.0):.0e}")


def as_documented(machine: Machine, reference: Model) -> Model:
    """The model file from the documentation: one level, one drag, read off by eye."""
    moved = [motion(one) for one in machine.fit]
    w = np.concatenate([one.w for one in moved])
    a = np.concatenate([one.a for one in moved])
    torque = np.concatenate([slow(one.torque) for one in moved])
    x = np.column_stack([a, np.tanh(w / (0.1 * machine.stribeck_rad_s)), w])
    inertia, level, drag = np.linalg.lstsq(x, torque, rcond=None)[0]
    level = digit(level) or digit(0.1 * float(np.std(torque)))
    travel = max(float(np.ptp(one.q)) for one in moved)
    rest = min(0.02, 1e-3 * travel)
    guess = machine.inertia or digit(inertia) or digit(level / 100.0)
    friction = Friction(level, level, digit(drag), digit(drag), 0.0, 0.0, level / rest, 0.0, 0.75)
    return replace(
        reference,
        inertia_kg_m2=guess,
        friction=friction,
        delays_s=type(reference.delays_s)(),
        effects=(),
    )


def write_table(path: Path, one: Recording) -> Path:
    """A CSV of canonical columns."""
    columns = one.columns()
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",",
               header=",".join(columns), comments="", fmt="%.9g")  # fmt: skip
    return path


def rms(parts: Sequence[Floats]) -> float:
    """Of all together."""
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def cut_off(machine: Machine) -> Machine:
    """Its last third kept, where no other recording is."""
    if machine.kept:
        return machine

    def part(one: Recording, some: slice) -> Recording:
        speed = None if one.speed is None else one.speed[some]
        return Recording(one.time_s[some], one.angle[some], one.torque[some], speed)

    (one,) = machine.fit
    cut = 2 * len(one.time_s) // 3
    fit, kept = part(one, slice(None, cut)), part(one, slice(cut, None))
    return replace(machine, fit=[fit], kept=[kept])


def judged(name: str, machine: Machine, work: Path, more: Sequence[str]) -> dict[str, Any]:
    """Diagnose by the command, and compare on the hold-outs."""
    reference = load_model(Path(__file__).parents[1] / "configs" / "reference_rig.yaml")
    model = as_documented(machine, reference)
    work.mkdir(parents=True, exist_ok=True)
    model.save(work / "model.yaml")
    fit = [write_table(work / f"fit_{k}.csv", one) for k, one in enumerate(machine.fit, 1)]
    kept = [write_table(work / f"kept_{k}.csv", one) for k, one in enumerate(machine.kept, 1)]
    command = [
        sys.executable, "-m", "eps_hil", "diagnose", "--model", str(work / "model.yaml"),
        "--recording", *map(str, fit), "--holdout", *map(str, kept),
        "--json", str(work / "told.json"), "--write-model", str(work / "better.yaml"), *more,
    ]  # fmt: skip
    since = os.times().children_user
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    took = os.times().children_user - since
    (work / "said.txt").write_text(ran.stdout + ran.stderr)
    if ran.returncode:
        return {"machine": name, "refused": ran.stderr.strip().splitlines()[-1:]}
    told = json.loads((work / "told.json").read_text())
    better = load_model(work / "better.yaml") if (work / "better.yaml").exists() else model
    ready = seen_twice([
        prepare(path.name, {
            key: Series(np.round(one.time_s * 1e9).astype(np.int64), values)
            for key, values in one.columns().items() if key != "time_s"
        })
        for path, one in zip([*fit, *kept], [*machine.fit, *machine.kept], strict=True)
    ])[len(fit):]  # fmt: skip
    size = size_of(ready, model)
    predicted = regression(machine)
    before, after, regressed = [], [], []
    for prepared, recording in zip(ready, machine.kept, strict=True):
        one = prepared.changed(size=size)
        mask = Holdout(one, {}).judging(model)
        before.append(one.left_over(model)[mask])
        after.append(one.left_over(better)[mask] / one.acting_share(better))
        moved = motion(recording)
        since = moved.time_s - moved.time_s[0]
        torque = one.raw["motor_torque_nm"] - np.interp(one.time_s, since, predicted(moved))
        at = one.thin(torque)  # of the same torque, by the same filter
        regressed.append(at[mask])
    was, now, other = rms(before), rms(after), rms(regressed)
    return {
        "machine": name,
        "before_nm": was,
        "diagnosed_nm": now,
        "regression_nm": other,
        "share": (was - now) / (was - other) if was > other else float("nan"),
        "verdict": told["verdict"],
        "seconds": took,
        "names": [
            f"{one['effect']}"
            + (f" {one['model']['law'] or one['model']['form']}" if one.get("model") else "")
            for one in told["findings"]
        ],
        "limits": told["limits"],
    }


def main() -> None:
    """One line for each machine."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("machines", nargs="*", default=list(MACHINES))
    parser.add_argument("--keep", type=Path, help="folder for tables, models and answers")
    parser.add_argument("--trust-channels", action="store_true")
    asked = parser.parse_intermixed_args()
    more = ["--trust-channels"] if asked.trust_channels else []
    with tempfile.TemporaryDirectory() as temporary:
        for name in asked.machines:
            try:
                machine = cut_off(MACHINES[name](asked.data))
            except (FileNotFoundError, StopIteration):
                print(f"{name:10} its files are not there", flush=True)
                continue
            one = judged(name, machine, (asked.keep or Path(temporary)) / name, more)
            if "refused" in one:
                print(f"{name:10} refused: {' '.join(one['refused'])}", flush=True)
                continue
            print(
                f"{name:10} {one['before_nm']:9.4g} -> {one['diagnosed_nm']:9.4g} Nm, regression "
                f"{one['regression_nm']:9.4g}, share {one['share']:5.2f}, {one['seconds']:.0f} "
                f"processor s  {one['verdict']}: "
                f"{'; '.join(one['names'])}",
                flush=True,
            )


if __name__ == "__main__":
    main()
