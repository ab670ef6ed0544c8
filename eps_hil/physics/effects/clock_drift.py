"""One signal's time base runs fast or slow against the others."""

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Slot

EFFECT = Effect(
    id="clock_drift",
    kind=Kind.INSTRUMENT,
    slot=Slot.DATA,
    equation="stamp = instant · (1 + ppm·10⁻⁶)",
    parameters=(
        Parameter(
            "ppm", "1e-6", -1e5, 1e5, "positive: what is at t is stamped later, by this part of t"
        ),
    ),
    sentence="One signal's clock drifts by {ppm:.3g} ppm.",
    simulated=False,
)
