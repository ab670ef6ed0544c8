"""``eps-hil clocks``: how good a log's time stamps are (CONTRACT 6)."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from eps_hil.clocks.audit import Audit, ChannelAudit

_SHOWN = 3


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("clocks")(clocks)


def clocks(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="REC...", help="CAN logs: LOG, BLF, ASC, TRC or MF4.")
    ],
    json: Annotated[Path | None, typer.Option("--json", help="The result as JSON.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="A copy with the clocks corrected (.log, .blf, .asc, .mf4); {name} for several.",
        ),
    ] = None,
) -> None:
    """How late, how coarse, how steady are the stamps of a log, and do its channels agree?

    Per message: period, drift against its nominal cycle time, lateness, lost cycles. Per channel:
    where the stamps come from, steps of its clock. Between channels: offset and drift, by frames
    that both have. Nothing needs a database.
    """
    import sys

    from rich.console import Console

    from eps_hil.cli._files import check_kept, outputs_for, write_json
    from eps_hil.cli._inputs import check_extras, progress, say_notes
    from eps_hil.clocks.audit import audit
    from eps_hil.clocks.corrected import check_suffix, write_corrected

    check_extras([recordings])
    targets = {} if out is None else outputs_for(out, recordings)
    for target in targets.values():
        check_suffix(target)
    check_kept([json, *targets.values()], recordings)
    width = None if sys.stdout.isatty() else 110
    console = Console(width=width, highlight=False, soft_wrap=True)
    told = []
    for path in recordings:
        with progress(f"reading {path.name}") as bar:
            found = audit(path, bar)
        _show(console, found)
        told.append(found.content())
        if path in targets:
            notes: list[str] = []
            with progress(f"writing {targets[path].name}") as bar:
                count = write_corrected(found, targets[path], bar, notes)
            say_notes(path, notes)
            own = ", ".join(one.channel for one in found.untied)
            typer.echo(
                f"{count} frames written to {targets[path]}"
                + (f"; {own}: by its own clock" * bool(own))
            )
    if json is not None:
        write_json(json, told[0] if len(told) == 1 else {"schema": told[0]["schema"], "logs": told})


def _show(console: "object", found: "Audit") -> None:
    from rich.console import Console
    from rich.table import Table

    assert isinstance(console, Console)
    console.print(f"{found.path}: best stamps on {found.reference}")
    for channel in found.channels:
        table = Table(title=_headline(channel), title_justify="left", title_style="")
        for name in ("message", "frames", "period", "drift", "late p50", "p99", "most", "lost"):
            table.add_column(name, justify="left" if name == "message" else "right")
        for row in _rows(channel):
            table.add_row(*row)
        console.print(table)
        for line in _remarks(channel):
            console.print(f"  {line}")
    for pair in found.pairs:
        console.print(
            f"{pair.channel} against {pair.reference}: {_offset(pair.offset_s)} at the start "
            f"(± {1e3 * pair.offset_half_width_s:.4f} ms), {pair.drift_ppm:+.2f} ppm "
            f"(± {pair.drift_half_width_ppm:.2f}), by {pair.pairs} frames that both have"
        )
        if pair.within_s is not None:
            console.print(f"  payloads repeat: right if the clocks are within {pair.within_s:g} s")
        for step in pair.line.steps:
            console.print(f"  {1e3 * step.by_s:+.3f} ms from {step.at_s:.1f} s on")
    for untied in found.untied:
        console.print(f"{untied.channel} against {untied.reference}: {untied.why}")


def _offset(seconds: float) -> str:
    return f"{1e3 * seconds:+.4f} ms" if abs(seconds) < 10.0 else f"{seconds:+.6f} s"


def _headline(channel: "ChannelAudit") -> str:
    return f"{channel.channel.name}: {len(channel.channel.t_ns)} frames, stamps {channel.source}"


def _rows(channel: "ChannelAudit") -> "Iterator[list[str]]":
    from eps_hil.clocks.jumps import FEWEST

    for message, told in channel.messages:
        name, frames = message.name, str(len(message.t_ns))
        if told is None:
            what = "not cyclic" if len(message.t_ns) >= FEWEST else "too few"
            yield [name, frames, what, "", "", "", "", ""]
            continue
        drift = "–"
        if told.drift_ppm is not None and told.drift_ci95 is not None:
            half = 0.5 * (told.drift_ci95[1] - told.drift_ci95[0])
            drift = f"{told.drift_ppm:+.2f} ± {half:.2g} ppm"
        late = (told.late_p50_s, told.late_p99_s, told.late_max_s)
        period = told.nominal_s if told.nominal_s is not None else told.period_s
        yield [
            name, frames, f"{1e3 * period:.6g} ms", drift,
            *(f"{1e6 * one:.0f} us" for one in late), str(told.lost),
        ]  # fmt: skip


def _remarks(channel: "ChannelAudit") -> "Iterator[str]":
    count, most_ns = channel.went_back
    if count:
        yield f"{count} frames stand before an earlier one, by up to {most_ns * 1e-6:.3g} ms"
    or_less = {jump.at_s: jump.or_less_s for jump in channel.jumps}
    for step in channel.steps:
        less = or_less.get(step.at_s)
        lost = (
            ""
            if less is None
            else (f"; by multiples of {1e3 * less:.4g} ms less if all messages lost frames then")
        )
        yield f"the clock steps by {1e3 * step.by_s:+.3f} ms at {step.at_s:.1f} s{lost}"
    yield from _silences(channel)
    single = sum(told is not None for _, told in channel.messages) == 1
    why = " or the clock stepped: one message does not tell" if single else ""
    for name, step in channel.slipped:
        yield (
            f"{name} comes {1e3 * abs(step.by_s):.3f} ms {'later' if step.by_s > 0 else 'earlier'} "
            f"from {step.at_s:.1f} s on: its place in its sender's schedule moved{why}"
        )


def _silences(channel: "ChannelAudit") -> "Iterator[str]":
    for silence in sorted(channel.silences, key=lambda one: -one.for_s)[:_SHOWN]:
        yield (
            f"no message for {1e3 * silence.for_s:.6g} ms from {silence.at_s:.1f} s on: lost "
            "cycles, a pause, or a step of the clock; nothing tells, and nothing is corrected"
        )
    if len(channel.silences) > _SHOWN:
        yield f"{len(channel.silences) - _SHOWN} more of these, shorter ones"
