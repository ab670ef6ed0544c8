"""The three friction adaptations on the same gears; run by scripts/adaptation_comparison."""
# ruff: noqa: T201 - what this script is for

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from adaptation_plants import (
    CONFIGS,
    RIGS,
    Course,
    driven,
    gear,
    inject,
    parked,
    record,
    scaled,
    steered,
)

from eps_hil.adaptation.error_injection import ErrorInjection, ErrorInjectionSettings
from eps_hil.adaptation.gates import InjectionInputs
from eps_hil.adaptation.injection_settings import InjectionSettings
from eps_hil.adaptation.reversal import ReversalAdaptation, ReversalSettings
from eps_hil.adaptation.torque_injection import TorqueInjection
from eps_hil.physics.model import Model, load_model

NOMINAL = load_model(CONFIGS / "reference_rig.yaml")
TI, EI, RA, RC = "torque injection", "error injection", "reversal", "reversal, load cell"
Track = list[tuple[float, float, float, float]]
"""(time in s, errors of k0+, k0− and their sum as shares)."""
NEAR = 0.05
FALSE = 0.10


@dataclass(frozen=True)
class Outcome:
    """One method on one gear and course; errors as shares of the true levels.

    ``claimed``: the method stands by its result; ``time_s``: from when on the error (of what it
    claims to see) stays below 5 %, NaN if never; ``covered``: the truth in the 95 % interval, per
    direction.
    """

    case: str
    method: str
    rig: str
    positive: float
    negative: float
    total: float
    claimed: bool
    time_s: float
    covered: tuple[bool, ...] = ()
    note: str = ""

    @property
    def worst(self) -> float:
        """Largest error of what the method claims to see."""
        if self.method == RA:
            return abs(self.total)
        return max(abs(self.positive), abs(self.negative))


def errors(true: Model, levels: tuple[float, float]) -> tuple[float, float, float]:
    """Errors of k0+, k0− and their sum, as shares."""
    f = true.friction
    own = np.array([f.offset_pos_nm, f.offset_neg_nm])
    found = np.array(levels)
    both = found / own - 1.0
    return float(both[0]), float(both[1]), float(found.sum() / own.sum() - 1.0)


def torque_injection(rig: str, true: Model, course: Course, seed: int) -> Outcome:
    """Closed loop; the levels of the model are what it started from."""
    injection = TorqueInjection(InjectionSettings(), NOMINAL)
    seconds = inject(rig, true, course, injection, seed)
    result, f = injection.result, true.friction
    if result is None:
        own = NOMINAL.friction
        wrong = errors(true, (own.offset_pos_nm, own.offset_neg_nm))
        return Outcome(course.name, TI, rig, *wrong, False, np.nan, (), injection.reason)
    found = (result.positive, result.negative)
    wrong = errors(true, (found[0].offset_nm, found[1].offset_nm))
    covered = tuple(
        level.ci95_nm[0] <= own <= level.ci95_nm[1]
        for level, own in zip(found, (f.offset_pos_nm, f.offset_neg_nm), strict=True)
    )
    reached = seconds if max(abs(wrong[0]), abs(wrong[1])) < NEAR else np.nan
    accepted, note = result.accepted, "; ".join(result.problems)
    return Outcome(course.name, TI, rig, *wrong, accepted, reached, covered, note)


def listeners(
    rig: str,
    true: Model,
    course: Course,
    rows: list[InjectionInputs],
    methods: tuple[str, ...] = (EI, RA, RC),
) -> Iterator[tuple[Outcome, Track]]:
    """Error injection and reversal adaptation on one recording, with their errors over time."""
    if EI in methods:
        injection = ErrorInjection(ErrorInjectionSettings(), NOMINAL)
        track = []
        for k, row in enumerate(rows):  # without the load cell, which a gate would listen to
            state = injection.step(k * 1_000_000, row._replace(rack_force_n=np.nan))
            if k % 50 == 0:
                track.append((k * 1e-3, *errors(true, state.levels)))
        seen = min(state.time_pos_s, state.time_neg_s) > 1.0
        yield _outcome(course, EI, rig, track, seen), track
    for method, cell in ((RA, False), (RC, True)):
        if method not in methods:
            continue
        adaptation = ReversalAdaptation(ReversalSettings(load_cell=cell), NOMINAL)
        track = [(0.0, *errors(true, adaptation.state.levels))]
        for k, row in enumerate(rows):
            found = adaptation.step(k * 1_000_000, row)
            if found is not None:
                track.append((k * 1e-3, *errors(true, found.levels)))
        last = adaptation.state
        claimed = last.confident and (last.asymmetry_known or not cell)
        yield _outcome(course, method, rig, track, claimed), track


def _outcome(
    course: Course,
    method: str,
    rig: str,
    track: Track,
    claimed: bool,
) -> Outcome:
    table = np.array(track)
    seen = np.abs(table[:, 3]) if method == RA else np.abs(table[:, 1:3]).max(axis=1)
    bad = np.flatnonzero(seen >= NEAR)
    first = 0 if len(bad) == 0 else bad[-1] + 1
    reached = float(table[first, 0]) if first < len(table) else np.nan
    return Outcome(course.name, method, rig, *track[-1][1:], claimed, reached)


