"""``eps-hil record``: everything on a bus into a log file, in a process of its own."""

import sys
from pathlib import Path

import typer


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("record")(record)


def record(
    out: Path = typer.Argument(..., help="File to write: .log (candump) or .blf."),
    interface: str = typer.Option(None, help="socketcan, udp_multicast or any of python-can's."),
    channel: str = typer.Option(None, help="Such as vcan0, or 239.74.163.2."),
    duration: float = typer.Option(None, min=0.0, help="Stop after so many seconds."),
    config: Path = typer.Option(None, help="Take the bus from this configuration file."),
    option: list[str] = typer.Option([], help="KEY=VALUE for the interface, e.g. port=43113."),
    fd: bool = typer.Option(False, "--fd", help="Open the bus for CAN FD."),
    overwrite: bool = typer.Option(False, "--overwrite", help="Replace the file if it exists."),
) -> None:
    """Record a bus until Ctrl-C (or --duration); readable even if it is killed."""
    from eps_hil.bus import record as recorder
    from eps_hil.cli._bus_options import open_bus, stop_on_signals

    recorder.check_target(out, overwrite=overwrite)
    port, name = open_bus(config, interface, channel, option, fd, send_ids=())
    try:
        log = recorder.open_log(out, name, overwrite=overwrite)
        stop = stop_on_signals()
        typer.echo(f"recording {port.name} to {out}; Ctrl-C stops", err=True)
        live = sys.stderr.isatty()
        report = recorder.record(
            port,
            log,
            out,
            duration_s=duration,
            stop=stop,
            progress=(lambda n: typer.echo(f"\r{n} frames", nl=False, err=True)) if live else None,
        )
    finally:
        port.close()
    if live:
        typer.echo("\r", nl=False, err=True)
    typer.echo(
        f"recorded {report.frames} frames in {report.duration_s:.3f} s to {out} "
        f"({report.file_bytes} bytes); lost in the kernel {report.lost}, "
        f"error frames {report.error_frames}"
    )
