"""Whether a quick proof found what even a few cases must show; CI's verdict on it.

    python scripts/ci/quick_proof.py OUT

``OUT`` is what ``eps-hil prove concealed --quick --out OUT`` wrote. Every case has an answer, no
decoy a finding, and what is hidden at 1.5 times the noise is named. Status 1, and why, if not.
"""

import json
import sys
from pathlib import Path
from typing import Any

from eps_hil.proof.run import judgement

CLEAR = 1.5
"""Effect / noise from which a single effect that is not named is a fault of the tool."""


def problems(lines: list[dict[str, Any]]) -> list[str]:
    """Of the lines of ``cases.jsonl``."""
    found = [] if lines else ["no case was run"]
    for line in lines:
        judged, name = judgement(line), f"case {line['id']} ({line['answer']['kind']})"
        if not judged.answered:
            found.append(f"{name}: no diagnosis: {line['problem']}")
        elif judged.kind == "decoys" and not judged.clean:
            found.append(f"{name}: a false alarm")
        elif judged.kind == "singles" and judged.level >= CLEAR and not judged.right_first:
            found.append(f"{name}: {', '.join(judged.truths)} at {judged.level:g} is not named")
    return found


if __name__ == "__main__":
    path = Path(sys.argv[1]) / "cases.jsonl"
    told = problems([json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()])
    sys.stdout.write(
        "\n".join(told or ["all cases answered, decoys clean, clear singles named"]) + "\n"
    )
    sys.exit(bool(told))
