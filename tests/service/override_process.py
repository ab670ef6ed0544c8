"""An override session as a process: a sawtooth of torque on the bus of a configuration file.

    python override_process.py CONFIG.yaml JOURNAL.jsonl [PEAK_NM]

What the kill tests and scripts/kill_transcript start and kill. It is unattended, so whoever
starts it must be sure that the bus is a simulated rig's.
"""

import asyncio
import sys
from collections.abc import Mapping
from pathlib import Path

from eps_hil.errors import EpsHilError
from eps_hil.service.config import load_config
from eps_hil.service.journal import Journal
from eps_hil.service.operator import Unattended
from eps_hil.service.override_session import OverrideSession
from eps_hil.service.override_setup import prepare_override


class Hold:
    """Ramps to ``peak_nm`` within half a second and holds it."""

    def __init__(self, peak_nm: float) -> None:
        self._peak_nm, self._wanted_nm = peak_nm, 0.0

    def step(
        self, t_ns: int, values: Mapping[str, float], *, engaged: bool, now_ns: int
    ) -> float | None:
        if not engaged:
            return None
        self._wanted_nm = min(self._wanted_nm + self._peak_nm / 500, self._peak_nm)
        return self._wanted_nm


def main(arguments: list[str]) -> int:
    config = Path(arguments[0])
    parts = prepare_override(load_config(config), config)
    parts.estimator.warm_up()
    journal = Journal(Path(arguments[1]))
    peak_nm = float(arguments[2]) if len(arguments) > 2 else 0.04
    session = OverrideSession(parts, Hold(peak_nm), Unattended(), print, journal=journal)
    try:
        asyncio.run(session.run(60.0))
    except EpsHilError as error:
        print(error)
        return 1
    return 0 if session.fault is None else 3


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
