"""Usual frames by compiled calls, in layouts that the rig's own database has not; and copies."""

import copy
import random
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus import live_frames
from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.live_kernels import Samples
from eps_hil.bus.mapping import MessageRules, SignalMapping, SignalSource, load_mapping
from eps_hil.bus.protection import PROFILES
from eps_hil.estimation.stream_steps import new_waiting
from tests.recordings.test_log_columns import SIGNALS, traffic

from .test_live_frames import Both, mapping

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'
NAMES = tuple(load_mapping(SIGNALS).signals)
EXTENDED = 1 << 31
ROOT = Path(__file__).parents[2]


class Layout:
    """Three messages at random: byte order, widths, signs, laws, labels, lengths, ids, rules."""

    def __init__(self, folder: Path, rng: random.Random) -> None:
        self._rng, self.path = rng, folder / "any.dbc"
        lines, labels = [HEAD], []
        self.rules: dict[str, MessageRules] = {}
        self.limits: dict[str, dict[str, tuple[float, float]]] = {}
        self._names, signals = iter(NAMES), {}
        shared = rng.choice([3, 10, 15, 16])
        for m in range(3):
            can_id, length = (
                rng.choice([0x100 + m, EXTENDED | 0x1ABC00 + m]),
                rng.choice([8, 8, 12]),
            )
            name, lines_of, labels_of = self._message(m, length, shared)
            lines += [f"BO_ {can_id} {name}: {length} A", *lines_of, ""]
            labels += [label.format(can_id=can_id) for label in labels_of]
            for signal in self.limits[name]:
                scale, offset = rng.choice([1.0, -0.5]), rng.choice([0.0, 1.5])
                signals[next(self._names)] = SignalSource(name, signal, scale, offset)
        self.path.write_text("\n".join([*lines, *labels]) + "\n")
        self.mapping = SignalMapping(signals, f"M{rng.randrange(3)}", self.rules)

    def _message(self, m: int, length: int, shared: int) -> tuple[str, list[str], list[str]]:
        rng, name = self._rng, f"M{m}"
        little, at, lines, labels = rng.random() < 0.5, 0, [], []
        limits = self.limits.setdefault(name, {})

        def add(signal: str, width: int, law: str, sign: str = "+") -> None:
            nonlocal at
            start = at if little else at // 8 * 8 + 7 - at % 8
            place = f"{start}|{width}@{int(little)}{sign}"
            lines.append(f' SG_ {signal} : {place} {law} "" A')
            at += width

        add(f"Crc{m}", 8, "(1,0) [0|255]")
        add(f"Cnt{m}", 8, "(1,0) [0|255]")
        for s in range(2):
            width, sign = rng.choice([3, 8, 12, 21, 24]), rng.choice("+-")
            if at + width > 8 * length:
                continue
            scale, shift = rng.choice([1.0, 0.01, -0.003]), rng.choice([0.0, 10.0])
            least = -(1 << width - 1) if sign == "-" else 0
            ends = sorted(scale * (least + part * (1 << width)) + shift for part in (0.0, 0.9))
            add(f"S{m}{s}", width, f"({scale},{shift}) [{ends[0]}|{ends[1]}]", sign)
            limits[f"S{m}{s}"] = ends[0], ends[1]
            raws = [least + (1 << width) - 1, 1 << 63, (1 << 64) - 1][: rng.choice([0, 1, 3])]
            if raws:
                said = " ".join(f'{raw} "SNA"' for raw in raws)
                labels.append(f"VAL_ {{can_id}} S{m}{s} {said} ;")
        self.rules[name] = MessageRules(
            counter=f"Cnt{m}", counter_modulo=shared, crc=f"Crc{m}",
            crc_profile=rng.choice(PROFILES), clock=rng.choice(["counter", "counter", "stamp"]),
            cycle_time_s=1e-3,
        )  # fmt: skip
        return name, lines, labels

    def frames(self, begin_ns: int, cycles: int) -> Iterator[Frame]:
        """Each message in each cycle, with what goes wrong on a bus."""
        rng, database = self._rng, load_database([self.path])
        encoders = {n: FrameEncoder(database, n, rules=r) for n, r in self.rules.items()}
        for cycle in range(cycles):
            for k, (name, encoder) in enumerate(encoders.items()):
                values = {s: rng.uniform(*ends) for s, ends in self.limits[name].items()}
                if rng.random() < 0.01:
                    values.pop(next(iter(values)), None)
                t_ns = begin_ns + cycle * 1_000_000 + k * 90_000 + int(rng.expovariate(1e-4))
                yield from self._fated(encoder.frame(values, t_ns))
            if rng.random() < 0.004:
                begin_ns += rng.choice([-3_000_000, 40_000_000, 5_000_000, 700, -500_000])

    def _fated(self, frame: Frame) -> Iterator[Frame]:
        rng, fate = self._rng, self._rng.random()
        if fate < 0.01:
            return
        if fate < 0.02:
            frame = replace(frame, data=bytes([frame.data[0] ^ 1, *frame.data[1:]]))
        elif fate < 0.03:
            frame = replace(frame, data=frame.data[: rng.randrange(len(frame.data))])
        elif fate < 0.1:
            frame = replace(frame, data=frame.data + bytes(rng.randrange(4)))
        elif fate < 0.11:
            frame = replace(frame, extended=not frame.extended)
        elif fate < 0.13:
            frame = replace(frame, remote=True)
        yield frame
        if rng.random() < 0.01:
            yield replace(frame, t_ns=frame.t_ns + rng.choice([0, 1_000, 1_000_000]), remote=False)


