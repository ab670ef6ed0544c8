"""Added effects for the estimator's step; of a model without any, no machine code at all.

The estimator's own code is compiled for the type of its table of effects: :class:`Nothing` where
the model has none, which most have, and the catalogue's kernels are three quarters of all that
would be compiled. Same values in both.
"""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import overload  # frozen into compiled code

from eps_hil.physics.effects import added
from eps_hil.physics.effects.added import Added, InUse
from eps_hil.physics.effects.effect import Instant


class Nothing(Added):
    """A table in which no effect acts."""

    __slots__ = ()


def table_of(effects: Added, use: InUse) -> Added:
    """The table by a type that says whether anything in it acts."""
    return effects if any(use) else Nothing(*effects)


def _is_nothing(table: Any) -> bool:
    return isinstance(table, types.NamedTuple) and table.instance_class is Nothing


def level_nm(a: Added, u: Instant, value: float) -> float:
    """As :data:`eps_hil.physics.effects.added.level_nm`; so are the others."""
    return added.level_nm(a, u, value)


def torque_nm(a: Added, u: Instant, value: float) -> float:
    """Torque beside friction and load."""
    return added.torque_nm(a, u, value)


def motor_nm(a: Added, u: Instant, value: float) -> float:
    """Shaft torque of the motor."""
    return added.motor_nm(a, u, value)


def sensor_nm(a: Added, u: Instant, value: float) -> float:
    """True torsion-bar torque."""
    return added.sensor_nm(a, u, value)


def position_m(a: Added, u: Instant, value: float) -> float:
    """The rack's position."""
    return added.position_m(a, u, value)


def load_nm(a: Added, u: Instant, value: float) -> float:
    """What a load is at this place of the rack."""
    return added.load_nm(a, u, value)


def advance(a: Added, u: Instant, dt: float) -> None:
    """What effects remember."""
    added.advance(a, u, dt)


def out_of_range(a: Added, u: Instant) -> bool:
    """Whether an effect is asked beyond its range."""
    return added.out_of_range(a, u)


def _same(a: Any, u: Any, value: Any) -> Any:
    return value


def _stays(a: Any, u: Any, dt: Any) -> None:
    return None


def _inside(a: Any, u: Any) -> bool:
    return False


_LEAN: Any = {"_nrt": False, "forceinline": True}
"""As :func:`eps_hil.compiled.kernel`."""


def _compiled(function: Callable[..., Any], nothing: Callable[..., Any], arguments: str) -> None:
    """Which code a call of ``function`` in a kernel becomes: itself, or ``nothing``."""
    choose: Any = {
        "a, u, value": lambda a, u, value: nothing if _is_nothing(a) else function,
        "a, u, dt": lambda a, u, dt: nothing if _is_nothing(a) else function,
        "a, u": lambda a, u: nothing if _is_nothing(a) else function,
    }[arguments]
    function.__annotations__ = {}  # numba compares them
    overload(function, jit_options=_LEAN)(choose)


for _function in (_same, _stays, _inside):
    _function.__annotations__ = {}
for _function in (level_nm, torque_nm, motor_nm, sensor_nm, position_m, load_nm):
    _compiled(_function, _same, "a, u, value")
_compiled(advance, _stays, "a, u, dt")
_compiled(out_of_range, _inside, "a, u")
