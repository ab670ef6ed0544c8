"""All figures in order, as one result that page, terminal and JSON are made of."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_hil.reproduction import (
    figure4,
    figure5,
    figure7,
    figure9,
    figure10,
    figure12,
    figure14,
)
from eps_hil.reproduction.result import Outcome, Result
from eps_hil.reproduction.workbench import Workbench

SCHEMA = "eps-hil/reproduction/1"

Make = Callable[[Workbench, Path], Result]

FIGURES: Sequence[tuple[str, Make]] = (
    ("fig. 4, friction map", figure4.make),
    ("fig. 5, frequency responses", figure5.make),
    ("fig. 7, linear friction map", figure7.make),
    ("table 2, parameters", figure7.make_table2),
    ("fig. 9, friction estimate", figure9.make),
    ("fig. 10, rack force in simulation", figure10.make),
    ("fig. 11, rack force on the rig", figure10.make_rig),
    ("fig. 12, steps and standstill", figure12.make),
    ("fig. 14, friction adaptation", figure14.make),
)
"""What is made, in this order: later figures estimate with the model that earlier ones identify."""


@dataclass(frozen=True, slots=True)
class Reproduction:
    """All results of one run, with what is needed to repeat it."""

    results: Sequence[Result]
    seed: int
    quick: bool
    seconds: float

    def count(self, outcome: Outcome) -> int:
        """Statements with that outcome."""
        every = (one for result in self.results for one in result.statements)
        return sum(one.outcome is outcome for one in every)

    def content(self) -> dict[str, Any]:
        """JSON-ready; the same seed gives the same content (it holds no times)."""
        return {
            "schema": SCHEMA,
            "seed": self.seed,
            "quick": self.quick,
            "outcomes": {outcome.value: self.count(outcome) for outcome in Outcome},
            "figures": {result.key: result.content() for result in self.results},
        }


def reproduce(
    folder: Path,
    *,
    seed: int = 0,
    quick: bool = False,
    on_progress: Callable[[str, float], None] | None = None,
) -> Reproduction:
    """Make every figure into ``folder`` (which exists), and judge the paper's statements."""
    started_s = time.monotonic()
    bench, results = Workbench(seed, quick), []
    for number, (name, make) in enumerate(FIGURES):
        if on_progress:
            on_progress(name, number / len(FIGURES))
        results.append(make(bench, folder))
    if on_progress:
        on_progress("done", 1.0)
    return Reproduction(results, seed, quick, time.monotonic() - started_s)
