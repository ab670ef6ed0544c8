"""Set-points over CAN: what the rig follows, what it refuses, and how it stops by itself."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import find_message, load_database
from eps_hil.bus.frame import Frame
from eps_hil.physics.chain import HAND_ANGLE, HAND_STIFFNESS, LOAD_FORCE
from eps_hil.rig.command import (
    ACCELERATION_RAD_S2,
    FORCE_LIMIT_N,
    FORCE_RATE_N_PER_S,
    RIG_COMMAND,
    WHEEL_SPEED_LIMIT_RAD_S,
    CommandState,
    RigControl,
    SetPoint,
    SetPointReader,
)
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.manoeuvre import PRELOAD_COMPENSATION
from eps_hil.rig.process import RigSimulation

MS = 1_000_000
TIMEOUT_MS = 100
DATABASE = load_database([Path(__file__).parents[2] / "dbc" / "eps_rig.dbc"])
MOVE = SetPoint(0, True, 1.0, 500.0, 0.0)


@pytest.fixture
def reader() -> SetPointReader:
    return SetPointReader(find_message(DATABASE, RIG_COMMAND))


def frame(**values: float) -> Frame:
    content = {"WheelSpeedSetPoint": 1.5, "RackForceSetPoint": -750.0, "MotorShare": 50.0}
    return FrameEncoder(DATABASE, RIG_COMMAND).frame(content | {"CommandRequest": 1.0} | values)


class TestReader:
    def test_a_good_frame(self, reader: SetPointReader) -> None:
        assert reader.read(frame()) == SetPoint(0, True, 1.5, -750.0, 0.5)

    @pytest.mark.parametrize("byte", range(8))
    def test_any_flipped_bit_is_refused(self, reader: SetPointReader, byte: int) -> None:
        data = bytearray(frame().data)
        data[byte] ^= 0x10
        assert reader.read(replace(frame(), data=bytes(data))) is None

    def test_a_short_frame_is_refused(self, reader: SetPointReader) -> None:
        assert reader.read(replace(frame(), data=frame().data[:7])) is None

    def test_not_available_is_no_number(self, reader: SetPointReader) -> None:
        for name in ("WheelSpeedSetPoint", "RackForceSetPoint", "MotorShare"):
            command = reader.read(frame(**{name: float("nan")}))
            assert command is not None
            assert not command.within_limits

    def test_offset_and_no_range_of_another_database(self, tmp_path: Path) -> None:
        """The offset was left out, and a signal without a range ended the rig in a traceback."""
        file = Path(__file__).parents[2] / "dbc" / "eps_rig.dbc"
        text = file.read_text().replace("(0.001,0) [-32.767|32.767]", "(0.001,-2) [0|0]")
        (tmp_path / "own.dbc").write_text(text)
        database = load_database([tmp_path / "own.dbc"])
        own = SetPointReader(find_message(database, RIG_COMMAND))
        values = {"WheelSpeedSetPoint": 1.5, "RackForceSetPoint": 0.0, "MotorShare": 0.0}
        sent = FrameEncoder(database, RIG_COMMAND).frame(values | {"CommandRequest": 1.0})
        assert own.read(sent) == SetPoint(0, True, 1.5, 0.0, 0.0)
        sent = FrameEncoder(database, RIG_COMMAND).frame(values | {"WheelSpeedSetPoint": np.nan})
        command = own.read(sent)
        assert command is not None
        assert not command.within_limits


class TestControl:
    def control(self) -> RigControl:
        return RigControl(TIMEOUT_MS * MS)

    def test_without_a_command_the_manoeuvre_goes_on(self) -> None:
        assert self.control().rows(0) is None

    def test_set_points_are_reached_at_the_rigs_rates(self) -> None:
        control = self.control()
        rows = []
        for ms in range(400):
            control.hear(replace(MOVE, counter=ms % 256), ms * MS, 0.25)
            found = control.rows(ms * MS)
            assert found is not None
            rows.append(found.copy())
        angle = np.array([row[0][HAND_ANGLE] for row in rows])
        force = np.array([row[0][LOAD_FORCE] for row in rows])
        assert angle[0] == 0.25  # takes over where the wheel is
        assert np.diff(angle)[300] == pytest.approx(1e-3)
        ramp_s = 1.0 / ACCELERATION_RAD_S2
        assert angle[399] == pytest.approx(0.25 + 0.399 - 0.5 * ramp_s, abs=1e-3)
        assert np.abs(np.diff(force)).max() == pytest.approx(FORCE_RATE_N_PER_S * 1e-3)
        assert force[-1] == 500.0
        assert rows[-1][0][PRELOAD_COMPENSATION] == 1.0
        for before, after in pairwise(rows):
            np.testing.assert_array_equal(before[1], after[0])

    def test_silence_brings_speed_and_force_to_zero_and_the_robot_holds(self) -> None:
        control = self.control()
        for ms in range(1000):
            if ms < 300:
                control.hear(replace(MOVE, counter=ms % 256), ms * MS, 0.0)
            found = control.rows(ms * MS)
            assert found is not None
            if ms == 299 + TIMEOUT_MS:
                assert control.state is CommandState.ACTIVE
        assert control.state is CommandState.TIMED_OUT
        assert control.timeouts == 1
        assert found is not None
        assert found[1][LOAD_FORCE] == 0.0
        assert found[1][HAND_ANGLE] == found[0][HAND_ANGLE]
        assert found[1][HAND_STIFFNESS] > 0
        control.hear(SetPoint(7, False, 0.0, 0.0, 0.0), 2000 * MS, 0.0)
        assert control.rows(2000 * MS) is None

    @pytest.mark.parametrize("speed_rad_s", [1.0, 50.0])
    def test_after_a_time_out_commands_alone_bring_nothing_back(self, speed_rad_s: float) -> None:
        """A program that was stopped and goes on sends what is long out of date."""
        control = self.control()
        far = replace(MOVE, wheel_speed_rad_s=speed_rad_s)
        control.hear(far, 0, 0.0)  # active, or rejected
        for ms in range(300):
            control.rows(ms * MS)
        assert control.state is CommandState.TIMED_OUT
        for ms in range(300, 600):
            control.hear(replace(MOVE, counter=ms % 256), ms * MS, 0.0)
            found = control.rows(ms * MS)
            assert control.state is CommandState.TIMED_OUT
            assert found is not None
            assert found[1][LOAD_FORCE] == 0.0
            assert found[1][HAND_ANGLE] == found[0][HAND_ANGLE]
        control.hear(SetPoint(1, False, 0.0, 0.0, 0.0), 600 * MS, 0.0)
        control.hear(replace(MOVE, counter=2), 601 * MS, 0.0)
        assert str(control.state) == str(CommandState.ACTIVE)
        assert control.timeouts == 1

    def test_a_repeated_or_damaged_frame_is_no_sign_of_life(self) -> None:
        control = self.control()
        control.hear(MOVE, 0, 0.0)
        for ms in range(1, 200):
            control.hear(MOVE, ms * MS, 0.0)
            control.hear(None, ms * MS, 0.0)
            control.rows(ms * MS)
        assert control.state is CommandState.TIMED_OUT

    def test_beyond_the_limits_it_stops(self) -> None:
        control = self.control()
        for ms in range(600):
            far = replace(MOVE, counter=ms % 256, wheel_speed_rad_s=50.0 if ms > 300 else 1.0)
            control.hear(far, ms * MS, 0.0)
            found = control.rows(ms * MS)
        assert control.state is CommandState.REJECTED
        assert found is not None
        assert found[1][LOAD_FORCE] == 0.0

    @pytest.mark.parametrize("share", [0.005, 1.0])
    def test_a_share_for_the_motor_is_refused_and_none_is_taken_over(self, share: float) -> None:
        """A torque of the motor is commanded by an armed override, which a guard judges."""
        control = RigControl(TIMEOUT_MS * MS, 0.25)
        control.hear(replace(MOVE, motor_share=share), 0, 0.0)
        found = control.rows(0)
        assert control.state is CommandState.REJECTED
        assert found is not None
        assert found[1][LOAD_FORCE] == 0.0
        assert found[1][PRELOAD_COMPENSATION] == 0.25

    @given(
        st.lists(
            st.tuples(
                st.integers(0, 255),
                st.booleans(),
                st.floats(-40, 40) | st.just(float("nan")),
                st.floats(-20_000, 20_000),
                st.floats(-1, 2),
                st.integers(1, 300),
            ),
            max_size=8,
        )
    )
    @settings(max_examples=60, deadline=None)
    def test_no_sequence_of_commands_leaves_the_limits_or_jumps(
        self, commands: list[tuple[int, bool, float, float, float, int]]
    ) -> None:
        control, now, before = self.control(), 0, None
        for counter, enable, speed, force, share, wait_ms in commands:
            control.hear(SetPoint(counter, enable, speed, force, share), now, 0.0)
            for _ in range(wait_ms):
                found = control.rows(now)
                now += MS
                if found is None:
                    before = None
                    continue
                assert abs(found[1][LOAD_FORCE]) <= FORCE_LIMIT_N
                step = found[1][HAND_ANGLE] - found[0][HAND_ANGLE]
                assert abs(step) <= WHEEL_SPEED_LIMIT_RAD_S * 1e-3 + 1e-9
                if before is not None:
                    assert abs(step - before) <= ACCELERATION_RAD_S2 * 1e-6 + 1e-12
                before = step


def test_the_simulated_rig_follows(config_file: Path) -> None:
    """One second at 2 rad/s and 800 N: rotor at 40 rad/s, load cell at 800 N."""
    text = config_file.read_text().replace("sine_sweep", "idle")
    config_file.write_text(text)
    simulation = RigSimulation(load_rig_setup(config_file))
    assert set(simulation.listens_to) == {0x80, 0xA0}
    encoder = FrameEncoder(DATABASE, RIG_COMMAND)
    values = {"WheelSpeedSetPoint": 2.0, "RackForceSetPoint": 800.0, "MotorShare": 0.0}
    speed, force = [], []
    for ms in range(1000):
        if ms % 10 == 0:
            simulation.hear(encoder.frame(values | {"CommandRequest": 1.0}), ms * MS)
        for sent in simulation.step(ms * MS):
            content = DATABASE.decode_message(sent.can_id, sent.data, decode_choices=False)
            if "MotorSpeed" in content:
                speed.append(content["MotorSpeed"])
            if "RackForce" in content:
                force.append(content["RackForce"])
    assert np.mean(speed[700:]) == pytest.approx(40.0, rel=0.02)
    assert np.mean(force[700:]) == pytest.approx(800.0, abs=3.0)
