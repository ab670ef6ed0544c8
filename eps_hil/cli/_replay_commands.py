"""``eps-hil replay --commands``: the torques of a log, asked for again through the guard."""

import sys
from pathlib import Path
from typing import Any

import typer

from eps_hil.cli._lines import Lines
from eps_hil.errors import EpsHilError, InputError, SafetyStop


def play_commands(
    log: Path, channel: str | None, config: Path | None, journal_file: Path,
    window: tuple[float, float | None], *, alone: bool,
) -> None:  # fmt: skip
    """One override session whose source is the log (of several channels: ``channel``).

    :class:`SafetyStop` if the guard ended it.
    """
    import asyncio

    from eps_hil.bus.replay import offsets, read_log
    from eps_hil.bus.replay_choice import between
    from eps_hil.service.command_replay import CommandReplay, read_commands
    from eps_hil.service.config import load_config
    from eps_hil.service.journal import Journal
    from eps_hil.service.operator import HINT, Operator, Unattended, terminal_operator
    from eps_hil.service.override_session import OverrideSession
    from eps_hil.service.override_setup import prepare_override

    if config is None:
        raise InputError(
            "--commands", "", "needs --config with an override: block",
            "no torque is commanded without the guard: docs/safety.md",
        )  # fmt: skip
    setup = load_config(config)
    parts = prepare_override(setup, config)
    commands = read_commands(between(offsets(read_log(log, channel)), *window), parts, log)
    source = CommandReplay(commands)
    for line in _plan(parts, commands, log):
        typer.echo(line)
    operator: Operator = Unattended() if alone else terminal_operator()
    typer.echo("operator   none: unattended" if alone else f"operator   {HINT}")
    parts.estimator.warm_up()
    journal, lines = Journal(journal_file), Lines(live=sys.stderr.isatty())
    session = OverrideSession(
        parts, source, operator, lines.say, over=lambda: source.over,
        show=lambda core: lines.show(_progress(core, source)), journal=journal, silence_s=10.0,
    )  # fmt: skip
    try:
        asyncio.run(session.run())
    finally:
        journal.close()
        lines.end()
    if session.fault is not None:
        raise SafetyStop(f"the torque guard ended the run: {session.fault.why}")
    if not session.core.syncs:
        raise EpsHilError("no sync frame was received: is the rig on this bus?")
    _say_done(source)


def _say_done(source: Any) -> None:
    """How much was asked for; :class:`EpsHilError` where that is not the whole log."""
    asked, whole = source.done
    if not source.over:
        raise EpsHilError(f"stopped: asked for {asked} of {whole} commands")
    typer.echo(f"asked for {asked} of {whole} commands")


def _plan(parts: Any, commands: Any, log: Path) -> list[str]:
    most = max(abs(each.torque_nm) for each in commands if each.torque_nm is not None)
    ids = ", ".join(f"0x{can_id:X}" for can_id in parts.send_ids)
    return [
        f"bus        {parts.config.bus}",
        f"plan       the torques of {log}: {len(commands)} commands over "
        f"{commands[-1].t_ns * 1e-9:.1f} s, {most:g} Nm at most; the guard ends it beyond "
        f"{parts.override.limits.max_torque_nm:g} Nm",
        f"send       {ids}: frames of this session; nothing of the log itself",
    ]


def _progress(core: Any, source: Any) -> str:
    asked, whole = source.done
    return f"{core.state.name.lower()}  {core.command.torque_nm:+.3f} Nm  {asked}/{whole}"
