"""Added effects that ask where the rotor is: what they make without an angle, nobody knows.

Without one the observer integrates the speed from zero, wherever rotor and rack were at the start.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect
from eps_hil.physics.model import Model

_PLACES = frozenset({"angle_rad", "position_m", "pinion_rad"})
"""Fields of an :class:`~eps_hil.physics.effects.effect.Instant` that follow from the angle."""
_INPUTS = frozenset({"motor_angle_rad", "rack_position_m"})
"""The same as a law names its inputs."""
_WAYS = frozenset({"stop", "hysteresis"})
"""Memories of a law that keep how far its input went, and not where it is."""


def effects_of_places(model: Model) -> tuple[str, ...]:
    """Ids of the model's effects that act at run time and read the rotor's or rack's place.

    ``model``: with those effects worked in that change its numbers.
    """
    found: dict[str, None] = {}
    for entry in model.effects:
        effect = catalogue()[str(entry["effect"])]
        if _law_asks(effect.read(entry)) if effect.read is not None else _asks(effect):
            found[effect.id] = None
    return tuple(found)


def _law_asks(values: Mapping[str, Any]) -> bool:
    """Whether a law that was found in recordings reads a place, or has a range of places."""
    return any(
        name in _INPUTS and (memory not in _WAYS or name in values["range"])
        for name, memory in zip(values["inputs"], values["memory"], strict=True)
    )


def _asks(effect: Effect) -> bool:
    kernels = (effect.kernel, effect.advance, *effect.elsewhere.values(), *effect.slots.values())
    return any(_PLACES & set(_names(kernel)) for kernel in kernels if kernel is not None)


def _names(kernel: Callable[..., Any]) -> Iterator[str]:
    """Names that a kernel's code uses, and that of the functions beside it that it calls."""
    function = getattr(kernel, "py_func", kernel)  # itself, where kernels run as Python
    for name in function.__code__.co_names:
        yield name
        called: Any = function.__globals__.get(name)
        called = getattr(called, "py_func", called)
        if hasattr(called, "__code__") and called is not function:
            yield from _names(called)
