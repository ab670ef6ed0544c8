"""Frames in, samples out; values in, frames out. Against cantools, and against what goes wrong."""

import math
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from eps_hil.bus.codec import FrameDecoder, FrameEncoder, Sample
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import MessageRules, SignalMapping, SignalSource, load_mapping
from eps_hil.errors import InputError
from eps_hil.signals import CANONICAL

ROOT = Path(__file__).parents[2]
DATABASE = load_database([ROOT / "dbc" / "eps_rig.dbc"])
RIG = load_mapping(ROOT / "configs" / "eps_rig_signals.yaml")
T0 = 1_700_000_000_000_000_000
MS = 1_000_000

FOREIGN = """VERSION ""
BU_: A B
BO_ 100 Torque: 8 A
 SG_ Current : 7|12@0- (0.05,-64) [-166.4|38.35] "A" B
 SG_ State : 20|4@0+ (1,0) [0|15] "" B
 SG_ Alive : 56|4@1+ (1,0) [0|15] "" B
BO_ 2147484648 Angle: 8 A
 SG_ Mode M : 0|8@1+ (1,0) [0|1] "" B
 SG_ Angle m0 : 8|16@1- (0.1,0) [-1600|1600] "deg" B
 SG_ Other m1 : 8|16@1- (0.1,0) [0|0] "deg" B
BO_ 300 Wide: 16 A
 SG_ Speed : 64|32@1- (1,0) [-1000|1000] "rad/s" B
BO_ 400 Short: 2 A
 SG_ Speed : 0|16@1- (0.1,0) [0|0] "rad/s" B
BO_ 500 Twin1: 8 A
 SG_ S : 0|8@1+ (1,0) [0|0] "" B
BO_ 500 Twin2: 8 A
 SG_ S : 0|8@1+ (1,0) [0|0] "" B
SIG_VALTYPE_ 300 Speed : 1;
VAL_ 100 State 14 "Error" 15 "Signal not available" ;
"""


@pytest.fixture
def foreign(tmp_path: Path) -> Any:
    path = tmp_path / "foreign.dbc"
    path.write_text(FOREIGN)
    return load_database([path])


def decoder(mapping: SignalMapping = RIG) -> FrameDecoder:
    return FrameDecoder(DATABASE, mapping, mapping_file="m.yaml", dbc_file="d.dbc")


def only(name: str, message: str, signal: str, **rest: Any) -> SignalMapping:
    return SignalMapping(signals={name: SignalSource(message, signal, **rest)})


def values(samples: list[Sample]) -> dict[str, float]:
    return {sample.signal: sample.value for sample in samples}


def motor_frames(count: int, **changed: float) -> list[Frame]:
    encoder = FrameEncoder(DATABASE, "EPS_MotorState")
    sent = {"MotorSpeed": 12.5, "MotorAngle": -3.0} | changed
    return [encoder.frame(sent, T0 + n * MS) for n in range(count)]


def test_what_the_rig_mapping_listens_to() -> None:
    found = decoder()
    assert found.receive_ids == (0x100, 0x101, 0x110, 0x120, 0x200, 0x210, 0x300)
    assert found.sync_id == 0x100
    assert set(found.period_s) == set(CANONICAL)
    assert found.period_s["motor_speed_rad_s"] == 0.001
    assert found.period_s["motor_temperature_degc"] == 0.1


@settings(max_examples=200)
@given(data=st.data())
def test_every_canonical_signal_survives_the_bus(data: st.DataObject) -> None:
    name, source = data.draw(st.sampled_from(sorted(RIG.signals.items())))
    signal = DATABASE.get_message_by_name(source.message).get_signal_by_name(source.signal)
    given_value = data.draw(st.floats(signal.minimum, signal.maximum))
    frame = FrameEncoder(DATABASE, str(source.message)).frame({str(source.signal): given_value}, T0)
    found = values(decoder().decode(frame))[name]
    quantum = abs(signal.scale * source.scale)
    assert found == pytest.approx(given_value * source.scale, abs=0.50001 * quantum)


