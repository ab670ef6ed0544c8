"""The ``eps-hil`` command, also as ``python -m eps_hil``.

Imports take a moment, in which Ctrl-C shall end as quietly as it does later.
"""

import sys


def run() -> None:
    """Entry point of the installed script."""
    try:
        from eps_hil.cli.main import run as run_command

        run_command()
    except KeyboardInterrupt:
        sys.stderr.write("eps-hil: interrupted\n")
        sys.exit(130)


if __name__ == "__main__":
    run()
