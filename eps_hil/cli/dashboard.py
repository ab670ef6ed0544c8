"""``eps-hil dashboard``: the live page, and the page of a recording (CONTRACT 6)."""

import enum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from eps_hil.dashboard.diagnosis import Subject
    from eps_hil.service.config import ServiceConfig


class _From(enum.StrEnum):
    HERE = "here"
    ANYWHERE = "anywhere"
    NOWHERE = "nowhere"


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("dashboard")(dashboard)


def dashboard(
    recording: Path = typer.Argument(
        None, metavar="[REC]", help="A recording to look at, instead of the bus."
    ),
    config: Path = typer.Option(..., help="Configuration of the service (YAML)."),
    host: str = typer.Option("127.0.0.1", help="Address to listen on."),
    port: int = typer.Option(8050, min=0, max=65535, help="Port to listen on (0: any free one)."),
    marks: Path = typer.Option(
        None, help="Append marks to this file (default: beside REC; else the page keeps them)."
    ),
    diagnose_from: _From = typer.Option(
        "here",
        help="Who may start a diagnosis: pages on this machine (here), any page that reaches the "
        "port (anywhere), none (nowhere).",
    ),
) -> None:
    """Signals, estimate, residual and state live in a browser. Read-only; sends nothing."""
    from eps_hil.dashboard.server import check

    check()
    from eps_hil.cli._files import check_places
    from eps_hil.dashboard.marks import Marks, marks_path
    from eps_hil.dashboard.server import listening
    from eps_hil.service.config import load_config

    loaded = load_config(config)
    if marks is None and recording is not None:
        marks = marks_path(recording)
    check_places(marks)
    kept = Marks(marks)
    if recording is not None:
        _show_recording(recording, loaded, kept, host, port, diagnose_from)
        return
    sock = listening(host, port)
    _say_where(host, sock.getsockname()[1])  # who comes now waits a moment, and is answered
    _show_bus(loaded, marks, sock, host, diagnose_from)


def _show_recording(
    recording: Path,
    config: "ServiceConfig",
    marks: object,
    host: str,
    port: int,
    who: _From,
) -> None:
    from eps_hil.cli._first_answer import say_if_it_compiles
    from eps_hil.cli._inputs import check_extras, progress, say_notes
    from eps_hil.dashboard.marks import Marks
    from eps_hil.dashboard.recording import store_of
    from eps_hil.dashboard.server import About, Hub, listening, serve

    check_extras([recording])
    sock = listening(host, port)
    say_if_it_compiles()
    with progress(f"reading {recording.name}") as on_progress:
        store, notes = store_of(recording, config, on_progress)
    say_notes(recording, notes)
    _say_where(host, sock.getsockname()[1])
    assert isinstance(marks, Marks)
    about = About(recording.name, recording.name, notes)
    subject = _subject(config, who, recording=recording)
    serve(Hub(about, store, marks, subject, anyone=who is _From.ANYWHERE), sock, host)


def _subject(
    config: "ServiceConfig",
    who: _From,
    measured: tuple[str, ...] = (),
    recording: Path | None = None,
) -> "Subject | None":
    """What can be diagnosed; None: nothing."""
    from eps_hil.dashboard.collect import late_ns
    from eps_hil.dashboard.diagnosis import Subject
    from eps_hil.monitor.alarm import limits_of
    from eps_hil.physics.model import load_model

    if who is _From.NOWHERE:
        return None
    model = load_model(config.model)
    return Subject(
        config.model,
        measured,
        tuple(late_ns(model, name) for name in measured),
        recording,
        tuple(config.dbc),
        config.signals,
        limits_of(model).balance_n,
    )


def _show_bus(
    config: "ServiceConfig", marks: Path | None, sock: object, host: str, who: _From
) -> None:
    import multiprocessing
    import socket

    from eps_hil.cli._bus_options import stop_on_signals
    from eps_hil.cli._first_answer import say_if_others_compile
    from eps_hil.dashboard.listener import Listener, Outlet, listen, stand_back
    from eps_hil.dashboard.server import About, serve_live
    from eps_hil.errors import BusError
    from eps_hil.monitor.process import open_watched

    assert isinstance(sock, socket.socket)
    listener = Listener(config)
    port = open_watched(config.bus, _say)
    stop = stop_on_signals()
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    about, subject = About(str(config.bus)), _subject(config, who, listener.mapped)
    server = multiprocessing.get_context("spawn").Process(
        target=serve_live,
        args=(sock, host, theirs, about, marks, subject, who is _From.ANYWHERE),
        daemon=True,
    )
    server.start()
    theirs.close()
    stand_back()
    say_if_others_compile("problem")
    try:
        listener.warm_up()
        if not listen(listener, port, Outlet(ours), lambda: stop() or not server.is_alive()):
            raise BusError("dashboard: the page's server has ended")
        if not server.is_alive() and not stop():
            raise BusError("dashboard: the page's server has ended")
    finally:
        ours.close()
        server.terminate()
        server.join(5.0)


def _say_where(host: str, port: int) -> None:
    name = f"[{host}]" if ":" in host else host
    _say(f"dashboard: http://{name}:{port}/  (read-only; Ctrl-C ends it)")


def _say(text: str) -> None:
    typer.echo(text, err=True)
