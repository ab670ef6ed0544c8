"""Whether the machine stood still during a demo, in one or two plain lines; nothing if it did not.

    python scripts/demo_stalls.py RIG.txt ESTIMATES.csv "COMMAND TO REPEAT"

RIG.txt is what `eps-hil rig` said, ESTIMATES.csv what `eps-hil run --log-estimates` wrote.
"""

import csv
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from eps_hil.estimation.validity import Reason

_STALL_MS = 20.0
"""From here on the rig begins its time anew (eps_hil.rig.realtime): frames are missing then."""
_LEAST_SHARE = 0.005
_OF_A_STALL = (
    Reason.MOTOR_TORQUE | Reason.TORQUE_SENSOR | Reason.MOTOR_SPEED | Reason.GAP
    | Reason.NO_INPUT | Reason.TIME | Reason.STALE
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Stalls:
    """What the machine did to a run."""

    number: int
    longest_ms: float
    invalid_share: float | None
    """Of the rig's run, because of stalls; None: there was no service."""

    def lines(self, command: str) -> list[str]:
        """For whoever looks at the figure; none if there is nothing to say."""
        if not self.number and (self.invalid_share or 0.0) < _LEAST_SHARE:
            return []
        times = "once" if self.number == 1 else f"{self.number} times"
        share = self.invalid_share
        so = (
            "the recording has holes there"
            if share is None
            else f"{100 * share:.0f} % of the run was INVALID because of it"
        )
        return [
            f"NOTE: this machine stood still {times} while the rig drove, "
            f"{self.longest_ms:.0f} ms at the longest: {so}.",
            f"That is not the estimator: end what else runs on it, and repeat: {command}",
        ]


def stalls(rig_text: str, rows: Iterable[tuple[int, int]] | None) -> Stalls:
    """From the rig's last words and the estimates' (instant in ns, reason bits).

    The estimates are those of the rig's run. What is INVALID before the first valid one belongs to
    the start. Later, a stretch is a stall's if samples were missing in it: what follows (settling,
    a bristle that is unknown until the rotor slides) belongs to it.
    """
    said = re.findall(r"max (\d+) us; \S+ ms caught up, (\d+) overruns", rig_text)
    longest_ms, overruns = (int(said[-1][0]) / 1000, int(said[-1][1])) if said else (0.0, 0)
    if rows is None:
        return Stalls(overruns, longest_ms, None)
    lost_ns = total_ns = stretches = 0
    for begin_ns, end_ns, reasons, hole_ns in _stretches(rows):
        total_ns += end_ns - begin_ns
        if reasons & _OF_A_STALL or hole_ns > _STALL_MS * 1e6:
            lost_ns += end_ns - begin_ns
            stretches += 1
            longest_ms = max(longest_ms, hole_ns * 1e-6)
    number = max(overruns, stretches)
    never = 1.0 if overruns else 0.0  # valid; without a stall it has another cause
    return Stalls(number, longest_ms, lost_ns / total_ns if total_ns else never)


def _stretches(rows: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int, int, int]]:
    """From the first valid row on, valid and not in turn: begin, end, reasons, longest hole.

    A hole between two valid rows is a stretch, too.
    """
    begin = last = None
    reasons = hole_ns = 0
    for t_ns, reason in rows:
        if begin is None or last is None:
            if not reason:
                begin = last = t_ns
            continue
        apart_ns = t_ns - last
        torn = apart_ns > _STALL_MS * 1e6
        if (reason or torn) and not reasons and not hole_ns:  # it begins after the last valid row
            yield begin, last, 0, 0
            begin = last
        elif not reason and not torn and (reasons or hole_ns):
            yield begin, last, reasons, hole_ns
            begin, reasons, hole_ns = last, 0, 0
        reasons |= reason
        hole_ns = max(hole_ns, apart_ns if torn else 0)
        last = t_ns
    if begin is not None and last is not None:
        yield begin, last, reasons, hole_ns


def estimates(path: Path, last_s: float) -> list[tuple[int, int]]:
    """Instants and reasons of the log's last so many seconds."""
    with path.open(encoding="utf-8") as file:
        rows = [(int(row["t_ns"]), int(row["reason"])) for row in csv.DictReader(file)]
    while rows and rows[-1][1] & Reason.NO_INPUT:  # the rig is done
        rows.pop()
    return [row for row in rows if row[0] > rows[-1][0] - last_s * 1e9]


def main() -> None:
    """Say it."""
    rig, log, seconds, command = sys.argv[1:]
    found = stalls(Path(rig).read_text(encoding="utf-8"), estimates(Path(log), float(seconds)))
    sys.stdout.writelines(f"{line}\n" for line in found.lines(command))


if __name__ == "__main__":
    main()
