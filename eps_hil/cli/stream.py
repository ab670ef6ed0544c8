"""``eps-hil stream``: signals, estimate and state live to PlotJuggler."""

from pathlib import Path

import typer

_DEFAULT = "127.0.0.1:9870"


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("stream")(stream)


def stream(
    config: Path = typer.Option(..., help="Configuration of the service (YAML)."),
    udp: str = typer.Option(_DEFAULT, metavar="HOST:PORT", help="Where PlotJuggler listens."),
    rate: float = typer.Option(1000.0, min=1.0, max=2000.0, help="Instants a second."),
    seconds: float = typer.Option(None, min=0.1, help="End after so many seconds."),
) -> None:
    """Signals, estimate and state live to PlotJuggler (UDP, JSON). Sends nothing on the bus.

    In PlotJuggler: Streaming, UDP Server, protocol json, tick "use field as timestamp" and name it
    timestamp. A layout comes with the package: eps-hil example plotjuggler
    """
    import math
    import time

    from eps_hil.cli._bus_options import stop_on_signals
    from eps_hil.cli._first_answer import say_if_others_compile
    from eps_hil.dashboard.listener import Listener, listen, stand_back
    from eps_hil.dashboard.udp_json import JsonStream, address_of
    from eps_hil.monitor.process import open_watched
    from eps_hil.service.config import load_config

    loaded = load_config(config)
    outlet = JsonStream(address_of(udp), rate)
    listener = Listener(loaded)
    port = open_watched(loaded.bus, _say)
    stop = stop_on_signals()
    end_s = math.inf if seconds is None else time.monotonic() + seconds
    _say(f"stream: {loaded.bus} to udp {udp}, JSON, {rate:g} instants a second; Ctrl-C ends it")
    stand_back()
    say_if_others_compile("problem")
    try:
        listener.warm_up()
        listen(listener, port, outlet, lambda: stop() or time.monotonic() >= end_s)
    finally:
        outlet.close()
        _say(f"stream: {outlet.sent} datagrams sent, {outlet.dropped} dropped")


def _say(text: str) -> None:
    typer.echo(text, err=True)
