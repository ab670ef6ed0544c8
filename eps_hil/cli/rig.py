"""``eps-hil rig``: a simulated rig and ECU on a bus, in real time."""

from pathlib import Path

import typer


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def rig(
        config: Path = typer.Option(..., "--config", help="Configuration file (bus, model, rig)."),
        manoeuvre: str | None = typer.Option(
            None, "--manoeuvre", help="Name of a manoeuvre, or a YAML file."
        ),
        duration: float | None = typer.Option(
            None, "--duration", min=0.001, help="Seconds; default: one round of the manoeuvre."
        ),
        loop: bool = typer.Option(False, "--loop", help="Repeat the manoeuvre until stopped."),
    ) -> None:
        """Simulate a rig and its ECU on a bus, in real time, until the manoeuvre is over.

        Sends from the line READY on; the first time its code is compiled before.
        """
        import math
        import signal

        from eps_hil.cli._bus_options import end_on_signals, ending_signals
        from eps_hil.cli._first_answer import say_if_it_compiles
        from eps_hil.rig.config import load_rig_setup
        from eps_hil.rig.process import Rig

        setup = load_rig_setup(config, manoeuvre)
        say_if_it_compiles()
        end_on_signals()  # nothing is sent yet: it ends at once, also amid the compiler
        process = Rig(setup, typer.echo)

        def loaded() -> None:
            for number in ending_signals():
                signal.signal(number, lambda *_: process.stop())

        # A duration longer than the manoeuvre can only be meant to repeat it.
        repeat = loop or setup.rig.loop or duration is not None
        length_s = math.inf if duration is None else duration
        report = process.run(duration_s=length_s, loop=repeat, loaded=loaded)
        late = report.lateness
        typer.echo(
            f"done: {report.simulated_s:.3f} s, {report.frames_sent} frames sent, "
            f"{report.send_dropped} dropped, {report.clipped} values clipped, "
            f"{report.commands} override commands ({report.bad_commands} bad, "
            f"{report.timeouts} time-outs)"
        )
        typer.echo(
            f"lateness: p50 {late.p50_us:.0f} us, p99 {late.p99_us:.0f} us, "
            f"max {late.max_us:.0f} us; {report.caught_up_ms:g} ms caught up, "
            f"{report.overruns} overruns"
        )
