"""Whether tests were skipped that continuous integration has to run; each is named.

    python scripts/ci/skips.py LOG

``LOG`` is what pytest said (with ``-rs``). What needs vcan0 runs in a step of its own, real data
are not everywhere, and a container may withhold rights; every other skip, of a package or program
that is not installed above all, is a failure. Status 1, and which, if there is one.
"""

import re
import sys
from pathlib import Path

MAY = (
    "no vcan0 on this machine",
    "SocketCAN is NOT tested here",
    "REAL DATA MISSING",
    "is not permitted here (CAP_",
    "as root",
    "about compiled code",  # scripts/kernel_coverage, which interprets it…
    "stopped: what it ran until then counts",  # …and stops what takes long so
)
"""Words of the reasons for which a test may be skipped."""
_SKIPPED = re.compile(r"^SKIPPED \[(\d+)\] (\S+?:(?:\d+:)?) (.*)$", re.MULTILINE)
_COUNTED = re.compile(r"^(?:.* )?(\d+) skipped\b.* in [0-9.]+s", re.MULTILINE)


def problems(log: str) -> list[str]:
    """Of the text of a log."""
    skips = [(int(n), place, why) for n, place, why in _SKIPPED.findall(log)]
    found = [
        f"skipped: {place} {why}" for _, place, why in skips if not any(word in why for word in MAY)
    ]
    counted, named = sum(map(int, _COUNTED.findall(log))), sum(n for n, _, _ in skips)
    if counted != named:
        found.append(f"{counted} tests were skipped, and the reasons of {named} are told")
    return found


if __name__ == "__main__":
    told = problems(Path(sys.argv[1]).read_text(encoding="utf-8", errors="replace"))
    sys.stdout.write("\n".join(told or ["nothing was skipped that has to run here"]) + "\n")
    sys.exit(bool(told))
