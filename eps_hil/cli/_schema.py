"""``--schema [KIND]`` of every verb that takes YAML files: the JSON schema of one, printed.

A verb tells by the names of its options which kinds of file it takes (:data:`KINDS`).
"""

import functools
import inspect
import json
from collections.abc import Callable, Iterator
from typing import Any

import typer

OPTION = "--schema"
KINDS = {
    "config": "config",
    "model": "model",
    "signals": "signals",
    "chain": "chain",
    "manoeuvre": "manoeuvre",
    "file": "programme",
    "settings": "settings",
    "uncertainty": "uncertainty",
}
"""Kind of file by the name of the option that takes it."""
_KINDS = "_schema_kinds"


def schema(kind: str) -> dict[str, Any]:
    """The JSON schema of a kind of file."""
    from eps_hil.check.schemas import SCHEMAS, block, titled

    if kind == "uncertainty":
        from eps_hil.budget.uncertainty import Uncertainty

        return titled(kind, block(kind, Uncertainty)())
    if kind == "settings":
        from pydantic import TypeAdapter

        from eps_hil.estimation.settings import EstimatorSettings

        return titled(kind, TypeAdapter(EstimatorSettings).json_schema())
    return titled(kind, SCHEMAS[kind]())


def prints_schemas(verb: Callable[..., Any]) -> Callable[..., Any]:
    """The verb with ``--schema`` behind its own options, where it takes YAML files."""
    own = inspect.signature(verb)
    kinds = tuple(kind for option, kind in KINDS.items() if option in own.parameters)
    if verb.__name__ == "check":  # of any file
        kinds = tuple(KINDS.values())
    if not kinds:
        return verb

    def show(kind: str | None) -> None:
        if kind is None:
            return
        if kind not in kinds:
            raise typer.BadParameter(f"'{kind}': one of {', '.join(kinds)}")
        typer.echo(json.dumps(schema(kind), indent=1, ensure_ascii=False))
        raise typer.Exit

    @functools.wraps(verb)
    def command(*arguments: Any, schema: str | None = None, **values: Any) -> Any:
        return verb(*arguments, **values)

    option = typer.Option(
        None, OPTION, metavar="KIND", is_eager=True, callback=show, show_default=False,
        help=f"Print the JSON schema of a file ({', '.join(kinds)}) and end.",
    )  # fmt: skip
    kind = inspect.Parameter(
        "schema", inspect.Parameter.KEYWORD_ONLY, default=option, annotation=str | None
    )
    command.__signature__ = own.replace(  # type: ignore[attr-defined]
        parameters=[*own.parameters.values(), kind]
    )
    command.__annotations__ = {**verb.__annotations__, "schema": str | None}
    setattr(command, _KINDS, kinds)
    return command


def with_kind(app: typer.Typer, words: list[str]) -> list[str]:
    """``--schema`` without a kind: the first that the verb takes."""
    if OPTION not in words:
        return words
    place = words.index(OPTION) + 1
    if place < len(words) and not words[place].startswith("-"):
        return words
    kinds = next(_kinds(app, words), ())
    return [*words[:place], *kinds[:1], *words[place:]]


def _kinds(app: typer.Typer, words: list[str]) -> Iterator[tuple[str, ...]]:
    for verb in app.registered_commands:
        if verb.callback is not None and (verb.name or verb.callback.__name__) == words[0]:
            yield getattr(verb.callback, _KINDS, ())
    for group in app.registered_groups:
        if group.typer_instance is not None and _name(group) == words[0]:
            yield from _kinds(group.typer_instance, words[1:])


def _name(group: Any) -> str:
    return str(group.name if isinstance(group.name, str) else group.typer_instance.info.name)
