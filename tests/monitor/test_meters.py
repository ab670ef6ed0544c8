"""Rates, ages and verdicts of signals, by stamps alone."""

import math

import pytest

from eps_hil.monitor.meters import RateMeter, SignalTrack

MS = 1_000_000
T0 = 1_790_000_000_000_000_000


def test_a_rate_is_exact_from_its_first_second_on() -> None:
    meter = RateMeter()
    assert meter.per_s(T0) == 0.0
    for k in range(3_000):
        meter.add(T0 + k * MS)
        if k > 150:
            assert meter.per_s(T0 + k * MS) == pytest.approx(1_000.0)


def test_a_rate_falls_to_zero_within_a_second_of_silence() -> None:
    meter = RateMeter()
    for k in range(1_000):
        meter.add(T0 + k * MS)
    assert meter.per_s(T0 + 1_500 * MS) == pytest.approx(500.0, abs=60)
    assert meter.per_s(T0 + 2_100 * MS) == 0.0


def test_a_clock_that_is_set_back_is_counted_from_there() -> None:
    """For an hour there was no rate, and a signal four times too slow was fine."""
    track = fed(1)
    for k in range(500):
        track.take(T0 - 3_600_000 * MS + k * 4 * MS, 1.0)
    now_ns = T0 - 3_600_000 * MS + 2_000 * MS
    assert track.rate_hz(now_ns) == pytest.approx(250.0)
    assert track.verdict(now_ns) == "too slow"


def fed(period_ms: int, count: int = 2_000, value: float = 1.0) -> SignalTrack:
    track = SignalTrack(1e-3)
    for k in range(count):
        track.take(T0 + k * period_ms * MS, value)
    return track


@pytest.mark.parametrize(
    ("period_ms", "later_ms", "verdict"),
    [(1, 1, "fine"), (2, 1, "too slow"), (1, 99, "fine"), (1, 101, "silent")],
)
def test_verdicts(period_ms: int, later_ms: int, verdict: str) -> None:
    track = fed(period_ms)
    assert track.verdict(track.t_ns + later_ms * MS) == verdict  # type: ignore[operator]


def test_two_senders_are_too_fast() -> None:
    track = SignalTrack(2e-3)
    for k in range(2_000):
        track.take(T0 + k * MS, 0.0)
    assert track.verdict(T0 + 2_000 * MS) == "too fast"


def test_a_refused_sample_is_bad_and_counted() -> None:
    track = fed(1)
    track.take(T0 + 2_000 * MS, math.nan)
    assert track.verdict(T0 + 2_000 * MS) == "bad sample"
    assert track.bad == 1


def test_never_seen() -> None:
    track = SignalTrack(None)
    assert track.verdict(T0) == "never seen"
    assert math.isinf(track.age_s(T0))
