"""The session in lock-step with rig and ECU: normal run, every end, what is on the bus."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cantools
import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import find_message, load_database
from eps_hil.bus.e2e import E2eProfile, E2eProtector
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import MessageRules
from eps_hil.bus.port import BusState
from eps_hil.errors import InputError
from eps_hil.rig.ecu import OverrideState
from eps_hil.service.config import load_config
from eps_hil.service.guard import Command, Trip
from eps_hil.service.override import State
from eps_hil.service.override_core import RELEASES, OverrideCore
from eps_hil.service.override_setup import (
    CommandEncoder,
    OverrideParts,
    StatusReader,
    prepare_override,
)

from .lockstep import CONFIG, ROOT, Lockstep, Sawtooth, parts_of

DATABASE = load_database([ROOT / "dbc" / "eps_rig.dbc"])
COMMAND, STATE, STATUS = 0x80, 0x140, 0x130
TIMEOUT_MS = 20


@pytest.fixture
def parts() -> OverrideParts:
    return parts_of()


@pytest.fixture
def bench(parts: OverrideParts) -> Lockstep:
    return Lockstep(parts, Sawtooth())


def injecting(bench: Lockstep) -> Lockstep:
    bench.arm()
    bench.step(100)
    assert bench.state is State.INJECTING
    assert abs(bench.ticks[-1].applied_nm) > 0.01
    bench.story()
    return bench


def zero_from_here(bench: Lockstep, within_ms: int) -> None:
    """Zero after at most so many milliseconds, and for ever."""
    start = bench.ms
    bench.step(within_ms + 300)
    loud = [tick.ms for tick in bench.ticks if tick.ms >= start and tick.applied_nm != 0.0]
    assert not loud or loud[-1] - start < within_ms, (loud, bench.story())


def tapped(bench: Lockstep) -> list[Frame]:
    """What the session sends from now on."""
    sent: list[Frame] = []

    def tap(frames: list[Frame]) -> list[Frame]:
        sent.extend(frames)
        return frames

    bench.spoil_commands = tap
    return sent


def trips(bench: Lockstep) -> Trip:
    return bench.core.override.guard.trips


class TestRun:
    def test_a_torque_reaches_the_motor_and_is_the_one_that_was_wanted(
        self, bench: Lockstep
    ) -> None:
        bench.arm()
        bench.step(700)
        assert bench.state is State.INJECTING, bench.story()
        applied = [tick.applied_nm for tick in bench.ticks[-500:]]
        assert max(applied) == pytest.approx(0.12, abs=2e-3)
        assert min(applied) == pytest.approx(-0.12, abs=2e-3)
        steps = [abs(b - a) for a, b in pairwise(applied)]
        assert max(steps) == pytest.approx(1e-3, abs=1e-5)

    def test_release_comes_before_the_first_torque(self, bench: Lockstep) -> None:
        """An ECU that timed out once obeys again only after a release."""
        bench.arm()
        bench.step(60)
        commands = [command for tick in bench.ticks for command in tick.commands]
        assert [command.enable for command in commands[:RELEASES]] == [False] * RELEASES
        assert commands[-1].enable
        counters = [command.counter for command in commands]
        assert counters == list(range(len(counters)))

    def test_nothing_is_sent_before_arming_but_the_state(self, bench: Lockstep) -> None:
        sent = tapped(bench)
        bench.step(300)
        assert {frame.can_id for frame in sent} == {STATE}
        assert len(sent) == pytest.approx(30, abs=2)

    def test_one_command_for_a_sync_frame_and_none_without(self, bench: Lockstep) -> None:
        """A batch of several sync frames is one answer; other frames, and timers, are none."""
        injecting(bench)
        bench.running = False
        bench.step(4)
        bench.running = True
        sent = tapped(bench)
        bench.step(2)
        assert [frame.can_id for frame in sent].count(COMMAND) == 1
        assert bench.state is State.INJECTING
        other = Frame(bench.wall_ns, 0x7F0, bytes(8))
        commands = bench.core.on_frames([other], bench.now_ns, bench.wall_ns)
        assert COMMAND not in [frame.can_id for frame in commands]
        late_ns = bench.now_ns + 4_000_000
        assert bench.core.command.enable
        on_timer = bench.core.on_timer(late_ns)
        assert COMMAND not in [frame.can_id for frame in on_timer]
        assert bench.state is State.INJECTING, "too early for a trip"

    def test_the_state_on_the_bus(self, bench: Lockstep) -> None:
        sent = tapped(bench)
        injecting(bench)
        bench.core.on_bus(bench.now_ns, BusState.ERROR_PASSIVE)
        bench.step(30)
        message = DATABASE.get_message_by_frame_id(STATE)
        told = [message.decode(f.data, decode_choices=False) for f in sent if f.can_id == STATE]
        states = [int(each["State"]) for each in told]
        assert states == sorted(states)
        assert set(states) == {1, 2, 3, 4}
        assert told[-1]["TripReason"] == Trip.BUS
        assert told[-1]["CommandedTorque"] == 0.0
        assert any(each["CommandedTorque"] != 0.0 for each in told if each["State"] == 3)
        beats = [int(each["Heartbeats"]) for each in told]
        assert beats[0] < beats[-1]
        assert "injecting -> fault: bus: the bus is error passive" in bench.story()

    def test_an_end_in_good_order(self, bench: Lockstep) -> None:
        injecting(bench)
        last = bench.core.end(bench.now_ns, "done")
        assert [frame.can_id for frame in last] == [COMMAND] * RELEASES + [STATE]
        bench.send(last)
        bench.dead = True
        zero_from_here(bench, 2)
        assert bench.rig.override.state is OverrideState.RELEASED
        assert bench.story() == ["injecting -> off: done"]

    def test_an_end_by_fault_is_told_as_one(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.core.end(bench.now_ns, "SIGTERM", fault=True)
        assert bench.story() == ["injecting -> fault: operator: SIGTERM", "fault -> off: SIGTERM"]

    def test_a_dry_run_returns_nothing_ever(self, parts: OverrideParts) -> None:
        bench = Lockstep(parts, Sawtooth())
        bench.core = OverrideCore(parts, Sawtooth(), dry_run=True)
        bench.core.start(bench.now_ns)
        bench.accepts = lambda: pytest.fail("a frame was to be sent")
        bench.step(100)
        assert not bench.core.prepare(bench.now_ns)
        bench.step(250)
        assert not bench.core.arm(bench.now_ns)
        bench.step(100)
        assert bench.core.end(bench.now_ns, "done") == []
        assert bench.core.values["motor_speed_rad_s"] != 0.0


class TestTrips:
    def test_a_process_that_dies(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.dead = True
        zero_from_here(bench, TIMEOUT_MS + 1)
        assert bench.rig.override.state is OverrideState.TIMED_OUT

    @pytest.mark.parametrize("stopped_ms", [16, 25, 500])
    def test_a_process_that_stops_and_goes_on(self, bench: Lockstep, stopped_ms: int) -> None:
        injecting(bench)
        bench.running = False
        bench.step(stopped_ms)
        bench.running = True
        before = len([c for tick in bench.ticks for c in tick.commands if c.enable])
        zero_from_here(bench, max(TIMEOUT_MS + 1 - stopped_ms, 2))
        after = len([c for tick in bench.ticks for c in tick.commands if c.enable])
        assert after == before
        assert trips(bench) & Trip.CLOCK

    def test_a_silent_bus(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.spoil = lambda frames: []
        zero_from_here(bench, TIMEOUT_MS)
        assert trips(bench) & Trip.STALE_INPUT
        assert bench.rig.override.state is OverrideState.RELEASED, "not by the ECU's time-out"

    def test_a_full_send_queue(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.accepts = lambda: False
        bench.step(1)
        assert (bench.core.dropped, trips(bench)) == (1, Trip.BUS)
        assert not bench.core.command.enable or bench.state is State.FAULT
        bench.accepts = lambda: True
        zero_from_here(bench, 2)

    @pytest.mark.parametrize("full_ms", [1, 5, 12, 40])
    def test_a_release_that_the_queue_refused_is_none(self, bench: Lockstep, full_ms: int) -> None:
        """The ECU timed out meanwhile, and gives no assist before it hears one."""
        injecting(bench)
        end = bench.ms + full_ms
        bench.accepts = lambda: bench.ms >= end
        bench.step(full_ms)
        before = len(bench.ticks)
        bench.step(30)
        heard = [command for tick in bench.ticks[before:] for command in tick.commands]
        assert [command.enable for command in heard] == 10 * [False]
        assert bench.rig.override.state is OverrideState.RELEASED

    def test_the_end_owes_the_releases_that_the_queue_refused(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.accepts = lambda: False
        bench.step(15)
        command_id = bench.core._parts.command.can_id
        last = [
            frame for frame in bench.core.end(bench.now_ns, "over") if frame.can_id == command_id
        ]
        assert len(last) == 10
        bench.send(last)
        assert len(bench.core.owed()) == 10
        bench.accepts = lambda: True
        bench.send(bench.core.owed()[:1])
        assert len(bench.core.owed()) == 9
        one, other = (bench.core.owed(1)[0].data for _ in range(2))
        counts = [DATABASE.decode_message(command_id, data)["Counter"] for data in (one, other)]
        assert (counts[1] - counts[0]) % 256 == 1
        bench.send(bench.core.owed())
        assert bench.core.owed() == []

    def test_another_transmitter(self, bench: Lockstep) -> None:
        injecting(bench)
        foreign = FrameEncoder(DATABASE, "EPSHIL_TorqueOverride")
        frame = foreign.frame({"RequestedMotorTorque": 0.0, "OverrideRequest": 0})
        bench.waiting.append(replace(frame, t_ns=bench.wall_ns))
        zero_from_here(bench, 2)
        assert trips(bench) == Trip.OTHER_TRANSMITTER | Trip.INVALID_INPUT

    @pytest.mark.parametrize("can_id", [COMMAND, STATE, 0x120, STATUS])
    def test_a_remote_request_is_neither_a_transmitter_nor_data(
        self, bench: Lockstep, can_id: int
    ) -> None:
        injecting(bench)
        for _ in range(30):
            bench.waiting.append(Frame(bench.wall_ns, can_id, b"", remote=True))
            bench.step(1)
        assert bench.state is State.INJECTING, bench.story()
        assert not trips(bench)

    @pytest.mark.parametrize(
        ("disturb", "trip"),
        [
            (lambda core, now: core.on_bus(now, BusState.BUS_OFF), Trip.BUS),
            (lambda core, now: core.on_bus(now, BusState.LOST), Trip.BUS),
            (lambda core, now: core.on_bus(now, BusState.ERROR_ACTIVE, 1), Trip.BUS),
        ],
    )
    def test_the_bus(
        self, bench: Lockstep, disturb: Callable[[OverrideCore, int], None], trip: Trip
    ) -> None:
        injecting(bench)
        disturb(bench.core, bench.now_ns)
        assert trips(bench) == trip
        zero_from_here(bench, 2)

    def test_ten_releases_follow_a_trip(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.core.on_bus(bench.now_ns, BusState.BUS_OFF)
        start = len(bench.ticks) + 1  # what was sent before is heard in the next millisecond
        bench.step(40)
        heard = [c for tick in bench.ticks[start:] for c in tick.commands]
        assert [command.enable for command in heard] == [False] * RELEASES

    def test_a_trip_is_told_at_once(self, bench: Lockstep) -> None:
        injecting(bench)
        sent = tapped(bench)
        while not [frame for frame in sent if frame.can_id == STATE]:
            bench.step()
        sent.clear()  # the next one is due in 10 ms
        bench.waiting.append(Frame(bench.wall_ns, 0x40, b"", error=True))
        bench.step(2)
        message = DATABASE.get_message_by_frame_id(STATE)
        (told,) = [f for f in sent if f.can_id == STATE]
        assert message.decode(told.data, decode_choices=False)["State"] == State.FAULT

    def test_a_good_bus_is_no_trip(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.core.on_bus(bench.now_ns, BusState.ERROR_ACTIVE)
        bench.core.on_bus(bench.now_ns, BusState.UNKNOWN)
        bench.step(50)
        assert bench.state is State.INJECTING

    def test_an_error_frame(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.waiting.append(Frame(bench.wall_ns, 0x40, b"", error=True))
        zero_from_here(bench, 2)
        assert trips(bench) == Trip.BUS

    @pytest.mark.parametrize("key", [OverrideCore.arm, OverrideCore.prepare])
    @pytest.mark.parametrize("what", ["error", "foreign"])
    def test_a_key_of_arming_hides_nothing(
        self, bench: Lockstep, key: Callable[[OverrideCore, int], bool], what: str
    ) -> None:
        """Pressed between a frame that trips and the sync frame at which it is judged."""
        injecting(bench)
        found = Frame(bench.wall_ns, COMMAND, bytes(8), error=what == "error")
        bench.send(bench.core.on_frames([found], bench.now_ns, bench.wall_ns))
        assert key(bench.core, bench.now_ns) is False
        bench.step()
        assert bench.state is State.FAULT
        assert trips(bench) & (Trip.BUS if what == "error" else Trip.OTHER_TRANSMITTER)

    def test_the_key_of_arming_does_nothing_to_a_torque(self, bench: Lockstep) -> None:
        injecting(bench)
        assert bench.core.arm(bench.now_ns) is False
        assert "arming refused" in bench.story()[-1]
        bench.step(3)
        assert bench.state is State.INJECTING
        assert bench.core.command.enable

    def test_the_ecu_says_no(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.rig.override.state = OverrideState.REJECTED
        bench.rig.override.hear = lambda command, now_ns: None  # type: ignore[method-assign]
        zero_from_here(bench, TIMEOUT_MS)
        assert trips(bench) & (Trip.ECU_STATUS | Trip.TORQUE_ERROR)

    def test_the_hand_lets_go_of_the_key(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.beating = False
        bench.step(690)
        assert bench.state is State.INJECTING, bench.story()
        zero_from_here(bench, 22)
        assert trips(bench) == Trip.HEARTBEAT

    @pytest.mark.parametrize("wish", [math.nan, math.inf, 0.5, -0.2])
    def test_a_source_gone_mad(self, parts: OverrideParts, wish: float) -> None:
        source = Sawtooth()
        bench = injecting(Lockstep(parts, source))
        source.wish = lambda _: wish
        zero_from_here(bench, 2)
        assert trips(bench) & (Trip.NOT_FINITE | Trip.TORQUE | Trip.STEP)

    @pytest.mark.parametrize("jump_s", [-3600.0, -0.05, 0.05, 3600.0])
    def test_the_wall_clock_jumps_between_stamp_and_reading(
        self, bench: Lockstep, jump_s: float
    ) -> None:
        injecting(bench)
        shift = round(jump_s * 1e9)
        bench.spoil = lambda frames: [replace(f, t_ns=f.t_ns - shift) for f in frames]
        zero_from_here(bench, 2)
        assert trips(bench) & Trip.STALE_INPUT

    def test_cleared_and_armed_again_it_goes_on(self, bench: Lockstep) -> None:
        injecting(bench)
        bench.core.on_bus(bench.now_ns, BusState.BUS_OFF)
        bench.step(300)
        bench.core.override.clear(bench.now_ns)
        source = Sawtooth()
        bench.core._source = source
        bench.arm()
        bench.step(100)
        assert bench.state is State.INJECTING
        assert abs(bench.ticks[-1].applied_nm) > 0.01


class TestSetup:
    def broken(self, tmp_path: Path, old: str, new: str) -> Path:
        text = CONFIG.read_text()
        assert old in text
        text = text.replace(old, new).replace("../dbc", f"{ROOT}/dbc")
        text = text.replace("signals: ", f"signals: {ROOT}/configs/")
        text = text.replace("model: ", f"model: {ROOT}/configs/")
        path = tmp_path / "c.yaml"
        path.write_text(text)
        return path

    @pytest.mark.parametrize(
        ("old", "new", "said"),
        [
            ("max_torque_nm: 0.4", "max_torque_nm: 1.5", "override.limits.max_torque_nm"),
            ("max_torque_nm: 0.4", "max_torque_nm: .nan", "override.limits.max_torque_nm"),
            ("    max_step_nm: 0.02\n", "", "override.limits.max_step_nm: is missing"),
            ("min_m: -0.01", "min_m: 0.02", "rack_position_min_m is not below"),
            ("max_torque_nm: 0.4", "max_torque_nm: 0.05", "max_torque_error_nm 0.05 is not below"),
            ("limits:", "command_message: EPS_Nothing\n  limits:", "override.command_message"),
            ("limits:", "torque_signal: Torque\n  limits:", "has no signal Torque"),
            ("limits:", "status_signal: Nope\n  limits:", "has no signal Nope"),
            ("limits:", "state_message: Nope\n  limits:", "override.state_message"),
            ("limits:", "state_message: EPS_Temperature\n  limits:", "has no signal State"),
            ("limits:", "torque_scale: 0.01\n  limits:", "carries -8.38861 to 8.38861 Nm only"),
            ("limits:", "torque_scale: 0\n  limits:", "carries -8.38861 to 8.38861 Nm only"),
            ("max_input_age_s: 0.015", "max_input_age_s: 0.001", "not longer than the cycle"),
            ("timeout_s: 0.05", "timeout_s: 0.01", "cycle of EPS_OverrideStatus (0.01 s)"),
            ("hop_limit: 0}", "hop_limit: 0, hardware_stamps: true}", "hardware_stamps"),
            ("limits:", "e2e: {profile: p09}\n  limits:", "override.e2e.profile"),
        ],
    )
    def test_a_mistake_names_the_field(self, tmp_path: Path, old: str, new: str, said: str) -> None:
        path = self.broken(tmp_path, old, new)
        with pytest.raises(InputError, match=re.escape(said)):
            prepare_override(load_config(path), path)

    def test_without_the_block_there_is_no_override(self) -> None:
        config = replace(load_config(CONFIG), override=None)
        with pytest.raises(InputError, match="override: block is missing"):
            prepare_override(config, CONFIG)

    @pytest.mark.parametrize("name", ["motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s"])
    def test_an_input_that_the_guard_needs(self, tmp_path: Path, name: str) -> None:
        text = (ROOT / "configs" / "eps_rig_signals.yaml").read_text()
        mapping = tmp_path / "s.yaml"
        mapping.write_text(re.sub(rf"  {name}: .*\n", "", text))
        config = replace(load_config(CONFIG), signals=mapping)
        with pytest.raises(InputError, match=name):
            prepare_override(config, CONFIG)

    def test_a_torque_that_nobody_measured_is_no_input(self, tmp_path: Path) -> None:
        text = (ROOT / "configs" / "eps_rig_signals.yaml").read_text()
        supply = (
            "{supply_power: {message: EPS_Torques, current: MotorTorque, "
            "voltage: TorsionBarTorque, assist_gain: 0.3, blend_speed_rad_s: 10.0}}"
        )
        mapping = tmp_path / "s.yaml"
        mapping.write_text(re.sub(r"(  motor_torque_nm: ).*\n", rf"\1{supply}\n", text))
        config = replace(load_config(CONFIG), signals=mapping)
        with pytest.raises(InputError, match="motor_torque_nm: is calculated from supply_power"):
            prepare_override(config, CONFIG)

    def test_the_rack_position_may_come_from_the_rotor(self, tmp_path: Path) -> None:
        text = (ROOT / "configs" / "eps_rig_signals.yaml").read_text()
        mapping = tmp_path / "s.yaml"
        mapping.write_text(re.sub(r"  rack_position_m: .*\n", "", text))
        parts = parts_of(replace(load_config(CONFIG), signals=mapping))
        bench = injecting(Lockstep(parts, Sawtooth()))
        position = bench.core._readings["rack_position_m"].value
        assert position == pytest.approx(bench.core.values["motor_angle_rad"] / 2513.0)
        mapping.write_text(re.sub(r"  (rack_position_m|motor_angle_rad): .*\n", "", text))
        with pytest.raises(InputError, match="one of them"):
            prepare_override(replace(load_config(CONFIG), signals=mapping), CONFIG)

    def test_the_state_is_not_told_under_the_name_of_a_command(self) -> None:
        config = load_config(CONFIG)
        assert config.override is not None
        for name in ("EPSHIL_TorqueOverride", "RIG_Command"):
            override = replace(config.override, state_message=name)
            with pytest.raises(InputError, match=f"override.state_message: {name} commands"):
                prepare_override(replace(config, override=override), CONFIG)

    def test_the_session_may_send_its_own_command_and_no_other(self, parts: OverrideParts) -> None:
        assert 0x80 in parts.send_ids
        assert parts.never_send_ids == (0xA0,)

    def test_a_command_with_an_autosar_profile(self) -> None:
        rule = E2eProfile("p01", data_id=0x80)
        override = load_config(CONFIG).override
        assert override is not None
        encoder = CommandEncoder(DATABASE, replace(override, e2e=rule), "DBC")
        message = find_message(DATABASE, "EPSHIL_TorqueOverride")
        assert message is not None
        checker = E2eProtector(rule, 8)
        for k in range(20):
            frame = encoder.frame(Command(0.01 * k, True))
            assert checker.good(frame.data)
            told = message.decode(frame.data, decode_choices=False)
            assert told["RequestedMotorTorque"] == pytest.approx(0.01 * k, abs=1e-6)
            assert told["OverrideRequest"] == 1

    def test_state_and_trip_bits_are_those_of_the_dbc(self) -> None:
        message = find_message(DATABASE, "EPSHIL_OverrideState")
        assert message is not None
        labels = message.get_signal_by_name("State").choices
        named = {int(raw): str(text) for raw, text in labels.items() if str(text) != "SNA"}
        assert named == {int(state): state.name.lower() for state in State}
        reason = message.get_signal_by_name("TripReason")
        assert max(Trip) < 2**reason.length
        for bit in Trip:
            if bit and bit.name:
                assert f"{bit.value} {bit.name.lower().replace('_', ' ')}" in reason.comment


def test_the_ecus_word_is_checked_as_the_mapping_says() -> None:
    """A DBC that names no counter leaves a frozen status message looking alive."""
    database: Any = cantools.database.load_string(
        'VERSION ""\nBO_ 5 Status: 8 ECU\n SG_ Alive : 0|4@1+ (1,0) [0|14] "" X\n'
        ' SG_ Active : 8|2@1+ (1,0) [0|3] "" X\n',
        "dbc",
    )
    message = database.get_message_by_name("Status")
    rules = MessageRules(counter="Alive")
    reader = StatusReader(message, message.get_signal_by_name("Active"), "a.dbc", rules)
    frames = [Frame(n, 5, bytes([n % 15, 1, 0, 0, 0, 0, 0, 0])) for n in range(40)]
    assert [reader.read(frame) for frame in frames] == [1.0] * 40
    assert reader.read(frames[-1]) is None
    blind = StatusReader(message, message.get_signal_by_name("Active"), "a.dbc")
    assert [blind.read(frames[-1]) for _ in range(3)] == [1.0] * 3
