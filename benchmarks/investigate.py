"""Rig minutes to a right verdict: experiments that are chosen, against the fixed programme.

    python benchmarks/investigate.py [--budget 10] [--cases 0 1 2] [--json FILE]

Each case is the simulated rig of two masses with an effect in its model file that the model file in
use lacks (the last with none), led in lock-step over the frames of its bus. `eps-hil investigate`
runs until it stops by itself; the fixed programme is configs/programmes/friction_map.yaml, whose
recordings are diagnosed after 8, 16, 24, 32, 48, 64 and 80 cells in the same way (two thirds of
each stretch fitted, the last third kept). A verdict is right if its names are what was hidden, no
more and no less, and no rival is left to any. "right from": the rig minutes from which on every
verdict is right, which nobody at the rig can know at that moment; "ends": where the investigation
stops by itself, and the programme's length. "settled": nothing is open by the rule of `investigate`
(docs/howto-investigate.md), judged on what each of the two recorded.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from eps_hil.bus.config import load_bus_setup
from eps_hil.bus.record import open_log
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.investigate.journal import Journal
from eps_hil.investigate.lockstep import LockstepRig
from eps_hil.investigate.possible import Menu, Possible
from eps_hil.investigate.run import Investigation, diagnosed, letting_go, prepared_menu
from eps_hil.physics.model import Model, load_model
from eps_hil.programme.conductor import Conductor
from eps_hil.programme.limits import load_limits
from eps_hil.programme.plan import load_plan
from eps_hil.programme.recordings import joined

ROOT = Path(__file__).parents[1]
PROGRAMME = ROOT / "configs" / "programmes" / "friction_map.yaml"
LOOKED_AT = (8, 16, 24, 32, 48, 64, 80)
"""Cells of the programme after which its recordings are diagnosed."""
CASES: tuple[Mapping[str, Any] | None, ...] = (
    {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 6.0},
    {"effect": "quadratic_drag", "coefficient_nm_s2_per_rad2": 1.5e-5},
    {"effect": "position_dependent_friction", "level_nm": 0.03, "centre_m": 0.02, "width_m": 0.005},
    {"effect": "breakaway_dwell", "level_nm": 0.05, "time_s": 1.0, "release_rad": 1.0},
    {"effect": "cogging_torque", "amplitude_nm": 0.012, "order": 8.0, "phase_rad": 0.5},
    {"effect": "torque_ripple", "fraction": 0.03, "phase_rad": 0.5},
    {"effect": "motor_torque_gain", "gain": 1.03},
    {"effect": "torque_sensor_gain", "gain": 1.05},
    {"effect": "cardan_joint", "fraction": 0.04, "phase_rad": 0.5},
    {"effect": "screw_ripple", "amplitude_nm": 0.012, "phase_rad": 0.5},
    {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 4e-4},
    None,
)


@dataclass(frozen=True)
class Verdict:
    """After so many seconds of rig time."""

    rig_s: float
    names: tuple[str, ...]
    rivals: bool
    settled: bool

    def right(self, hidden: Mapping[str, Any] | None) -> bool:
        """Whether it names what was hidden, and nothing else."""
        return self.names == (() if hidden is None else (hidden["effect"],)) and not self.rivals


def verdict(rig_s: float, menu: Menu, found: Diagnosis) -> Verdict:
    """Of one diagnosis, with what it leaves open."""
    possible = Possible(menu, found)
    rivals = any(one["confusable_with"] for one in found.content["findings"])
    return Verdict(rig_s, possible.names, rivals, possible.answered and not possible.same)


def files(folder: Path, hidden: Mapping[str, Any] | None) -> Path:
    """A configuration whose rig holds the effect."""
    content = yaml.safe_load((ROOT / "configs" / "reference_rig.yaml").read_text())
    content["model"]["effects"] = [] if hidden is None else [dict(hidden)]
    (folder / "rig.yaml").write_text(yaml.safe_dump(content))
    config = {
        "bus": {"interface": "virtual", "channel": "benchmark"},
        "dbc": [str(ROOT / "dbc" / "eps_rig.dbc")],
        "signals": str(ROOT / "configs" / "eps_rig_signals.yaml"),
        "model": str(ROOT / "configs" / "reference_rig.yaml"),
        "rig": {"manoeuvre": "idle", "model": "rig.yaml", "order": 2, "realtime": False},
    }
    (folder / "c.yaml").write_text(yaml.safe_dump(config))
    return folder / "c.yaml"


def chosen(config: Path, menu: Menu, model: Model, budget_min: float) -> list[Verdict]:
    """The investigation's verdicts, one a round."""
    setup = load_bus_setup(config)
    journal = Journal(config.parent / "out", model, menu.limits, simulated=True)
    rig = LockstepRig(config, model)
    run = Investigation(setup, menu, journal, lambda _: letting_go(rig))
    rounds = run.run(60.0 * budget_min).rounds
    return [
        Verdict(
            one["rig_s"],
            tuple(sorted(finding["effect"] for finding in one["findings"])),
            any(finding["confusable_with"] for finding in one["findings"]),
            one["stop"] == "settled",
        )
        for one in rounds
        if one["verdict"] is not None
    ]


