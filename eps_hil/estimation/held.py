"""Arguments of machine code that are taken apart once, and not at every call.

A call from Python takes every number out of every tuple that it is given. The estimator's step has
some hundred and forty of them, which takes several times as long as the step. Held, they lie in
memory as machine code has them: numbers, and where arrays begin.
"""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from numba import types
from numba.core import cgutils, datamodel
from numba.core.typing.typeof import typeof_impl
from numba.extending import NativeValue, intrinsic, overload, unbox  # frozen into compiled code

from eps_hil.compiled import direct, interpreted, kernel

_UTILS: Any = cgutils
_LEAN: Any = {"_nrt": False, "forceinline": True}
"""As :func:`eps_hil.compiled.kernel`."""
_ROOM = 1 << 14
"""Bytes: far more than any arguments take; the machine code that fills it knows the size."""


class Held:
    """A tuple of arguments, whose numbers stay as they are now; arrays stay those arrays."""

    __slots__ = ("address", "arguments", "kind", "room")

    def __init__(self, arguments: tuple[Any, ...]) -> None:
        self.arguments = arguments
        self.room = np.zeros(_ROOM, np.uint8)
        self.address = self.room.ctypes.data
        self.kind: Any = None
        if not interpreted():
            type_of: Any = numba.typeof
            self.kind = type_of(arguments)
            direct(_hold, self.room, arguments)(self.room, arguments)


class HeldType(types.Type):
    """What machine code knows of it: the types of the arguments."""

    def __init__(self, of: Any) -> None:
        self.of = of
        super().__init__(name=f"Held({of.name})")

    @property
    def key(self) -> Any:
        """By what two are the same."""
        return self.of


def arguments(held: Any) -> Any:
    """The arguments of a :class:`Held`, as machine code has them."""
    return held.arguments


_models: Any = datamodel
_models.register_default(HeldType)(_models.models.OpaqueModel)
_typed: Any = typeof_impl
_unboxed: Any = unbox
_native: Any = NativeValue


@_typed.register(Held)
def _type_of(held: Held, _context: Any) -> HeldType:
    return HeldType(held.kind)


@_unboxed(HeldType)
def _address(_kind: Any, held: Any, c: Any) -> Any:
    attribute = c.pyapi.object_getattr_string(held, "address")
    place = c.pyapi.long_as_voidptr(attribute)
    c.pyapi.decref(attribute)
    return _native(place)


def _each(builder: Any, place: Any, of: Any, found: Any, act: Any) -> Any:
    """``act`` on every number of a value of type ``of``, and where it lies in memory."""
    if not hasattr(of, "elements"):
        return act(place, found)
    for k, element in enumerate(of.elements):
        inner = builder.gep(place, [_UTILS.int32_t(0), _UTILS.int32_t(k)], inbounds=True)
        part = _each(builder, inner, element, builder.extract_value(found, k), act)
        found = builder.insert_value(found, part, k)
    return found


def _stored(_context: Any, room: Any, given: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        of = context.get_value_type(signature.args[1])
        if context.get_abi_sizeof(of) > _ROOM:
            raise ValueError("too many arguments to be held")
        data = context.make_array(signature.args[0])(context, builder, value=values[0]).data

        def store(place: Any, number: Any) -> Any:
            builder.store(number, place)
            return number

        _each(builder, builder.bitcast(data, of.as_pointer()), of, values[1], store)
        return context.get_dummy_value()

    return types.void(room, given), code


def _loaded(_context: Any, held: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        of = context.get_value_type(signature.return_type)
        place = builder.bitcast(values[0], of.as_pointer())
        nothing = _UTILS.get_null_value(of)
        return _each(builder, place, of, nothing, lambda where, _: builder.load(where))

    return held.of(held), code


_store: Any = intrinsic(_stored)
_load: Any = intrinsic(_loaded)


@kernel
def _hold(room: npt.NDArray[np.uint8], given: Any) -> None:
    _store(room, given)


@overload(arguments, jit_options=_LEAN)
def _arguments(held: Any) -> Callable[..., Any] | None:
    if not isinstance(held, HeldType):
        return None

    def loaded(held: Any) -> Any:
        return _load(held)

    return loaded
