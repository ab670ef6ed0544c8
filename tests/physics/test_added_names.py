"""Machine code of different effects must not share a name: numba would take one for another."""

from collections.abc import Iterator
from typing import Any

from eps_hil.physics.effects import added
from eps_hil.physics.effects.catalogue import catalogue


def _chain(compiled: Any) -> Iterator[str]:
    """Qualified names of a fused function and of those of its kind that it calls."""
    yield compiled.py_func.__qualname__
    for cell in compiled.py_func.__closure__ or ():
        inner = cell.cell_contents
        if hasattr(inner, "py_func") and inner.py_func.__module__ == added.__name__:
            yield from _chain(inner)


def test_every_fused_function_has_a_name_of_its_own() -> None:
    fused = (added.level_nm, added.torque_nm, added.motor_nm, added.sensor_nm, added.advance)
    names = [name for function in fused for name in _chain(function)]
    assert len(names) == len(set(names))
    assert not any("<locals>" in name for name in names)
    acting = [effect for effect in catalogue().values() if effect.kernel is not None]
    for effect in acting:
        if effect.simulated:
            assert any(name.endswith(f"_through_{effect.id}") for name in names)
