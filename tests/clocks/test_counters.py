"""Counters are found in payloads, whatever stands beside them."""

import numpy as np
import pytest

from eps_hil.clocks.counters import find_counter
from eps_hil.clocks.payloads import Payloads

K = np.arange(3_000)
NOISE = np.random.default_rng(0).integers(0, 256, (len(K), 3))


def payloads(*columns: np.ndarray) -> tuple[bytes, ...]:
    return tuple(bytes(row) for row in np.column_stack(columns).astype(int).tolist())


@pytest.mark.parametrize(
    ("data", "modulus"),
    [
        (payloads(NOISE, K % 256), 256),
        (payloads(K % 16, NOISE), 16),
        (payloads(NOISE, K % 15 + 16 * (NOISE[:, 0] % 16)), 15),
        (payloads(NOISE, NOISE[:, 1] % 16 + 16 * (K % 16)), 16),
        (payloads(K % 256, K // 256, NOISE), 65536),
        (payloads(NOISE, K // 256, K % 256), 65536),
    ],
)
def test_a_counter_is_found(data: tuple[bytes, ...], modulus: int) -> None:
    found = find_counter(Payloads.of(data))
    assert found is not None
    assert found.modulus == modulus
    assert found.lost_between(10, 14) == 3


@pytest.mark.parametrize(
    "data",
    [payloads(NOISE), payloads(K % 2, NOISE), (b"\x01",) * 100, (b"\x01", b"") * 50, ()],
)
def test_where_there_is_none_none_is_found(data: tuple[bytes, ...]) -> None:
    assert find_counter(Payloads.of(data)) is None
