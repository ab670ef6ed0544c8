"""What one thing to hide is: a strength and a shape on the true rig."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from eps_hil.proof.world import World

Shape = Mapping[str, float]
Apply = Callable[[World, float, Shape], World]
Tell = Callable[[float, Shape, World], dict[str, float]]
Draw = Callable[[np.random.Generator], dict[str, float]]

_NOT_IN_A_MODEL_FILE = (
    "belt_compliance",
    "backlash",
    "torque_sensor_hysteresis",
    "breakaway_dwell",
)
"""One mass and one angle cannot hold the first two, sensor play is not simulated, and for the last
this plant calls rest what moves slower than 0.05 rad/s, which no recording resolves."""


@dataclass(frozen=True, slots=True)
class HiddenEffect:
    """One thing to hide. ``apply`` puts it into a world at a strength, with its shape.

    ``start`` is a strength to begin with, ``limit`` the largest that still makes sense;
    ``free`` says that the baseline's own parameters can imitate it (it is then measured before
    projection); ``twins`` are ids that recordings cannot be expected to tell from it
    (DIAGNOSIS 5); ``signed`` effects take either sign. ``knots`` makes the curve of an effect
    that a model file holds as one. ``placed`` ones act only where the rack comes to, which the two
    forms of the plant do not share to the millimetre.
    """

    id: str
    kind: str
    start: float
    limit: float
    apply: Apply
    tell: Tell
    draw: Draw
    free: bool = False
    signed: bool = False
    twins: tuple[str, ...] = ()
    alien: bool = False
    knots: Callable[[float, Shape], list[list[float]]] | None = None
    placed: bool = False

    def entry(self, strength: float, shape: Shape, world: World) -> dict[str, Any] | None:
        """What a model file (CONTRACT 4) would say of it; None where it cannot."""
        if self.alien or self.id in _NOT_IN_A_MODEL_FILE:
            return None
        if self.knots is not None:
            return {"effect": self.id, "curve": self.knots(strength, shape)}
        return {"effect": self.id, **self.tell(strength, shape, world)}
