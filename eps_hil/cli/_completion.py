"""What the shell runs when somebody presses Tab; typer's own scripts, with one line more."""

import contextlib
import importlib
from collections.abc import MutableMapping

_QUIET = {
    "bash": ("    local IFS", '    command -v "$1" >/dev/null || return 0\n    local IFS'),
    "zsh": ("  eval ", "  command -v %(prog_name)s >/dev/null || return 0\n  eval "),
    "fish": ('--condition "', '--condition "command -q %(prog_name)s; and '),
}
"""A shell outside the environment knows the script and not the program: no word, no complaint."""


def keep_quiet_without_the_program() -> None:
    """Let the scripts that --install-completion and --show-completion write look for it first."""
    with contextlib.suppress(ImportError, AttributeError, KeyError):  # a typer that has others
        scripts: MutableMapping[str, str] = importlib.import_module(
            "typer._completion_shared"
        )._completion_scripts
        for shell, (before, after) in _QUIET.items():
            if after not in scripts[shell]:
                scripts[shell] = scripts[shell].replace(before, after, 1)
