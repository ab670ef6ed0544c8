"""How often ``eps-hil changes`` names what differs between two states of one rig.

    python benchmarks/changed.py [--seed 1] [--cases 8] [--level 0.6] [--shared 3.0]

Half of the cases have a change: an effect of the catalogue at ``--level`` of the noise that is new
after, or gone, in turn. The other half has none. In every second case of both halves the two states
share an effect that no catalogue holds, at ``--shared`` of the noise, which does not change. Cases
are those of ``eps_hil.proof``, development seeds only; before and after differ in programme and
noise. Prints a line for each, then the counts.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from eps_hil.diagnosis.changes import changes, in_words
from eps_hil.physics.model import load_model
from eps_hil.proof.effects import ALIENS, CATALOGUED, find
from eps_hil.proof.plans import lasting, near
from eps_hil.proof.states import State, two_states
from eps_hil.series import Series


def _recordings(state: State) -> dict[str, dict[str, Series]]:
    read: dict[str, dict[str, Series]] = {}
    for name, columns in state.items():
        n = len(next(iter(columns.values())))
        t_ns = np.arange(n, dtype=np.int64) * 1_000_000
        read[name] = {key: Series(t_ns, values) for key, values in columns.items()}
    return read


def main() -> None:
    """Run the cases and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=8)
    parser.add_argument("--level", type=float, default=0.6)
    parser.add_argument("--shared", type=float, default=3.0)
    asked = parser.parse_args()
    model = load_model(Path(__file__).parents[1] / "configs" / "reference_rig.yaml")
    rng = np.random.default_rng([asked.seed, 24])
    counts = {True: [0, 0, 0], False: [0, 0, 0]}  # cases, as they should be, a false name
    for k in range(asked.cases):
        changed, shared, gone = k % 2 == 0, k % 4 >= 2, k % 8 >= 4
        alien = str(rng.choice(list(ALIENS)))
        beside = {alien, *find(alien).twins} if shared else set()
        name = str(rng.choice([one for one in lasting() if one not in beside]))
        base = [(alien, asked.shared)] if shared else []
        change = (name, asked.level) if changed else None
        made = two_states(700_000 + 1000 * asked.seed + k, base, change)
        states = (made.without, made.with_change)
        states = states[::-1] if gone else states
        since = time.monotonic()
        told = changes(model, *(_recordings(one) for one in states)).after.content
        found = [one["effect"] for one in told["findings"]]
        # near: what the recordings may not be able to tell from it, as in the proof
        allowed = near(name) if changed else set()
        false = [one for one in found if one not in allowed and one in CATALOGUED]
        right = (bool(allowed & set(found)) if changed else not found) and not false
        count = counts[changed]
        count[0] += 1
        count[1] += right
        count[2] += bool(false)
        said = [f"{one['effect']} {in_words(one['change'])}" for one in told["findings"]]
        what = (f"{name} {'gone' if gone else 'new'}") if changed else "nothing"
        print(
            f"{'right' if right else 'WRONG'} {what}{f' beside {alien}' if shared else ''} -> "
            f"{said} {time.monotonic() - since:.0f} s",
            flush=True,
        )
    for changed, (cases, right, false) in counts.items():
        what = "with a change" if changed else "without one"
        print(f"# {what}: {cases} cases, {right} as they should be, {false} with a false name")


if __name__ == "__main__":
    main()
