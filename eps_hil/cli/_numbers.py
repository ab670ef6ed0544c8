"""NaN and infinity are no numbers of an option: no range refuses NaN, and no limit trips on it."""

import functools
import inspect
import math
from collections.abc import Callable
from typing import Any

import typer


def takes_numbers(verb: Callable[..., Any]) -> Callable[..., Any]:
    """The verb, which refuses NaN and infinity in whatever option takes a float."""
    names = {name: _option(one) for name, one in inspect.signature(verb).parameters.items()}

    @functools.wraps(verb)
    def command(*arguments: Any, **values: Any) -> Any:
        for name, value in values.items():
            for one in value if isinstance(value, list | tuple) else (value,):
                if isinstance(one, float) and not math.isfinite(one):
                    raise typer.BadParameter(
                        f"{one:g} is not a finite number", param_hint=f"'{names[name]}'"
                    )
        return verb(*arguments, **values)

    return command


def _option(parameter: inspect.Parameter) -> str:
    """As it is written on the command line."""
    for info in (parameter.default, *getattr(parameter.annotation, "__metadata__", ())):
        for word in getattr(info, "param_decls", None) or ():
            if word.startswith("--"):
                return str(word)
    return "--" + parameter.name.replace("_", "-")
