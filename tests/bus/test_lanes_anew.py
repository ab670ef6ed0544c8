"""A relation of two messages' counters that is new, or was lost: who waits is found out soon."""

from collections.abc import Sequence
from random import Random

import pytest

from eps_hil.bus.protection import Seen
from eps_hil.bus.sample_clock import Instant, SampleClock

MS = 1_000_000
EPOCH = 1_700_000_000 * 1000 * MS

Event = tuple[int, int, int, str]
"""(stamp after the start, true cycle, counter, message)."""


def run(events: Sequence[Event]) -> dict[tuple[int, str], Instant]:
    clock, found = SampleClock(MS, 256), {}
    for stamp, n, counter, lane in sorted(events):
        at = clock.instant(EPOCH + stamp, counter % 256, lane)
        if at is not None:
            found[n, lane] = at
    return found


def queue(
    cycles: range, counter: int, wait: int, until: int, lane: str, since: int = 0
) -> list[Event]:
    """Frames of cycles ``since`` to ``until`` wait; nothing overtakes, then all go at bus speed."""
    events, free = [], 0
    for n in cycles:
        stamp = max(n * MS + 220_000 + (wait if since <= n < until else 0), free + 120_000)
        free = stamp
        events.append((stamp, n, n + counter, lane))
    return events


def together(found: dict[tuple[int, str], Instant], n: int) -> bool:
    """Whether both messages of a cycle are trusted, and of one instant."""
    a, b = found[n, "a"], found[n, "b"]
    return a.trusted and b.trusted and abs(a.t_ns - b.t_ns) < 0.3 * MS


def test_a_message_that_waited_since_the_start_costs_the_others_a_moment() -> None:
    """Four cycles: by its place on the new line the other is too little late to be told at once."""
    first = [(n * MS + 100_000, n, n, "a") for n in range(1200)]
    found = run([*first, *queue(range(1200), 0, 4 * MS, 220, "b")])
    assert all(together(found, n) for n in range(330, 1200))


def test_a_relation_from_before_a_silence_is_not_held_against_the_other() -> None:
    """Both counters begin anew, but the second one with frames that had waited."""
    events = [(n * MS + 100_000, n, n, "a") for n in range(3300)]
    events += [(n * MS + 220_000, n, n, "b") for n in range(3300)]
    events += [(n * MS + 100_000, n, n + 100, "a") for n in range(3500, 4700)]
    found = run([*events, *queue(range(3475, 4700), 125, 105 * MS, 3500, "b")])
    assert all(together(found, n) for n in range(3750, 4700))


@pytest.mark.slow
def test_frames_that_come_in_a_burst_leave_their_relation_alone() -> None:
    """Of a bus that was blocked, and lost some: without that, 15 of 40 are doubted."""
    doubted = 0
    for seed in range(40):
        random = Random(seed)
        share = {"a": random.uniform(0.0, 0.8), "b": random.uniform(0.0, 0.8)}
        blocked, slot = random.randint(20, 100), random.choice([120_000, 300_000, 500_000])
        events, free, opens = [], 0, (3300 + blocked) * MS
        for n in range(4400):
            for lane, place in (("a", 100_000), ("b", 220_000)):
                if 3300 <= n < 3340 + blocked and random.random() < share[lane]:
                    continue
                wait = slot * random.random() if 3300 <= n < 3360 + blocked else 0.0
                free = max(n * MS + place, opens if n >= 3300 else 0, free + 120_000 + round(wait))
                events.append((free, n, n, lane))
        found = run(events)
        doubted += not all(together(found, n) for n in range(3550 + blocked, 4400))
    assert doubted <= 1


def decoded(events: Sequence[Event]) -> dict[tuple[int, str], Instant]:
    """As :func:`run`, where a counter that was there a moment ago has no instant."""
    clock, found, seen = SampleClock(MS, 256), {}, {lane: Seen(256, MS) for lane in "ab"}
    for stamp, n, count, lane in sorted(events):
        t, counter = EPOCH + stamp, count % 256
        again = seen[lane].again(t, counter, bytes([n % 251]))
        if again is not None:
            clock.again(t, counter, lane, other_data=not again)
            continue
        at = clock.instant(t, counter, lane)
        if at is not None:
            found[n, lane] = at
    return found


@pytest.mark.parametrize("back", [2, 3, 8, 14, 16, 20, 60])
def test_a_counter_that_jumps_back_is_believed_at_once(back: int) -> None:
    """Its frames come in time; by their counter they would be as late as it went back."""
    events = [(n * MS + 100_000, n, n, "a") for n in range(900)]
    events += [(n * MS + 220_000, n, n + 77 - (back if n >= 300 else 0), "b") for n in range(900)]
    found = decoded(events)
    assert all(together(found, n) for n in range(305 + back, 900))


@pytest.mark.parametrize("again", [4, 8])
def test_frames_that_waited_behind_others_that_came_again_keep_their_cycle(again: int) -> None:
    """A gateway repeats its last frames in a burst, and sends 10 ms late from then on."""
    events = [(n * MS + 100_000, n, n, "a") for n in range(700)]
    events += [(n * MS + 220_000 + (10 * MS if n >= 300 else 0), n, n, "b") for n in range(700)]
    events += [(305 * MS + 120_000 * k, n, n, "b") for k, n in enumerate(range(300 - again, 300))]
    found = decoded(events)
    for n in range(300, 700):
        assert abs(found[n, "b"].t_ns - found[n, "a"].t_ns) < 0.3 * MS
        assert n < 320 or not found[n, "b"].trusted