@example(payload=b"\0\0\0\x08 \0\0\0", name="friction_torque_nm")  # -1023 of 2 mNm: the lowest
@given(payload=st.binary(min_size=8, max_size=8), name=st.sampled_from(sorted(RIG.signals)))
def test_decoding_agrees_with_cantools(payload: bytes, name: str) -> None:
    source = RIG.signals[name]
    mapping = SignalMapping(signals={name: source})
    message = DATABASE.get_message_by_name(source.message)
    signal = message.get_signal_by_name(source.signal)
    theirs = message.decode(payload, decode_choices=False)[source.signal]
    raw = message.decode(payload, decode_choices=False, scaling=False)[source.signal]
    [sample] = decoder(mapping).decode(Frame(T0, message.frame_id, payload))
    rounding = 1e-6 * abs(signal.scale)  # an end of the range times its scale may lie beyond it
    lowest, highest = signal.minimum - rounding, signal.maximum + rounding
    if raw in (signal.choices or {}) or not lowest <= theirs <= highest:
        assert math.isnan(sample.value)
    else:
        assert sample.value == pytest.approx(theirs * source.scale, rel=1e-12, abs=0)


def test_units_signs_and_currents_are_mapped(foreign: Any) -> None:
    mapping = only(
        "motor_torque_nm", "Torque", "Current", scale=-1.0, offset=0.5,
        torque_constant_nm_per_a=0.04,
    )  # fmt: skip
    data = (1380 << 52).to_bytes(8, "big")  # the topmost 12 bits: 0.05 * 1380 - 64 = 5 A
    [sample] = FrameDecoder(foreign, mapping).decode(Frame(T0, 100, data))
    assert sample.value == pytest.approx((-5.0 + 0.5) * 0.04)


def test_a_message_that_is_not_mapped_or_no_data_gives_nothing() -> None:
    found = decoder()
    [frame] = motor_frames(1)
    assert found.decode(Frame(T0, 0x7FF, bytes(8))) == []
    assert found.decode(Frame(T0, 0x100, frame.data, extended=True)) == []
    assert found.decode(Frame(T0, 0x100, b"", remote=True)) == []
    assert found.decode(Frame(T0, 0x100, bytes(8), error=True)) == []
    assert found.sync(frame)
    assert not found.sync(Frame(T0, 0x100, bytes(8), error=True))
    assert not found.sync(Frame(T0, 0x101, frame.data))
    assert set(found.faults.values()) == {0}


@given(bit=st.integers(0, 63))
def test_a_flipped_bit_gives_nan_and_is_counted(bit: int) -> None:
    first, second, third = motor_frames(3)
    flipped = (int.from_bytes(second.data, "big") ^ 1 << bit).to_bytes(8, "big")
    found = decoder()
    found.decode(first)
    samples = found.decode(Frame(second.t_ns, second.can_id, flipped))
    assert [s.signal for s in samples] == ["motor_speed_rad_s", "motor_angle_rad"]
    assert all(math.isnan(s.value) and s.t_ns == second.t_ns for s in samples)
    assert [s.t_ns for s in found.decode(third)] == [third.t_ns] * 2
    assert found.faults["crc"] == 1


def test_a_short_frame_is_bad_and_a_padded_one_is_good() -> None:
    first, second = motor_frames(2)
    found = decoder()
    samples = found.decode(Frame(T0, 0x100, first.data[:7]))
    assert all(math.isnan(sample.value) for sample in samples)
    assert found.faults["length"] == 1
    padded = Frame(second.t_ns, 0x100, second.data + bytes(4), fd=True)
    assert values(found.decode(padded))["motor_speed_rad_s"] == 12.5


@given(lost=st.sets(st.integers(1, 98), max_size=60))
def test_lost_frames_are_counted_exactly(lost: set[int]) -> None:
    found = decoder()
    for n, frame in enumerate(motor_frames(100)):
        if n not in lost:
            assert found.decode(frame)
    assert found.faults["lost_frames"] == len(lost)


@given(kept=st.lists(st.integers(1, 200), min_size=1, max_size=20))
def test_lost_frames_are_counted_without_a_clock_too(kept: list[int]) -> None:
    encoder = FrameEncoder(DATABASE, "VEH_Motion")
    found = decoder()
    t_ns = T0
    found.decode(encoder.frame({}, t_ns))
    for step in kept:
        t_ns += 20 * MS * step
        frames = [encoder.frame({}, t_ns) for _ in range(step)]
        found.decode(frames[-1])
    assert found.faults["lost_frames"] == sum(kept) - len(kept)