@pytest.mark.parametrize("seed", range(12))
def test_any_layout_gives_the_same(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Handed over to and fro every few frames."""
    monkeypatch.setattr(live_frames, "_REST", 2)
    monkeypatch.setattr(live_frames, "_LONGEST_REST", 5)
    rng = random.Random(seed)
    layout = Layout(tmp_path, rng)
    both = Both(layout.mapping, layout.path)
    begin_ns = rng.choice([1_757_617_431_821_276_000, -3_000_000_000, 0, 1 << 61])
    frames = list(layout.frames(begin_ns, 400))
    both.agree(frames)
    assert both.compiled > 0.2 * len(frames)


TOP = """BO_ 256 M: 8 A
 SG_ Torque : 0|16@1- (0.01,0) [-300|300] "Nm" A
 SG_ Count : 60|4@1+ (1,0) [0|15] "" A
BO_ 257 B: 8 A
 SG_ Torque : 23|16@0- (0.01,0) [-300|300] "Nm" A
 SG_ Count : 7|4@0+ (1,0) [0|15] "" A
BO_ 258 W: 8 A
 SG_ Wide : 0|64@1+ (1,0) [0|0] "" A
"""


@pytest.mark.parametrize("name", ["M", "B", "W"])
def test_a_counter_in_the_highest_bits_is_encoded(name: str, tmp_path: Path) -> None:
    path = tmp_path / "top.dbc"
    path.write_text(HEAD + TOP)
    rules = MessageRules() if name == "W" else MessageRules(counter="Count")
    plain, warm = (FrameEncoder(load_database([path]), name, rules=rules) for _ in range(2))
    warm.warm_up()
    for k in range(40):
        values = {"Torque": 0.5 * k - 7.0, "Wide": float(k)}
        assert warm.encode(values) == plain.encode(values)


def test_a_remote_frame_is_no_measurement() -> None:
    """Also one that comes with eight good bytes, as by UDP it may."""
    both = Both(mapping())
    for k, frame in enumerate(traffic(900, np.random.default_rng(4))):
        both.agree([replace(frame, remote=True), frame] if k % 50 == 0 else [frame])
    assert both.compiled > 900


def test_a_copy_of_a_decoder_has_a_clock_of_its_own() -> None:
    """The fault harness drives copies of one that has been driven."""
    both = Both(mapping())
    frames = traffic(3_000, np.random.default_rng(6))
    both.agree(frames[:4_000])
    copied = copy.deepcopy(both)
    later = [replace(f, t_ns=f.t_ns + 5_000_000) for f in frames[4_000:]]
    before = copied.plain.moved_ns, copied.compiled
    copied.agree(later)
    assert copied.plain.moved_ns != before[0], "the clock moves"
    assert copied.compiled > before[1]
    both.agree(frames[4_000:])


def test_told_anew_where_samples_wait_it_goes_on() -> None:
    both = Both(mapping())
    frames = traffic(900, np.random.default_rng(7))
    both.agree(frames[:1_500])
    live = both.decoder.live({name: k for k, name in enumerate(both.names)}, both.room)
    assert live is not None
    both.live = live
    both.agree(frames[1_500:])
    assert both.decoder.faults["lost_frames"] == both.plain.faults["lost_frames"]


def test_interpreted_it_is_the_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eps_hil.compiled.interpreted", lambda: True)
    both_of = mapping()
    database = load_database([ROOT / "dbc" / "eps_rig.dbc"])
    assert FrameDecoder(database, both_of).live({}, Samples(*new_waiting())) is None
    encoder = FrameEncoder(database, "EPSHIL_Estimate")
    encoder.warm_up()
    assert encoder.encode({}) == FrameEncoder(database, "EPSHIL_Estimate").encode({})
