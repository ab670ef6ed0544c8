"""Where the real recordings are: beside the checkout, because they are not ours to pass on."""

import os
import warnings
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLACE = Path(os.environ.get("EPS_HIL_REAL_DATA") or ROOT.parent / "shared" / "data")


@pytest.fixture(scope="session")
def ford_log() -> Path:
    """The candump log of the parked Ford GT350; skips, and says so, where it is not."""
    log = PLACE / "ford_gt350" / "normalsportcomfortengineon.log"
    if log.is_file():
        return log
    message = (
        f"REAL DATA MISSING: no {log}; set EPS_HIL_REAL_DATA to the folder that holds "
        "ford_gt350/ to run the tests of real input"
    )
    warnings.warn(message, stacklevel=2)
    pytest.skip(message)
