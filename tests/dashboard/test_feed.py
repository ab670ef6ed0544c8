"""What a page is sent: batches, and less of them where it is slow."""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from eps_hil.dashboard.feed import IN_FLIGHT, Feed, answer, bucket_for
from eps_hil.dashboard.store import Block, Store, Track
from eps_hil.dashboard.traces import AT_ONE_INSTANT, NAMES
from eps_hil.dashboard.wire import Kind, pack, unpack

MS = 1_000_000
Blocks = Callable[[float, float], dict[str, Block]]


def head(message: bytes | None) -> Any:
    """Kind, number, buckets, begin, bucket."""
    assert message is not None
    magic, *rest = struct.unpack_from("<4sB3xIIdd", message)
    assert magic == b"EPS1"
    n = rest[2]
    assert len(message) == 32 + 8 * n * (len(NAMES) + len(AT_ONE_INSTANT))
    kind, number, n, begin, bucket = rest
    return kind, number, n, begin, bucket


@pytest.fixture
def store(blocks: Blocks) -> Store:
    made = Store(60.0)
    made.append(blocks(0.0, 12.0))
    return made


def test_the_first_message_is_the_window_and_the_next_what_came_since(
    store: Store, blocks: Blocks
) -> None:
    feed = Feed()
    assert feed.next(store) is None, "nothing before the page says what it shows"
    feed.view(10.0, 1000)
    kind, number, n, _, bucket = head(feed.next(store))
    assert (kind, number, n, bucket) == (Kind.BEGINS, 1, 1000, pytest.approx(0.01))
    assert feed.next(store) is None, "nothing new"
    store.append(blocks(12.0, 12.04))
    assert head(feed.next(store))[:3] == (Kind.GOES_ON, 2, 4)


def test_batches_join_without_a_hole_or_a_repetition(store: Store, blocks: Blocks) -> None:
    feed, whole = Feed(), Feed()
    feed.view(5.0, 500)
    parts, end_s = [feed.next(store)], 12.0
    for step_s in (0.013, 0.04, 0.001, 0.3, 0.027):
        store.append(blocks(end_s, end_s + step_s))
        end_s += step_s
        parts.append(feed.next(store))
        feed.drawn(99)
        feed.drawn(feed._sent)
    whole.view(10.0, 1000)
    all_at_once = strips(whole.next(store))
    joined = np.concatenate([strips(one) for one in parts if one is not None], axis=1)
    n = joined.shape[1]
    assert np.array_equal(joined, all_at_once[:, -n:], equal_nan=True)


def strips(message: bytes | None) -> Any:
    n = head(message)[2]
    assert message is not None
    values = np.frombuffer(message, "<f4", 2 * n * len(NAMES), 32)
    return values.reshape(len(NAMES), -1)


def test_a_slow_page_has_few_messages_each_with_all_that_came_meanwhile(
    store: Store, blocks: Blocks
) -> None:
    slow, quick = Feed(), Feed()
    for feed in (slow, quick):
        feed.view(10.0, 1000)
    given = {"slow": 0, "quick": 0}
    for k in range(100):
        store.append(blocks(12.0 + 0.04 * k, 12.04 + 0.04 * k))
        if (message := quick.next(store)) is not None:
            given["quick"] += 1
            quick.drawn(head(message)[1])
        if slow.next(store) is not None:
            given["slow"] += 1
    assert given == {"slow": IN_FLIGHT, "quick": 100}
    assert slow.waits
    slow.drawn(1)
    kind, number, n, *_ = head(slow.next(store))
    assert (kind, number) == (Kind.GOES_ON, 3)
    assert n == 98 * 4, "the 3.92 s since its second message, in one"


