"""What of a direct look the model file holds already: no finding, but known in what follows.

Play, a belt that gives and play in the torque sensor are measured whole, whatever the model says of
them; a written model meets the same recordings, or others of the same rig, again.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from eps_hil.diagnosis.data.size import Size
from eps_hil.diagnosis.direct.rotor_and_rack import LEAST_GAP_RAD, least_compliance
from eps_hil.diagnosis.direct.seen import Seen
from eps_hil.diagnosis.direct.torsion_bar import LEAST_PLAY_NM, PLAY
from eps_hil.physics.model import Model

MEASURED_WHOLE: Mapping[str, tuple[str, float]] = {
    "backlash": ("gap_rad", LEAST_GAP_RAD),
    "belt_compliance": ("stiffness_nm_per_rad", 0.0),
    PLAY: ("play_nm", LEAST_PLAY_NM),
}
"""The number by which each is known, and how large it has to be to be seen."""
_WIDE = 2.0
"""Half widths of its interval that a number may be from the model's and still be it."""


def held(model: Model, seen: Seen, size: Size) -> dict[str, Any] | None:
    """The model's own entry, if it has this effect in this size."""
    name = str(seen.entry["effect"])
    entries = [dict(one) for one in model.effects if one["effect"] == name]
    if name not in MEASURED_WHOLE or not entries:
        return None
    number, least = MEASURED_WHOLE[name]
    least *= {"backlash": size.angle, PLAY: size.power}.get(name, 1.0)
    value, known = float(seen.entry[number]), float(entries[-1][number])
    if name == "belt_compliance":
        least = least_compliance(model) * value * known  # as little as is no belt at all
    wide = _WIDE * seen.half_width.get(number, 0.0)
    return entries[-1] if abs(value - known) <= max(wide, least) else None


def without(model: Model, seen: Seen) -> Model:
    """The model without its own entries of what has been measured whole."""
    name = seen.entry["effect"]
    if name not in MEASURED_WHOLE:
        return model
    left = tuple(one for one in model.effects if one["effect"] != name)
    return model if len(left) == len(model.effects) else replace(model, effects=left)
