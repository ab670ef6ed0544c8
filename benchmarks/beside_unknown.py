"""How often a diagnosis names known physics beside physics that no catalogue holds.

    python benchmarks/beside_unknown.py [--seed 1] [--count 15] [--keep DIR] [KIND ...]

Kinds are those of ``eps_hil.proof.plans``, development seeds only: ``beside`` (an effect at 0.6 of
the noise beside each alien at 3), ``triples`` (three effects at 1.5), ``aliens``, ``decoys``…
``--keep`` holds the recordings, so that two versions of the code see the same ones at once.
"""

import argparse
import pickle
import time
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model, load_model
from eps_hil.proof.cases import Case, make
from eps_hil.proof.effects import CATALOGUED
from eps_hil.proof.judge import judge
from eps_hil.proof.plans import Plan, plans
from eps_hil.series import Series


def _made(plan: Plan, keep: Path | None) -> Case:
    if keep is None:
        return make(plan)
    said = "-".join(f"{name}@{level}" for name, level in plan.wanted) or plan.decoy
    path = keep / f"{plan.kind}-{plan.seed}-{said}.pickle"
    if not path.exists():
        keep.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(make(plan)))
    case = pickle.loads(path.read_bytes())  # written by this script
    assert isinstance(case, Case)
    return case


def _diagnosed(case: Case, model: Model) -> dict[str, Any]:
    read: dict[str, dict[str, Series]] = {}
    for name, columns in case.recordings.items():
        n = len(next(iter(columns.values())))
        t_ns = np.arange(n, dtype=np.int64) * 1_000_000
        read[name] = {key: Series(t_ns, values) for key, values in columns.items()}
    holdouts = {name: read.pop(name) for name in list(read) if name == "holdout"}
    return diagnose(model, read, holdouts).content


def main() -> None:
    """Run the cases asked for and print one line each, then the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=["beside", "triples", "aliens", "decoys"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=15)
    parser.add_argument("--keep", type=Path)
    asked = parser.parse_args()
    model = load_model(Path(__file__).parents[1] / "configs" / "reference_rig.yaml")
    for kind in asked.kinds:
        right = named = cases = invented = unknown = hidden = 0
        for plan in plans(kind, 500 + asked.seed, asked.count):
            case = _made(plan, asked.keep)
            since = time.monotonic()
            try:
                content = _diagnosed(case, model)
            except Exception as error:  # counted as a miss, and printed
                print(f"{kind} {plan.wanted}: {type(error).__name__}: {error}", flush=True)
                cases += 1
                continue
            j = judge(str(plan.seed), case.answer, content)
            known = [name for name in j.truths if name in CATALOGUED]
            found = [name for name in known if name in j.in_set]
            hidden += len(known)
            named += len(found)
            cases += 1
            invented += bool(j.invented)
            unknown += j.said_unknown
            right += len(found) == len(known) and not j.invented
            said = [f"{one['effect']}:{one['confidence']:.2f}" for one in content["findings"]]
            kept = content["fit"]["holdout"]
            left = [
                round(kept[m]["torque_nrmse"], 4) for m in ("baseline", "augmented", "noise_floor")
            ]
            print(
                f"{kind} {list(j.truths) or plan.decoy} -> {said} invented {list(j.invented)} "
                f"nrmse {left} {time.monotonic() - since:.1f} s",
                flush=True,
            )
        print(
            f"# {kind}: {cases} cases, {right} as they should be, {named} of {hidden} names there, "
            f"{invented} with a false name, {unknown} with unknown",
            flush=True,
        )


if __name__ == "__main__":
    main()
