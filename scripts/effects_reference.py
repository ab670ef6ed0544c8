"""Write docs/reference-effects.md from the catalogue; ``--check`` fails where the two differ."""

import sys
from pathlib import Path

from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Slot

PAGE = Path(__file__).parents[1] / "docs" / "reference-effects.md"

HEAD = """# Effects that a model file may add

Written by `scripts/effects_reference.py` from `eps_hil/physics/effects/`, one file an effect.
A model file takes them as `effects: [{effect: stribeck, level_nm: 0.045, speed_rad_s: 12.0}]`;
`eps-hil simulate`, `eps-hil estimate` and the live service then use them. Torques and angles are
at the rotor, ω is its speed, φ its angle, x the rack position, F the rack force, ψ the pinion
angle. Brackets hold what a parameter may be. With an effect on the joint between rotor and rack
`simulate` runs two masses; the estimator's band lies far below.
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


def page() -> str:
    """The whole page as text."""
    parts = [HEAD]
    for effect in catalogue().values():
        used = "" if effect.simulated else " It can be named, but not be simulated."
        if effect.on_bus:
            used = (
                " Only the model of a simulated rig may hold it, perhaps with the `signal` that it"
                " is about ([the rig](reference-rig.md#effects))."
            )
        where = "where its entry says" if effect.slots else WHERE[effect.slot]
        parts.append(
            f"## {effect.name}: `{effect.id}`\n\n"
            f"{effect.equation} — {effect.kind}, acts {where}.{used}\n"
        )
        rows = []
        for p in effect.parameters:
            default = " (optional)" if p.default is not None else ""
            plain = effect.read is None or effect.on_bus
            span = f" ({p.allowed})" if plain else ""
            rows.append(f"- `{p.name}`{span}: {p.meaning}{default}")
        parts.append("\n".join(rows) + "\n")
        tests: dict[str, list[str]] = {}
        for twin, experiment in effect.twins.items():
            tests.setdefault(experiment, []).append(f"`{twin}`")
        told = "; ".join(f"{', '.join(twins)} by {how}" for how, twins in tests.items())
        if told:
            parts.append(f"Told from {told}.\n")
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
