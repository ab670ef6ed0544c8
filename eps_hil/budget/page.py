"""The budget as one self-contained HTML page: what to do next first, then the figures behind it."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from eps_hil.budget.budget import PHASES, Budget, Line, advice
from eps_hil.budget.figure import draw
from eps_hil.budget.sources import JOBS, Group
from eps_hil.report import page

LEAST_SHARE = 0.02
"""Groups that would gain less than this part of the total are printed in grey."""


@dataclass(frozen=True, slots=True)
class About:
    """What the budget was worked out for, as the user calls it."""

    model: str
    manoeuvre: str
    estimator: str
    masses: int
    angle: bool


def write(found: Budget, path: Path, about: About) -> None:
    """Write the page whole or not at all; it loads nothing from elsewhere."""
    page.write(path, render(found, about))


def render(found: Budget, about: About) -> str:
    """The page's HTML."""
    page.check("--report", "matplotlib")
    with tempfile.TemporaryDirectory() as folder:
        title = "the largest sources by phase: what one standard deviation of each costs"
        picture = page.picture(draw(found, Path(folder) / "budget.png", title))
    return page.fill(
        "budget.html.jinja",
        "eps_hil.budget",
        about=about,
        found=found,
        phases=PHASES,
        sentences=[_split(sentence) for sentence in advice(found)],
        wholes=_wholes(found),
        groups=[_group(found, line) for line in found.groups],
        picture=picture,
        css=page.asset("page.css"),
    )


def _split(sentence: str) -> tuple[str, str]:
    """Advice as (phase, words)."""
    phase, _, words = sentence.partition(": ")
    return phase, words


def _wholes(found: Budget) -> list[tuple[str, Mapping[str, float], str]]:
    return [
        ("all together", found.total_n, f"Monte Carlo, {found.draws} draws"),
        ("root of the squares", found.root_sum_n, "of the sources alone"),
        ("the method itself", found.method_n, "every source at zero; no calibration lowers it"),
        ("error with the method", found.with_method_n, "what an estimate is off by in the end"),
        ("the rack force", found.force_n, "for scale"),
    ]


def _group(found: Budget, line: Line) -> tuple[str, str, Mapping[str, float], dict[str, bool]]:
    """(name, what to do, gain by phase, whether it is worth a look by phase)."""
    gains = line.gain_n or {}
    worth = {phase: gains[phase] > LEAST_SHARE * found.total_n[phase] for phase in PHASES}
    return line.name, JOBS[Group(line.name)], gains, worth