@pytest.mark.parametrize("message", ["EPS_MotorState", "VEH_Motion"])
def test_a_repeated_frame_gives_no_sample(message: str) -> None:
    frame = FrameEncoder(DATABASE, message).frame({}, T0)
    found = decoder()
    assert found.decode(frame)
    assert found.decode(Frame(T0 + MS, frame.can_id, frame.data)) == []
    assert found.faults["counter"] == 1


def test_not_available_and_out_of_range_give_nan_under_their_own_count() -> None:
    found = decoder()
    temperature = DATABASE.get_message_by_name("EPS_Temperature")
    encoder = FrameEncoder(DATABASE, "EPS_Temperature")
    [sample] = found.decode(encoder.frame({"MotorTemperature": math.nan}, T0))
    assert math.isnan(sample.value)
    assert found.faults["not_available"] == 1
    assert encoder.not_available == 1
    hot = temperature.encode(
        {"Crc": 0, "Counter": 1, "MotorTemperature": 300.02}, strict=False, padding=False
    )
    mapping = SignalMapping(
        signals={"motor_temperature_degc": RIG.signals["motor_temperature_degc"]}
    )
    plain = decoder(mapping)
    [sample] = plain.decode(Frame(T0, 0x300, hot))
    assert math.isnan(sample.value)
    assert plain.faults["out_of_range"] == 1


def test_labels_of_foreign_databases_that_mean_no_value(foreign: Any) -> None:
    found = FrameDecoder(foreign, only("motor_torque_nm", "Torque", "State"))
    for state, missing in ((13, False), (14, True), (15, True)):
        payload = bytes((0, 0, state << 1, 0, 0, 0, 0, 0))
        [sample] = found.decode(Frame(T0, 100, payload))
        assert math.isnan(sample.value) == missing


def test_a_multiplexed_signal_is_there_when_it_is_selected(foreign: Any) -> None:
    found = FrameDecoder(foreign, only("motor_angle_rad", "Angle", "Angle", scale=math.pi / 180))
    shown = Frame(T0, 1000, bytes((0, 100, 0, 0, 0, 0, 0, 0)), extended=True)
    [sample] = found.decode(shown)
    assert sample.value == pytest.approx(math.radians(10.0))
    assert found.decode(Frame(T0, 1000, bytes((1, 100, 0, 0, 0, 0, 0, 0)), extended=True)) == []
    assert found.decode(Frame(T0, 1000, shown.data)) == []  # an 11-bit id of the same number
    assert found.faults["not_decodable"] == 0
    [bad] = found.decode(Frame(T0, 1000, bytes((7,) * 8), extended=True))
    assert math.isnan(bad.value)
    assert found.faults["not_decodable"] == 1
    assert found.period_s == {}


def test_the_format_of_an_id_can_be_overruled(foreign: Any) -> None:
    mapping = SignalMapping(
        signals={"motor_angle_rad": SignalSource("Angle", "Angle")},
        messages={"Angle": MessageRules(extended=False)},
    )
    found = FrameDecoder(foreign, mapping)
    assert found.decode(Frame(T0, 1000, bytes(8)))
    assert not found.decode(Frame(T0, 1000, bytes(8), extended=True))


def test_floats_and_long_frames(foreign: Any) -> None:
    found = FrameDecoder(foreign, only("motor_speed_rad_s", "Wide", "Speed"))
    for speed, seen in ((12.5, 12.5), (math.nan, math.nan), (1e6, math.nan), (math.inf, math.nan)):
        data = bytes(8) + struct.pack("<f", speed) + bytes(4)
        [sample] = found.decode(Frame(T0, 300, data, fd=True))
        assert sample.value == pytest.approx(seen, nan_ok=True)
    assert found.faults["out_of_range"] == 2
    assert found.faults["not_available"] == 1


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_an_infinity_is_no_value(tmp_path: Path, value: float) -> None:
    """Of a float signal without a range: frame by frame and by columns."""
    dbc = tmp_path / "x.dbc"
    dbc.write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 M: 8 A\n'
        ' SG_ Speed : 0|32@1- (1,0) [0|0] "rad/s" A\nSIG_VALTYPE_ 256 Speed : 1;\n'
    )
    found = FrameDecoder(load_database([dbc]), only("motor_speed_rad_s", "M", "Speed"))
    for sent in (value, 3.5):
        (sample,) = found.decode(Frame(0, 256, struct.pack("<fxxxx", sent)))
        assert sample.value == sent or (math.isnan(sample.value) and sent is value)
    (signal,) = found._plans[256, False].signals
    read, _ = signal.read_all(np.array([value, 3.5]))
    assert np.isnan(read[0])
    assert read[1] == 3.5


