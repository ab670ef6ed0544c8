"""Machine code of different effects must not share a name: numba would take one for another."""

import re
from collections.abc import Iterator
from typing import Any

from eps_hil.physics.effects import added
from eps_hil.physics.effects.catalogue import catalogue


def _chain(compiled: Any) -> Iterator[str]:
    """Qualified names of a fused function and of those of its kind that it calls."""
    plain = getattr(compiled, "py_func", compiled)  # the function itself without the compiler
    yield plain.__qualname__
    for cell in plain.__closure__ or ():
        inner = getattr(cell.cell_contents, "py_func", cell.cell_contents)
        if callable(inner) and inner.__module__ == added.__name__:
            yield from _chain(inner)


def test_every_fused_function_has_a_name_of_its_own() -> None:
    fused = (added.level_nm, added.torque_nm, added.motor_nm, added.sensor_nm, added.advance)
    names = [name for function in fused for name in _chain(function)]
    assert len(names) == len(set(names))
    assert not any("<locals>" in name for name in names)
    acting = [effect for effect in catalogue().values() if effect.kernel is not None]
    for effect in acting:
        if effect.simulated:
            named = re.compile(rf".*_through_{effect.id}(_[0-9a-f]{{12}})?")  # a digest follows
            assert any(named.fullmatch(name) for name in names)
