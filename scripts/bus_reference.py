#!/usr/bin/env python3
"""Write the tables of docs/reference-bus.md, and dbc/eps_hil.dbc, from dbc/eps_rig.dbc.

The text between the markers of the document is generated, the rest is written by hand.
dbc/eps_hil.dbc holds only the messages that we send, for a rig with a database of its own, whose
ids may be those of the simulated rig. A test fails when they have drifted apart; running this
script puts them in step again.
"""

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from eps_hil.bus.database import load_database
from eps_hil.bus.load import classic_bits, fd_seconds

ROOT = Path(__file__).resolve().parents[1]
DBC = ROOT / "dbc" / "eps_rig.dbc"
OURS = ROOT / "dbc" / "eps_hil.dbc"
DOCUMENT = ROOT / "docs" / "reference-bus.md"
_NODE = "EPS_HIL"
_ABOUT = "What the service and its tools send, to stand beside a rig's own database."
_CHECKS = ("Crc", "Counter")
"""Signals that stand with their message."""
_I_APA, _I_PI, _J = 2513.0, 125.7, 2.0e-4
NEWTON_PER = {  # at the rack of the reference rig, per unit of the signal's quantum
    "MotorSpeed": _J * _I_APA / 1e-3,  # as a step within 1 ms
    "MotorTorque": _I_APA,
    "AppliedMotorTorque": _I_APA,
    "RequestedMotorTorque": _I_APA,
    "CommandedTorque": _I_APA,
    "FrictionTorque": _I_APA,
    "TorsionBarTorque": _I_PI,
}


def load(messages: Iterable[Any], duration_s: Callable[[int], float]) -> float:
    """Share of the bus in percent, each message sent at its cycle time."""
    return float(sum(100e3 * duration_s(m.length) / m.cycle_time for m in messages))


def _bits(signal: Any) -> str:
    return f"{signal.start}..{signal.start + signal.length - 1}"


def _range(signal: Any) -> str:
    low, high = signal.minimum, signal.maximum
    return f"±{high:.10g}" if low == -high else f"{low:.10g} to {high:.10g}"


def _messages(database: Any) -> list[str]:
    """A listing, one block a message."""
    lines = ["```"]
    for m in sorted(database.messages, key=lambda each: each.frame_id):
        checks = {s.name: _bits(s) for s in m.signals}
        crc = "" if checks.get("Crc") == "0..7" else ", no CRC"
        lines += [
            f"0x{m.frame_id:03X} {m.name}  {m.cycle_time} ms  {m.senders[0]}"
            f"  counter {checks['Counter']}{crc}",
        ]
        for s in m.signals:
            if s.name in _CHECKS:
                continue
            newton = f"{s.scale * NEWTON_PER[s.name]:.3g} N" if s.name in NEWTON_PER else ""
            none = [str(raw) for raw, text in (s.choices or {}).items() if str(text) == "SNA"]
            plain = s.scale == 1 and not s.unit  # a count, or one of the labels below
            scale = "" if plain else f"{s.scale:.10g}"
            span = "" if plain else f"{_range(s)} {s.unit or ''}"
            cells = f"  {s.name:24} {_bits(s):8} {scale:8} {newton:12} {span:24} {' '.join(none)}"
            lines.append(cells.rstrip())
    return [*lines, "```"]


def _labels(database: Any) -> list[str]:
    """A line for signals with the same labels; SNA stands in the listing."""
    of: dict[str, list[str]] = {}
    for m in sorted(database.messages, key=lambda each: each.frame_id):
        for s in m.signals:
            named = [f"{raw} {text}" for raw, text in (s.choices or {}).items() if text != "SNA"]
            if named:
                of.setdefault(", ".join(named), []).append(f"`{s.name}`")
    return [f"- {', '.join(dict.fromkeys(names))}: {labels}" for labels, names in of.items()]


def _bus_load(database: Any) -> list[str]:
    everything = list(database.messages)
    override = ("EPSHIL_TorqueOverride", "EPSHIL_OverrideState", "EPS_OverrideStatus")
    listening = [m for m in everything if m.name not in override]
    lines = [
        "| bus | estimating | with the torque override |",
        "|---|---|---|",
    ]
    for rate in (500e3, 1e6):
        cells = []
        for messages in (listening, everything):
            plain = load(messages, lambda n, r=rate: classic_bits(n)[0] / r)  # type: ignore[misc]
            worst = load(messages, lambda n, r=rate: classic_bits(n)[1] / r)  # type: ignore[misc]
            cells.append(f"{plain:.0f} % ({worst:.0f} %)")
        lines.append(f"| classic, {rate / 1e3:.0f} kbit/s | {cells[0]} | {cells[1]} |")
    for nominal, data in ((500e3, 2e6), (1e6, 5e6)):
        cells = []
        for messages in (listening, everything):
            worst = load(messages, lambda n, a=nominal, d=data: fd_seconds(n, a, d))  # type: ignore[misc]
            cells.append(f"({worst:.0f} %)")
        name = f"CAN FD, {nominal / 1e3:.0f} kbit/s and {data / 1e6:.0f} Mbit/s"
        lines.append(f"| {name} | {cells[0]} | {cells[1]} |")
    return lines


PARTS = {"messages": _messages, "labels": _labels, "load": _bus_load}


def rendered(document: str) -> str:
    """The document with every generated part made anew from the database."""
    database = load_database([DBC])
    for name, make in PARTS.items():
        begin, end = f"<!-- {name}: generated -->", f"<!-- {name}: end -->"
        pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
        if not pattern.search(document):
            raise SystemExit(f"{DOCUMENT}: the markers of '{name}' are missing")
        text = "\n".join([begin, *make(database), end])
        document = pattern.sub(lambda _, text=text: text, document)  # type: ignore[misc]
    return document


def ours(text: str) -> str:
    """A DBC with the messages of our node only, from the text of dbc/eps_rig.dbc."""
    sent = set(re.findall(rf"^BO_ (\d+) \w+: \d+ {_NODE}$", text, re.MULTILINE))
    lines: list[str] = []
    inside = True  # of a message that we send, or of none
    for line in text.splitlines():
        if not line.startswith(" SG_"):
            inside = _is_ours(line, sent)
        if inside and (line or lines[-1:] != [""]):
            lines.append(re.sub(r"^( SG_ .* )\S+$", r"\1Vector__XXX", line))
    made = "\n".join(lines) + "\n"
    made = re.sub(r'^CM_ ".*";$', f'CM_ "{_ABOUT}";', made, flags=re.MULTILINE)
    return re.sub(r"^BU_:.*$", f"BU_: {_NODE}", made, flags=re.MULTILINE)


def _is_ours(line: str, sent: set[str]) -> bool:
    """Whether a line speaks of a message with one of these ids, of our node, or of neither."""
    message = re.match(r'(?:(?:CM_|BA_ "\w+") (?:BO_|SG_)|BO_|VAL_) (\d+) ', line)
    node = re.match(r"CM_ BU_ (\w+) ", line)
    return message[1] in sent if message else not node or node[1] == _NODE


if __name__ == "__main__":
    OURS.write_text(ours(DBC.read_text(encoding="utf-8")), encoding="utf-8")
    DOCUMENT.write_text(rendered(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
