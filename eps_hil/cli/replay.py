"""``eps-hil replay``: a CAN log onto a bus, at its own pace."""

import contextlib
import gc
import os
import sys
from pathlib import Path

import typer

_REALTIME_PACE_MAX = 2.0  # faster, and a replay might not sleep enough to be let ahead of others


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("replay")(replay)


def replay(
    log: Path = typer.Argument(..., help="CAN log: .log (candump), .blf, .asc, .trc, .mf4, ..."),
    interface: str = typer.Option(None, help="socketcan, udp_multicast or any of python-can's."),
    channel: str = typer.Option(None, help="Such as vcan0, or 239.74.163.2."),
    speed: str = typer.Option("1.0", help="Multiple of the log's pace, or max (no waiting)."),
    loop: bool = typer.Option(False, "--loop", help="Play it over and over, until stopped."),
    ids: list[str] = typer.Option([], help="Only these ids, e.g. 0x76,118."),
    config: Path = typer.Option(None, help="Take the bus from this configuration file."),
    option: list[str] = typer.Option([], help="KEY=VALUE for the interface, e.g. port=43113."),
    fd: bool = typer.Option(False, "--fd", help="Open the bus for CAN FD."),
) -> None:
    """Play a CAN log onto a bus with the spacing of its stamps, and say how late it was."""
    from eps_hil.bus import replay as player
    from eps_hil.cli._bus_options import open_bus, stop_on_signals

    pace = player.parse_speed(speed)
    wanted = player.parse_ids(ids) or None
    next(player.read_log(log))  # a bad log is the user's first news, before any bus is touched
    port, _ = open_bus(
        config,
        interface,
        channel,
        option,
        fd,
        receive_ids=(),
        send_ids=sorted(wanted or ()) or None,
    )
    stop = stop_on_signals()
    typer.echo(f"replaying {log} on {port.name} at {speed} x; Ctrl-C stops", err=True)
    live = sys.stderr.isatty()
    if pace is not None and pace <= _REALTIME_PACE_MAX:
        _ask_for_priority()
    try:
        frames = player.again(lambda: player.read_log(log)) if loop else player.read_log(log)
        report = player.replay(
            frames,
            port,
            speed=pace,
            ids=wanted,
            stop=stop,
            progress=(lambda n: typer.echo(f"\r{n} frames", nl=False, err=True)) if live else None,
        )
    finally:
        port.close()
    if live:
        typer.echo("\r", nl=False, err=True)
    _say(report, pace)


def _ask_for_priority() -> None:
    """Real-time scheduling where we may have it (root, CAP_SYS_NICE), else as we are.

    A replay sleeps nearly always, so it takes nothing from anybody; without this, other work on
    the machine makes single frames several milliseconds late.
    """
    gc.freeze()
    with contextlib.suppress(AttributeError, OSError):  # not Linux, or not allowed
        lowest = os.sched_param(os.sched_get_priority_min(os.SCHED_FIFO))
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, lowest)


def _say(report: object, pace: float | None) -> None:
    from eps_hil.bus.replay import ReplayReport

    assert isinstance(report, ReplayReport)
    typer.echo(
        f"{'stopped: ' if report.stopped else ''}sent {report.sent} frames of {report.log_s:.3f} s "
        f"in {report.wall_s:.3f} s; dropped by a full bus {report.dropped}, "
        f"not played {report.skipped}"
    )
    if pace is not None:
        p50, p99, worst = (
            t / 1e6 for t in (report.late_p50_ns, report.late_p99_ns, report.late_max_ns)
        )
        typer.echo(f"lateness: p50 {p50:.3f} ms, p99 {p99:.3f} ms, max {worst:.3f} ms")
