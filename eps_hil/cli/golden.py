"""``eps-hil golden``: estimates of a log kept, and compared with what comes out now."""

import os
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.cli._files import check_kept, write_json
from eps_hil.cli._first_answer import say_if_it_compiles
from eps_hil.cli._inputs import waiting
from eps_hil.cli._outputs import check_apart, named_in
from eps_hil.errors import EpsHilError, InputError

if TYPE_CHECKING:
    from eps_hil.oracle.golden import Diff, Estimates
    from eps_hil.oracle.golden_file import Golden

SCHEMA = "eps-hil/golden-check/1"

Tolerances = Annotated[
    list[str],
    typer.Option("--tolerance", help="NAME=VALUE in its unit, e.g. rack_force_estimate_n=5."),
]


class GoldenDiffersError(EpsHilError):
    """An estimate is not what it was."""


def register(app: typer.Typer) -> None:
    """Add the verb."""
    verb = typer.Typer(
        no_args_is_help=True, help="Keep the estimates of a log, and check them after a change."
    )
    verb.command("make")(make)
    verb.command("check")(check)
    app.add_typer(verb, name="golden")


def make(
    log: Annotated[Path, typer.Argument(help="CAN log.")],
    config: Annotated[Path, typer.Option("--config", help="Configuration of the service (YAML).")],
    out: Annotated[Path, typer.Option("--out", help="File to write: .csv or .csv.gz.")],
    tolerance: Tolerances = [],  # noqa: B006
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file.")] = False,
) -> None:
    """Run a log through the service's core and keep every estimate, with where it came from."""
    from eps_hil.cli._inputs import check_extras
    from eps_hil.oracle import golden as oracle
    from eps_hil.oracle.golden_file import Golden, write_golden

    check_extras([log])
    tolerances = oracle.parse_tolerances(tolerance, oracle.DEFAULT_TOLERANCES)
    if out.name.lower().removesuffix(".gz")[-4:] != ".csv":
        raise InputError(out, "--out", "is neither .csv nor .csv.gz", "name it so")
    if out.exists() and not overwrite:
        raise InputError(out, "--out", "exists already", "add --overwrite to replace it")
    check_kept((out,), (log, config))
    setup = oracle.load_pair(log, config)
    say_if_it_compiles()
    with waiting(f"playing {log.name} through the service"):
        estimates, own = oracle.run_core(log, setup, config)
    valid = int(estimates.valid.sum())
    if not valid:
        problem = f"gives no valid estimate ({estimates.t_ns.size} in all)"
        raise InputError(log, "", problem, "a golden without one would hold anything")
    provenance = oracle.Provenance(
        log=_from(out, log),
        config=_from(out, config),
        files=oracle.hashes(log, setup, config),
        version=oracle.code_version(),
        made=datetime.now(UTC).isoformat(timespec="seconds"),
        own_frames=own,
    )
    write_golden(out, Golden(provenance, tolerances, estimates))
    left_out = f"; {own} frames of the service itself left out" if own else ""
    typer.echo(f"{out}: {estimates.t_ns.size} estimates, {valid} valid{left_out}")


def check(
    goldens: Annotated[list[Path], typer.Argument(help="Files of golden make.")],
    tolerance: Tolerances = [],  # noqa: B006
    log: Annotated[
        Path | None, typer.Option("--log", help="The log, where it is elsewhere now.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="Another configuration than the golden's.")
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", help="All differences as JSON.")] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Golden and now, drawn (one golden).")
    ] = None,
) -> None:
    """Compare what the service makes of each log now with what is kept; status 1 if they differ.

    Status 2: a file is wrong or missing, or the log is not the one that the golden was made from.
    """
    from eps_hil.cli._inputs import check_extras
    from eps_hil.oracle.golden_file import read_golden

    check_extras([log])
    for option, value in (("--log", log), ("--figure", figure)):
        if value is not None and len(goldens) > 1:
            raise InputError(option, "", "goes with one golden", f"not with {len(goldens)}")
    check_kept((json, figure), (*goldens, log, config))
    if figure is not None:
        from eps_hil.report import figures

        figures.check(figure)
    read = [read_golden(path) for path in goldens]  # every file before any work
    for path, golden in zip(goldens, read, strict=True):
        made_from = path.parent / golden.provenance.config
        check_apart(
            (json, figure), (path.parent / golden.provenance.log, made_from, *named_in(made_from))
        )
    found: list[dict[str, Any]] = []
    bad = []
    for path, golden in zip(goldens, read, strict=True):
        diff, now, tolerances, changed = _against(path, golden, tolerance, log, config)
        _say(path, diff, golden, changed)
        found.append({"golden": str(path), "good": diff.good, "changed": changed, **asdict(diff)})
        if not diff.good:
            bad.append(path)
        if figure is not None:
            from eps_hil.oracle.golden_figure import draw

            draw(golden.estimates, now, tolerances["rack_force_estimate_n"], figure)
    if json is not None:
        write_json(json, {"schema": SCHEMA, "goldens": found})
    if bad:
        raise GoldenDiffersError(
            f"{len(bad)} of {len(goldens)} golden replays differ: {', '.join(map(str, bad))}"
        )


