"""Units of databases, and the one letter whose case counts."""

import pytest

from eps_hil.bus import units


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("Nm", 1.0), ("NM", 1.0), ("N·m", 1.0), ("mNm", 1e-3), ("m N m", 1e-3), ("kNm", 1e3),
     ("KNM", 1e3), ("MNm", None), ("MNM", None), ("M Nm", None), ("MN-m", None)],
)  # fmt: skip
def test_milli_is_no_mega(unit: str, factor: float | None) -> None:
    assert units.torque_nm(unit) == factor
    assert units.ambiguous(unit) is (factor is None)


@pytest.mark.parametrize(
    ("unit", "known"),
    [("mm", ("length", 1e-3)), ("Mm", None), ("MM", None), ("mA", ("current", 1e-3)),
     ("MA", None), ("M/S", ("speed", 1.0)), ("MPH", ("speed", 0.44704)), ("M", ("length", 1.0)),
     ("Min-1", ("angular speed", 0.10471975511965977)), (None, None)],
)  # fmt: skip
def test_other_units_that_begin_with_the_letter(
    unit: str | None, known: tuple[str, float] | None
) -> None:
    assert units.known(unit) == known
