"""The clock against a simulated sender whose true sample instants are known."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.bus.sample_clock import MIN_STEP_NS, Instant, SampleClock

MS = 1_000_000
US = 1_000
EPOCH = 1_700_000_000 * 1000 * MS


@dataclass
class Sender:
    """A task of ``period`` on a drifting quartz, its frames late by latency, noise and hiccups."""

    cycles: int = 4000
    drift: float = 0.0
    latency: int = 100 * US
    noise: float = 2.0 * US
    hiccups: int = 0
    longest: int = 8 * MS
    first_hiccup: int = 0
    seed: int = 1
    true: list[int] = field(init=False)
    stamps: list[int] = field(init=False)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        period = MS * (1 + self.drift)
        self.true = [EPOCH + round(n * period) for n in range(self.cycles)]
        late = self.latency + np.abs(rng.normal(0, self.noise, self.cycles))
        starts = set(rng.integers(self.first_hiccup, self.cycles, self.hiccups).tolist())
        blocked, last = 0, 0
        self.stamps = []
        for n, true in enumerate(self.true):
            if n in starts:
                blocked = true + int(rng.integers(MS, self.longest))
            last = max(true + int(late[n]), blocked, last + 20 * US)
            self.stamps.append(last)


def run(
    clock: SampleClock, sender: Sender, lost: frozenset[int] = frozenset(), modulo: int = 256
) -> dict[int, Instant]:
    result: dict[int, Instant] = {}
    for n, stamp in enumerate(sender.stamps):
        if n not in lost:
            instant = clock.instant(stamp, n % modulo)
            assert instant is not None
            result[n] = instant
    return result


def errors_us(result: dict[int, Instant], sender: Sender, first: int = 0) -> list[float]:
    return [(at.t_ns - sender.true[n]) / US for n, at in result.items() if n >= first]


@settings(max_examples=40, deadline=None)
@given(
    drift=st.floats(-200e-6, 200e-6),
    noise=st.floats(0, 20),
    hiccups=st.integers(0, 40),
    loss=st.floats(0, 0.1),
    modulo=st.sampled_from([15, 16, 256]),
    seed=st.integers(0, 1000),
)
def test_instants_rise_and_stay_near_the_truth(
    drift: float, noise: float, hiccups: int, loss: float, modulo: int, seed: int
) -> None:
    sender = Sender(
        drift=drift, noise=noise * US, hiccups=hiccups, first_hiccup=100, seed=seed, cycles=2500
    )
    rng = np.random.default_rng(seed)
    lost = frozenset(np.flatnonzero(rng.random(sender.cycles) < loss).tolist()) - {0, 2499}
    clock = SampleClock(MS, modulo)
    result = run(clock, sender, lost, modulo)
    instants = [at.t_ns for at in result.values()]
    assert all(a < b for a, b in pairwise(instants))
    assert all(at.t_ns <= sender.stamps[n] for n, at in result.items())
    assert sum(at.lost for at in result.values()) == len(lost)
    assert clock.restarts == 0
    # Latency is 100 us. Before the drift is known, the envelope of a slow sender is as old as its
    # window: 9 blocks of 64 cycles, 115.2 us at 200 ppm.
    assert max(errors_us(result, sender)) < 100 + 4 * noise + 60
    assert min(errors_us(result, sender)) > 100 - 9 * 64 * 0.2 - 1


@pytest.mark.parametrize("drift", [-200e-6, -50e-6, 0.0, 200e-6])
def test_drift_is_followed(drift: float) -> None:
    sender = Sender(cycles=8000, drift=drift, hiccups=80, first_hiccup=50)
    clock = SampleClock(MS, 256)
    result = run(clock, sender)
    assert clock.drift_ppm == pytest.approx(drift * 1e6, abs=2)
    settled = errors_us(result, sender, first=3000)
    assert min(settled) > 95
    assert max(settled) < 105


def test_bursts_after_hiccups_are_spread_over_their_cycles() -> None:
    sender = Sender(hiccups=200, first_hiccup=10)
    raw = [stamp - true for stamp, true in zip(sender.stamps, sender.true, strict=True)]
    assert max(raw) > 5 * MS
    worst = errors_us(run(SampleClock(MS, 256), sender), sender, first=10)
    assert max(worst) < 120


@pytest.mark.parametrize("median_ms", [0.3, 1.0])
def test_a_sender_late_all_the_time_is_still_told_its_cycles(median_ms: float) -> None:
    """A busy machine: the task wakes at random and then sends every cycle that is due."""
    rng = np.random.default_rng(3)
    clock = SampleClock(MS, 256)
    wake, late, wrong = EPOCH, [], []
    for n in range(10_000):
        true = EPOCH + n * MS
        if true > wake:
            wake = true + int(rng.exponential(median_ms * MS))
        wake += 20 * US
        at = clock.instant(wake, n % 256)
        assert at is not None
        late.append(wake - true)
        wrong.append(abs(at.t_ns - true))
    assert np.percentile(late[1000:], 99) > 1 * MS
    assert max(wrong[1000:]) < 60 * US
    assert clock.restarts == 0


def test_losses_around_a_restart_are_counted_in_every_lane() -> None:
    clock = SampleClock(MS, 256)
    lost = {"a": 0, "b": 0}
    for n in range(100):
        if n in (50, 51, 52):
            continue
        slip = 0 if n < 50 else 40 * MS  # a silence that ended late: the line starts anew
        for lane in lost:
            at = clock.instant(EPOCH + n * MS + slip, n, lane)
            assert at is not None
            lost[lane] += at.lost
    assert clock.restarts == 1
    assert lost == {"a": 3, "b": 3}


def test_starting_inside_a_hiccup_ends_with_the_burst() -> None:
    sender = Sender(cycles=100)
    sender.stamps[:6] = [sender.true[5] + 100 * US + i * 20 * US for i in range(6)]
    result = run(SampleClock(MS, 256), sender)
    instants = [at.t_ns for at in result.values()]
    assert all(a < b for a, b in pairwise(instants))
    assert all(at.t_ns <= sender.stamps[n] + 6 * MIN_STEP_NS for n, at in result.items())
    assert sum(at.lost for at in result.values()) == 0
    assert max(errors_us(result, sender, first=7)) < 120


@pytest.mark.parametrize("modulo", [16, 256])
def test_a_loss_longer_than_the_counter_is_counted(modulo: int) -> None:
    sender = Sender(cycles=2000)
    lost = frozenset(range(700, 700 + 3 * modulo + 5))
    clock = SampleClock(MS, modulo)
    result = run(clock, sender, lost, modulo)
    assert sum(at.lost for at in result.values()) == len(lost)
    assert clock.restarts == 0
    assert max(errors_us(result, sender)) < 120


@pytest.mark.parametrize(("pause_ms", "jump"), [(50, 123), (800, 0), (5, 77), (3000, 1)])
def test_a_restarted_sender_is_followed_at_once(pause_ms: int, jump: int) -> None:
    sender = Sender(cycles=600)
    clock = SampleClock(MS, 256)
    instants: list[int] = []
    for n, stamp in enumerate(sender.stamps):
        later, count = (0, n) if n < 300 else (pause_ms * MS + 371 * US, jump + n - 300)
        at = clock.instant(stamp + later, count % 256)
        if at is None:  # the new count may happen to begin with the old number
            continue
        instants.append(at.t_ns)
        assert at.t_ns <= stamp + later
        # 800 ms on, counter 0 may pass for a late frame of the old count for a few cycles
        if n >= 300:
            assert abs(at.t_ns - sender.true[n] - later) < 1.2 * MS
    assert all(a < b for a, b in pairwise(instants))
    assert clock.restarts >= 1
    assert abs(instants[-1] - sender.true[-1] - later) < 200 * US


def test_a_sender_that_slips_without_catching_up_is_followed_within_16_cycles() -> None:
    sender = Sender(cycles=600)
    clock = SampleClock(MS, 256)
    for n, stamp in enumerate(sender.stamps):
        slip = 0 if n < 300 else 7 * MS
        at = clock.instant(stamp + slip, n % 256)
        assert at is not None
        if n >= 316:
            assert abs(at.t_ns - sender.true[n] - slip) < 200 * US
    assert clock.restarts == 1


def test_hiccups_that_follow_each_other_are_not_taken_for_a_slip() -> None:
    sender = Sender(cycles=400)
    free = 0
    for n in range(200, 260):  # held up for 7 ms every 6 cycles: never in time, always catching up
        free = max(free, sender.true[n // 6 * 6] + 7 * MS) + 20 * US
        sender.stamps[n] = free
    late = [sender.stamps[n] - sender.true[n] for n in range(200, 260)]
    assert min(late) > MS
    clock = SampleClock(MS, 256)
    assert max(errors_us(run(clock, sender), sender)) < 120
    assert clock.restarts == 0


def test_a_slip_is_followed_even_if_frames_keep_falling_behind_and_catching_up() -> None:
    sender = Sender(cycles=800)
    clock = SampleClock(MS, 256)
    for n, stamp in enumerate(sender.stamps):
        slip = 0 if n < 300 else 7 * MS + n % 3 * 800 * US
        at = clock.instant(stamp + slip, n % 256)
        assert at is not None
        if n >= 300 + 130:
            assert abs(at.t_ns - sender.true[n] - 7 * MS) < 200 * US
    assert clock.restarts >= 1


def test_frames_that_wait_on_a_full_bus_do_not_move_the_line_again_and_again() -> None:
    """Ever later, and then less: the line went along by 1 ms each time, until it was 3 ms late."""
    sender = Sender(cycles=1600)
    clock = SampleClock(MS, 256)
    off = []
    for n, stamp in enumerate(sender.stamps):
        full = 600 <= n < 840
        wait = min(1.2 + (n - 600) // 40 * 0.6, 3.2) + 0.2 * (n % 3) if full else 0.0
        at = clock.instant(stamp + round(wait * MS), n % 256)
        assert at is not None
        if at.trusted:
            off.append(abs(at.t_ns - sender.true[n]))
    assert max(off) < 1.5 * MS
    assert len(off) > 1300


@pytest.mark.parametrize("slips_ms", [(50, 2.2), (7, 2.2), (1, 1, 1, 1, 1), (3, 2, 1, 3)])
def test_a_sender_that_slips_time_and_again_is_followed_each_time(
    slips_ms: tuple[float, ...],
) -> None:
    """It is late by one and the same, as frames that wait are not: a set clock, a busy sender."""
    sender = Sender(cycles=300 + 200 * len(slips_ms))
    clock = SampleClock(MS, 256)
    for n, stamp in enumerate(sender.stamps):
        k, since = divmod(n - 300, 200)
        slipped = round(sum(slips_ms[: max(k + 1, 0)]) * MS)
        at = clock.instant(stamp + slipped, n % 256)
        assert at is not None
        if n < 300 or since >= 64:
            assert at.trusted
            assert abs(at.t_ns - sender.true[n] - slipped) < 200 * US
    assert clock.restarts == len(slips_ms)


@pytest.mark.parametrize("jump_s", [-3600, -1, 1, 3600])
def test_jumping_stamps_are_followed_at_once(jump_s: int) -> None:
    sender = Sender(cycles=600)
    clock = SampleClock(MS, 256)
    for n, stamp in enumerate(sender.stamps):
        moved = stamp + (0 if n < 300 else jump_s * 1000 * MS)
        at = clock.instant(moved, n % 256)
        assert at is not None
        assert moved - 1.2 * MS < at.t_ns <= moved
    assert clock.restarts <= 1


def test_a_wrong_cycle_time_never_runs_away() -> None:
    clock = SampleClock(MS, 256)
    for period in (1_050_000, 930_000):
        for n in range(3000):
            stamp = EPOCH + period * 4000 + n * period
            at = clock.instant(stamp, n % 256)
            assert at is None or stamp - 4 * MS < at.t_ns <= stamp + MS


def test_a_repeated_frame_has_no_instant_however_long_it_repeats() -> None:
    clock = SampleClock(MS, 16)
    assert clock.instant(EPOCH, 3) is not None
    assert all(clock.instant(EPOCH + n * MS, 3) is None for n in range(1, 100))
    assert clock.instant(EPOCH + 100 * MS, 4) is not None


def test_messages_of_one_cycle_keep_one_instant_through_drift_and_hiccups() -> None:
    sender = Sender(cycles=6000, drift=150e-6, hiccups=100, first_hiccup=50)
    clock = SampleClock(MS, 256)
    rng = np.random.default_rng(5)
    for n, stamp in enumerate(sender.stamps):
        if rng.random() < 0.02:
            continue
        first = clock.instant(stamp, n % 256, "state")
        second = clock.instant(stamp + 10 * US, (n + 99) % 256, "torques")
        assert first is not None
        assert second is not None
        assert second.t_ns == first.t_ns
    assert clock.restarts == 0


@given(phase_us=st.integers(-450, 450))
def test_a_second_message_elsewhere_in_the_cycle_joins_the_nearest(phase_us: int) -> None:
    sender = Sender(cycles=200, noise=0)
    clock = SampleClock(MS, 256)
    frames = [(s, n, "a") for n, s in enumerate(sender.stamps)]
    frames += [(s + phase_us * US, n, "b") for n, s in enumerate(sender.stamps)]
    instants: dict[tuple[int, str], int] = {}
    for stamp, n, lane in sorted(frames):
        at = clock.instant(stamp, n % 256, lane)
        assert at is not None
        instants[n, lane] = at.t_ns
    assert all(instants[n, "a"] == instants[n, "b"] for n in range(5, 200))


def test_a_lane_that_joined_during_a_hiccup_is_put_right() -> None:
    """b's first frame is held back 3 ms, a's is not: b would be three cycles ahead for ever."""
    clock = SampleClock(MS, 256)
    frames = [(EPOCH + n * MS, n, "a") for n in range(100)]
    frames += [(EPOCH + n * MS + 50 * US, n, "b") for n in range(4, 100)]
    frames += [(EPOCH + 3 * MS + (10 + n) * US, n, "b") for n in range(4)]
    instants: dict[tuple[int, str], int] = {}
    for stamp, n, lane in sorted(frames):
        at = clock.instant(stamp, n, lane)
        assert at is not None
        instants[n, lane] = at.t_ns
    assert instants[0, "b"] != instants[0, "a"]
    assert all(instants[n, "a"] == instants[n, "b"] for n in range(5, 100))


def test_frames_without_a_place_do_not_move_the_others() -> None:
    """All counters jump at once, and another sender's frames keep b's from being believed.

    b's own frames were once taken for the newest place on the line, and a was late beside them.
    """
    clock = SampleClock(MS, 256)
    frames = []
    for n in range(400):
        jumped = (n + 9 if n >= 200 else n) % 256
        frames.append((EPOCH + n * MS, jumped, "a", n))
        frames.append((EPOCH + n * MS + 100 * US, jumped, "b", n))
        if 150 <= n < 240:
            frames.append((EPOCH + n * MS + 500 * US, (jumped + 97) % 256, "b", -1))
    late = []
    for stamp, counter, lane, n in sorted(frames):
        at = clock.instant(stamp, counter, lane)
        assert at is not None
        if n >= 210 and (lane == "a" or n >= 250):
            late.append(stamp - at.t_ns)
            assert at.trusted
    assert max(late) < MS // 2


def test_who_waited_since_the_start_puts_no_other_in_doubt() -> None:
    """b's frames wait 20 ms from the first on, then no more: a was in time, and counts on."""
    clock = SampleClock(MS, 256)
    frames = [(EPOCH + n * MS, n % 256, "a", n) for n in range(1200)]
    for n in range(1180):
        wait = 20 * MS if n < 400 else 0
        stamp = max(EPOCH + n * MS + wait, EPOCH + 419 * MS + (n - 399) * US if n >= 400 else 0)
        frames.append((stamp + 100 * US, n % 256, "b", n))
    untrusted = {"a": 0, "b": 0}
    for stamp, counter, lane, n in sorted(frames):
        at = clock.instant(stamp, counter, lane)
        assert at is not None
        untrusted[lane] += not at.trusted
        if n > 600:
            assert at.trusted
            assert abs(stamp - at.t_ns) < MS
    assert untrusted["b"] == 0
    assert untrusted["a"] == 0


