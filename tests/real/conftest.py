"""Where the real recordings are: beside the checkout, because they are not ours to pass on."""

import os
import warnings
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLACES = (
    *([Path(os.environ["EPS_HIL_REAL_DATA"])] if os.environ.get("EPS_HIL_REAL_DATA") else []),
    ROOT.parent / "shared" / "data",
)


@pytest.fixture(scope="session")
def ford_log() -> Path:
    """The candump log of the parked Ford GT350; skips, and says so, where it is not."""
    name = Path("ford_gt350") / "normalsportcomfortengineon.log"
    for place in PLACES:
        if (place / name).is_file():
            return place / name
    message = (
        f"REAL DATA MISSING: {name} is in none of {', '.join(map(str, PLACES))}; "
        "set EPS_HIL_REAL_DATA to the folder that holds ford_gt350/ to run these tests"
    )
    warnings.warn(message, stacklevel=2)
    pytest.skip(message)
