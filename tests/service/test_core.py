"""The core without a bus: what is published, when, and that it depends on the frames alone."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.bus.frame import Frame
from eps_hil.bus.sample_clock import SampleClock
from eps_hil.estimation.age import AgeDoubt, ShiftDoubt
from eps_hil.estimation.batch import lanes
from eps_hil.estimation.stream import Estimate
from eps_hil.estimation.validity import Reason
from eps_hil.service.adaptation_config import AdaptationConfig
from eps_hil.service.config import ServiceConfig
from eps_hil.service.core import ServiceCore, Status, status_of
from eps_hil.service.setup import Parts, prepare

from .conftest import T0_NS, Receiver, TinyRig, decoded

CONFIG = Path("c.yaml")


def fresh(config: ServiceConfig) -> ServiceCore:
    return prepare(config, CONFIG).core


def drive(core: ServiceCore, rig: TinyRig, since: int, until: int) -> list[Frame]:
    return [f for k in range(since, until) for f in core.on_frames(rig.millisecond(k))]


def test_one_frame_a_millisecond_with_value_status_age_and_counter(
    parts: Parts, rig: TinyRig, receiver: Receiver
) -> None:
    sent = drive(parts.core, rig, 0, 400)
    assert len(sent) == 400
    first, last = receiver.read(sent[0]), receiver.read(sent[-1])
    assert first["EstimateStatus"] == Status.INVALID
    assert int(first["EstimateReason"]) & Reason.NOT_STARTED
    assert last["EstimateStatus"] == Status.VALID
    assert last["EstimateReason"] == 0
    assert parts.core.latest is not None
    assert last["RackForceEstimate"] == pytest.approx(parts.core.latest.rack_force_n, abs=0.11)
    assert last["EstimateAge"] == pytest.approx(parts.estimator.latency_s * 1e3, abs=0.7)
    assert [int(receiver.read(f)["Counter"]) for f in sent] == [k % 16 for k in range(400)]
    assert parts.core.steps == 400
    assert 200 < parts.core.valid_steps < 400


@pytest.mark.parametrize("hole_ms", [0, 300])
def test_a_start_amid_traffic_is_waited_for(
    config: ServiceConfig, rig: TinyRig, hole_ms: int
) -> None:
    """A torque that was wrong or late before the service looked shows it only where it ends.

    It has not looked before a hole that came at once.
    """
    service = replace(config.service, start_wait_s=0.75)
    waits = prepare(replace(config, service=service), CONFIG).core
    at_once, looks_since = fresh(config), None
    settling = Reason.SETTLING | Reason.FRICTION_UNKNOWN
    for k in range(hole_ms + 900):
        frames = rig.millisecond(k)
        if 5 <= k < 5 + hole_ms:
            continue
        for core in (waits, at_once):
            core.on_frames(frames)
        assert waits.latest is not None
        assert at_once.latest is not None
        assert waits.latest.rack_force_n == at_once.latest.rack_force_n
        if looks_since is None and not at_once.latest.reason & ~settling:
            looks_since = k
        if looks_since is not None and abs(k - looks_since - 750) < 2:
            continue  # the bus' own jitter
        waited = looks_since is not None and k > looks_since + 750
        assert waits.latest.valid == (at_once.latest.valid and waited)
        if at_once.latest.valid and not waited:
            assert waits.latest.reason == Reason.SETTLING
    assert looks_since is not None
    assert hole_ms < looks_since < hole_ms + 50
    assert waits.latest == at_once.latest


@pytest.mark.parametrize(
    ("late_ms", "rate_n_per_ms", "told"),
    [(5, 30.0, True), (5, 5.0, False), (1, 45.0, False), (0, 900.0, False)],
)
def test_an_age_that_nobody_knows_is_told_where_the_force_is_fast(
    late_ms: int, rate_n_per_ms: float, told: bool
) -> None:
    """The clock was set: until what was sampled then is out of the look-back.

    Frames that wait are late for as long as nobody can tell: from the third window of 5 ms on.
    """
    doubt, ms = AgeDoubt(22 * 10**6), 10**6
    said = []
    for k in range(200):  # the clock is set at 100, and the samples' line begins anew at 116
        receive = k + (late_ms if k >= 100 else 0)
        sample = k + (late_ms if k >= 116 else 0)
        estimate = Estimate((sample - 22) * ms, rate_n_per_ms * k, 0.0, True, Reason.FINE)
        said.append(doubt.stale(estimate, receive * ms, sample * ms))
    assert not any(said[:110])
    assert all(said[110:138]) == told
    assert not any(said[145:])
    assert any(said) == told


@pytest.mark.parametrize("paused_ms", [0.0, 1.0, 15.7])
def test_frames_that_never_catch_up_are_not_taken_to_have_waited(paused_ms: float) -> None:
    """By their counters they did wait; or the sender paused, and instants are off by as much.

    A bus that is blocked again and again puts off the clock's own verdict for 128 ms.
    """
    ms, rate_n_per_ms = 10**6, 9.0
    clock, doubt, free = SampleClock(ms, 256), AgeDoubt(22 * ms), 0
    wrong, told = [], 0
    for n in range(500):
        sent = T0_NS + n * ms + (round(paused_ms * ms) if n >= 300 else 0)
        blocked = max(6 * ms - (sent - T0_NS) % (10 * ms), 0) if 300 <= n < 450 else 0
        free = max(sent + blocked, free + 300_000)
        at = clock.instant(free, n % 256)
        assert at is not None
        estimate = Estimate(at.t_ns - 22 * ms, rate_n_per_ms * n, 0.0, True, Reason.FINE)
        stale = doubt.stale(estimate, free, at.t_ns)
        told += stale
        if abs(at.t_ns - sent) * rate_n_per_ms > 100 * ms and not stale:
            wrong.append(free)
    assert max(wrong, default=0) - min(wrong, default=0) < 20 * ms
    assert bool(told) == bool(wrong) == (paused_ms > 11)


@pytest.mark.parametrize(("speed_up", "told"), [(0.0, False), (2_000.0, True)])
def test_an_estimate_is_stale_where_instants_moved_while_the_rotor_sped_up(
    parts: Parts, speed_up: float, told: bool
) -> None:
    """Speed that changed in one millisecond seems to have changed in four."""
    doubt, ms = ShiftDoubt(22 * 10**6, parts.estimator, 0), 10**6
    parts.estimator.memory.carried.moment[0].acceleration = speed_up
    said = [doubt.stale(3 * ms if k >= 100 else 0, k * ms) for k in range(200)]
    assert not any(said[:100])
    assert all(said[100:144]) == told
    assert any(said) == told
    assert not any(said[146:])


def test_settling_is_told_from_invalid(parts: Parts, rig: TinyRig, receiver: Receiver) -> None:
    seen = [receiver.read(f)["EstimateStatus"] for f in drive(parts.core, rig, 0, 300)]
    assert Status.SETTLING in seen
    assert status_of(Reason.SETTLING | Reason.GAP) == Status.INVALID


def test_bunched_frames_publish_the_newest_once(config: ServiceConfig, rig: TinyRig) -> None:
    frames = [rig.millisecond(k) for k in range(300)]
    one_by_one, bunched = fresh(config), fresh(config)
    all_published = [f for batch in frames for f in one_by_one.on_frames(batch)]
    for batch in frames[:250]:
        bunched.on_frames(batch)
    late = bunched.on_frames([frame for batch in frames[250:260] for frame in batch])
    assert late == [all_published[259]]
    assert bunched.skipped == 9
    assert bunched.on_frames(frames[260]) == [all_published[260]]


@pytest.mark.slow
@settings(max_examples=20)
@given(cuts=st.lists(st.integers(1, 899), max_size=60), data=st.data())
def test_estimates_do_not_depend_on_how_frames_were_bunched(
    cuts: list[int], data: st.DataObject
) -> None:
    rig = TinyRig()
    frames = [frame for k in range(300) for frame in rig.millisecond(k)]
    whole, cut = fresh(_config()), fresh(_config())
    whole.record, cut.record = [], []
    published = [f for frame in frames for f in whole.on_frames([frame])]
    edges = sorted({0, *cuts, len(frames)})
    got = [f for a, b in itertools.pairwise(edges) for f in cut.on_frames(frames[a:b])]
    assert _bits(cut.record) == _bits(whole.record)
    assert set(f.data for f in got) <= set(f.data for f in published)
    assert len(got) + cut.skipped == len(published)


def test_batch_run_over_the_decoded_frames_gives_the_same_floats(
    config: ServiceConfig, rig: TinyRig
) -> None:
    frames = [f for k in range(1500) if not 700 <= k < 760 for f in rig.millisecond(k)]
    live = fresh(config)
    live.record = []
    live.on_frames(frames)
    parts = prepare(config, CONFIG)
    trace = parts.estimator.run(lanes(decoded(parts.decoder, frames)))
    by_instant = {int(t): k for k, t in enumerate(trace.t_ns)}
    assert len(live.record) == 1440
    for _, estimate in live.record:
        k = by_instant[estimate.t_ns]
        assert estimate.rack_force_n == trace.rack_force_n[k]
        assert estimate.friction_torque_nm == trace.friction_torque_nm[k]
        assert estimate.reason == trace.reason[k]


def test_a_gap_makes_it_invalid_with_a_reason_and_it_comes_back(parts: Parts, rig: TinyRig) -> None:
    drive(parts.core, rig, 0, 300)
    assert _latest(parts).valid
    drive(parts.core, rig, 360, 362)
    assert not _latest(parts).valid
    assert _latest(parts).reason != Reason.FINE
    drive(parts.core, rig, 362, 1200)
    assert _latest(parts).valid


def test_a_damaged_frame_makes_it_invalid_and_it_comes_back(
    parts: Parts, rig: TinyRig, receiver: Receiver
) -> None:
    drive(parts.core, rig, 0, 300)
    torque, *others = rig.millisecond(300)
    damaged = Frame(torque.t_ns, torque.can_id, bytes((torque.data[0] ^ 1,)) + torque.data[1:])
    parts.core.on_frames([damaged, *others])
    sent = drive(parts.core, rig, 301, 340)
    reasons = [Reason(int(receiver.read(f)["EstimateReason"])) for f in sent]
    assert any(reason & Reason.BAD_SAMPLE for reason in reasons)
    assert parts.decoder.faults["crc"] == 1
    drive(parts.core, rig, 340, 1200)
    assert _latest(parts).valid


def test_another_transmitter_of_our_id_makes_it_invalid_for_a_second(
    parts: Parts, rig: TinyRig, receiver: Receiver
) -> None:
    drive(parts.core, rig, 0, 300)
    stamp = rig.millisecond(300)[0].t_ns
    assert parts.core.on_frames([Frame(stamp, 0x120, bytes(8))]) == []
    (during,) = parts.core.on_frames(rig.millisecond(301))
    told = receiver.read(during)
    assert told["EstimateStatus"] == Status.INVALID
    assert told["EstimateReason"] == Reason.OTHER_TRANSMITTER
    assert parts.core.foreign == 1
    sent = drive(parts.core, rig, 302, 1400)
    assert receiver.read(sent[900])["EstimateStatus"] == Status.INVALID
    assert receiver.read(sent[-1])["EstimateStatus"] == Status.VALID


def test_own_and_error_frames_and_strangers_change_nothing(parts: Parts, rig: TinyRig) -> None:
    drive(parts.core, rig, 0, 10)
    before = (parts.core.steps, parts.core.latest)
    strangers = [
        Frame(0, 0x120, bytes(8), own=True),
        Frame(0, 0x100, bytes(8), error=True),
        Frame(0, 0x120, b"", remote=True),
        Frame(0, 0x100, b"", remote=True),
        Frame(0, 0x7FF, bytes(8)),
        Frame(0, 0x100, bytes(8), extended=True),
    ]
    assert parts.core.on_frames(strangers) == []
    assert (parts.core.steps, parts.core.latest) == before
    assert parts.core.foreign == 0


def test_a_repeated_sync_frame_is_not_a_step(parts: Parts, rig: TinyRig) -> None:
    drive(parts.core, rig, 0, 10)
    sync = rig.millisecond(10)[2]
    assert len(parts.core.on_frames([sync])) == 1
    again = Frame(sync.t_ns + 100_000, sync.can_id, sync.data)
    assert parts.core.on_frames([again]) == []
    assert parts.core.steps == 11


def test_without_an_encoder_nothing_is_ever_returned(parts: Parts, rig: TinyRig) -> None:
    core = ServiceCore(parts.decoder, parts.estimator)
    assert drive(core, rig, 0, 50) == []
    assert core.steps == 50


@pytest.mark.parametrize("adapted", [False, True])
def test_a_warm_service_answers_bit_for_bit_as_a_cold_one(
    config: ServiceConfig, rig: TinyRig, adapted: bool
) -> None:
    """Compiled calls for usual frames; lost, late, repeated and spoilt ones between them."""
    if adapted:
        config = replace(config, adaptation=AdaptationConfig(method="reversals"))
    cold, warm = prepare(config, CONFIG), prepare(config, CONFIG)
    warm.warm_up()
    assert (warm.core.live is None) == adapted
    rng, answers = np.random.default_rng(7), 0
    for k in range(1_500):
        frames = rig.millisecond(k)
        kind, which = rng.integers(60), int(rng.integers(3))
        if kind == 0:
            del frames[which]
        elif kind == 1:
            frames.insert(which, frames[which])
        elif kind == 2:
            frames[which] = replace(frames[which], data=bytes([*frames[which].data[:7], 0]))
        elif kind == 3:
            frames = [replace(frame, t_ns=frame.t_ns + 3_000_000) for frame in frames]
        elif kind == 4:
            frames.insert(0, replace(frames[0], own=True))
        now = partial(int, frames[-1].t_ns)
        said = [parts.core.on_frames(frames, now) for parts in (cold, warm)]
        assert said[0] == said[1]
        answers += len(said[0])
    assert answers > 1_400
    assert list(cold.core.load_cell) == list(warm.core.load_cell)
    assert cold.decoder.faults == warm.decoder.faults
    assert sum(warm.decoder.faults.values()) > 20


def test_load_cell_beside_the_estimate_is_of_the_same_instant(parts: Parts, rig: TinyRig) -> None:
    drive(parts.core, rig, 0, 300)
    at = _latest(parts).t_ns
    shown = parts.core.load_cell_at(at)
    assert shown is not None
    phase = 2 * math.pi * 2.0 * (at - rig.millisecond(0)[0].t_ns) * 1e-9
    assert shown == pytest.approx(1000.0 * math.sin(phase), abs=15.0)
    assert parts.core.load_cell_at(at + 10**10) is None


def _latest(parts: Parts) -> Estimate:
    assert parts.core.latest is not None
    return parts.core.latest


def _bits(record: Sequence[tuple[int, Estimate]] | None) -> list[tuple[object, ...]]:
    assert record
    return [
        (t, e.t_ns, e.rack_force_n.hex(), e.friction_torque_nm.hex(), e.reason) for t, e in record
    ]


def _config() -> ServiceConfig:
    from eps_hil.service.config import load_config

    from .conftest import ROOT

    return load_config(ROOT / "configs" / "demo_udp.yaml")


def at(now_ns: int) -> Callable[[], int]:
    """A clock that stands still."""
    return lambda: now_ns


def test_a_batch_that_waited_is_said_to_be_stale(
    parts: Parts, rig: TinyRig, receiver: Receiver
) -> None:
    drive(parts.core, rig, 0, 400)
    batch = rig.millisecond(400)
    (late,) = parts.core.on_frames(batch, at(batch[-1].t_ns + 300_000_000))
    told = receiver.read(late)
    assert told["EstimateStatus"] == Status.INVALID
    assert told["EstimateReason"] == Reason.TIME
    assert told["EstimateAge"] == 127.5
    assert parts.core.stale == 1
    batch = rig.millisecond(401)
    (prompt,) = parts.core.on_frames(batch, at(batch[-1].t_ns + 3_000_000))
    told = receiver.read(prompt)
    assert told["EstimateStatus"] == Status.VALID
    assert told["EstimateAge"] == pytest.approx(parts.estimator.latency_s * 1e3 + 3.0, abs=0.8)


def test_how_late_the_service_was_changes_no_estimate(config: ServiceConfig, rig: TinyRig) -> None:
    prompt, late = fresh(config), fresh(config)
    prompt.record, late.record = [], []
    for k in range(400):
        batch = rig.millisecond(k)
        prompt.on_frames(batch)
        late.on_frames(batch, at(batch[-1].t_ns + k * 1_000_000))
    assert _bits(late.record) == _bits(prompt.record)
    assert late.stale > 300


@pytest.mark.parametrize("back_ms", [1, 5, 500, 1500])
def test_a_clock_set_back_is_never_a_frozen_valid(
    parts: Parts, rig: TinyRig, receiver: Receiver, back_ms: int
) -> None:
    drive(parts.core, rig, 0, 400)
    sent = []
    for k in range(400, 1400):
        set_back = [replace(f, t_ns=f.t_ns - back_ms * 1_000_000) for f in rig.millisecond(k)]
        sent += [receiver.read(f) for f in parts.core.on_frames(set_back)]
    valid = [each for each in sent if each["EstimateStatus"] == Status.VALID]
    forces = [each["RackForceEstimate"] for each in valid]
    repeated = sum(a == b for a, b in itertools.pairwise(forces))
    assert repeated < 10
    assert sent[-1]["EstimateStatus"] == Status.VALID


@pytest.mark.parametrize("ppm", [pytest.param(-300, marks=pytest.mark.slow), 300])
def test_a_drifting_rig_gets_no_answer_twice_as_new(parts: Parts, rig: TinyRig, ppm: int) -> None:
    core = parts.core
    core.record = []
    for k in range(8000):
        frames = [
            replace(f, t_ns=T0_NS + round((f.t_ns - T0_NS) * (1 + ppm * 1e-6)))
            for f in rig.millisecond(k)
        ]
        core.on_frames(frames)
    stamps = [estimate.t_ns for _, estimate in core.record]
    assert len(set(stamps)) == len(stamps)
    assert abs(len(stamps) - 8000) <= 4
    assert all(estimate.valid for _, estimate in core.record[1000:])
