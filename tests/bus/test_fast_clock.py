"""The sample clock of a sender at 2 and 4 kHz: delays are those of machines, not of its rate."""

from itertools import pairwise

import numpy as np
import pytest

from eps_hil.bus.sample_clock import SampleClock
from tests.bus.test_sample_clock import EPOCH, MS, US

RATES = (2_000, 4_000)


def stamps(rate_hz: int, cycles: int, drift: float, late_us: float, hiccups: int, seed: int = 1):  # type: ignore[no-untyped-def]
    """True instants and stamps: latency 100 us, what a scheduler adds, hiccups to 8 ms."""
    rng = np.random.default_rng(seed)
    true = [EPOCH + round(n * (1e9 / rate_hz) * (1 + drift)) for n in range(cycles)]
    late = 100 * US + rng.exponential(late_us * US, cycles)
    starts = set(rng.integers(500, cycles, hiccups).tolist())
    seen, blocked, last = [], 0, 0
    for n, t in enumerate(true):
        if n in starts:
            blocked = t + int(rng.integers(MS, 8 * MS))
        last = max(t + int(late[n]), blocked, last + 10 * US)
        seen.append(last)
    return true, seen


@pytest.mark.parametrize("rate_hz", RATES)
@pytest.mark.parametrize("late_us", [5.0, 150.0])
def test_a_busy_machine_does_not_restart_it(rate_hz: int, late_us: float) -> None:
    """Frames that wait for most of a period, often, and for many periods now and then."""
    true, seen = stamps(rate_hz, 40_000, 50e-6, late_us, hiccups=100)
    clock = SampleClock(1_000_000_000 // rate_hz, 256)
    found = [clock.instant(t, n % 256) for n, t in enumerate(seen)]
    assert all(at is not None and at.trusted and not at.lost for at in found)
    instants = [at.t_ns for at in found if at is not None]
    assert clock.restarts == 0
    assert all(a < b for a, b in pairwise(instants))
    error_us = (np.array(instants) - np.array(true))[8_000:] / US
    assert error_us.min() > 90
    assert error_us.max() < 130


@pytest.mark.parametrize("rate_hz", RATES)
def test_the_drift_is_followed_over_as_many_seconds(rate_hz: int) -> None:
    _, seen = stamps(rate_hz, 10 * rate_hz, 120e-6, 20.0, hiccups=0)
    clock = SampleClock(1_000_000_000 // rate_hz, 256)
    for n, t in enumerate(seen):
        clock.instant(t, n % 256)
    assert clock.drift_ppm == pytest.approx(120, abs=2)


@pytest.mark.parametrize("rate_hz", RATES)
def test_a_counter_of_eight_bits_tells_a_loss(rate_hz: int) -> None:
    _, seen = stamps(rate_hz, 3_000, 0.0, 5.0, hiccups=0)
    clock = SampleClock(1_000_000_000 // rate_hz, 256)
    gone = {1_000, 1_500, 1_501, 1_502}
    found = [clock.instant(t, n % 256) for n, t in enumerate(seen) if n not in gone]
    assert sum(at.lost for at in found if at is not None) == len(gone)
