"""A device's clock that drifts, is set, or is our own: stamps stay where the frames were."""

from functools import cache

import numpy as np
import pytest

from eps_hil.bus.stamp_offset import StampOffset

MS = 1_000_000
T0_NS, STEADY0_NS = 1_790_000_000_000_000_000, 40_000_000_000_000


@cache
def _minutes(seed: int) -> list[tuple[int, int]]:
    random = np.random.default_rng(seed)
    late_ms = random.exponential(0.15, 240_000)
    held = random.random(240_000) < 0.02
    late_ms[held] += random.uniform(1.0, 30.0, np.count_nonzero(held))
    return [(k * MS, round((k + 0.2 + late) * MS)) for k, late in enumerate(late_ms.tolist())]


def frames(seconds: float, seed: int = 3) -> list[tuple[int, int]]:
    """(true instant since the start, arrival) in ns, 1 kHz; now and then the driver is late."""
    return _minutes(seed)[: round(seconds * 1000)]


def errors(
    offset: StampOffset, ppm: float, seconds: float, start_ns: int = 12_500_000_000
) -> np.ndarray:
    """(n,) ms by which frames were moved past their true instants."""
    found = []
    for true_ns, arrival_ns in frames(seconds):
        stamp_ns = start_ns + round(true_ns * (1.0 + ppm * 1e-6))
        told = offset.on_epoch(stamp_ns, T0_NS + arrival_ns, STEADY0_NS + arrival_ns)
        found.append((told - T0_NS - true_ns) / MS)
    return np.array(found)


BACK, STILL = (pytest.param(ppm, marks=pytest.mark.slow) for ppm in (-100.0, 0.0))


@pytest.mark.parametrize("ppm", [BACK, STILL, 100.0])
def test_a_crystal_that_drifts_is_followed_for_minutes(ppm: float) -> None:
    """The quickest way takes 0.2 ms here; what remains is drift within the window of 2 s."""
    late_ms = errors(StampOffset(), ppm, 240.0)[1_000:]
    assert np.all(np.abs(late_ms - 0.2) < 0.3)
    assert np.max(np.abs(np.diff(late_ms))) < 0.1, "no jolts"


@pytest.mark.parametrize("ppm", [BACK, 100.0])
def test_a_device_that_stamps_on_the_epoch_and_drifts_is_found_out(ppm: float) -> None:
    """Drivers add the epoch once when they are opened."""
    offset = StampOffset()
    late_ms = errors(offset, ppm, 240.0, T0_NS)
    assert offset.followed
    assert np.max(np.abs(late_ms)) < 6.0
    assert np.all(np.abs(late_ms[90_000:] - 0.2) < 0.3)


def test_stamps_of_our_own_clock_are_taken_as_they_are() -> None:
    offset = StampOffset()
    assert not np.any(errors(offset, 0.0, 20.0, T0_NS))
    wait_ns = 3_000_000_000  # stopped for 3 s; then all that waited comes at once, and life goes on
    for k in range(3_000 + 20_000):
        true_ns = (20_000 + k) * MS
        arrival_ns = max(true_ns, 20_000 * MS + wait_ns)
        told = offset.on_epoch(T0_NS + true_ns, T0_NS + arrival_ns, STEADY0_NS + arrival_ns)
        assert told == T0_NS + true_ns
    for k in range(5_000):  # somebody sets it, forward or back: stamps and arrivals alike
        true_ns, arrival_ns = (43_000 + k) * MS, (43_000 + k) * MS
        told = offset.on_epoch(T0_NS + true_ns - 10**9, T0_NS + arrival_ns - 10**9, arrival_ns)
        assert told == T0_NS + true_ns - 10**9
    assert not offset.followed


def test_frames_that_waited_do_not_look_young() -> None:
    """A process that was stopped for 3 s finds them in the driver's queue, in one go."""
    offset = StampOffset()
    errors(offset, 0.0, 20.0)
    stop_ns = 20_000 * MS
    for k in range(8_000):
        true_ns = stop_ns + k * MS
        arrival_ns = max(true_ns + MS // 5, stop_ns + 3_000_000_000 + k * 5_000)
        stamp_ns = 12_500_000_000 + true_ns
        told = offset.on_epoch(stamp_ns, T0_NS + arrival_ns, STEADY0_NS + arrival_ns)
        assert abs(told - T0_NS - true_ns) < 0.4 * MS


def test_a_queue_that_grows_for_seconds_is_not_taken_for_drift() -> None:
    """All frames 50 ms late for 10 s: by then they may look 5 ms younger than they are."""
    offset = StampOffset()
    errors(offset, 0.0, 20.0)
    for k in range(10_000):
        true_ns = (20_000 + k) * MS
        arrival_ns = true_ns + 50 * MS
        stamp_ns = 12_500_000_000 + true_ns
        told = offset.on_epoch(stamp_ns, T0_NS + arrival_ns, STEADY0_NS + arrival_ns)
        assert -0.1 * MS < told - T0_NS - true_ns < 5.5 * MS


@pytest.mark.parametrize("jump_ns", [-12_000_000_000, 60 * MS, 5_000_000_000])
def test_a_device_whose_clock_was_set_is_followed_at_once(jump_ns: int) -> None:
    offset = StampOffset()
    errors(offset, 0.0, 20.0)
    found = []
    for true_ns, arrival_ns in frames(5.0, seed=4):
        at_ns, came_ns = 20_000 * MS + true_ns, 20_000 * MS + arrival_ns
        stamp_ns = 12_500_000_000 + jump_ns + at_ns
        told = offset.on_epoch(stamp_ns, T0_NS + came_ns, STEADY0_NS + came_ns)
        found.append((told - T0_NS - at_ns) / MS)
    assert np.all(np.abs(found) < 6.0)
    assert np.all(np.abs(np.array(found[300:]) - 0.2) < 0.3)


def test_a_wall_clock_that_was_set_moves_the_instants_with_it() -> None:
    """They are compared with that clock: by it, a frame is as old as it was."""
    offset = StampOffset()
    errors(offset, 0.0, 20.0)
    for true_ns, arrival_ns in frames(3.0):
        at_ns, came_ns = 20_000 * MS + true_ns, 20_000 * MS + arrival_ns
        wall_ns = T0_NS + came_ns + 3_600_000_000_000
        told = offset.on_epoch(12_500_000_000 + at_ns, wall_ns, STEADY0_NS + came_ns)
        assert abs(wall_ns - told - (came_ns - at_ns)) < 0.5 * MS