@pytest.mark.parametrize(
    ("mapping", "said"),
    [
        (
            only("motor_speed_rad_s", "EPS_MotorStat", "MotorSpeed"),
            "m.yaml: signals.motor_speed_rad_s: d.dbc has no message EPS_MotorStat; "
            "nearest: EPS_MotorState",
        ),
        (
            only("motor_speed_rad_s", "EPS_MotorState", "Motorspeed"),
            "m.yaml: signals.motor_speed_rad_s: message EPS_MotorState of d.dbc has no signal "
            "Motorspeed; nearest: MotorSpeed",
        ),
        (
            SignalMapping(
                signals={"motor_speed_rad_s": SignalSource("EPS_MotorState", "MotorSpeed")},
                messages={"EPS_MotorState": MessageRules(crc="Checksum")},
            ),
            "m.yaml: messages.EPS_MotorState.crc: message EPS_MotorState of d.dbc has no signal",
        ),
        (
            SignalMapping(
                signals={"motor_speed_rad_s": SignalSource("EPS_MotorState", "MotorSpeed")},
                messages={"EPS_MotorState": MessageRules(crc="MotorAngle")},
            ),
            "m.yaml: messages.EPS_MotorState.crc: MotorAngle is not one whole byte",
        ),
        (
            SignalMapping(
                signals={"motor_speed_rad_s": SignalSource("EPS_MotorState", "MotorSpeed")},
                messages={"EPS_MotorState": MessageRules(counter="MotorAngle")},
            ),
            "m.yaml: messages.EPS_MotorState.counter: MotorAngle cannot be a counter",
        ),
        (
            SignalMapping(
                signals={"motor_speed_rad_s": SignalSource("EPS_MotorState", "MotorSpeed")},
                messages={"EPS_Motor": MessageRules()},
            ),
            "m.yaml: messages.EPS_Motor: d.dbc has no message EPS_Motor; nearest:",
        ),
        (
            SignalMapping(
                signals={"motor_speed_rad_s": SignalSource("EPS_MotorState", "MotorSpeed")},
                sync="RIG_State",
            ),
            "m.yaml: sync: RIG_State carries no mapped signal",
        ),
    ],
)
def test_a_mapping_that_does_not_fit_the_database(mapping: SignalMapping, said: str) -> None:
    with pytest.raises(InputError) as caught:
        decoder(mapping)
    assert str(caught.value).startswith(said)
    assert "\n" not in str(caught.value)


def test_ids_shared_by_messages_are_refused_where_they_matter(foreign: Any) -> None:
    with pytest.raises(InputError, match="0x1F4 belongs to several messages: Twin1, Twin2"):
        FrameDecoder(foreign, only("motor_speed_rad_s", "Twin2", "S"))
    assert FrameDecoder(foreign, only("motor_speed_rad_s", "Short", "Speed")).receive_ids == (400,)


def test_a_clock_needs_a_cycle_time(foreign: Any) -> None:
    mapping = SignalMapping(
        signals={"motor_torque_nm": SignalSource("Torque", "Current")},
        messages={"Torque": MessageRules(counter="Alive", clock="counter")},
    )
    with pytest.raises(InputError, match="no cycle time"):
        FrameDecoder(foreign, mapping, mapping_file="m.yaml")


def test_one_senders_messages_share_their_instants() -> None:
    state, torques = (FrameEncoder(DATABASE, name) for name in ("EPS_MotorState", "EPS_Torques"))
    torques.encode({})  # counters need not agree
    found = decoder()
    for n in range(50):
        late = 5 * MS if n == 20 else 0
        a = found.decode(state.frame({}, T0 + n * MS + late))
        b = found.decode(torques.frame({}, T0 + n * MS + late + 200_000))
        assert {s.t_ns for s in a} == {s.t_ns for s in b} == {T0 + n * MS}


LATE_NS = st.integers(0, 3 * MS).filter(lambda ns: ns % 1000 != 500)
"""Half a microsecond may have been rounded either way, and the stamps after it follow that one."""


