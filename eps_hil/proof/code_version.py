"""Which code a proof was made with."""

import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def code_version() -> str:
    """The checkout's commit, else the package's version."""
    with suppress(OSError, subprocess.CalledProcessError):
        # installed, the folder above may be in somebody else's checkout
        (Path(__file__).parents[2] / ".git").lstat()
        said = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=10"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        )
        return said.stdout.strip()
    with suppress(PackageNotFoundError):
        return version("eps_hil")
    return "unknown"