def cases(count: int) -> Iterator[tuple[str, Model, Course, int]]:
    """(rig, true gear, course, seed) of every case beside the big one; both rigs in turn."""
    for seed in range(count):
        rig, true = list(RIGS)[seed % 2], gear(NOMINAL, seed)
        yield rig, true, parked("parked, hands on", 60.0, hands=True), seed
        yield rig, true, parked("parked, 40 N at the rack", 60.0, hands=False, load_n=40.0), seed
        yield rig, true, parked("parked, tyre spring 46 N/mm", 60.0, hands=False, tyre=46e3), seed
        yield rig, true, steered("near centre, 40 N at the rack", 20.0, seed, load_n=40.0), seed
        yield rig, true, driven("driving, road 50 N rms", 60.0, seed, road_n=50.0), seed
        yield rig, true, driven("driving, road 150 N rms", 60.0, seed, road_n=150.0), seed
        yield rig, true, driven("road 200 N alone", 30.0, seed, road_n=200.0, amplitude=0.0), seed


def units(count: int) -> Iterator[tuple[str, Model, Course, int]]:
    """Unit-to-unit spread: every gear parked, steered near the centre, and driven."""
    for seed in range(count):
        rig, true = list(RIGS)[seed % 2], gear(NOMINAL, seed)
        yield rig, true, parked("parked, hands off", 60.0, hands=False), seed
        yield rig, true, steered("near centre, no load", 20.0, seed), seed
        yield rig, true, driven("driving, smooth road", 30.0, seed), seed


METHODS = (TI, EI, RA, RC)


def outcomes(
    todo: Iterator[tuple[str, Model, Course, int]],
    total: int,
    few: int,
    wanted: tuple[str, ...] = METHODS,
) -> list[Outcome]:
    """What the methods make of ``total`` courses; progress on a terminal, Ctrl-C ends it early.

    Beyond ``few`` gears each course goes only to the method that it was made for.
    """
    found: list[Outcome] = []
    since = time.monotonic()
    try:
        for k, (rig, true, course, seed) in enumerate(todo):
            made_for = _made_for(course, seed < few)
            methods = tuple(name for name in made_for if name in wanted)
            if TI in methods:
                found.append(torque_injection(rig, true, course, seed))
            elif methods:
                rows = record(rig, true, course, seed)
                found += [one for one, _ in listeners(rig, true, course, rows, methods)]
            if sys.stderr.isatty():
                left = (time.monotonic() - since) / (k + 1) * (total - k - 1)
                print(f"\r{k + 1}/{total}, {left:.0f} s left   ", end="", file=sys.stderr)
    except KeyboardInterrupt:
        print("interrupted; the tables hold what was done until then")
    if sys.stderr.isatty():
        print(file=sys.stderr)
    return found


def _made_for(course: Course, every: bool) -> tuple[str, ...]:
    if course.name.startswith("parked"):
        return (TI,)
    if every:
        return (EI, RA, RC)
    return (EI,) if course.name.startswith("near") else (RA,)


def hour(rounds: int) -> dict[str, np.ndarray]:
    """Friction that loses 35 % over an hour: rows (minute, k0+, k0−) of truth and methods (n, 3).

    Each round is 44.5 s of driving and 14.5 s near the centre, with half a second of rest after
    each, and both listeners hear all of it; with 60 rounds that is the hour without a gap. The
    friction changes from round to round. A torque injection needs the car parked: one in every
    five minutes, beside the hour.
    """
    error = ErrorInjection(ErrorInjectionSettings(), NOMINAL)
    reversal = ReversalAdaptation(ReversalSettings(load_cell=False), NOMINAL)
    rig = next(iter(RIGS))
    found: dict[str, list[tuple[float, float, float]]] = {"truth": [], TI: [], EI: [], RA: []}
    for number in range(rounds):
        minute = 60.0 * (number + 1) / rounds
        share = 1.0 - 0.35 * -np.expm1(-minute / 20.0)
        true, ms = scaled(NOMINAL, share, share), round(60_000 * (minute - 1.0))
        found["truth"].append((minute, *_own(true)))
        for course in (driven("", 44.5, number), steered("", 14.5, number)):
            for k, row in enumerate(record(rig, true, course, number)):
                error.step((ms + k) * 1_000_000, row._replace(rack_force_n=np.nan))
                reversal.step((ms + k) * 1_000_000, row)
            ms += course.rows + 500
        found[EI].append((minute, *error.levels))
        found[RA].append((minute, *reversal.state.levels))
        if minute % 5.0 == 0.0:
            injection = TorqueInjection(InjectionSettings(repetitions=3), NOMINAL)
            inject(rig, true, parked("", 60.0, hands=False), injection, number)
            assert injection.result is not None
            result = injection.result
            levels = result.positive.offset_nm, result.negative.offset_nm
            found[TI].append((minute, *levels))
    return {name: np.array(value) for name, value in found.items()}


