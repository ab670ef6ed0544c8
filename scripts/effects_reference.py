"""Write docs/reference-effects.md from the catalogue; ``--check`` fails where the two differ."""

import re
import sys
from pathlib import Path

from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect, Parameter, Slot

PAGE = Path(__file__).parents[1] / "docs" / "reference-effects.md"

HEAD = """# Effects that a model file may add

Made by `scripts/effects_reference.py`. In a model file, indented below `model:`,
`effects: [{effect: stribeck, level_nm: 0.045, speed_rad_s: 12.0}]`; `simulate`, `estimate`, `run`
and `rig` obey them. At the rotor: ω its speed, φ its angle; x rack position, F rack force, ψ pinion
angle. Units end the names; brackets hold what a value may be, `?` an optional one. *Like*: effects
that recordings may confuse with it.
"""

WHERE = {
    Slot.MODEL: "The model's own numbers",
    Slot.LEVEL: "Inside T_fs",
    Slot.LEVEL_FACTOR: "Inside T_fs, after the rest",
    Slot.TORQUE: "Beside friction and load",
    Slot.MOTOR: "Between reported and shaft torque",
    Slot.SENSOR: "Between reported and true torsion-bar torque",
    Slot.JOINT: "On the joint between rotor and rack",
    Slot.DATA: "In the recording only ([a simulated rig's](reference-rig.md#effects) model; "
    "there with `signal`)",
}
ANYWHERE = "Where its entry says"


def _allowed(p: Parameter) -> str:
    """What a parameter may be, in signs; its unit ends its name: ``0 Nm or more`` is ``≥ 0``."""
    text = re.sub(r"^a number of ", "", p.allowed)
    text = re.sub(r"^more than ", "> ", text)
    text = re.sub(r"^(.+) or more$", r"≥ \1", text)
    text = re.sub(r"^(\S+) to ", r"\1…", text)
    return text.removesuffix(f" {p.unit}") if text != p.unit else ""


def _entry(effect: Effect) -> list[str]:
    """An effect: its name, equation, twins, and a line a parameter."""
    facts = [f"**{effect.name}** `{effect.id}`: `{effect.equation}`"]
    if not (effect.on_bus or effect.simulated):
        facts.append("It can be named, but not be simulated.")
    if effect.twins:
        facts.append(f"Like {', '.join(f'`{twin}`' for twin in effect.twins)}.")
    rows: list[str] = []
    pairs: list[str] = []
    ranges = effect.read is None or effect.on_bus
    names = [p.name for p in effect.parameters]
    for p in effect.parameters:
        if p.name.endswith("_2") and f"{p.name[:-1]}1" in names:
            continue
        if p.name.endswith("_1") and f"{p.name[:-1]}2" in names:
            pairs.append(f"`{p.name}`, `_2`")
            continue
        allowed = _allowed(p) if ranges else ""
        span = f" ({allowed})" if allowed else ""
        optional = "?" if p.default is not None else ""
        rows.append(f"- `{p.name}`{optional}{span}: {p.meaning}")
    if pairs:
        rows.append(f"- {', '.join(pairs)}?: what the name says, of that input")
    return [". ".join(facts) if len(facts) > 1 else facts[0], "", *rows, ""]


def page() -> str:
    """The whole page as text."""
    where: dict[str, list[str]] = {title: [] for title in (*WHERE.values(), ANYWHERE)}
    for effect in catalogue().values():
        where[ANYWHERE if effect.slots else WHERE[effect.slot]] += _entry(effect)
    lines = [HEAD]
    for title, entries in where.items():
        if entries:
            lines += [f"## {title}", "", *entries]
    return "\n".join(lines)


def main() -> int:
    """Write the page, or compare it."""
    text = page()
    if "--check" in sys.argv:
        return 0 if PAGE.read_text(encoding="utf-8") == text else 1
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
