"""``eps-hil replay``: a CAN log onto a bus, at its own pace, without the commands it holds."""

import contextlib
import gc
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.bus.live_senders import LISTEN_S
from eps_hil.errors import InputError

if TYPE_CHECKING:
    from eps_hil.bus.commands import Commands
    from eps_hil.bus.frame import Frame
    from eps_hil.bus.live_senders import LiveSenders
    from eps_hil.bus.port import Port
    from eps_hil.bus.replay import ReplayReport
    from eps_hil.bus.replay_choice import Choice
    from eps_hil.bus.replay_controls import ReplayControls

_REALTIME_PACE_MAX = 2.0  # faster, and a replay might not sleep enough to be let ahead of others
_TRIP_HELP = "Play the torque commands of the log through the guard; the motor moves."


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("replay")(replay)


def replay(
    log: Annotated[Path, typer.Argument(help="CAN log: .log (candump), .blf, .asc, .trc, .mf4.")],
    interface: Annotated[str, typer.Option(help="socketcan, udp_multicast or python-can's.")] = "",
    channel: Annotated[str, typer.Option(help="Such as vcan0, or 239.74.163.2.")] = "",
    speed: Annotated[str, typer.Option(help="Multiple of the log's pace, or max.")] = "1.0",
    loop: Annotated[bool, typer.Option("--loop", help="Over and over, until stopped.")] = False,
    ids: Annotated[list[str], typer.Option(help="Only these ids, e.g. 0x76,118.")] = [],  # noqa: B006
    without: Annotated[list[str], typer.Option(help="Not these ids.")] = [],  # noqa: B006
    from_s: Annotated[
        float, typer.Option("--from", min=0.0, help="Begin so many seconds into the log.")
    ] = 0.0,
    to_s: Annotated[
        float | None, typer.Option("--to", min=0.0, help="End so many seconds into the log.")
    ] = None,
    log_channel: Annotated[
        str | None, typer.Option("--log-channel", help="Only this channel of a log of several.")
    ] = None,
    paused: Annotated[bool, typer.Option("--paused", help="Begin paused.")] = False,
    listen: Annotated[
        float, typer.Option(min=0.1, help="Seconds to listen for live senders before sending.")
    ] = LISTEN_S,
    config: Annotated[
        Path | None, typer.Option(help="Bus, and which messages are commands, from this file.")
    ] = None,
    dbc: Annotated[
        list[Path], typer.Option("--dbc", help="Says which messages of the log are commands.")
    ] = [],  # noqa: B006
    option: Annotated[list[str], typer.Option(help="KEY=VALUE for the interface.")] = [],  # noqa: B006
    fd: Annotated[bool, typer.Option("--fd", help="Open the bus for CAN FD.")] = False,
    commands: Annotated[bool, typer.Option("--commands", help=_TRIP_HELP)] = False,
    journal: Annotated[
        Path, typer.Option("--journal", help="With --commands: every transition goes here.")
    ] = Path("override-journal.jsonl"),
    yes_i_stand_clear: Annotated[
        bool, typer.Option("--yes-i-stand-clear", help="With --commands: no dead-man key.")
    ] = False,
) -> None:
    """Play a CAN log onto a bus with the spacing of its stamps, and say how late it was.

    Commands (of a torque, of a rig's set-points) are never played. Nothing is sent on an id that
    a live sender uses. In a terminal: space pauses, n sends the next frame, q ends; without one:
    SIGUSR1 and SIGUSR2.
    """
    from eps_hil.bus import replay as player
    from eps_hil.bus.replay_choice import Choice, refuse_asked
    from eps_hil.bus.replay_controls import ReplayControls
    from eps_hil.cli._bus_options import choose_bus, open_bus
    from eps_hil.cli._inputs import check_extras

    check_extras([log])
    pace = player.parse_speed(speed)
    wanted, unwanted = player.parse_ids(ids) or None, player.parse_ids(without, "--without")
    if to_s is not None and to_s <= from_s:
        raise InputError("--to", f"{to_s:g}", "is not after --from", "seconds into the log")
    if commands:
        _refuse_beside_commands(
            speed=pace != 1.0, loop=loop, ids=ids, without=without, paused=paused,
            listen=listen != LISTEN_S, interface=interface, channel=channel, option=option, fd=fd,
            dbc=dbc,
        )  # fmt: skip
        from eps_hil.cli._replay_commands import play_commands

        window = from_s, to_s
        play_commands(log, log_channel, config, journal, window, alone=yes_i_stand_clear)
        return
    controls = ReplayControls()
    controls.paused = paused
    controls.hear_signals()  # a long log takes a while before its first frame
    never = _commands(config, dbc)
    refuse_asked(wanted or (), never)
    frames = _frames(log, log_channel, from_s, to_s)
    port = open_bus(
        choose_bus(config, interface or None, channel or None, option, fd),
        send_ids=sorted(wanted or ()) or None,
        never_send_ids=tuple(never),
    )
    choice = Choice(wanted, unwanted, never)
    try:
        live = _look_first(frames(), port, Choice(wanted, unwanted, never), listen, log)
        report = _play(frames, port, pace, choice, live, controls, loop=loop)
    finally:
        port.close()
    _say(report, choice, pace)


def _frames(
    log: Path, channel: str | None, from_s: float, to_s: float | None
) -> "Callable[[], Iterator[Frame]]":
    """The part of the log that is played, as often as wanted; a bad log is the user's first news,
    before any bus is touched."""
    from eps_hil.bus.replay import offsets, read_log
    from eps_hil.bus.replay_choice import between

    def frames() -> "Iterator[Frame]":
        return between(offsets(read_log(log, channel)), from_s, to_s)

    next(read_log(log, channel))
    if next(frames(), None) is None:
        raise InputError("--from", f"{from_s:g}", "is after the end of the log", "begin earlier")
    return frames


