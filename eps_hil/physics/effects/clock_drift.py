"""One signal's time base runs fast or slow against the others."""

from functools import partial

from eps_hil.physics.effects.effect import Effect, Kind, Parameter, Slot
from eps_hil.physics.on_bus_entry import read

_PPM = Parameter(
    "ppm", "1e-6", -1e5, 1e5, "positive: what is at t is stamped later, by this part of t"
)

EFFECT = Effect(
    id="clock_drift",
    title="Clock drift",
    kind=Kind.INSTRUMENT,
    slot=Slot.DATA,
    equation="stamp = instant · (1 + ppm·10⁻⁶)",
    parameters=(_PPM,),
    sentence="One signal's clock drifts by {ppm:.3g} ppm.",
    read=partial(read, "clock_drift", _PPM, "motor_speed_rad_s"),
    simulated=False,
    on_bus=True,
)
