"""``python -m eps_hil.cli``: the same command where no script is installed."""

from eps_hil.__main__ import run

run()