def test_a_counter_that_jumps_within_a_burst_puts_no_other_in_doubt() -> None:
    """By its counter the frames are early then; the line and the other message are right."""
    first = [(n * MS + 100_000, n, n, "a") for n in range(3400)]
    late = [
        (stamp, n, counter + (14 if n >= 3050 else 0), lane)
        for stamp, n, counter, lane in queue(range(3400), 0, 105 * MS, 3080, "b", 2900)
    ]
    found = run([*first, *late])
    assert all(found[n, "a"].trusted for n in range(3400))
    for n in range(3400):  # one that is early by less than half a period counts as in time
        assert abs(found[n, "a"].t_ns - EPOCH - n * MS - 100_000) < 0.5 * MS
    assert all(together(found, n) for n in range(3210, 3400))


def test_counters_that_begin_at_zero_keep_no_relation_that_was_a_guess() -> None:
    """One message was late as the service began; then the ECU is started anew."""
    events = [(n * MS + 100_000, n, n + 240, "a") for n in range(930)]
    events += queue(range(930), 240, 20 * MS, 600, "b")
    events = [each for each in events if each[0] >= 10 * MS and each[0] < 660 * MS]
    for place, lane in ((100_000, "a"), (220_000, "b")):
        events += [(n * MS + place + 820_000, n, n - 930, lane) for n in range(930, 1300)]
    found = run(events)
    assert all(together(found, n) for n in range(935, 1300))


@pytest.mark.parametrize("still", [30, 200])
def test_a_counter_that_stood_still_is_believed_as_it_goes_on(still: int) -> None:
    """Elsewhere in its count: the frames came in time all the while."""
    events = [(n * MS + 100_000, n, n, "a") for n in range(900)]
    for n in range(900):
        counter = n if n < 300 else 300 if n < 300 + still else n + 153
        events.append((n * MS + 220_000, n, counter, "b"))
    found = decoded(events)
    assert all(together(found, n) for n in range(312 + still, 900))


def test_a_counter_that_jumped_ahead_in_a_silence_puts_no_other_in_doubt() -> None:
    """What kept pace did not wait, and what is before its time did not either."""
    events = [
        (n * MS + place, n, n + (14 if lane == "b" and n >= 800 else 0), lane)
        for place, lane in ((220_000, "a"), (100_000, "b"))
        for n in range(1200)
        if n < 400 or n >= 800
    ]
    found = decoded(events)
    assert all(together(found, n) for n in range(805, 1200))


@pytest.mark.parametrize("held_ms", [8, 18, 30, 90, 300])
def test_a_sender_that_was_held_up_and_catches_up_loses_nothing(held_ms: int) -> None:
    """All its frames of that time come in a burst, in order; none is doubted, none is missing."""
    events, free = [], 0
    for n in range(1200):
        for lane, place in (("a", 100_000), ("b", 220_000)):
            held = (400 + held_ms) * MS if 400 <= n < 400 + held_ms else 0
            free = max(n * MS + place, held, free + 60_000)
            events.append((free, n, n + (77 if lane == "b" else 0), lane))
    found = run(events)
    assert sum(at.lost for at in found.values()) == 0
    assert all(at.trusted for at in found.values())
    assert all(together(found, n) for n in range(410 + 2 * held_ms, 1200))


@pytest.mark.parametrize("seed", [1, 9, 12, 50, 52, 80])
def test_counters_that_jumped_while_the_clock_was_set_keep_no_relation(seed: int) -> None:
    """Both messages' counters jump at random, and the clock goes back: where they fell then on the
    line is no relation, and as they count on none is in doubt because of it."""
    clock, random, after = SampleClock(MS, 256), Random(seed), []
    ends = random.randrange(350, 1000)
    set_at = random.randrange(300, ends)
    for n in range(ends + 250):
        back = 500 * MS if n >= set_at else 0
        for lane, place in (("a", 100_000), ("b", 220_000)):
            counter = random.randrange(256) if 300 <= n < ends else n
            at = clock.instant(EPOCH + n * MS + place - back, counter % 256, lane)
            if n >= ends + 40:
                assert at is not None
                after.append(at)
    assert all(at.trusted for at in after)
    assert all(
        abs(a.t_ns - b.t_ns) < 0.3 * MS for a, b in zip(after[::2], after[1::2], strict=True)
    )


@pytest.mark.parametrize("counter", [29, 20])
def test_a_message_that_begins_at_zero_after_a_silence_waits_for_nothing(counter: int) -> None:
    """The other began before it, with another counter: what their relation was is over."""
    events = [(n * MS + 100_000, n, n, "a") for n in range(500)]
    events += [(n * MS + 220_000, n, n, "b") for n in range(235)]
    events += [(n * MS + 610_000, n, n + counter - 545, "a") for n in range(545, 1600)]
    events += [(n * MS + 730_000, n, n - 634, "b") for n in range(634, 1600)]
    found = run(events)
    assert all(together(found, n) for n in range(640, 1600))
