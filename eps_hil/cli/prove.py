"""``eps-hil prove``: the proofs that anybody can run again (CONTRACT 6)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from eps_hil.cli._files import check_kept, write_json
from eps_hil.cli._first_answer import say_if_it_compiles, say_if_others_compile
from eps_hil.cli._inputs import progress, waiting
from eps_hil.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the verb and its proofs."""
    group = typer.Typer(no_args_is_help=True, help="Run a proof of the diagnosis again.")
    group.command("concealed")(concealed)
    group.command("changes")(changes)
    group.command("loop")(loop)
    group.command("emps")(emps)
    app.add_typer(group, name="prove")


def concealed(
    seed: Annotated[int, typer.Option("--seed", min=1, max=998, help="Which cases are drawn.")] = 1,
    quick: Annotated[
        bool, typer.Option("--quick", help="A few development cases in minutes, for CI.")
    ] = False,
    json: Annotated[Path | None, typer.Option("--json", help="The figures as JSON.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for page, pictures and all cases.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with what --out holds of an interrupted run.")
    ] = False,
    jobs: Annotated[
        int | None, typer.Option("--jobs", min=1, help="Cases at once (default: all cores).")
    ] = None,
    cases: Annotated[
        int | None, typer.Option("--cases", min=1, help="Only so many: a fair sample of all.")
    ] = None,
    development: Annotated[
        bool, typer.Option("--development", help="Seeds that the method may be improved on.")
    ] = False,
    kind: Annotated[
        list[str] | None, typer.Option("--kind", help="Only cases of this kind; repeat for more.")
    ] = None,
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep all recordings and pages (10 MB a case).")
    ] = False,
) -> None:
    """Hide physics, seal the answers, have it diagnosed by a process that is not told, and judge.

    Without --quick it takes hours and may be interrupted at any time. --quick and --development
    draw from seeds on which the method may be improved; a proof draws from others.
    """
    import os

    from eps_hil.oracle.closed_loop import closed_loop
    from eps_hil.proof.plans import MIX, QUICK
    from eps_hil.proof.run import Desk, Setting, run
    from eps_hil.report import page, proof_page

    page.check("prove", "matplotlib")
    known = QUICK if quick else MIX
    for one in kind or ():
        if one not in known:
            raise InputError("--kind", one, "is no kind of a proof", f"use {', '.join(known)}")
    most, kinds = cases or sum(MIX.values()), tuple(dict.fromkeys(kind or ()))
    setting = Setting(seed, quick, not (quick or development), most, kinds)
    folder = out or Path(f"concealed{'_quick' if quick else ''}_{seed}")
    _check_place(json, folder)
    say_if_others_compile("problem")
    with progress("proving") as bar:
        desk = Desk(
            closed_loop,
            jobs or os.cpu_count() or 1,
            keep=keep,
            say=typer.echo,
            part=bar or (lambda _part: None),
        )
        lines = run(folder, setting, desk, resume=resume)
    content = proof_page.write(folder, setting, lines)
    typer.echo(content["table"])
    typer.echo(content["details"])
    typer.echo(f"page written to {folder / proof_page.PAGE}")
    if json:
        write_json(json, content["result"])


def changes(
    seed: Annotated[int, typer.Option("--seed", min=1, max=998, help="Which cases are drawn.")] = 1,
    cases: Annotated[int, typer.Option("--cases", min=1, help="How many; half hold a change.")] = 8,
    json: Annotated[Path | None, typer.Option("--json", help="The figures as JSON.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for all cases; goes on with its own.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", min=1, help="Cases at once (default: all cores).")
    ] = None,
    development: Annotated[
        bool, typer.Option("--development", help="Seeds that the method may be improved on.")
    ] = False,
) -> None:
    """Hide what differs between two states of one rig, and have eps-hil changes find it.

    Half of the cases hold a change at 0.6 of the sensor noise, half none; in half of both the two
    states share an effect without a name. Answers are sealed before anything is asked.
    """
    import os

    from eps_hil.proof.changed import Desk, prove_changes

    folder = out or Path(f"changes_{seed}")
    _check_place(json, folder)
    say_if_others_compile("problem")
    with progress("proving") as bar:
        desk = Desk(jobs or os.cpu_count() or 1, typer.echo, bar or (lambda _part: None))
        content = prove_changes(folder, seed, cases, desk, proof=not development)
    if json:
        write_json(json, content)


def loop(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="CAN log of the rig, with its load cell.")
    ],
    config: Annotated[Path, typer.Option("--config", help="Configuration of the service (YAML).")],
    better: Annotated[
        list[Path],
        typer.Option("--with", help="Model that diagnose wrote (--write-model); may repeat."),
    ],
    json: Annotated[Path | None, typer.Option("--json", help="The errors as JSON.")] = None,
) -> None:
    """The loop closed on the bus: what the service publishes, with its model and with better ones.

    Replays the log in lock-step through the service, without a bus and without waiting, decodes the
    frames that it sends, and compares them with the load cell.
    """
    from eps_hil.oracle.lock_step import compare
    from eps_hil.service.config import load_config

    check_kept((json,), (log, config, *better))
    chosen = load_config(config)
    models = {str(path): path for path in (chosen.model, *better)}
    say_if_it_compiles()
    with waiting(f"playing {log.name} through the service"):
        errors = compare(log, chosen, config, models)
    typer.echo(f"{log.name}: error of the published rack force, N rms against the load cell")
    typer.echo(f"  {'moving':>8}{'overall':>9}  model")
    for name, one in errors.items():
        typer.echo(f"  {one.rmse_moving_n:8.2f}{one.rmse_overall_n:9.2f}  {name}")
    if json:
        content = [
            {
                "model": name,
                "rmse_moving_n": one.rmse_moving_n,
                "rmse_overall_n": one.rmse_overall_n,
                "rows": one.rows,
            }
            for name, one in errors.items()
        ]
        write_json(json, {"schema": "eps-hil/proof-loop/1", "log": str(log), "models": content})


