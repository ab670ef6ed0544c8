"""The table of a proof: diagnoses (CONTRACT 7) against the opened answers.

    python -m eps_hil.proof.score OUT_DIR RESULTS_DIR [--seal SHA256] [--json FILE]

RESULTS_DIR holds one <id>.json a case. The seal is checked before anything is counted; a case
without a diagnosis counts as missed. Shares come with Wilson's 95 % interval.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from eps_hil import json_text
from eps_hil.errors import EpsHilError, InputError
from eps_hil.proof.judge import Judgement, failed, judge
from eps_hil.proof.seal import open_answers

_Z95 = 1.959964


@dataclass(frozen=True, slots=True)
class Share:
    """``hits`` of ``cases`` under a name, with Wilson's interval."""

    what: str
    hits: int
    cases: int

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the share, 0 to 1."""
        if not self.cases:
            return (0.0, 1.0)
        n, p, z2 = self.cases, self.hits / self.cases, _Z95**2
        middle = (p + z2 / (2 * n)) / (1 + z2 / n)
        half = _Z95 / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
        return (max(middle - half, 0.0), min(middle + half, 1.0))

    def __str__(self) -> str:
        low, high = self.interval
        percent = f"{self.hits / self.cases:6.1%}" if self.cases else "     –"
        return f"{self.what:<58} {percent} {self.hits:>5}/{self.cases:<5} {low:.0%}–{high:.0%}"


def _all_in_set(j: Judgement) -> bool:
    return j.all_in_set


Hit = Callable[[Judgement], bool]

_HIDDEN: dict[str, Hit] = {
    "right name first": lambda j: j.right_first,
    "truth in the reported set": _all_in_set,
    "something invented": lambda j: bool(j.invented),
    "ERR names it first": lambda j: j.naive_err[:1] == j.truths[-1:],
    "STLSQ names it first": lambda j: j.naive_stlsq[:1] == j.truths[-1:],
}
_PAIRS: dict[str, Hit] = {
    "both named": lambda j: len(j.named) == len(j.truths),
    "both in the reported set": _all_in_set,
    "something invented": lambda j: bool(j.invented),
}
_TRIPLES: dict[str, Hit] = {
    "all named": lambda j: len(j.named) == len(j.truths),
    "all in the reported set": _all_in_set,
    "something invented": lambda j: bool(j.invented),
}
_BESIDE: dict[str, Hit] = {
    "known effect named": lambda j: j.truths[-1] in j.named,
    "known effect in the reported set": lambda j: j.truths[-1] in j.in_set,
    "rest said to be unknown": lambda j: j.said_unknown,
    "something invented": lambda j: bool(j.invented),
}
_DECOYS: dict[str, Hit] = {
    "false alarm": lambda j: not j.clean,
    "ERR names something": lambda j: bool(j.naive_err),
    "STLSQ names something": lambda j: bool(j.naive_stlsq),
}
_ALIENS: dict[str, Hit] = {
    "said to be unknown": lambda j: j.said_unknown,
    "wrong name, no twin": lambda j: bool(j.invented),
}
_TWINS: dict[str, Hit] = {
    "truth in the reported set": _all_in_set,
    "truth and twin both named as possible": lambda j: j.all_in_set and j.twin_in_set,
    "something invented": lambda j: bool(j.invented),
}
_LOADS: dict[str, Hit] = {
    "right name first": lambda j: j.right_first,
    "right name, or said to be like the load": lambda j: j.right_first or bool(j.told_hidden),
    "something invented": lambda j: bool(j.invented),
}
_EMPTY: dict[str, Hit] = {"false alarm": lambda j: not j.clean}
_OTHERS: dict[str, tuple[str, dict[str, Hit]]] = {
    "pairs": ("masked pairs", _PAIRS),
    "decoys": ("decoys", _DECOYS),
    "aliens": ("aliens", _ALIENS),
    "missing": ("family withheld", _ALIENS),
    "beside": ("known effects beside aliens", _BESIDE),
    "triples": ("triples", _TRIPLES),
    "twins": ("twins", _TWINS),
}


def shares(judged: Sequence[Judgement]) -> list[Share]:
    """What is counted, by form, kind and strength; only what there are cases of."""
    table: list[Share] = []
    for form in sorted({j.form for j in judged}):
        for kind in ("singles", "poor", "crowds", "behind"):
            one = [j for j in judged if (j.form, j.kind) == (form, kind)]
            for level in sorted({j.level for j in one}):
                at = [j for j in one if j.level == level]
                table += _counted(f"{form} {kind} at {level:g}", at, _HIDDEN)
        for kind, (name, counted) in _OTHERS.items():
            of = [j for j in judged if (j.form, j.kind) == (form, kind)]
            table += _counted(f"{form} {name}", of, counted)
            for decoy in sorted({j.decoy for j in of} - {""}):
                one = [j for j in of if j.decoy == decoy]
                table += _counted(f"{form} decoys, {decoy}", one, _EMPTY)
        blind = [j for j in judged if (j.form, j.kind) == (form, "unmeasured")]
        hidden = [j for j in blind if j.truths]
        table += _counted(f"{form} rack force unmeasured", hidden, {**_HIDDEN, **_LOADS})
        empty = [j for j in blind if not j.truths]
        table += _counted(f"{form} rack force unmeasured, nothing hidden", empty, _EMPTY)
        for kind in ("rates", "sizes", "loads"):
            of = [j for j in judged if (j.form, j.kind) == (form, kind)]
            for group in sorted({j.group for j in of}):
                one = [j for j in of if j.group == group]
                label, counted = f"{form} {kind}, {group}", _LOADS if kind == "loads" else _HIDDEN
                table += _counted(label, [j for j in one if j.truths], counted)
                table += _counted(
                    f"{label}, nothing hidden", [j for j in one if not j.truths], _EMPTY
                )
    intervals = [e for j in judged for e in j.estimates if e.covered is not None]
    if intervals:
        hits = sum(bool(e.covered) for e in intervals)
        table.append(Share("95 % intervals that hold the truth", hits, len(intervals)))
    return table


def _counted(label: str, cases: Sequence[Judgement], hits: Mapping[str, Hit]) -> list[Share]:
    if not cases:
        return []
    return [
        Share(f"{label}: {what}", sum(map(hit, cases)), len(cases)) for what, hit in hits.items()
    ]


def reliability(judged: Sequence[Judgement], bins: int = 5) -> list[tuple[float, float, int]]:
    """Stated confidence against how often it was right: (mean stated, share right, findings)."""
    pairs = [pair for j in judged for pair in j.stated]
    table = []
    for k in range(bins):
        low, high = k / bins, (k + 1) / bins
        last = k == bins - 1
        inside = [(c, r) for c, r in pairs if low <= c < high or (last and c == high)]
        if inside:
            stated = sum(c for c, _ in inside) / len(inside)
            table.append((stated, sum(r for _, r in inside) / len(inside), len(inside)))
    return table


def parameter_errors(judged: Sequence[Judgement]) -> list[tuple[str, str, float, float, int]]:
    """(effect, parameter, median relative error, median of its size, number)."""
    errors: dict[tuple[str, str], list[float]] = {}
    for j in judged:
        for e in j.estimates:
            errors.setdefault((e.effect, e.parameter), []).append(e.relative_error)
    return [
        (effect, parameter, _median(values), _median([abs(v) for v in values]), len(values))
        for (effect, parameter), values in sorted(errors.items())
    ]


def _median(values: Sequence[float]) -> float:
    ordered = sorted(values)
    middle = len(ordered) // 2
    return ordered[middle] if len(ordered) % 2 else 0.5 * (ordered[middle - 1] + ordered[middle])


def failures(judged: Sequence[Judgement]) -> list[str]:
    """One line a case that went wrong."""
    lines = []
    for j in judged:
        if failed(j):
            lines.append(f"{j.id} {j.kind} {j.level:g}: {told(j)}")
    return lines


def told(j: Judgement) -> str:
    """What was hidden and what was said of it, in a few words."""
    said = j.first or j.verdict or "no diagnosis"
    hidden = ", ".join(j.truths) or j.decoy or "nothing"
    invented = f"; invented {', '.join(j.invented)}" if j.invented else ""
    in_set = "; truth in its set" if j.in_set and not j.right_first else ""
    return f"{hidden} → {said}{in_set}{invented}"


def score(cases: Mapping[str, Any], results: Path) -> list[Judgement]:
    """Judge every sealed case by RESULTS_DIR/<id>.json."""
    return [judge(id, answer, _read(results / f"{id}.json")) for id, answer in cases.items()]


def _read(path: Path) -> dict[str, Any] | None:
    if not path.exists():
        return None
    try:
        return dict(json_text.parse(path.read_text()))
    except ValueError as error:
        raise InputError(path, "", f"is no JSON: {error}", "diagnose the case again") from None


def report(judged: Sequence[Judgement]) -> str:
    """All tables as text."""
    lines = [str(share) for share in shares(judged)]
    lines += ["", "stated confidence → share right (findings)"]
    lines += [f"  {stated:.2f} → {right:.2f} ({n})" for stated, right, n in reliability(judged)]
    lines += ["", "parameter: median relative error, median size of it (number)"]
    lines += [
        f"  {effect}.{parameter}: {middle:+.1%}, {size:.1%} ({n})"
        for effect, parameter, middle, size, n in parameter_errors(judged)
    ]
    return "\n".join([*lines, "", "failures", *(f"  {line}" for line in failures(judged))]) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; 2 where the seal is broken or a file is not what it should be."""
    parser = argparse.ArgumentParser(prog="python -m eps_hil.proof.score", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of the cases, with answers.json")
    parser.add_argument("results", type=Path, help="folder of the diagnoses, <id>.json")
    parser.add_argument("--seal", help="the hash as it was published")
    parser.add_argument("--json", type=Path, help="write all judgements and shares here")
    chosen = parser.parse_args(arguments)
    try:
        cases = open_answers(chosen.out / "answers.json", chosen.seal)
        judged = score(cases, chosen.results)
    except EpsHilError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_status
    sys.stdout.write(report(judged))
    if chosen.json:
        content = {
            "shares": [{**asdict(s), "ci95": s.interval} for s in shares(judged)],
            "reliability": reliability(judged),
            "cases": [asdict(j) for j in judged],
        }
        chosen.json.write_text(json.dumps(content, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