def fixed(config: Path, menu: Menu, model: Model) -> list[Verdict]:
    """The programme's verdicts, one after every stretch of cells."""
    setup, plan = load_bus_setup(config), load_plan(PROGRAMME, model)
    rig, cells = LockstepRig(config, model), plan.cells()
    began_s, first = rig.simulated_s, 0
    stretches: dict[str, Any] = {}
    found: list[Verdict] = []
    for last in LOOKED_AT:
        logs = []
        for cell in cells[first:last]:
            logs.append(config.parent / f"{cell.name}.log")
            file = open_log(logs[-1], "can0", overwrite=True)
            rig.lead(Conductor(cell, plan, model), file, lambda: None)
            file.close()
        first = last
        stretches |= joined(logs, setup)
        found.append(verdict(rig.simulated_s - began_s, menu, diagnosed(model, stretches)))
    return found


def stays_right(verdicts: Sequence[Verdict], hidden: Mapping[str, Any] | None) -> float | None:
    """Seconds from which on every verdict is right, None if the last is not."""
    since = None
    for one in verdicts:
        since = (since or one.rig_s) if one.right(hidden) else None
    return since


def minutes(seconds: float | None) -> str:
    """For the table."""
    return "never" if seconds is None else f"{seconds / 60.0:.1f}"


def main() -> None:
    """Run the cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=float, default=10.0, help="minutes")
    parser.add_argument("--cases", type=int, nargs="*", default=list(range(len(CASES))))
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    model = load_model(ROOT / "configs" / "reference_rig.yaml")
    with tempfile.TemporaryDirectory() as folder:
        menu = prepared_menu(model, load_limits(files(Path(folder), None)), 1.0)
    print("| hidden | chosen: right from | ends | settled | verdict | fixed: right from | ends | "
          "settled | verdict |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    rows = []
    for k in asked.cases:
        hidden, since = CASES[k], time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            config = files(Path(folder), hidden)
            both = chosen(config, menu, model, asked.budget), fixed(config, menu, model)
        name = "nothing" if hidden is None else str(hidden["effect"])
        cells, row = [name], {"hidden": name, "took_s": round(time.monotonic() - since)}
        for who, verdicts in zip(("chosen", "fixed"), both, strict=True):
            from_s, last = stays_right(verdicts, hidden), verdicts[-1]
            told = ", ".join(last.names) or "nothing"
            settled = "yes" if last.settled else "no"
            cells += [minutes(from_s), minutes(last.rig_s), settled, told]
            row[who] = {"right_from_s": from_s, "s": last.rig_s, "settled": last.settled}
        rows.append(row)
        print(f"| {' | '.join(cells)} |", flush=True)
        if asked.json:
            asked.json.write_text(json.dumps(rows, indent=1) + "\n")
    summary(rows)


def summary(rows: Sequence[Mapping[str, Any]]) -> None:
    """Counts, and minutes where both are right in the end."""
    for who in ("chosen", "fixed"):
        right = sum(one[who]["right_from_s"] is not None for one in rows)
        settled = sum(one[who]["settled"] for one in rows)
        print(f"{who}: {right} of {len(rows)} right in the end, {settled} settled")
    both = [
        one for one in rows if all(one[w]["right_from_s"] is not None for w in ("chosen", "fixed"))
    ]
    for key, what in (("s", "until it ends"), ("right_from_s", "until it is right")):
        mine, theirs = (sum(one[who][key] for one in both) / 60.0 for who in ("chosen", "fixed"))
        if both:
            print(f"where both are right ({len(both)}), {what}: {mine:.1f} min of rig against "
                  f"{theirs:.1f} ({mine / theirs:.2f})")  # fmt: skip


if __name__ == "__main__":
    main()
