"""``eps-hil check``: what is missing, contradictory or dangerous in files, before their use."""

from pathlib import Path
from typing import Annotated

import typer

from eps_hil.cli._files import check_kept, write_json


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("check")(check)


def check(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FILE...", help="Configuration, mapping, model, … or CAN database."),
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", help="The remarks as JSON.")] = None,
) -> None:
    """Say what is missing, contradictory or dangerous in files, before the first frame.

    A configuration is checked with the model, mapping and database that it names, by the code that
    will run them, units and counters of the database included. Opens no bus. Status 2: an error.
    """
    if not files:
        raise typer.BadParameter("a file is needed", param_hint="'FILE'")
    from eps_hil.check.check import check as checked

    check_kept((json,), files)
    found = [checked(path) for path in files]
    for each in found:
        errors = sum(one.level.value == "error" for one in each.remarks)
        warnings = sum(one.level.value == "warning" for one in each.remarks)
        typer.echo(f"{each.path} ({each.kind.value}): {errors} errors, {warnings} warnings")
        for remark in each.remarks:
            typer.echo(f"  {remark}")
    if json:
        content = [
            {
                "file": str(each.path),
                "kind": each.kind.value,
                "remarks": [
                    {"level": r.level.value, "place": r.place, "text": r.text, "remedy": r.remedy}
                    for r in each.remarks
                ],
            }
            for each in found
        ]
        write_json(json, {"schema": "eps-hil/check/1", "files": content})
    wrong = [each for each in found if not each.good]
    if wrong:
        first = next(one for one in wrong[0].remarks if one.level.value == "error")
        named = str(wrong[0].path) in str(first)
        typer.echo(str(first) if named else f"{wrong[0].path}: {first}", err=True)
        raise typer.Exit(2)
