"""A static torque over rack position that is no spring, stop or ripple: gravity, imbalance."""

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import (
    Effect,
    Floats,
    Instant,
    Kind,
    Mass,
    Parameter,
    Probe,
    Slot,
)


@kernel
def _torque_nm(p: Floats, _s: Floats, u: Instant, torque: float) -> float:
    n = int(p[0])  # knots: p[1], p[2] = position and torque of the first, and so on
    if n == 0:
        return torque
    if u.position_m <= p[1]:
        return torque + p[2]
    for k in range(1, n):
        x0, x1 = p[2 * k - 1], p[2 * k + 1]
        if u.position_m <= x1:
            part = (u.position_m - x0) / (x1 - x0)
            return torque + p[2 * k] + part * (p[2 * k + 2] - p[2 * k])
    return torque + p[2 * n]


EFFECT = Effect(
    id="position_torque",
    title="Position-dependent torque",
    kind=Kind.STRUCTURE,
    slot=Slot.TORQUE,
    equation="+ curve(x), straight between its knots",
    parameters=(
        Parameter("curve", "m, Nm", -10.0, 10.0, "knots [[x_m, torque_nm], …], at most 32"),
    ),
    sentence="A static torque over rack position is missing.",
    twins={"unmodelled_spring": "slow passes over the whole travel"},
    mass=Mass.RACK,
    kernel=_torque_nm,
    probe=Probe("curve", 0.0, 5e-3, scan="curve"),
)
