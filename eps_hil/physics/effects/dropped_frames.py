"""Frames that are missing from the recording."""

from functools import partial

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Slot
from eps_hil.physics.on_bus_entry import read

_COUNT = Parameter("count", "1", 0.0, 1e9, "frames missing")

EFFECT = Effect(
    id="dropped_frames",
    title="Dropped frames",
    kind=Kind.INSTRUMENT,
    slot=Slot.DATA,
    equation="samples missing",
    parameters=(_COUNT,),
    sentence="{count:.0f} frames are missing.",
    read=partial(read, "dropped_frames", _COUNT, None),
    simulated=False,
    on_bus=True,
)
