"""``eps-hil record``: all that one or several buses carry into log files, as its own process."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.errors import InputError

if TYPE_CHECKING:
    from eps_hil.bus.config import BusConfig
    from eps_hil.bus.recorder import Channel, RecordReport

_STAMPS = "kernel, on reception (SO_TIMESTAMPNS), by the system clock"
_RESOLUTION = {".log": "1 us", ".blf": "about 0.3 us (float seconds of python-can)"}


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("record")(record)


def record(
    out: Annotated[Path, typer.Argument(help="File to write: .log (candump) or .blf.")],
    interface: Annotated[
        list[str], typer.Option(help="socketcan, udp_multicast or any of python-can's.")
    ] = [],  # noqa: B006
    channel: Annotated[
        list[str], typer.Option(help="Such as vcan0, or 239.74.163.2; repeat it for several.")
    ] = [],  # noqa: B006
    duration: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after so many seconds.")
    ] = None,
    rotate_mb: Annotated[
        float | None, typer.Option("--rotate-mb", min=0.001, help="A new file after so many MB.")
    ] = None,
    rotate_s: Annotated[
        float | None, typer.Option("--rotate-s", min=1.0, help="A new file after so many seconds.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Take bus and DBC from this configuration file.")
    ] = None,
    dbc: Annotated[
        list[Path], typer.Option("--dbc", help="Noted with its hash; tells losses by counters.")
    ] = [],  # noqa: B006
    option: Annotated[
        list[str], typer.Option(help="KEY=VALUE for the interface, e.g. port=43113.")
    ] = [],  # noqa: B006
    fd: Annotated[bool, typer.Option("--fd", help="Open the bus for CAN FD.")] = False,
    reconnect: Annotated[
        bool, typer.Option(help="Open a bus again that was lost, or end there.")
    ] = True,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the files if they exist.")
    ] = False,
) -> None:
    """Record until Ctrl-C (or --duration); readable even if it is killed.

    Beside each file stands FILE.json: configuration, DBC hash, clock, versions, counts and losses
    by channel and message id, brought up to date each second.
    """
    from eps_hil.bus.record_parts import Target
    from eps_hil.bus.recorder import Recorder
    from eps_hil.cli._bus_options import stop_on_signals

    rotate_bytes = None if rotate_mb is None else round(rotate_mb * 1e6)
    target = Target(out, rotate_bytes, rotate_s, overwrite)
    target.check()
    about, counters = _provenance(config, dbc)
    buses = _buses(config, interface, channel, option, fd)
    live = sys.stderr.isatty()
    recorder = Recorder(
        [_channel(bus, reconnect=reconnect and bus.reconnect) for bus in buses],
        target,
        about=about | {"clock": _clock(buses, out)},
        counters=counters,
        say=lambda line: typer.echo(("\r" if live else "") + line, err=True),
        realtime=True,
    )
    stop = stop_on_signals()
    typer.echo(
        f"recording {', '.join(recorder.names)} to {recorder.parts.paths[0]}; Ctrl-C stops",
        err=True,
    )
    try:
        report = recorder.run(
            duration_s=duration,
            stop=stop,
            progress=(lambda n: typer.echo(f"\r{n} frames", nl=False, err=True)) if live else None,
        )
    finally:
        if live:
            typer.echo("\r", nl=False, err=True)
    _say(report, recorder.parts.paths)


def _buses(
    config: Path | None,
    interfaces: Sequence[str],
    channels: Sequence[str],
    option: Sequence[str],
    fd: bool,
) -> "list[BusConfig]":
    """One for each ``--channel``; one ``--interface`` is that of all."""
    from eps_hil.cli._bus_options import choose_bus

    if len(interfaces) > 1 and len(interfaces) != len(channels):
        raise InputError(
            "--interface", f"{len(interfaces)} of them", f"but {len(channels)} --channel",
            "give one for all, or one for each",
        )  # fmt: skip
    wanted: list[str | None] = [*channels] or [None]
    given: list[str | None] = [*interfaces] or [None]
    pairs = zip(given if len(given) > 1 else given * len(wanted), wanted, strict=True)
    buses = [choose_bus(config, one, other, option, fd) for one, other in pairs]
    known = {(bus.interface, bus.channel) for bus in buses}
    if len(known) < len(buses):
        raise InputError("--channel", "", "the same one is named twice", "each once")
    return buses


def _channel(bus: "BusConfig", *, reconnect: bool) -> "Channel":
    from eps_hil.bus.recorder import Channel
    from eps_hil.cli._bus_options import open_bus

    about = {
        "interface": bus.interface,
        "channel": bus.channel,
        "fd": bus.fd,
        "options": dict(bus.options),
    }
    return Channel(bus.channel, lambda: open_bus(bus, send_ids=()), about, reconnect)


def _clock(buses: "Sequence[BusConfig]", out: Path) -> dict[str, str]:
    """Which clock stamped the frames."""
    stamps = {}
    for bus in buses:
        if bus.interface not in {"socketcan", "udp_multicast"}:
            said = "driver (python-can), moved onto the system clock where it counts from elsewhere"
        elif bus.options.get("hardware_stamps"):
            said = "CAN controller, moved onto the system clock; kernel where it gives none"
        else:
            said = _STAMPS
        stamps[bus.channel] = said
    return {"resolution": _RESOLUTION[out.suffix.lower()], **stamps}


def _provenance(
    config: Path | None, dbc: Sequence[Path]
) -> tuple[dict[str, Any], Mapping[Any, Any]]:
    """What the sidecar says of files and machine, and where messages carry their counters."""
    from eps_hil.bus.record_counts import counters_of
    from eps_hil.bus.record_sidecar import provenance

    others: list[Path] = []
    strict = True
    if config is not None and not dbc:
        from eps_hil.bus.config import load_bus_setup
        from eps_hil.bus.mapping import load_mapping
        from eps_hil.yaml_file import read

        content = read(config)
        if isinstance(content, dict) and "dbc" in content:
            setup = load_bus_setup(config)
            dbc, others = list(setup.dbc), [setup.signals, setup.model]
            strict = load_mapping(setup.signals).strict
    counters: Mapping[Any, Any] = {}
    if dbc:
        from eps_hil.bus.database import load_database

        counters = counters_of(load_database(dbc, strict=strict))
    return provenance(config, dbc, others), counters


def _say(report: "RecordReport", paths: Sequence[Path]) -> None:
    where = f"{paths[0]}" if len(paths) == 1 else f"{len(paths)} files, {paths[0]} to {paths[-1]}"
    typer.echo(
        f"recorded {report.frames} frames in {report.duration_s:.3f} s to {where} "
        f"({report.file_bytes} bytes); lost in the kernel {report.lost}, "
        f"error frames {report.error_frames}"
        + (f", outages of a bus {report.outages}" if report.outages else "")
    )
    if not report.frames:
        typer.echo(
            "no frame came: does anything send there (a simulated rig does from READY on), on this "
            "channel and port?",
            err=True,
        )
