"""Imported first by the Python scripts of this folder: goes on in the checkout's own environment.

Where what eps_hil needs is not there, the same script is started once more by ``.venv``'s Python;
where there is none, one line says how to make it. The checkout's sources come first.
"""

import importlib.util
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_PYTHON = ROOT / ".venv/bin/python"

if importlib.util.find_spec("numba") is None:
    if _PYTHON.exists() and Path(sys.prefix) != ROOT / ".venv":
        os.execv(_PYTHON, [str(_PYTHON), *sys.argv])
    sys.exit(
        f"error: {sys.executable} lacks what eps_hil needs; run scripts/test once, which makes "
        ".venv, or activate the environment that eps_hil is installed in"
    )
sys.path.insert(0, str(ROOT))