def _own(true: Model) -> tuple[float, float]:
    return true.friction.offset_pos_nm, true.friction.offset_neg_nm


def drift_errors(levels: dict[str, np.ndarray]) -> Iterator[str]:
    """Of the sum of both levels, from minute 5 on."""
    minutes, total = levels["truth"][:, 0], levels["truth"][:, 1:].sum(axis=1)
    for name in (TI, EI, RA):
        late = levels[name][levels[name][:, 0] >= 5.0]
        off = late[:, 1:].sum(axis=1) / np.interp(late[:, 0], minutes, total) - 1.0
        yield (
            f"  {name}: {len(late)} points, mean {100 * off.mean():+.1f},"
            f" largest {100 * np.abs(off).max():.1f}"
        )


def table(found: list[Outcome]) -> Iterator[str]:
    """One line a course and method: claims, bias and spread, convergence, false adaptation."""
    names = ["course", "method", "gears", "claimed", "k0+ %", "k0− %", "sum %", "worst %"]
    names += ["5 % after (s)", "false"]
    yield f"| {' | '.join(names)} |"
    yield "|---" * len(names) + "|"
    for case, method in dict.fromkeys((one.case, one.method) for one in found):
        group = [one for one in found if (one.case, one.method) == (case, method)]
        stood = [one for one in group if one.claimed]
        head = f"| {case} | {method} | {len(group)} | {len(stood)} |"
        if not stood:
            yield f"{head} – | – | – | – | – | 0 |"
            continue
        columns = [
            f"{100 * np.mean(x):+.1f} ± {100 * np.std(x):.1f}"
            for x in (
                [getattr(one, name) for one in stood] for name in ("positive", "negative", "total")
            )
        ]
        worst = 100 * max(one.worst for one in stood)
        reached = [one.time_s for one in stood if np.isfinite(one.time_s)]
        after = f"{np.median(reached):.0f}" if 2 * len(reached) > len(stood) else "–"
        false = sum(one.worst > FALSE for one in stood)
        yield f"{head} {' | '.join(columns)} | {worst:.1f} | {after} | {false} |"


def must_show(found: list[Outcome]) -> Iterator[str]:
    """k0± within 3 % under the gates' conditions, over all gears."""
    for case in ("parked, hands off", "parked, hands on"):
        for rig in RIGS:
            group = [o for o in found if (o.case, o.rig, o.method) == (case, rig, TI)]
            if not group:
                continue
            done = [o for o in group if o.claimed]
            worst = np.array([max(abs(o.positive), abs(o.negative)) for o in done])
            inside = np.mean([hit for o in done for hit in o.covered])
            yield (
                f"{case}, {rig}: {len(done)} of {len(group)} gears calibrated, both levels within"
                f" 3 % in {np.sum(worst < 0.03)}, worst {100 * worst.max():.2f} %, 95th percentile"
                f" {100 * np.quantile(worst, 0.95):.2f} %, truth in the 95 % interval"
                f" {100 * inside:.0f} %"
            )


def main() -> None:
    """Run, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="8 gears, and an hour in 6 rounds")
    parser.add_argument("--gears", type=int, default=200, help="how many for the spread")
    parser.add_argument("--figure", type=Path, default=Path("build/adaptation.png"))
    told = "print these methods' lines only, and neither hour nor figure"
    parser.add_argument("--only", nargs="*", choices=METHODS, default=METHODS, help=told)
    choice = parser.parse_args()
    many, few = (8, 2) if choice.quick else (choice.gears, 10)
    wanted = tuple(choice.only)
    found = outcomes(chain(cases(few), units(many)), 7 * few + 3 * many, few, wanted)
    for line in must_show(found):
        print(line)
    print()
    for line in table(found):
        print(line)
    notes = sorted({f"{o.case}: {o.note}" for o in found if o.note and not o.claimed})
    print("\nwhat torque injection said where it did not stand by its result, among others:")
    for note in notes[:6]:
        print(f"  {note}")
    if wanted != METHODS:
        return
    levels = hour(6 if choice.quick else 60)
    print("\nfriction losing 35 % over an hour, error of the sum in % (from minute 5 on):")
    for line in drift_errors(levels):
        print(line)
    from adaptation_figure import draw

    choice.figure.parent.mkdir(parents=True, exist_ok=True)
    draw(choice.figure, found, levels, example())
    print(f"\n{choice.figure}")


def example() -> dict[str, np.ndarray]:
    """Errors over time of one gear that is 40 % off both ways: (n, 4) time, k0+, k0−, sum."""
    true = scaled(NOMINAL, 0.6, 1.4)
    rig = next(iter(RIGS))
    near, out = steered("", 40.0, 3), driven("", 60.0, 3)
    tracks = {EI: next(listeners(rig, true, near, record(rig, true, near, 3)))[1]}
    pairs = list(listeners(rig, true, out, record(rig, true, out, 3)))
    tracks[RA], tracks[RC] = pairs[1][1], pairs[2][1]
    return {name: np.array(track) for name, track in tracks.items()}


if __name__ == "__main__":
    main()