def _against(
    path: Path, golden: "Golden", words: list[str], log: Path | None, config: Path | None
) -> "tuple[Diff, Estimates, dict[str, float], list[str]]":
    """What differs now, and which files have changed since it was made."""
    from eps_hil.oracle import golden as oracle

    kept = golden.provenance
    log = log or path.parent / kept.log
    config = config or path.parent / kept.config
    tolerances = oracle.parse_tolerances(words, golden.tolerances)
    setup = oracle.load_pair(log, config)
    hashes = oracle.hashes(log, setup, config)
    if hashes["log"] != kept.files.get("log"):
        problem = f"is not the log that {path} was made from"
        raise InputError(log, "", problem, "find that log, or make the golden anew")
    changed = [
        role for role in {**kept.files, **hashes} if hashes.get(role) != kept.files.get(role)
    ]
    say_if_it_compiles()
    with waiting(f"playing {log.name} through the service"):
        now, _ = oracle.run_core(log, setup, config)
    return oracle.compare(golden.estimates, now, tolerances), now, tolerances, changed


def _say(path: Path, diff: "Diff", golden: "Golden", changed: list[str]) -> None:
    from rich.console import Console
    from rich.table import Table

    kept = golden.provenance
    typer.echo(f"{path}: {'within tolerance' if diff.good else 'DIFFERS'}")
    typer.echo(
        f"  {diff.rows} estimates kept ({kept.made}, eps_hil {kept.version}), "
        f"{diff.both_valid} valid then and now"
    )
    if changed:
        typer.echo(f"  changed since then: {', '.join(changed)}")
    if diff.good:
        return
    table = Table(box=None, title_justify="left")
    for heading in ("", "tolerance", "beyond it", "first", "then -> now", "worst", "at", "rms"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for one in diff.signals:
        first = "" if one.first_s is None else f"{one.first_s:.3f} s"
        values = "" if one.first is None else f"{one.first[0]:.6g} -> {one.first[1]:.6g}"
        table.add_row(
            one.signal, f"{one.tolerance:g}", f"{one.beyond} of {one.rows}", first, values,
            f"{one.worst:.4g}", f"{one.worst_s:.3f} s", f"{one.rms:.4g}",
        )  # fmt: skip
    Console(width=140, highlight=False).print(table)
    _say_reason(diff)


def _say_reason(diff: "Diff") -> None:
    from eps_hil.estimation.validity import Reason, words

    reason = diff.reason
    if not diff.both_valid:
        typer.echo("  no estimate is valid both then and now: nothing was compared")
    if reason.differ and reason.first is not None:
        was, now = (words(Reason(each)) for each in reason.first)
        where = f"first at {reason.first_s:.3f} s: {was} -> {now}"
        typer.echo(f"  reason: {reason.differ} rows differ, {where}")
    if reason.only_golden or reason.only_now:
        typer.echo(f"  rows: {reason.only_golden} only then, {reason.only_now} only now")


def _from(out: Path, path: Path) -> str:
    """As seen from the golden's folder, so that both can move together."""
    return os.path.relpath(path.resolve(), out.resolve().parent)