def test_a_line_that_moved_is_told_and_begins_at_the_least_late_frame() -> None:
    clock = SampleClock(MS, 256)
    for n in range(300):
        clock.instant(EPOCH + n * MS, n % 256)
    assert clock.moved_ns == 0
    late = [3 * MS + (k % 4) * MS // 2 for k in range(200)]  # 3 to 4.5 ms, never in time
    for k, by in enumerate(late):
        at = clock.instant(EPOCH + (300 + k) * MS + by, (300 + k) % 256)
        assert at is not None
    assert clock.moved_ns == pytest.approx(3 * MS, abs=MS // 2)
    assert at is not None
    assert at.t_ns == EPOCH + 499 * MS + clock.moved_ns


def test_a_frame_that_cannot_be_trusted_gets_the_instant_that_was_due() -> None:
    sender = Sender(cycles=200)
    clock = SampleClock(MS, 256)
    last = 0
    for n, stamp in enumerate(sender.stamps):
        if n % 7 == 3:
            t_ns = clock.expected(stamp)
        else:
            at = clock.instant(stamp, n % 256)
            assert at is not None
            t_ns = at.t_ns
        assert last < t_ns <= stamp
        assert abs(t_ns - sender.true[n]) < 200 * US
        last = t_ns


@settings(max_examples=30, deadline=None)
@given(
    steps=st.lists(
        st.tuples(st.integers(-2 * MS, 40 * MS), st.integers(0, 255), st.sampled_from("ab")),
        min_size=1,
        max_size=300,
    )
)
def test_any_sequence_is_survived_and_repeatable(steps: list[tuple[int, int, str]]) -> None:
    clocks = SampleClock(MS, 256), SampleClock(MS, 256)
    stamp = EPOCH
    for step, counter, lane in steps:
        stamp += step
        first, again = (clock.instant(stamp, counter, lane) for clock in clocks)
        assert first == again
        if first is not None:
            assert first.t_ns <= stamp + MS
            assert first.lost >= 0
