"""``python -m eps_hil``: the ``eps-hil`` command where its script is not on the path."""

from eps_hil.cli.main import run

if __name__ == "__main__":
    run()
