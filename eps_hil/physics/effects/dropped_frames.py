"""Frames that are missing from the recording."""

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Slot

EFFECT = Effect(
    id="dropped_frames",
    kind=Kind.INSTRUMENT,
    slot=Slot.DATA,
    equation="samples missing",
    parameters=(Parameter("count", "1", 0.0, 1e9, "frames missing"),),
    sentence="{count:.0f} frames are missing.",
    simulated=False,
)
