"""One record copied over another, as a block of memory.

numba's own ``to[i] = of[j]`` moves a record byte by byte in straight code: some thousand stores,
which took a third of all compiling.
"""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload  # frozen into compiled code


def copy(to: Any, i: Any, of: Any, j: Any) -> None:
    """``to[i] = of[j]`` for arrays of the same records."""
    to[i] = of[j]


_UTILS: Any = cgutils
_LEAN: Any = {"_nrt": False, "forceinline": True}
"""As :func:`eps_hil.compiled.kernel`."""


def _memory(_context: Any, to: Any, i: Any, of: Any, j: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        places = []
        for kind, array, index in zip(
            signature.args[::2], arguments[::2], arguments[1::2], strict=True
        ):
            data = context.make_array(kind)(context, builder, value=array).data
            places.append(builder.gep(data, [index]))
        size = context.get_constant(types.intp, to.dtype.size)
        _UTILS.raw_memcpy(builder, *places, size, 1)
        return context.get_dummy_value()

    whole = types.intp
    return types.void(to, whole, of, whole), code


_move: Any = intrinsic(_memory)


@overload(copy, jit_options=_LEAN)
def _copied(to: Any, i: Any, of: Any, j: Any) -> Callable[..., None] | None:
    if to.dtype != of.dtype or {to.layout, of.layout} != {"C"}:
        return None

    def moved(to: Any, i: Any, of: Any, j: Any) -> None:
        _move(to, i, of, j)

    return moved