@settings(max_examples=30)
@given(jitter=st.lists(LATE_NS, min_size=60, max_size=60))
def test_nanosecond_and_microsecond_stamps_give_the_same_samples(jitter: list[int]) -> None:
    frames = motor_frames(60)
    live, logged = decoder(), decoder()
    for frame, late in zip(frames, jitter, strict=True):
        t_ns = frame.t_ns + late
        text = round(t_ns, -3)
        seen = live.decode(Frame(t_ns, frame.can_id, frame.data))
        read = logged.decode(Frame(text, frame.can_id, frame.data))
        assert seen == read


def test_stamps_within_one_microsecond_stay_in_order() -> None:
    encoder = FrameEncoder(DATABASE, "VEH_Motion")
    found = decoder()
    stamps = [found.decode(encoder.frame({}, T0))[0].t_ns for _ in range(5)]
    assert stamps == [T0 + n * 1000 for n in range(5)]


def test_the_encoder_counts_and_signs_each_frame() -> None:
    encoder = FrameEncoder(DATABASE, "EPSHIL_Estimate")
    found = decoder()
    for n in range(40):
        frame = encoder.frame({"RackForceEstimate": 100.0 * n}, T0 + n * MS)
        assert frame.can_id == 0x120
        assert frame.data[1] & 0x0F == n % 16
        assert values(found.decode(frame))["rack_force_estimate_n"] == pytest.approx(100.0 * n)
    assert found.faults["crc"] == found.faults["lost_frames"] == found.faults["counter"] == 0


def test_the_encoder_follows_rules_given_to_it(foreign: Any) -> None:
    rules = MessageRules(counter="Alive", counter_modulo=15)
    encoder = FrameEncoder(foreign, "Torque", rules=rules)
    assert [encoder.encode({"Current": 0.0})[7] for _ in range(16)] == [*range(15), 0]
    assert encoder.clipped == 0


@pytest.mark.parametrize(
    ("most", "told", "values"),
    [(14, None, 15), (15, None, 16), (0, None, 16), (9, None, 16), (15, 12, 12), (None, None, 16)],
)
def test_a_counter_that_the_dbc_ends_before_its_last_value_leaves_that_out(
    most: int | None, told: int | None, values: int
) -> None:
    """AUTOSAR profile 1 counts to 14; [0|0] says nothing, and other ends are often not meant."""
    signal = SimpleNamespace(length=4, maximum=most)
    assert MessageRules(counter="Alive", counter_modulo=told).counter_values(signal) == values


@pytest.mark.parametrize(("cycle_ms", "cycle_s"), [(5, 0.005), (0, None), (-1, None), (None, None)])
def test_a_cycle_time_is_positive_or_none(cycle_ms: int | None, cycle_s: float | None) -> None:
    assert MessageRules().cycle_s(SimpleNamespace(cycle_time=cycle_ms)) == cycle_s


def test_the_encoder_names_a_message_that_is_missing() -> None:
    with pytest.raises(InputError, match="nearest: EPSHIL_Estimate"):
        FrameEncoder(DATABASE, "EPSHIL_Estimat", dbc_file="d.dbc")


def test_nothing_is_sent_by_an_id_that_is_another_messages_too(foreign: Any) -> None:
    with pytest.raises(InputError, match="Twin1: would be sent by id 0x1F4, which is also that of"):
        FrameEncoder(foreign, "Twin1", dbc_file="d.dbc")
    # by another format it is another id, and the same message in two files is one
    rig = [ROOT / "dbc" / "eps_rig.dbc", ROOT / "dbc" / "eps_hil.dbc"]
    assert FrameEncoder(load_database(rig), "EPSHIL_Estimate").can_id == 0x120


@given(st.dictionaries(st.sampled_from(["MotorSpeed", "MotorAngle", "Other"]), st.floats()))
def test_the_encoder_never_raises(sent: dict[str, float]) -> None:
    assert len(FrameEncoder(DATABASE, "EPS_MotorState").encode(sent)) == 8


@given(
    can_id=st.sampled_from([0x100, 0x101, 0x110, 0x120, 0x200, 0x210, 0x300]),
    data=st.binary(max_size=64),
    t_ns=st.integers(0, 2**62),
)
def test_the_decoder_never_raises(can_id: int, data: bytes, t_ns: int) -> None:
    for mapping in (RIG, SignalMapping(signals=RIG.signals)):
        for sample in decoder(mapping).decode(Frame(t_ns, can_id, data)):
            assert sample.signal in CANONICAL