def emps(
    data_dir: Annotated[
        Path,
        typer.Argument(
            metavar="DATA_DIR", help="Folder with DATA_EMPS.mat and DATA_EMPS_PULSES.mat."
        ),
    ],
    json: Annotated[Path | None, typer.Option("--json", help="The result as JSON.")] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Before and after (.png, .svg, .pdf).")
    ] = None,
    traces: Annotated[
        Path | None,
        typer.Option("--traces", help="Folder for free_run.csv (time_s, position_m): score it."),
    ] = None,
) -> None:
    """Real hardware, a ball-screw axis: find what its published model lacks, judge it on new data.

    Everything is fitted on DATA_EMPS. In DATA_EMPS_PULSES a square wave of force is withheld, is
    estimated as the rack force is, and is opened at the end.
    """
    from eps_hil.axis.emps import FITTED, HELD_OUT, read
    from eps_hil.axis.proof import prove
    from eps_hil.recordings.files import make_folder
    from eps_hil.report import figures

    fitted, heldout = read(data_dir)
    if traces:
        make_folder(traces, "--traces")
    check_kept((json, figure), (data_dir / FITTED, data_dir / HELD_OUT))
    if figure:
        figures.check(figure)
    say_if_it_compiles()
    with progress("proving") as bar:
        proof = prove(fitted, heldout, (lambda _what, part: bar(part)) if bar else None)
    _say(proof.content)
    if json:
        write_json(json, proof.content)
    if traces:
        from eps_hil.axis.free_run import write

        typer.echo(f"free run written to {write(traces, heldout, proof.run)}")
    if figure:
        from eps_hil.axis.figure import draw

        typer.echo(f"figure written to {draw(proof, figure)}")


def _check_place(json: Path | None, folder: Path) -> None:
    """Refuse before hours of work a file that cannot be written; ``folder`` is made by then."""
    if json and folder.resolve() not in json.resolve().parents:
        check_kept((json,), ())


_ROWS = (
    ("heldout_force_error_percent", "held-out force error, %"),
    ("hidden_force_rmse_n", "hidden force, RMSE in N"),
    ("hidden_force_without_drive_delay_rmse_n", "  if it is taken not to be late, N"),
    ("hidden_force_plateau_rmse_n", "  between its edges, N"),
    ("online_hidden_force_rmse_n", "on-line estimator, RMSE in N"),
    ("online_hidden_force_plateau_rmse_n", "  between its edges, N"),
    ("free_run_position_rmse_mm", "free run, position, RMSE in mm"),
)


def _say(content: Mapping[str, Any]) -> None:
    typer.echo(
        f"On DATA_EMPS_PULSES, of which only the ripple's phase is known, below "
        f"{content['band_hz']:g} Hz:"
    )
    typer.echo(f"  {'':34}{'published':>11}{'identified':>12}{'augmented':>11}")
    for name, words in _ROWS:
        row = content[name]
        typer.echo(
            f"  {words:34}{row['before']:11.2f}{row['identified_only']:12.2f}{row['after']:11.2f}"
        )
    more = content["friction_more_than_modelled_n"]["held_out"]
    typer.echo(
        f"    with the friction that it has more of ({more['forward']:.2f} N forward, "
        f"{more['backward']:.2f} N backward): "
        f"{content['free_run_position_rmse_mm']['after_with_its_own_friction']:.2f}"
    )
    run = content["free_run_position_rmse_mm"]
    typer.echo(f"    with 1 N more than that: {run['with_1_n_more_than_its_own']:.2f}")
    typer.echo(f"    DATA_EMPS' positions as the answer: {run['fitted_record_replayed']:.2f}")
    course = content["friction_more_than_modelled_by_quarter_n"]
    typer.echo("  friction more than modelled, quarter by quarter, N forward / backward:")
    for record, name in (("fitted", "DATA_EMPS"), ("held_out", "DATA_EMPS_PULSES")):
        parts = (f"{one['forward']:5.2f} /{one['backward']:5.2f}" for one in course[record])
        typer.echo(f"    {name:18}{'   '.join(parts)}")
    numbers = content["parameters"]
    typer.echo("The model's own numbers, from DATA_EMPS:")
    for name in numbers["published"]:
        typer.echo(
            f"  {name:34}{numbers['published'][name]:11.5g}{numbers['identified'][name]:12.5g}"
            f"{numbers['augmented'][name]:11.5g}"
        )
    typer.echo("What that structure lacks, and the two figures without it:")
    for finding in content["findings"]:
        without = finding["heldout_without_it"]
        typer.echo(
            f"  {finding['effect']}: {finding['summary']} "
            f"({without['heldout_force_error_percent']:.2f} %, "
            f"{without['hidden_force_rmse_n']:.2f} N)"
        )
