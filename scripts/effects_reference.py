"""Write docs/reference-effects.md from the catalogue; ``--check`` fails where the two differ."""

import re
import sys
from pathlib import Path

from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Slot

PAGE = Path(__file__).parents[1] / "docs" / "reference-effects.md"

HEAD = """# Effects that a model file may add

Written by `scripts/effects_reference.py` from `eps_hil/physics/effects/`, one file an effect. A
model file takes them below `model:`, indented: `effects: [{effect: stribeck, level_nm: 0.045,
speed_rad_s: 12.0}]`; `simulate`, `estimate`, the service and the simulated rig use them. Torques
and angles are at the rotor, ω is its speed, φ its angle, x the rack position, F the rack force, ψ
the pinion angle. Brackets hold what a parameter may be. *Looks like*: what it may be confused
with; `diagnose` says how to tell them apart.
"""

WHERE = {
    Slot.MODEL: "the model's own numbers",
    Slot.LEVEL: "inside T_fs",
    Slot.LEVEL_FACTOR: "inside T_fs, after the rest",
    Slot.TORQUE: "beside friction and load",
    Slot.MOTOR: "between reported and shaft torque",
    Slot.SENSOR: "between reported and true torsion-bar torque",
    Slot.JOINT: "on the joint between rotor and rack",
    Slot.DATA: "in the recording only",
}


def _allowed(text: str) -> str:
    """What a parameter may be, in signs: ``0 Nm or more`` is ``≥ 0 Nm``."""
    text = re.sub(r"^a number of ", "", text)
    text = re.sub(r"^more than ", "> ", text)
    return re.sub(r"^(.+) or more$", r"≥ \1", text)


def page() -> str:
    """The whole page as text."""
    parts = [HEAD]
    for effect in catalogue().values():
        where = "where its entry says" if effect.slots else WHERE[effect.slot]
        facts = [f"`{effect.equation}` ({where})."]
        if effect.on_bus:
            facts.append("Only in [a simulated rig's](reference-rig.md#effects) model.")
        elif not effect.simulated:
            facts.append("It can be named, but not be simulated.")
        if effect.twins:
            facts.append(f"Looks like {', '.join(f'`{twin}`' for twin in effect.twins)}.")
        rows = []
        ranges = effect.read is None or effect.on_bus
        names = [p.name for p in effect.parameters]
        for p in effect.parameters:
            if p.name.endswith("_2") and f"{p.name[:-1]}1" in names:
                continue
            second = f"{p.name[:-1]}2"
            name = f"`{p.name}`" + (f", `{second}`" if second in names else "")
            meaning = p.meaning.replace(" input 1", " that input") if second in names else p.meaning
            span = f" ({_allowed(p.allowed)})" if ranges else ""
            rows.append(f"- {name}{span}: {meaning}{'; optional' if p.default is not None else ''}")
        parts.append(f"## {effect.name}: `{effect.id}`\n\n{' '.join(facts)}\n")
        parts.append("\n".join(rows) + "\n")
    return "\n".join(parts)


def main() -> int:
    """Write the page, or compare it."""
    text = page()
    if "--check" in sys.argv:
        return 0 if PAGE.read_text(encoding="utf-8") == text else 1
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
