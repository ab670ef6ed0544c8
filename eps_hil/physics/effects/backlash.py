"""Play between rotor and rack: a dead zone in which the rotor turns and the rack does not."""

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Slot

EFFECT = Effect(
    id="backlash",
    kind=Kind.STRUCTURE,
    slot=Slot.TORQUE,
    equation="load acts only when |φ − i_APA·x| has closed the gap",
    parameters=(Parameter("gap_rad", "rad", 0.0, 5.0, "whole width of the gap at the rotor"),),
    sentence="Between rotor and rack there is play of {gap_rad:.3g} rad.",
    twins={"presliding_hysteresis": "φ against rack position through slow reversals"},
    simulated=False,
)
