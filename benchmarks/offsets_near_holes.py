#!/usr/bin/env python3
"""Offsets that begin or end while frames are lost: how many stay valid and wrong for over 20 ms.

    python benchmarks/offsets_near_holes.py [--cases 3000] [--seed 1]

Sweep and weave of the rig of other code (tests/estimation/independent_rig.py). In each case one
signal reads too much for 2 to 400 ms (motor torque 0.15 to 8 Nm, speed 1 to 80 rad/s, angle 0.05 to
20 rad; the least is what scripts/estimate_faults asks), and frames of up to four stretches of 1 to
16 ms are lost within 30 ms of its beginning or its end, or a tenth of them around it: all frames,
or those of both torques or of speed and angle alone. In scripts/estimate_faults so much seldom
comes together; here it always does. The estimate is held against that of the same recording
unharmed: more than 100 N apart, and both valid. Prints a line for each signal; --list shows the
cases.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from false_alarms import NAMES, ROOT, rig

from eps_hil.estimation.batch import estimate
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import load_model
from eps_hil.series import Series

SIZES = {"motor_torque_nm": (0.15, 8.0), "motor_speed_rad_s": (1.0, 80.0),
         "motor_angle_rad": (0.05, 20.0)}  # fmt: skip
BEFORE, AFTER = 3000, 600
WRONG_N, SPELL_MS = 100.0, 20

Recording = dict[str, Series]
Hole = tuple[int, int, str]
"""First sample, how many, and which frames: "all", "torque" or "motion"."""
OF = {"all": ("torque", "speed", "angle"), "torque": ("torque",), "motion": ("speed", "angle")}
"""Words in the names of their signals."""


def offset(whole: Recording, at: int, name: str, size: float, length: int) -> Recording:
    """The part around sample ``at`` with a signal that reads ``size`` too much from there on."""
    part = slice(at - BEFORE, at + AFTER)
    cut = {n: Series(one.t_ns[part], one.value[part].copy()) for n, one in whole.items()}
    cut[name].value[BEFORE : BEFORE + length] += size
    return cut


def lost(recording: Recording, holes: list[Hole]) -> Recording:
    """The recording without the samples of ``holes``."""
    left = {}
    for name, one in recording.items():
        kept = np.ones(BEFORE + AFTER, bool)
        for first, count, frames in holes:
            if any(word in name for word in OF[frames]):
                kept[first : first + count] = False
        left[name] = Series(one.t_ns[kept], one.value[kept])
    return left


def drawn(rng: np.random.Generator, length: int) -> list[Hole]:
    """Holes near the beginning or the end of an offset of so many samples."""
    holes = []
    for _ in range(int(rng.integers(0, 5))):
        near = BEFORE + length * int(rng.integers(2))
        frames = str(rng.choice(["all", "all", "torque", "motion"]))
        holes.append((near + int(rng.integers(-30, 15)), int(rng.integers(1, 17)), frames))
    if rng.random() < 0.25:
        frames = str(rng.choice(list(OF)))
        lost_at = np.flatnonzero(rng.random(length + 120) < 0.1)
        holes += [(BEFORE - 60 + int(at), 1, frames) for at in lost_at]
    return holes


def spell_ms(trace: Trace, right: Trace) -> tuple[int, float]:
    """Longest spell in which both are valid and too far apart, and how far (N)."""
    same = np.minimum(np.searchsorted(right.t_ns, trace.t_ns), len(right.t_ns) - 1)
    apart = np.abs(trace.rack_force_n - right.rack_force_n[same])
    at = np.flatnonzero((apart > WRONG_N) & trace.valid & right.valid[same])
    if not len(at):
        return 0, 0.0
    spells = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
    return max(len(one) for one in spells), float(np.max(apart[at]))


def main() -> int:
    """Run the cases; exit status 1 where any was wrong and valid for too long."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--list", action="store_true", help="a line for each failure")
    asked = parser.parse_args()
    rng, plant = np.random.default_rng(asked.seed), rig()
    model = load_model(ROOT / "configs" / "reference_rig.yaml")
    recordings: list[Recording] = []
    for force in (plant.sweep(), plant.weave()):
        columns: dict[str, Any] = plant.run(force, 0.0 * force).columns
        t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
        recordings.append({name: Series(t_ns, columns[name]) for name in NAMES})
    told: dict[str, list[tuple[int, float]]] = {name: [] for name in SIZES}
    for _ in range(asked.cases):
        whole = recordings[int(rng.integers(len(recordings)))]
        at = int(rng.integers(BEFORE + 500, len(whole[NAMES[0]].value) - AFTER))
        name = str(rng.choice(list(SIZES)))
        size = float(rng.choice([-1, 1]) * np.exp(rng.uniform(*np.log(SIZES[name]))))
        length = int(np.exp(rng.uniform(np.log(2), np.log(400))))
        holes = drawn(rng, length)
        right = estimate(offset(whole, at, name, 0.0, length), model)
        found = spell_ms(estimate(lost(offset(whole, at, name, size, length), holes), model), right)
        told[name].append(found)
        if asked.list and found[0] > SPELL_MS:
            print(f"{name} {size:+.3f} for {length} ms at {at}, holes {holes}: {found[0]} ms")
    for name, spells in told.items():
        late = [one for one in spells if one[0] > SPELL_MS]
        print(
            f"{name}: {len(late)} of {len(spells)} for over {SPELL_MS} ms, the longest "
            f"{max((ms for ms, _ in spells), default=0)} ms, the worst of them "
            f"{max((n for _, n in late), default=0.0):.0f} N"
        )
    return int(any(ms > SPELL_MS for spells in told.values() for ms, _ in spells))


if __name__ == "__main__":
    sys.exit(main())
