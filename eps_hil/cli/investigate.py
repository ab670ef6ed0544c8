"""``eps-hil investigate``: experiments chosen, run and judged until the physics is settled."""

import contextlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from eps_hil.bus.config import BusSetup
    from eps_hil.investigate.run import OpenRig
    from eps_hil.physics.model import Model
    from eps_hil.programme.conductor import Wanted
    from eps_hil.programme.link import Rig

_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("investigate")(investigate)


def investigate(
    config: Annotated[
        Path, typer.Option("--config", help="Configuration (bus, DBC, model, investigate).")
    ],
    budget: Annotated[
        str, typer.Option("--budget", help="Rig time: 20min, 90s, 1h; counts earlier calls.")
    ],
    out: Annotated[
        Path, typer.Option("--out", help="Folder for recordings and steps; goes on with its own.")
    ] = Path("investigation"),
    simulated: Annotated[
        bool,
        typer.Option(
            "--simulated",
            help="Lead the simulated rig of the configuration in lock-step: no bus, no waiting.",
        ),
    ] = False,
    json: Annotated[Path | None, typer.Option("--json", help="The story as JSON.")] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="The page; default: in --out.")
    ] = None,
    write_model: Annotated[
        Path | None, typer.Option("--write-model", help="Model file with the effects added.")
    ] = None,
) -> None:
    """Find out what physics the model lacks by experiments that the tool chooses and runs itself.

    The rig must run and follow RIG_Command (the simulated one: eps-hil rig --manoeuvre idle
    --loop). Commands speed and preload within the limits of the investigate: block, no torque of
    the motor. Finished steps outlive an interruption, kill -9 included; a second call goes on.
    """
    from eps_hil.bus.config import load_bus_setup
    from eps_hil.cli._files import check_kept, check_model_place, write_json
    from eps_hil.cli._first_answer import say_if_it_compiles
    from eps_hil.cli._inputs import progress
    from eps_hil.investigate import story
    from eps_hil.investigate.course import most_of
    from eps_hil.investigate.journal import Journal
    from eps_hil.investigate.lockstep import simulated_rig
    from eps_hil.investigate.run import Investigation, prepared_menu
    from eps_hil.physics.model import dump_model, load_model
    from eps_hil.programme.fingerprint import fingerprint
    from eps_hil.programme.limits import load_limits
    from eps_hil.recordings.files import replacing
    from eps_hil.report import page
    from eps_hil.rig.config import load_rig_setup

    budget_s = seconds(budget)
    check_kept((json, report, write_model), (config,))
    check_model_place(write_model)
    page.check("investigate")
    setup, limits = load_bus_setup(config), load_limits(config)
    check_kept((json, report, write_model), (setup.model, setup.signals, *setup.dbc))
    model = load_model(setup.model)
    rig = load_rig_setup(config, "idle")
    say_if_it_compiles()
    stop = _Stop()
    open_rig = (
        _simulated(config, model, out) if simulated else _on_bus(setup, model, most_of(limits))
    )
    known_by = fingerprint(setup, model) + (simulated_rig(config) if simulated else "")
    journal = Journal(out, model, limits, simulated, known_by)
    steps = journal.steps()
    if steps:
        rig_min = sum(one.rig_s for one in steps) / 60.0
        typer.echo(f"{len(steps)} steps ({rig_min:.2f} min of rig) are there already")
    with progress("simulating what experiments would show") as bar:
        menu = prepared_menu(model, limits, rig.rig.motor_share, rig.chain, bar)
    typer.echo(f"{len(menu.prospects)} experiments keep the limits")
    led = stop.while_led(open_rig)
    run = Investigation(setup, menu, journal, led, lambda c: _say(story.lines(c)))
    outcome = run.run(budget_s, stop)
    if write_model and outcome.found is not None:
        with replacing(write_model) as temporary:
            temporary.write_text(dump_model(outcome.found.model), encoding="utf-8")
    story.write_page(outcome, report or out / "investigation.html", str(setup.model.name))
    if json:
        write_json(json, story.content_of(outcome))
    if write_model and outcome.found is not None:
        typer.echo(f"model written to {write_model}")
    elif write_model:
        typer.echo(f"no model written to {write_model}: there is no verdict")
    typer.echo(f"page: {report or out / 'investigation.html'}")


class _Stop:
    """Whether a signal asked to stop while the rig was led; at other times it ends the program.

    All that is finished is on disk, and the compiler would keep a question waiting for minutes.
    """

    def __init__(self) -> None:
        from eps_hil.cli._bus_options import end_on_signals

        self._asked: Callable[[], bool] = lambda: False
        end_on_signals()

    def __call__(self) -> bool:
        return self._asked()

    def while_led(self, open_rig: "OpenRig") -> "OpenRig":
        """The rig, which is let go of before a signal ends the program again."""
        from eps_hil.cli._bus_options import end_on_signals, stop_on_signals

        @contextlib.contextmanager
        def opened(stop: Callable[[], bool]) -> "Iterator[Rig]":
            self._asked = stop_on_signals()
            try:
                with open_rig(stop) as rig:
                    yield rig
            finally:
                end_on_signals()

        return opened


def seconds(text: str) -> float:
    """``20min``, ``90s`` or ``1h`` in seconds."""
    from eps_hil.errors import InputError

    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(s|min|h)", text.strip())
    if found is None or float(found[1]) <= 0.0:
        raise InputError("--budget", "", f"'{text}' is no time", "write 20min, 90s or 1h")
    return float(found[1]) * _UNITS[found[2]]


def _say(lines: list[str]) -> None:
    for line in lines:
        typer.echo(line)


def _on_bus(setup: "BusSetup", model: "Model", most: "Wanted") -> "OpenRig":
    """The rig on the bus, opened for each experiment and let go of after it; ``most``: asked."""
    from eps_hil.investigate.run import InterruptedInvestigationError
    from eps_hil.programme.link import RigLink
    from eps_hil.service.input_check import check_mapped

    check_mapped(setup, model)
    link = RigLink(setup, model, most)

    def stopped() -> Exception:
        return InterruptedInvestigationError("interrupted; call again to go on")

    @contextlib.contextmanager
    def opened(stop: Callable[[], bool]) -> "Iterator[Rig]":
        link.open(stop, stopped)
        try:
            yield link
        finally:
            link.let_go()

    return opened


def _simulated(config: Path, model: "Model", out: Path) -> "OpenRig":
    """The configuration's own simulated rig; each call is another run of it, an hour later."""
    from eps_hil.investigate.lockstep import START_NS, LockstepRig
    from eps_hil.investigate.run import letting_go

    numbers = [path.stem.removeprefix("step_") for path in out.glob("step_*.json")]
    before = max((int(each) for each in numbers if each.isdigit()), default=0)
    rig = LockstepRig(config, model, START_NS + before * 3_600_000_000_000)
    return lambda _: letting_go(rig)