def _look_first(
    frames: "Iterable[Frame]", port: "Port", choice: "Choice", listen_s: float, log: Path
) -> "LiveSenders":
    """Say what will be left out, and refuse to talk over anybody."""
    from eps_hil.bus.live_senders import LiveSenders
    from eps_hil.bus.replay_choice import scan

    opened_s = time.monotonic()
    seen = scan(frames, choice)
    part = "" if seen.whole else f" (in its first {seen.frames} frames)"
    if left_out := seen.choice.left_out():
        typer.echo(f"commands are left out{part}: {left_out}", err=True)
    typer.echo(f"replaying {log} on {port.name}", err=True)
    live = LiveSenders(port, seen.keys, lambda ids: f"leave them out with --without {ids}")
    live.listen(opened_s + listen_s - time.monotonic())
    return live


def _play(
    frames: "Callable[[], Iterator[Frame]]",
    port: "Port",
    pace: float | None,
    choice: "Choice",
    live: "LiveSenders",
    controls: "ReplayControls",
    *,
    loop: bool,
) -> "ReplayReport":
    from eps_hil.bus import replay as player
    from eps_hil.bus.replay_controls import HINT
    from eps_hil.cli._bus_options import stop_on_signals

    stop = stop_on_signals()
    if pace is not None and pace <= _REALTIME_PACE_MAX:
        _ask_for_priority()
    with controls.open() as keys:
        typer.echo(HINT if keys else "Ctrl-C stops", err=True)
        return player.replay(
            player.again(frames) if loop else frames(),
            port,
            speed=pace,
            choice=choice,
            stop=stop,
            progress=_progress(),
            live=live,
            controls=controls,
            on_step=_say_step,
        )


def _refuse_beside_commands(**given: object) -> None:
    for name, value in given.items():
        if value:
            raise InputError(
                f"--{name}", "", "does not go with --commands",
                "the torques are asked for once, at their own pace, on the configuration's bus",
            )  # fmt: skip


def _commands(config: Path | None, dbc: list[Path]) -> "Commands":
    """What stays out, by the databases of ``--dbc`` and of the configuration together."""
    from eps_hil.bus.commands import load_commands, of_replay

    known, names, marked = ([], [], ()) if config is None else _configured(config)
    if dbc:
        known.append(load_commands(dbc, None, names, marked))
    if config is not None:
        _refuse_unknown(names, known, config)
    return of_replay(*known)


def _configured(config: Path) -> "tuple[list[tuple[Any, Commands]], list[str], tuple[str, ...]]":
    """Of a configuration: database and commands (where it has one), the message of its override,
    and the messages that its mapping calls commands."""
    from eps_hil.bus.commands import TORQUE_MESSAGE, load_commands
    from eps_hil.bus.config import block, load_bus_setup, resolved
    from eps_hil.bus.mapping import load_mapping
    from eps_hil.yaml_file import read

    content = read(config)
    override = block(config, "override")
    names = [str(override.get("command_message", TORQUE_MESSAGE))] if override else []
    signals = content.get("signals") if isinstance(content, dict) else None
    marked = load_mapping(resolved(config, str(signals))).commands if signals else ()
    if not (isinstance(content, dict) and "dbc" in content):
        return [], names, marked
    setup = load_bus_setup(config)
    return [load_commands(setup.dbc, setup.signals, names)], names, marked


def _refuse_unknown(names: list[str], known: "list[tuple[Any, Commands]]", config: Path) -> None:
    """A command that no database knows could not be told from any other frame of the log."""
    from eps_hil.bus.commands import OWN

    found = [certain for _, certain in known] or [OWN]
    told = {command.name for certain in found for command in certain.values()}
    for name in names:
        if name not in told:
            raise InputError(
                config, "override.command_message", f"no database has a message {name}",
                "name the bench's database with --dbc: its commands must stay out",
            )  # fmt: skip


def _progress() -> "Callable[[int], None] | None":
    if not sys.stderr.isatty():
        return None
    return lambda n: typer.echo(f"\r{n} frames", nl=False, err=True)


def _say_step(offset_ns: int, frame: "Frame") -> None:
    digits = 8 if frame.extended else 3
    said = f"{offset_ns * 1e-9:.6f} s  {frame.can_id:0{digits}X}#{frame.data.hex().upper()}"
    typer.echo(f"\r{said}", err=True)


def _ask_for_priority() -> None:
    """Real-time scheduling where we may have it (root, CAP_SYS_NICE), else as we are.

    A replay sleeps nearly always, so it takes nothing from anybody; without this, other work on
    the machine makes single frames several milliseconds late.
    """
    gc.freeze()
    with contextlib.suppress(AttributeError, OSError):  # not Linux, or not allowed
        lowest = os.sched_param(os.sched_get_priority_min(os.SCHED_FIFO))
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, lowest)


def _say(report: "ReplayReport", choice: "Choice", pace: float | None) -> None:
    if sys.stderr.isatty():
        typer.echo("\r", nl=False, err=True)
    typer.echo(
        f"{'stopped: ' if report.stopped else ''}sent {report.sent} frames of {report.log_s:.3f} s "
        f"in {report.wall_s:.3f} s; dropped by a full bus {report.dropped}, "
        f"not played {report.skipped}"
    )
    typer.echo(f"commands left out: {choice.left_out() or 'none in what was played'}")
    if pace is not None:
        p50, p99, worst = (
            t / 1e6 for t in (report.late_p50_ns, report.late_p99_ns, report.late_max_ns)
        )
        typer.echo(f"lateness: p50 {p50:.3f} ms, p99 {p99:.3f} ms, max {worst:.3f} ms")
