"""The figures as a person reads them: a screen (rich), and one line for a pipe."""

import math
from collections.abc import Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from eps_hil.estimation.validity import Reason
from eps_hil.monitor.figures import Figures
from eps_hil.service.guard import Trip

_GOOD = {"fine", "valid", "error_active", "injecting", "listening", "armed", "Active", "Released"}
_QUIET = {"never seen", "not used", "off", "unknown"}
_DIGITS = {"Nm": 4, "N": 0, "rad/s": 3, "rad": 3, "m": 5, "degC": 1, "m/s": 2, "m/s^2": 3}


def screen(f: Figures) -> RenderableType:
    """Everything, for a terminal of 80 columns and more."""
    parts: list[RenderableType] = [
        _head(f),
        Text(),
        _signals(f),
        Text(),
        _estimate(f),
        _residual(f),
    ]
    if f.told:
        parts += [Text(), *(_told(name, values) for name, values in f.told.items())]
    return Group(*parts)


def line(f: Figures) -> str:
    """One line for a log."""
    e, r = f.estimate, f.residual
    said = f"{e.status}" + ("" if e.status == "valid" else f" ({e.reasons})")
    words = [
        f"estimate {_n(e.rack_force_n)} N {said}",
        f"load cell {_n(e.load_cell_n)} N",
        f"rms moving {_n(r.rms_moving_n)} N, at rest {_n(r.rms_resting_n)} N",
        f"balance {_n(r.balance_nm, 4)} Nm",
        f"lost {f.bus.lost_by_counter + f.bus.lost_in_kernel}",
    ]
    verdicts = dict.fromkeys(s.verdict for s in f.signals if s.verdict != "fine")
    wrong = [
        f"{verdict}: {', '.join(s.name for s in f.signals if s.verdict == verdict)}"
        for verdict in verdicts
    ]
    return "; ".join([*words, *wrong, *_alarm_words(f)])


def _n(value: float | None, digits: int = 0) -> str:
    if value is None or math.isnan(value):
        return "–"
    return f"{value:.{digits}f}"


def _style(word: str) -> str:
    if word in _GOOD:
        return "green"
    return "dim" if word in _QUIET else "bold red"


def _alarm_words(f: Figures) -> list[str]:
    found, by_name = [], f.residual.by_name()
    for names, what in ((f.parted, "ALARM: rig and model part"), (f.pending, "beyond its limit")):
        for name in names:
            is_now = f"{name} {_n(by_name[name])} N rms, limit {f.limits.of(name):.0f} N"
            found.append(f"{what}: {is_now}")
    return found


def _head(f: Figures) -> RenderableType:
    bus = f.bus
    load = "" if bus.load is None else f" ({bus.load:.0%} of the bus)"
    text = Text.assemble(
        (bus.name, "bold"), "  ", (bus.state.replace("_", " "), _style(bus.state)),
        f"  {_n(bus.frames_per_s)} frames/s  {_n(bus.kbit_per_s)} kbit/s{load}\n",
        ("lost ", ""), (f"{bus.lost_by_counter} by counter, {bus.lost_in_kernel} in the kernel",
                        "bold red" if bus.lost_by_counter + bus.lost_in_kernel else ""),
        "  CRC errors ", (str(bus.crc_errors), "bold red" if bus.crc_errors else ""),
        "  error frames ", (str(bus.error_frames), "bold red" if bus.error_frames else ""),
    )  # fmt: skip
    for words in _alarm_words(f):
        text.append("\n")
        text.append(f" {words} ", "bold white on red" if words.startswith("ALARM") else "yellow")
    return text


def _signals(f: Figures) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("signal", no_wrap=True)
    for heading in ("value", "age ms", "Hz"):
        table.add_column(heading, justify="right", no_wrap=True, min_width=8)
    table.add_column("verdict")
    for one in f.signals:
        said = one.verdict + (f", {one.bad} bad so far" if one.bad else "")
        if one.service not in {"", one.verdict}:
            said += f"; the service: {one.service}"
        table.add_row(
            one.name,
            f"{_n(one.value, _DIGITS.get(one.unit, 3))} {one.unit}",
            _n(one.age_s * 1e3, 1) if math.isfinite(one.age_s) else "–",
            _n(one.rate_hz),
            Text(said, _style(one.verdict if one.service in {"", "fine"} else one.service)),
        )
    return table


def _estimate(f: Figures) -> Text:
    e = f.estimate
    said = Text.assemble(
        ("rack force  ", "bold"), f"estimate {_n(e.rack_force_n)} N   "
        f"load cell {_n(e.load_cell_n)} N   difference {_n(f.residual.error_n)} N\n",
        "status      ", (e.status, _style(e.status)),
    )  # fmt: skip
    if e.status != "valid" and e.reasons:
        said.append(f": {e.reasons}", "bold red" if e.status != "off" else "dim")
    said.append(
        f"   age {_n(e.age_ms, 1)} ms   {_n(e.rate_hz)} Hz   "
        f"friction {_n(e.friction_torque_nm, 3)} Nm\n"
    )
    return said


def _residual(f: Figures) -> Text:
    r, limits = f.residual, f.limits
    said = Text.assemble(("residual    ", "bold"))
    if r.rms_moving_n is not None or r.rms_resting_n is not None:
        said.append("less load cell, N rms: moving ")
        said.append(_n(r.rms_moving_n), _over(r.rms_moving_n, limits.moving_n))
        said.append(f" (limit {limits.moving_n:.0f}), at rest ")
        said.append(_n(r.rms_resting_n), _over(r.rms_resting_n, limits.resting_n))
        said.append(f" ({limits.resting_n:.0f}); bias {_n(r.bias_moving_n)}\n            ")
    if r.balance_nm is not None:
        said.append("torque balance, sliding: ")
        said.append(f"{_n(r.balance_n)} N", _over(r.balance_n, limits.balance_n))
        said.append(f" (limit {limits.balance_n:.0f}) = {_n(r.balance_nm, 4)} Nm, "
                    f"noise {_n(r.balance_floor_nm, 4)}\n            ")  # fmt: skip
    if r.why_not:
        said.append(r.why_not, "dim")
    said.rstrip()
    return said


def _over(value: float | None, limit: float) -> str:
    return "bold red" if value is not None and value > limit else ""


def _told(name: str, values: Mapping[str, Any]) -> Text:
    """One of the other messages; bits of reasons in words, counters and CRC left out."""
    said = Text.assemble((name.removeprefix("EPSHIL_"), "bold"), "  ")
    age_s = float(values.get("age_s", math.inf))
    if age_s > 1.0:
        said.append(f"silent for {age_s:.0f} s  ", "bold red")
    shown = []
    for key, value in values.items():
        if key in {"age_s", "Crc", "Counter"}:
            continue
        text = bits_in_words(key, value) if isinstance(value, int) else None
        if text is None:
            text = f"{value:.5g}" if isinstance(value, float) else str(value)
        shown.append(f"{key} {text}")
    said.append("  ".join(shown))
    return said


def bits_in_words(key: str, value: int) -> str | None:
    """Bits of a signal that says reasons, in words; None for any other signal."""
    kind = {"TripReason": Trip, "EstimateReason": Reason, "EstimateReasons": Reason}.get(key)
    if kind is None:
        return None
    named = [bit.name for bit in kind if bit & value and bit.name]
    return ", ".join(name.lower().replace("_", " ") for name in named) or "none"
