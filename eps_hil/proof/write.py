"""Write cases to a folder: recordings and model file under opaque ids, the answers sealed.

    python -m eps_hil.proof.write OUT_DIR --kind singles --seed 1 --count 30 [--simple]

makes OUT_DIR/<id>/{train_1,train_2,holdout}.csv and model.yaml, OUT_DIR/answers.json and its
hash, answers.json.sha256, which is also printed. With --can the recordings are candump logs with
jitter and lost frames, and rig.dbc and signals.yaml go with them.
"""

import argparse
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from eps_hil.examples import CONFIGS, DBC
from eps_hil.proof.can_log import Wire, write_log
from eps_hil.proof.cases import Case, make
from eps_hil.proof.examine import WITHOUT
from eps_hil.proof.plans import KINDS, Plan, plans
from eps_hil.proof.seal import opaque_id, seal
from eps_hil.proof.sensors import SENSORS
from eps_hil.proof.sizes import SIZES, Size
from eps_hil.proof.truth import Floats

DATABASE, MAPPING = "rig.dbc", "signals.yaml"
LOSSY = Wire(lost_per_frame=2.0e-5)
_DECIMALS = {"time_s": 3, **{name: sensor.decimals for name, sensor in SENSORS.items()}}


def write_csv(path: Path, columns: Mapping[str, Floats], size: Size = SIZES[""]) -> None:
    """Canonical columns as the bus would have carried them: no more digits than its steps."""
    digits = (size.decimals(name, _DECIMALS[name]) for name in columns)
    line = ",".join(f"%.{count}f" for count in digits) + "\n"
    with path.open("w") as file:
        file.write(",".join(columns) + "\n")
        file.writelines(
            line % row for row in zip(*(one.tolist() for one in columns.values()), strict=True)
        )


def write_case(folder: Path, case: Case) -> None:
    """One case's recordings and model file; nothing in them or their names tells the answer.

    Effects that the diagnosis is to leave out stand in a file as well.
    """
    _begin(folder, case)
    for name, columns in case.recordings.items():
        write_csv(folder / f"{name}.csv", columns, SIZES[case.answer["size"]])


def _begin(folder: Path, case: Case) -> None:
    folder.mkdir(parents=True)
    (folder / "model.yaml").write_text(case.nominal)
    if case.answer.get("withheld"):
        (folder / WITHOUT).write_text("\n".join(case.answer["withheld"]) + "\n")


def write_can_case(folder: Path, case: Case, wire: Wire = LOSSY) -> None:
    """The same as CAN logs, with the database and the mapping that read them."""
    from eps_hil.bus.database import load_database

    _begin(folder, case)
    shutil.copy(DBC / "eps_rig.dbc", folder / DATABASE)
    shutil.copy(CONFIGS / "eps_rig_signals.yaml", folder / MAPPING)
    database = load_database([folder / DATABASE])
    rng = np.random.default_rng([case.answer["seed"], 7])
    for name, columns in case.recordings.items():
        write_log(folder / f"{name}.log", columns, database, wire, rng)


def write(out: Path, planned: Sequence[Plan], *, can: bool = False) -> str:
    """Write the planned cases and seal their answers; returns the hash."""
    out.mkdir(parents=True, exist_ok=True)
    cases = {}
    for plan in planned:
        id, case = opaque_id(), make(plan)
        (write_can_case if can or plan.can else write_case)(out / id, case)
        cases[id] = case.answer
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{len(cases)}/{len(planned)} cases")
    return seal(out / "answers.json", cases)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; 2 for an OUT_DIR that already holds answers."""
    parser = argparse.ArgumentParser(prog="python -m eps_hil.proof.write", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--kind", choices=KINDS, default="singles")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--simple", action="store_true", help="one mass, LuGre friction")
    parser.add_argument("--can", action="store_true", help="CAN logs instead of CSV")
    parser.add_argument("--proof", action="store_true", help="seeds that development never sees")
    chosen = parser.parse_args(arguments)
    if (chosen.out / "answers.json").exists():
        sys.stderr.write(f"{chosen.out}: holds answers already; give an empty folder\n")
        return 2
    planned = plans(
        chosen.kind, chosen.seed, chosen.count, simple=chosen.simple, proof=chosen.proof
    )
    value = write(chosen.out, list(planned), can=chosen.can)
    sys.stdout.write(f"answers sealed: sha256 {value}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
