"""One step of whichever estimator it is, chosen while compiling by what the physics holds.

The stream's compiled loop is the same for both; which step it calls follows from the type of its
physics, so neither estimator pays for the other (a compiled function that may call both carries
the memory of both).
"""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import overload  # frozen into compiled code

from eps_hil.estimation.bristle_filter import PhysicsInside, filter_step
from eps_hil.estimation.rack_force import estimator_step
from eps_hil.estimation.setup import Constants, Inputs, Physics
from eps_hil.estimation.state import Carried


def step(c: Constants, x: Physics, e: Carried, u: Inputs, reason: int) -> int:
    """One millisecond of the paper's estimator or of the bristle filter; the reason bits."""
    chosen: Callable[..., int] = filter_step if isinstance(x, PhysicsInside) else estimator_step
    return chosen(c, x, e, u, reason)


@overload(step)
def _chosen(c: Any, x: Any, e: Any, u: Any, reason: Any) -> Callable[..., int]:
    inside = isinstance(x, types.NamedTuple) and x.instance_class is PhysicsInside

    def paper(c: Any, x: Any, e: Any, u: Any, reason: Any) -> int:
        return estimator_step(c, x, e, u, reason)

    def bristle(c: Any, x: Any, e: Any, u: Any, reason: Any) -> int:
        return filter_step(c, x, e, u, reason)

    return bristle if inside else paper
