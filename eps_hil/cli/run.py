"""``eps-hil run``: the service on a bus (CONTRACT 6)."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from eps_hil.cli._lines import Lines


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("run")(run)


def run(
    config: Annotated[
        list[Path] | None,
        typer.Option(
            "--config", help="Configuration of the service (YAML); several: a process for each."
        ),
    ] = None,
    duration: Annotated[
        float | None, typer.Option("--duration", min=0.0, help="End after so many seconds.")
    ] = None,
    status_line: Annotated[
        bool | None,
        typer.Option("--status-line/--no-status-line", help="A live line (default: on a terminal)"),
    ] = None,
    log_estimates: Annotated[
        Path | None, typer.Option("--log-estimates", help="Write every estimate to this CSV file.")
    ] = None,
    journal: Annotated[
        Path, typer.Option("--journal", help="Changes of friction levels are appended here.")
    ] = Path("friction-journal.jsonl"),
) -> None:
    """Estimate the rack force live on a CAN bus and publish it there.

    Says at start what it listens to and what it will send; ends on Ctrl-C or SIGTERM with a
    last frame of status "off" and a summary. SIGUSR1: friction levels anew from the model file.
    """
    if not config:
        raise typer.BadParameter("a configuration file is needed", param_hint="'--config'")
    if len(config) > 1:
        from eps_hil.cli._several import run_several

        status = run_several(config, duration, log_estimates, journal, Lines().say)
        if status:
            raise typer.Exit(status)
        return
    _run(config[0], duration, _wanted(status_line), log_estimates, journal)


def _run(
    config: Path,
    duration: float | None,
    live: bool,
    log_path: Path | None,
    journal: Path,
) -> None:
    import asyncio

    from eps_hil.board import Notice
    from eps_hil.bus.eager_loop import EagerLoop
    from eps_hil.cli._first_answer import say_if_it_compiles
    from eps_hil.service.config import load_config
    from eps_hil.service.estimate_log import EstimateLog
    from eps_hil.service.level_updates import LevelUpdates
    from eps_hil.service.loop import Service
    from eps_hil.service.setup import describe, prepare
    from eps_hil.service.systemd import Notifier

    say_if_it_compiles()
    parts, lines = prepare(load_config(config), config), Lines(live=live)
    for line in describe(parts):
        lines.say(line)
    levels = LevelUpdates(parts, lines.say, journal)
    lines.say(levels.hint())
    log = EstimateLog(log_path, lines.say) if log_path else None
    notice = Notice("service", str(parts.config.bus), "service")
    notice.put(text="loads its code (the first time it is compiled, which takes minutes)")
    parts.warm_up()
    notice.end()
    service = Service(
        parts,
        lines.say,
        show=(lambda snapshot: lines.show(snapshot.line())) if live else None,
        log=log,
        levels=levels,
        notifier=Notifier(),
    )
    try:
        with asyncio.Runner(loop_factory=EagerLoop) as runner:
            runner.run(service.run(duration))
    finally:
        if log is not None:
            log.close()
        for line in service.summary().lines() if service.ready else []:
            lines.say(line)
        lines.end()


def _wanted(line: bool | None) -> bool:
    """Whether there is a live line; by itself on a terminal."""
    return sys.stderr.isatty() if line is None else line
