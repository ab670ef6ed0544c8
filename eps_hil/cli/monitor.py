"""``eps-hil monitor``: terminal view of rig, service and residual (CONTRACT 6)."""

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from eps_hil.errors import InputError

if TYPE_CHECKING:
    from eps_hil.bus.config import BusConfig
    from eps_hil.monitor.figures import Figures

_SCREEN_S, _LINE_S, _ONCE_S = 0.25, 1.0, 4.0


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("monitor")(monitor)


def monitor(
    config: Path = typer.Option(..., help="Configuration of the service (YAML)."),
    once: bool = typer.Option(False, "--once", help="One view after --seconds (4), and end."),
    json: bool = typer.Option(False, "--json", help="A line of JSON each second."),
    seconds: float = typer.Option(None, min=0.2, help="End after so many seconds."),
    window: float = typer.Option(4.0, min=1.0, max=60.0, help="Seconds of the residual's rms."),
    alarm_moving: float = typer.Option(
        None, min=0.0, help="Limit in N rms, moving (default: 0.35 of the model's friction)."
    ),
    alarm_resting: float = typer.Option(
        None, min=0.0, help="Limit in N rms, at rest (default: the model's friction)."
    ),
    alarm_balance: float = typer.Option(
        None, min=0.0, help="Limit in N rms, torque balance (default: 0.2 of the friction)."
    ),
    alarm_after: float = typer.Option(6.0, min=0.0, help="Seconds beyond a limit to an alarm."),
    alarm_exit: bool = typer.Option(False, "--alarm-exit", help="An alarm ends it with status 1."),
    bell: bool = typer.Option(False, "--bell", help="An alarm rings the terminal's bell."),
    journal: Path = typer.Option(None, help="Append alarms to this file, a line of JSON each."),
    bitrate: int = typer.Option(None, min=1, help="Of the bus in bit/s, where it is not known."),
) -> None:
    """Signals, estimate, health, losses, and where rig and model part. Sends nothing."""
    from eps_hil.cli._bus_options import stop_on_signals
    from eps_hil.cli._first_answer import say_if_it_compiles
    from eps_hil.monitor.alarm import limits_of
    from eps_hil.monitor.process import Pace, heard_nothing, open_watched, watch
    from eps_hil.monitor.view_model import Monitor
    from eps_hil.physics.model import load_model
    from eps_hil.service.config import load_config
    from eps_hil.service.journal import Journal

    loaded = load_config(config)
    given = (alarm_moving, alarm_resting, alarm_balance)
    limits = limits_of(load_model(loaded.model), *given, after_s=alarm_after)
    known = bitrate or _bitrate_of(loaded.bus)
    view = Monitor(loaded, limits, window_s=window, bitrate=known)
    if alarm_exit and not view.has_load_cell:
        problem = "rack_force_n is not mapped, and without a load cell nothing raises an alarm"
        raise InputError(loaded.signals, "signals", problem, "map it, or leave --alarm-exit out")
    _say("monitor: loading")
    say_if_it_compiles()
    view.warm_up()
    keep = Journal(journal)
    output = _Output(json, once)
    alarms = _Alarms(keep, bell, alarm_exit)
    period = math.inf if once else _SCREEN_S if output.live and not json else _LINE_S
    length = (_ONCE_S if once else math.inf) if seconds is None else seconds
    stop = stop_on_signals()
    port = open_watched(loaded.bus, _say)

    def show(figures: "Figures", changes: list[tuple[str, bool]]) -> bool:
        output.show(figures)
        return alarms.take(figures, changes)

    try:
        with output:
            last = watch(view, port, Pace(period, length), show, stop)
    finally:
        keep.close()
    if once and math.isinf(min((s.age_s for s in last.signals), default=math.inf)):
        raise heard_nothing(last)
    if alarm_exit and alarms.raised:
        _say(f"monitor: rig and model part ({', '.join(alarms.raised)}); ended by --alarm-exit")
        raise typer.Exit(1)


class _Output:
    """A screen on a terminal, lines in a pipe, JSON where asked for."""

    def __init__(self, json: bool, once: bool) -> None:
        from rich.console import Console

        self.live = sys.stdout.isatty() and not json and not once
        self._json, self._once = json, once
        width = None if sys.stdout.isatty() else 110
        self._console = Console(highlight=False, width=width)
        self._screen: Any = None

    def __enter__(self) -> "_Output":
        if self.live:
            from rich.live import Live

            self._screen = Live(console=self._console, auto_refresh=False, vertical_overflow="crop")
            self._screen.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._screen is not None:
            self._screen.stop()

    def show(self, figures: "Figures") -> None:
        from eps_hil.monitor.text import line, screen

        if self._json:
            import json

            print(json.dumps(figures.as_json(), ensure_ascii=False), flush=True)
        elif self._screen is not None:
            self._screen.update(screen(figures), refresh=True)
        elif self._once:
            self._console.print(screen(figures))
        else:
            print(line(figures), flush=True)


class _Alarms:
    """Keeps the alarms: journal, bell, and whether they end the run."""

    def __init__(self, journal: Any, bell: bool, ends: bool) -> None:
        self._journal, self._bell, self._ends = journal, bell, ends
        self.raised: list[str] = []

    def take(self, figures: "Figures", changes: list[tuple[str, bool]]) -> bool:
        """Alarms that went on or off; True where that ends the run."""
        from datetime import UTC, datetime

        for name, on in changes:
            stamp = datetime.fromtimestamp(figures.t_ns * 1e-9, UTC)
            self._journal.note({
                "utc": stamp.isoformat(timespec="milliseconds"),
                "alarm": name, "on": on, "rms_n": figures.residual.by_name()[name],
                "limit_n": figures.limits.of(name),
            })  # fmt: skip
            if on:
                self.raised.append(name)
                if self._bell:
                    sys.stderr.write("\a")
                    sys.stderr.flush()
        return self._ends and bool(self.raised)


def _bitrate_of(bus: "BusConfig") -> int | None:
    """What ``ip`` says of a CAN interface; None for any other bus."""
    if bus.interface != "socketcan":
        return None
    from eps_hil.selftest.can_interface import interfaces

    return next((one.bitrate for one in interfaces() if one.name == bus.channel), None)


_say: Callable[[str], None] = lambda text: typer.echo(text, err=True)  # noqa: E731
