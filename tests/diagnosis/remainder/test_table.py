"""How sure a learnt map is of its values: on samples of its own, without a simulator."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from eps_hil.diagnosis.remainder.sight import Place, Sight
from eps_hil.diagnosis.remainder.table import band

KNOTS = [np.linspace(-50.0, 50.0, 5).tolist(), [-1.0, 0.0, 1.0, 2.0, 3.0]]
ENTRY: dict[str, Any] = {
    "where": "rotor", "how": "sum", "inputs": ["motor_speed_rad_s", "rack_position_m"],
    "knots": KNOTS,
}  # fmt: skip


def seen(noise_nm: float, lasting: int, seed: int, n: int = 40000) -> Sight:
    """Samples at random places below 1 of the second signal; noise that lasts ``lasting`` long."""
    rng = np.random.default_rng(seed)
    scale = np.full(n, 0.01)
    noise = np.repeat(rng.standard_normal(n // lasting), lasting) * noise_nm
    block = np.arange(n) // 250
    inputs = {
        "motor_speed_rad_s": rng.uniform(-50.0, 50.0, n),
        "rack_position_m": rng.uniform(-1.0, 1.0, n),
    }
    return cast(
        Sight,
        SimpleNamespace(
            rows=np.arange(n), inputs=inputs, weight=np.ones(n), scale=scale, block=block,
            residual=noise / scale, problem=SimpleNamespace(stretch=block // 5),
            places={("rotor", "sum"): Place("rotor", "sum", -np.ones(n))},
        ),
    )  # fmt: skip


def test_half_widths_are_those_of_the_noise_and_none_where_nothing_was() -> None:
    """A knot inside has an eighth of the samples near it, and neighbours that are unsure too."""
    half = band(seen(0.02, 1, seed=3), ENTRY)
    assert all(row[3:] == [None, None] for row in half)
    alone = 1.96 * 0.02 / np.sqrt(40000 / 8)
    for row in half[1:-1]:
        assert alone < row[1] < 4.0 * alone


def test_noise_that_lasts_makes_it_less_sure() -> None:
    quick, slow = (band(seen(0.02, lasting, seed=3), ENTRY) for lasting in (1, 250))
    for row, other in zip(quick, slow, strict=True):
        assert other[1] > 1.3 * row[1]