def test_after_a_long_pause_it_begins_anew_with_no_more_than_its_window(
    store: Store, blocks: Blocks
) -> None:
    feed = Feed()
    feed.view(2.0, 200)
    feed.drawn(head(feed.next(store))[1])
    store.append(blocks(12.0, 42.0))
    kind, _, n, begin, bucket = head(feed.next(store))
    assert (kind, n) == (Kind.BEGINS, 200)
    assert begin + n * bucket == pytest.approx(1_790_000_000 + 42.0, abs=0.02)


def test_a_page_that_claims_to_have_drawn_what_it_was_not_sent_gains_nothing(
    store: Store, blocks: Blocks
) -> None:
    feed = Feed()
    feed.view(2.0, 200)
    feed.drawn(10_000)
    feed.next(store)
    store.append(blocks(12.0, 12.1))
    feed.next(store)
    assert feed.waits


def test_pages_that_show_the_same_share_one_cut(store: Store) -> None:
    cut = store.cut(0, 10 * MS, 5)
    assert store.cut(0, 10 * MS, 5) is cut


def test_absurd_wishes_are_kept_within_reason(store: Store) -> None:
    feed = Feed()
    feed.view(1e12, 10**9)
    assert head(feed.next(store))[2] <= 4096
    assert bucket_for(0.001, 4000) == MS
    assert answer(store, 5.0, 1.0, 100, 1) is None
    assert answer(store, float("nan"), 1.0, 100, 1) is None


def test_an_answer_about_the_past_shows_it_in_detail(store: Store) -> None:
    begin_s = 1_790_000_000 + 3.0
    kind, number, n, begin, bucket = head(answer(store, begin_s, begin_s + 0.1, 1000, 7))
    assert (kind, number, bucket) == (Kind.ANSWERS, 7, pytest.approx(0.001))
    assert n in {100, 101}
    assert begin == pytest.approx(begin_s, abs=0.002)


def test_it_waits_for_a_trace_that_lags_but_not_for_one_that_stopped(blocks: Blocks) -> None:
    store = Store(60.0)
    store.append(blocks(0.0, 2.0))
    moving = blocks(2.0, 2.1)
    late = moving.pop(NAMES[0])
    store.append(moving)
    newest = store.newest_ns
    assert newest is not None
    horizon = store.horizon_ns
    assert horizon is not None
    assert newest - horizon == 100 * MS
    store.append({NAMES[0]: late})
    assert store.horizon_ns == newest
    more = blocks(2.1, 3.0)
    del more[NAMES[0]]
    store.append(more)
    assert store.horizon_ns == store.newest_ns


def test_only_the_last_seconds_are_kept_and_what_does_not_rise_is_left_out() -> None:
    track = Track(length_ns=1_000 * MS)
    for k in range(20):
        t_ns = np.arange(1000 * k, 1000 * (k + 1), dtype=np.int64) * MS
        track.append(t_ns, t_ns.astype(float))
    assert len(track.t_ns) == 1001
    assert len(track._t_ns) < 10_000, "memory does not grow"
    track.append(np.array([0, 5, 19_999, 20_000, 20_000, 20_001]) * MS, np.zeros(6))
    assert np.all(np.diff(track.t_ns) > 0)
    assert track.newest_ns == 20_001 * MS


def test_a_clock_that_was_set_back_begins_anew(blocks: Blocks) -> None:
    store, feed = Store(60.0), Feed()
    store.append(blocks(0.0, 5.0))
    feed.view(2.0, 200)
    feed.drawn(head(feed.next(store))[1])
    store.append(blocks(-100.0, -99.0))
    assert head(feed.next(store))[0] == Kind.BEGINS
    oldest = store.oldest_ns
    assert oldest is not None
    assert oldest < 1_790_000_000_000_000_000


def test_samples_between_processes_come_out_as_they_went_in(blocks: Blocks) -> None:
    sent = blocks(0.0, 0.05)
    got = unpack(pack(sent))
    assert list(got) == list(sent)
    for name in sent:
        assert np.array_equal(got[name][0], sent[name][0])
        assert np.array_equal(got[name][1], sent[name][1])
