"""Two messages of one sender on one clock: which frames wait, and which counter cannot be."""

from collections.abc import Iterator

import pytest

from eps_hil.bus.sample_clock import Instant, SampleClock

MS = 1_000_000
EPOCH = 1_700_000_000 * 1000 * MS
PLACE = {"a": 100_000, "b": 220_000}

Event = tuple[int, int, str]


def traffic(
    cycles: int, late_ns: dict[str, int], since: int, until: int, *, counter_b: int = 0
) -> Iterator[Event]:
    """(stamp, cycle, lane) in order of the stamps; a late lane is a queue: nothing overtakes."""
    events: list[Event] = []
    free = dict.fromkeys(PLACE, 0)
    for n in range(cycles):
        for lane, place in PLACE.items():
            wait = late_ns.get(lane, 0) if since <= n < until else 0
            stamp = max(EPOCH + n * MS + place + wait, free[lane] + 120_000)
            free[lane] = stamp
            events.append((stamp, n, lane))
    yield from sorted(events)


def run(clock: SampleClock, events: Iterator[Event]) -> dict[tuple[int, str], Instant]:
    found = {}
    for stamp, n, lane in events:
        at = clock.instant(stamp, (n + (77 if lane == "b" else 0)) % 256, lane)
        assert at is not None
        found[n, lane] = at
    return found


@pytest.mark.parametrize("late_ms", [5, 20, 150])
@pytest.mark.parametrize("lane", ["a", "b"])
def test_frames_of_one_late_message_keep_their_cycle_and_are_not_trusted(
    lane: str, late_ms: int
) -> None:
    clock = SampleClock(MS, 256)
    found = run(clock, traffic(1400, {lane: late_ms * MS}, 200, 900))
    other = "b" if lane == "a" else "a"
    for n in range(220, 900):
        assert abs(found[n, lane].t_ns - found[n, other].t_ns) < 0.2 * MS
        assert not found[n, lane].trusted
        assert found[n, other].trusted
    assert all(found[n, each].trusted for n in range(1100, 1400) for each in "ab")
    assert clock.restarts == 0


def test_a_message_that_was_interrupted_is_believed_again_after_a_while() -> None:
    """It goes on where it stopped: by its counter it is late for ever."""
    clock = SampleClock(MS, 256)
    trusted = {}
    for n in range(2500):
        clock.instant(EPOCH + n * MS + PLACE["a"], n % 256, "a")
        if 300 <= n < 350:
            continue
        at = clock.instant(EPOCH + n * MS + PLACE["b"], (n - (50 if n >= 350 else 0)) % 256, "b")
        assert at is not None
        trusted[n] = at.trusted
        if n > 1700:
            assert abs(at.t_ns - EPOCH - n * MS) < 0.3 * MS
    assert not any(trusted[n] for n in range(350, 1100))
    assert all(trusted[n] for n in range(1700, 2500))


def test_a_sender_that_paused_is_believed_at_once() -> None:
    found = run(SampleClock(MS, 256), traffic(3000, dict.fromkeys("ab", 32 * MS), 200, 3000))
    assert all(at.trusted for at in found.values())
    for n in range(201, 3000):
        assert abs(found[n, "a"].t_ns - found[n, "b"].t_ns) < 2_000


def test_a_short_hiccup_of_all_messages_is_trusted() -> None:
    found = run(SampleClock(MS, 256), traffic(600, dict.fromkeys("ab", 9 * MS), 200, 206))
    assert all(at.trusted for at in found.values())


@pytest.mark.parametrize("jump", [5, 40, 200])
def test_a_counter_that_cannot_be_is_not_trusted_until_it_goes_on(jump: int) -> None:
    clock = SampleClock(MS, 256)
    verdicts = []
    for n in range(600):
        clock.instant(EPOCH + n * MS + PLACE["a"], n % 256, "a")
        at = clock.instant(EPOCH + n * MS + PLACE["b"], (n + (jump if n >= 300 else 0)) % 256, "b")
        assert at is not None
        verdicts.append(at.trusted)
        assert abs(at.t_ns - EPOCH - n * MS) < 0.3 * MS
    assert [n for n, trusted in enumerate(verdicts) if not trusted] == list(range(300, 307))


def test_a_second_count_between_the_first_is_never_trusted() -> None:
    clock = SampleClock(MS, 256)
    for n in range(600):
        first = clock.instant(EPOCH + n * MS, n % 256, "a")
        assert first is not None
        assert first.trusted
        if n >= 300:
            second = clock.instant(EPOCH + n * MS + 400_000, (n + 97) % 256, "a")
            assert second is not None
            assert not second.trusted
            assert second.t_ns > first.t_ns


def test_after_a_silence_a_message_of_two_senders_is_believed_by_its_time() -> None:
    """The second came as the sender slipped, and is gone: by its counters the first one is late."""
    clock = SampleClock(MS, 256)
    for n in range(1100):
        at = EPOCH + n * MS + (6 * MS if n > 400 else 0)  # held up between the two messages
        if 480 <= n < 700:
            continue
        b = None if n == 700 else clock.instant(at + PLACE["a"], n % 256, "b")
        a = clock.instant(at + PLACE["b"] + (6 * MS if n == 400 else 0), n % 256, "a")
        if 405 <= n < 480:
            clock.instant(at + 600_000, (n + 97) % 256, "b")
        if n >= 710:
            assert a is not None
            assert b is not None
            assert a.trusted
            assert b.trusted
            assert abs(a.t_ns - at) < 0.3 * MS
            assert abs(b.t_ns - at) < 0.3 * MS


def test_a_clock_that_is_set_back_keeps_the_messages_together() -> None:
    clock = SampleClock(MS, 256)
    for n in range(600):
        set_by = -500 * MS if n >= 300 else 0
        found = [
            clock.instant(EPOCH + n * MS + place + set_by, n % 256, lane)
            for lane, place in PLACE.items()
        ]
        assert found[0] is not None
        assert found[1] is not None
        assert found[0].trusted
        assert found[1].trusted
        assert abs(found[1].t_ns - found[0].t_ns) < 2_000


def test_a_message_that_becomes_late_while_the_other_is_missing_is_told_when_it_is_back() -> None:
    """The sync frame was missing; when it is back, the torques are 20 ms late."""
    clock = SampleClock(MS, 256)
    found = run(
        clock,
        (
            event
            for event in traffic(2400, {"b": 20 * MS}, 320, 700)
            if not (event[2] == "a" and 300 <= event[1] < 370)
        ),
    )
    # a is right at once, and b is not to be believed once the two can be compared
    for n in range(375, 700):
        assert abs(found[n, "a"].t_ns - EPOCH - n * MS) < 0.3 * MS
        assert found[n, "a"].trusted
        assert not found[n, "b"].trusted
    assert all(found[n, lane].trusted for n in range(800, 2400) for lane in "ab")
