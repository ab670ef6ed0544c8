"""``python -m eps_hil.cli``: the same command where no script is installed."""

from eps_hil.cli.main import run

run()
