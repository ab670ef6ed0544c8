"""A relation of two messages' counters that is new, or was lost: who waits is found out soon."""

from collections.abc import Sequence
from random import Random

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


def queue(cycles: range, counter: int, wait: int, until: int, lane: str) -> list[Event]:
    """Frames of cycles before ``until`` wait; nothing overtakes, then all go at the bus's speed."""
    events, free = [], 0
    for n in cycles:
        stamp = max(n * MS + 220_000 + (wait if n < until else 0), free + 120_000)
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
