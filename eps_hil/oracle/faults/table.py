"""The outcomes of many cases as a table, a line for each kind of fault."""

from collections.abc import Sequence

from eps_hil.oracle.faults.case import KINDS, NO_FAULT
from eps_hil.oracle.faults.judge import Outcome

_HEAD = (
    "| fault | cases | wrong and valid | worst while valid | longest spell | back after | failed |",
    "|---|---|---|---|---|---|---|",
)


def table(outcomes: Sequence[Outcome]) -> str:
    """Markdown: single faults by kind, then the sequences by their length.

    "wrong and valid" counts the cases with such a spell of over 20 ms; "back after" is the longest
    from the fault's end until valid for good, and in brackets in how many cases it was not asked.
    """
    lines = list(_HEAD)
    for name in (NO_FAULT, *KINDS):
        kinds = () if name == NO_FAULT else (name,)
        lines += _line(name, [each for each in outcomes if each.kinds == kinds])
    for count in range(2, 6):
        part = [each for each in outcomes if len(each.kinds) == count]
        lines += _line(f"{count} faults in sequence", part)
    return "\n".join(lines)


def _line(name: str, part: Sequence[Outcome]) -> list[str]:
    if not part:
        return []
    back = [each.back_ms for each in part if each.back_ms is not None]
    free = len(part) - len(back)
    again = f"{max(back):.0f} ms" if back else "–"
    return [
        f"| {name} | {len(part)} | {sum(each.longest_ms > 20 for each in part)}"
        f" | {max(each.worst_n for each in part):.0f} N"
        f" | {max(each.longest_ms for each in part):.0f} ms"
        f" | {again}{f' ({free})' if free else ''}"
        f" | {sum(bool(each.wrong) for each in part)} |"
    ]


def shares(outcomes: Sequence[Outcome]) -> str:
    """Markdown: which kinds take part in the sequences that failed, most suspicious first."""
    sequences = [each for each in outcomes if len(each.kinds) > 1]
    rows = []
    for name in KINDS:
        part = [each for each in sequences if name in each.kinds]
        failed = [each for each in part if each.wrong]
        if failed:
            rows.append((len(failed) / len(part), name, len(failed), len(part)))
    lines = ["| fault in a sequence | sequences | of them failed |", "|---|---|---|"]
    lines += [f"| {name} | {all_of} | {bad} |" for _, name, bad, all_of in sorted(rows)[::-1]]
    return "\n".join(lines) if rows else ""
