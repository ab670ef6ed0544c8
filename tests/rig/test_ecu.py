"""The ECU obeys good override commands only, and lets go by itself."""

import math
from pathlib import Path

import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import find_message, load_database
from eps_hil.bus.frame import Frame
from eps_hil.rig.ecu import (
    COMMAND,
    STATUS,
    Command,
    CommandReader,
    Override,
    OverrideReason,
    OverrideState,
)

DATABASE = load_database([Path(__file__).parents[2] / "dbc" / "eps_rig.dbc"])
MS = 1_000_000
TIMEOUT_MS = 20


@pytest.fixture
def override() -> Override:
    return Override(TIMEOUT_MS * MS, torque_limit_nm=5.0)


def enable(counter: int, torque_nm: float) -> Command:
    return Command(counter % 256, True, torque_nm)


class TestReader:
    reader = CommandReader(find_message(DATABASE, COMMAND))

    def frame(self, torque_nm: float, request: float) -> Frame:
        values = {"RequestedMotorTorque": torque_nm, "OverrideRequest": request}
        return FrameEncoder(DATABASE, COMMAND).frame(values)

    def test_a_good_frame_is_read(self) -> None:
        command = self.reader.read(self.frame(-1.25, 1))
        assert command == Command(0, True, -1.25)

    @pytest.mark.parametrize("request_value", [0.0, math.nan])
    def test_anything_but_enable_releases(self, request_value: float) -> None:
        command = self.reader.read(self.frame(1.0, request_value))
        assert command is not None
        assert not command.enable

    def test_a_torque_not_available_is_nan(self) -> None:
        command = self.reader.read(self.frame(math.nan, 1))
        assert command is not None
        assert math.isnan(command.torque_nm)

    def test_an_offset_of_another_database_is_part_of_the_torque(self, tmp_path: Path) -> None:
        """The ECU applied 1 Nm more than was asked for, and than the guard had judged."""
        file = Path(__file__).parents[2] / "dbc" / "eps_rig.dbc"
        own = file.read_text().replace("(1e-06,0) [-8.388607|8.388607]", "(1e-06,-1) [-9|7]")
        (tmp_path / "own.dbc").write_text(own)
        database = load_database([tmp_path / "own.dbc"])
        values = {"RequestedMotorTorque": 0.5, "OverrideRequest": 1.0}
        sent = FrameEncoder(database, COMMAND).frame(values)
        command = CommandReader(find_message(database, COMMAND)).read(sent)
        assert command is not None
        assert command.torque_nm == pytest.approx(0.5)

    @pytest.mark.parametrize("byte", range(8))
    def test_a_flipped_bit_anywhere_fails_the_crc(self, byte: int) -> None:
        data = bytearray(self.frame(1.0, 1).data)
        data[byte] ^= 0x10
        assert self.reader.read(Frame(0, self.reader.can_id, bytes(data))) is None

    @pytest.mark.parametrize("length", [0, 1, 7, 12])
    def test_a_wrong_length_is_refused_whatever_its_crc(self, length: int) -> None:
        data = bytearray(self.frame(1.0, 1).data + bytes(4))[:length]
        if data:
            data[0] = self.reader._crc.expected(bytes(data))
        assert self.reader.read(Frame(0, self.reader.can_id, bytes(data))) is None


class TestOverride:
    def test_own_control_until_commanded(self, override: Override) -> None:
        assert override.torque_nm(0) is None
        assert override.torque_nm(10**12) is None
        assert override.timeouts == 0

    def test_a_command_holds_for_the_timeout_and_not_a_millisecond_longer(
        self, override: Override
    ) -> None:
        override.hear(enable(7, 1.5), 0)
        assert override.torque_nm(TIMEOUT_MS * MS) == 1.5
        assert override.torque_nm((TIMEOUT_MS + 1) * MS) == 0.0
        assert override.state is OverrideState.TIMED_OUT
        assert override.reason is OverrideReason.COMMAND_TIMEOUT
        assert override.timeouts == 1
        assert override.torque_nm(10_000 * MS) == 0.0, "latched: no torque comes back by itself"
        assert override.timeouts == 1

    def test_a_repeated_frame_does_not_keep_it_alive(self, override: Override) -> None:
        for ms in range(30):
            override.hear(enable(7, 1.5), ms * MS)
        assert override.reason is OverrideReason.COUNTER_ERROR
        assert override.torque_nm(30 * MS) == 0.0
        assert override.state is OverrideState.TIMED_OUT

    def test_bad_frames_do_not_keep_it_alive(self, override: Override) -> None:
        override.hear(enable(7, 1.5), 0)
        for ms in range(1, 30):
            override.hear(None, ms * MS)
        assert override.reason is OverrideReason.CRC_ERROR
        assert override.torque_nm(30 * MS) == 0.0

    def test_the_counter_runs_over(self, override: Override) -> None:
        for number in range(600):
            override.hear(enable(number, 0.001 * number), number * MS)
            assert override.torque_nm(number * MS) == 0.001 * number

    @pytest.mark.parametrize("torque_nm", [5.01, -5.01, math.nan, math.inf])
    def test_a_torque_out_of_range_is_refused(self, override: Override, torque_nm: float) -> None:
        override.hear(enable(1, 1.0), 0)
        override.hear(enable(2, torque_nm), MS)
        assert override.torque_nm(MS) == 0.0
        assert override.state is OverrideState.REJECTED
        assert override.reason is OverrideReason.TORQUE_RANGE

    def test_release_gives_the_ecu_its_own_control_back(self, override: Override) -> None:
        override.hear(enable(1, 1.0), 0)
        assert override.torque_nm(100 * MS) == 0.0
        override.hear(Command(2, False, 0.0), 101 * MS)
        assert override.torque_nm(102 * MS) is None
        assert override.torque_nm(500 * MS) is None, "a release needs no further frames"

    def test_after_a_timeout_commands_alone_bring_nothing_back(self, override: Override) -> None:
        override.hear(enable(9, 1.0), 0)
        assert override.torque_nm(100 * MS) == 0.0
        for ms in range(101, 200):
            override.hear(enable(ms, 1.0), ms * MS)
            assert override.torque_nm(ms * MS) == 0.0
        assert override.state is OverrideState.TIMED_OUT
        assert override.reason is OverrideReason.COMMAND_TIMEOUT

    def test_a_new_sender_takes_over_with_a_release_and_any_counter(
        self, override: Override
    ) -> None:
        override.hear(enable(9, 1.0), 0)
        assert override.torque_nm(100 * MS) == 0.0
        override.hear(Command(9, False, 0.0), 101 * MS)
        assert override.state is OverrideState.RELEASED
        override.hear(enable(10, 2.0), 102 * MS)
        assert override.torque_nm(102 * MS) == 2.0

    def test_the_status_fits_its_message(self, override: Override) -> None:
        override.hear(enable(200, 1.25), 0)
        override.torque_nm(0)
        encoder = FrameEncoder(DATABASE, STATUS)
        message = find_message(DATABASE, STATUS)
        assert message is not None
        told = message.decode(encoder.encode(override.status(1.25)), decode_choices=False)
        assert encoder.clipped == encoder.not_available == 0
        assert told["OverrideState"] == OverrideState.ACTIVE
        assert told["CommandCounterEcho"] == 200
        assert told["AppliedMotorTorque"] == pytest.approx(1.25)
