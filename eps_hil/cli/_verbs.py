"""What is asked of every verb of the command line, in one place."""

from collections.abc import Callable
from typing import Any

import typer

Verb = Callable[..., Any]


def wrap(app: typer.Typer, wrapper: Callable[[Verb], Verb]) -> None:
    """Put ``wrapper`` around all verbs of an app and of its groups."""
    for verb in app.registered_commands:
        if verb.callback is not None:
            verb.callback = wrapper(verb.callback)
    for group in app.registered_groups:
        if group.typer_instance is not None:
            wrap(group.typer_instance, wrapper)
