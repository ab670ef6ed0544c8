"""Usual frames by compiled calls: samples, faults, payloads as of the decoder and encoder."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from fastcrc import crc8
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.bus.codec import FrameDecoder, FrameEncoder, Sample
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.live_kernels import Samples
from eps_hil.bus.mapping import MessageRules, SignalMapping, load_mapping
from eps_hil.bus.protection import PROFILES, CrcRule
from tests.recordings.test_log_columns import DBC, FAULTS, SIGNALS, lost, second_sender, traffic

Fault = Callable[[list[Frame], np.random.Generator], list[Frame]]
ROOM = 64


def mapping(clock: Literal["counter", "stamp"] = "counter") -> SignalMapping:
    """That of the rig; its messages with stamps for instants, if asked for."""
    found = load_mapping(SIGNALS)
    rules = {name: replace(one, clock=clock) for name, one in found.messages.items()}
    return replace(found, messages=rules)


class Both:
    """A decoder with compiled calls beside one without."""

    def __init__(self, of: SignalMapping, dbc: Path = DBC) -> None:
        self.plain, self.decoder = (FrameDecoder(load_database([dbc]), of) for _ in range(2))
        names = list(of.signals)
        self.names = names
        self.room = Samples(
            np.zeros(ROOM, np.int64), np.zeros(ROOM, np.int64), np.zeros(ROOM),
            np.zeros(1, np.int64),
        )  # fmt: skip
        live = self.decoder.live({name: k for k, name in enumerate(names)}, self.room)
        assert live is not None
        self.live, self.compiled = live, 0

    def samples(self, frame: Frame) -> list[Sample]:
        """Of the decoder that has them."""
        self.room.filled[0] = 0
        instant = self.live.take((frame.can_id, frame.extended), frame)
        if instant is None:
            assert self.room.filled[0] == 0
            return self.decoder.decode(frame)
        self.compiled += 1
        n = int(self.room.filled[0])
        found = [
            Sample(self.names[self.room.signal[k]], int(self.room.t_ns[k]), self.room.value[k])
            for k in range(n)
        ]
        assert self.live.names == tuple(sample.signal for sample in found)
        assert all(self.live.newest(s.signal) == s.value and s.t_ns == instant for s in found)
        return found

    def agree(self, frames: Sequence[Frame]) -> None:
        """That both say the same of each frame, and of the clock."""
        for k, frame in enumerate(frames):
            assert bits(self.samples(frame)) == bits(self.plain.decode(frame)), f"frame {k}"
            assert self.decoder.moved_ns == self.plain.moved_ns
        assert self.decoder.faults == self.plain.faults


def bits(samples: Sequence[Sample]) -> list[tuple[str, int, bytes]]:
    return [(s.signal, s.t_ns, np.float64(s.value).tobytes()) for s in samples]


@pytest.mark.parametrize("clock", ["counter", "stamp"])
def test_usual_traffic_is_taken_and_gives_the_same(clock: Literal["counter", "stamp"]) -> None:
    both = Both(mapping(clock))
    frames = traffic(3_000, np.random.default_rng(3))  # blocks from which the drift is taken
    both.agree(frames)
    assert both.compiled > 0.3 * len(frames)


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    which=st.lists(st.sampled_from(FAULTS), max_size=6),
    clock=st.sampled_from(["counter", "counter", "stamp"]),
)
def test_faulty_traffic_gives_the_same(
    seed: int, which: list[Fault], clock: Literal["counter", "stamp"]
) -> None:
    rng = np.random.default_rng(seed)
    frames = traffic(500, rng)
    for fault in which:
        frames = fault(frames, rng)
    Both(mapping(clock)).agree(frames)


def test_every_fault_in_one_drive() -> None:
    rng = np.random.default_rng(5)
    frames = traffic(3_000, rng)
    for fault in FAULTS:
        frames = fault(frames, rng)
    both = Both(mapping())
    both.agree(frames)
    told = {kind for kind, count in both.decoder.faults.items() if count}
    assert {"crc", "counter", "length", "lost_frames", "clock_restarts", "second_sender"} <= told


def test_a_decoder_that_is_asked_itself_knows_what_was_taken() -> None:
    """Now by the compiled call, now by the decoder, at random."""
    rng = np.random.default_rng(8)
    frames = second_sender(lost(traffic(2_000, rng), rng), rng)
    both = Both(mapping())
    for frame in frames:
        found = both.decoder.decode(frame) if rng.random() < 0.003 else both.samples(frame)
        assert bits(found) == bits(both.plain.decode(frame))
    assert both.decoder.faults == both.plain.faults
    assert both.compiled > 0


def test_what_is_not_mapped_remote_or_without_room_is_not_taken() -> None:
    both = Both(mapping())
    frames = [f for f in traffic(400, np.random.default_rng(4)) if f.can_id == 0x100]
    both.agree(frames)
    assert both.live.take((0x7F0, False), replace(frames[0], can_id=0x7F0)) is None
    both.room.filled[0] = ROOM
    assert both.live.take((0x100, False), frames[-1]) is None
    both.room.filled[0] = 0
    assert both.live.take((0x100, False), replace(frames[-1], data=b"", remote=True)) is None


def test_a_signal_without_a_place_is_left_to_the_decoder() -> None:
    of = mapping()
    decoder = FrameDecoder(load_database([DBC]), of)
    room = Samples(np.zeros(8, np.int64), np.zeros(8, np.int64), np.zeros(8), np.zeros(1, np.int64))
    live = decoder.live({"motor_speed_rad_s": 0}, room)
    assert live is not None
    plain = FrameDecoder(load_database([DBC]), of)
    for frame in traffic(200, np.random.default_rng(6)):
        assert live.take((frame.can_id, frame.extended), frame) is None
        assert bits(decoder.decode(frame)) == bits(plain.decode(frame))


@pytest.mark.parametrize("profile", PROFILES)
def test_the_table_of_a_crc_is_that_crc(profile: str) -> None:
    rng = np.random.default_rng(1)
    for length in (1, 2, 8, 24):
        byte = int(rng.integers(length))
        rule = CrcRule.make(byte, profile, int(rng.integers(1 << 16)))
        table = rule.table(length)
        for _ in range(20):
            data = rng.bytes(length)
            found = table[length][0]
            for k, each in enumerate(data):
                found ^= table[k][each]
            assert found == rule.expected(data)
    assert crc8.algorithms_available


MESSAGES = ("EPSHIL_Estimate", "EPS_MotorState", "EPS_Torques", "RIG_State", "EPSHIL_Health")


@pytest.mark.parametrize("name", MESSAGES)
def test_payloads_are_the_encoders(name: str) -> None:
    database = load_database([DBC])
    plain, warm = FrameEncoder(database, name), FrameEncoder(database, name)
    warm.warm_up()
    rng, message = np.random.default_rng(2), database.get_message_by_name(name)
    for k in range(600):
        values: dict[str, Any] = {}
        for signal in message.signals:
            least, most = signal.minimum or 0, signal.maximum or 1
            values[signal.name] = rng.uniform(least, most)
            if k % 3 == 0:  # halves between two raw numbers, and the limits
                raw = round(rng.uniform(least, most) / signal.scale) + 0.5 * rng.integers(2)
                values[signal.name] = raw * signal.scale
            if k % 5 == 0:
                values[signal.name] = rng.choice([least, most, math.nan, math.inf, 2.0 * most])
            if k % 50 == 7:
                del values[signal.name]
        assert warm.encode(values) == plain.encode(values)
        assert (warm.clipped, warm.not_available) == (plain.clipped, plain.not_available)


BIG = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 M: 8 A
 SG_ Check : 7|8@0+ (1,0) [0|255] "" A
 SG_ Count : 11|4@0+ (1,0) [0|15] "" A
 SG_ Torque : 23|12@0- (0.01,0) [-20|20] "Nm" A
 SG_ Level : 39|10@0+ (0.5,-20) [-20|490] "" A
BO_ 257 S: 5 A
 SG_ Far : 0|33@1- (1,0) [0|0] "" A
"""


def test_bytes_in_the_other_order_and_short_messages(tmp_path: Any) -> None:
    path = tmp_path / "big.dbc"
    path.write_text(BIG)
    database = load_database([path])
    rules = MessageRules(counter="Count", crc="Check")
    for name in ("M", "S"):
        of = rules if name == "M" else MessageRules()
        plain, warm = (FrameEncoder(database, name, rules=of) for _ in range(2))
        warm.warm_up()
        rng = np.random.default_rng(4)
        for _ in range(200):
            values = {"Torque": rng.uniform(-19, 19), "Level": rng.uniform(-19, 400)}
            values["Far"] = rng.uniform(-4e9, 4e9)
            assert warm.encode(values) == plain.encode(values)
