"""What a rig is led by, and how leading it ends: old values, pauses, refused frames."""

import errno
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from eps_hil.bus.frame import Frame
from eps_hil.bus.message_decoder import Sample
from eps_hil.errors import BusError, InputError, SafetyStop
from eps_hil.programme.conductor import Wanted
from eps_hil.programme.link import Readings, RigLink
from eps_hil.programme.plan import Plan
from eps_hil.programme.run import ProgrammeRun
from eps_hil.rig.command import CommandState
from eps_hil.rig.sensors import REPORTED

from .link_bench import (
    MODEL,
    MOTOR_STATE,
    RIG_COMMAND,
    RIG_STATE,
    SIGNALS,
    TORQUES,
    LinkBench,
    Turning,
)

NEEDED = (
    "motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "rack_force_n", "rack_position_m",
)  # fmt: skip
FAULT_S = 0.9


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LinkBench:
    return LinkBench(tmp_path, monkeypatch)


def stopped_and_released(bench: LinkBench, since_s: float, in_s: float = 0.08) -> None:
    """Zeros in time, nothing but zeros, a rig at rest, releases at the end."""
    after = bench.since(since_s)
    zero_s, _ = next(one for one in after if one[1].wheel_speed_rad_s == 0.0)
    later = [command for t_s, command in after if t_s >= zero_s]
    assert zero_s - since_s < in_s
    assert {(one.wheel_speed_rad_s, one.rack_force_n) for one in later} == {(0.0, 0.0)}
    assert [one.enable for one in later[-5:]] == [False] * 5
    assert bench.state is CommandState.RELEASED
    assert abs(bench.speed_rad_s) < 3.0
    assert bench.closed


class TestOldValues:
    """One message or one signal is gone, and all others go on."""

    @pytest.mark.parametrize(
        ("can_id", "said"),
        [
            (RIG_STATE, "rack_force_n, rack_position_m"),
            (TORQUES, "motor_torque_nm, torque_sensor_nm"),
            (MOTOR_STATE, "motor_speed_rad_s"),
        ],
    )
    @pytest.mark.parametrize("fault", ["lost", pytest.param("crc", marks=pytest.mark.slow)])
    def test_a_message_that_is_gone_ends_it(
        self, bench: LinkBench, can_id: int, said: str, fault: str
    ) -> None:
        def gone(frames: list[Frame]) -> list[Frame]:
            if bench.now_s < FAULT_S:
                return frames
            if fault == "lost":
                return [one for one in frames if one.can_id != can_id]
            bad = bytes(8)
            return [replace(one, data=bad) if one.can_id == can_id else one for one in frames]

        bench.frames = gone
        self.ends(bench, said)

    @pytest.mark.parametrize(
        "name", [*(pytest.param(one, marks=pytest.mark.slow) for one in NEEDED[:-1]), NEEDED[-1]]
    )
    def test_a_signal_that_is_not_available_ends_it(self, bench: LinkBench, name: str) -> None:
        step = bench.rig._sensors.step

        def without(truth: object, reported: object) -> None:
            step(truth, reported)  # type: ignore[arg-type]
            if bench.now_s >= FAULT_S:
                reported[REPORTED.index(name)] = float("nan")  # type: ignore[index]

        bench.rig._sensors.step = without  # type: ignore[method-assign, assignment]
        self.ends(bench, name)

    def test_a_rig_that_is_silent_altogether(self, bench: LinkBench) -> None:
        bench.frames = lambda frames: frames if bench.now_s < FAULT_S else []
        self.ends(bench, ", ".join(NEEDED))

    @staticmethod
    def ends(bench: LinkBench, said: str) -> None:
        bench.open()
        leader = Turning()
        try:
            with pytest.raises(SafetyStop, match=f"no good value of {said} for 50 ms"):
                bench.link.lead(leader, None, lambda: None)
        finally:
            bench.link.let_go()
        assert SafetyStop.exit_status == 3
        assert abs(leader.readings[-1].speed_rad_s) > 20.0, "it was turning"
        stopped_and_released(bench, FAULT_S)

    def test_some_lost_frames_do_not(self, bench: LinkBench) -> None:
        count = [0]

        def some(frames: list[Frame]) -> list[Frame]:
            count[0] += 1
            return frames if count[0] % 40 == 0 else []

        bench.open()
        bench.frames = some
        bench.link.lead(Turning(60), None, lambda: None)
        bench.link.let_go()

    def test_three_cycles_of_a_slower_message(self) -> None:
        readings = Readings("rack_position_m", MODEL, {"rack_force_n": 0.04})
        readings.take([Sample(name, 0, 1.0) for name in NEEDED], 10.0)
        assert readings.stale(10.049) == []
        assert set(readings.stale(10.06)) == set(NEEDED) - {"rack_force_n"}
        assert "rack_force_n" not in readings.stale(10.119)
        assert "rack_force_n" in readings.stale(10.13)
        readings.take([Sample("rack_force_n", 0, float("nan"))], 10.12)
        assert "rack_force_n" in readings.stale(10.13)

    def test_what_was_never_heard_is_old_and_no_zero(self) -> None:
        readings = Readings("rack_position_m", MODEL, {})
        readings.take([Sample(name, 0, 0.0) for name in NEEDED[:-1]], 1.0)
        assert readings.stale(1.0) == ["rack_position_m"]
        assert not readings.now().position_m < 1e9

    def test_a_message_that_comes_too_seldom_is_refused(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        slow = SIGNALS.read_text().replace(
            "RIG_State: {counter: Counter, crc: Crc, crc_profile: e2e_p01, clock: counter}",
            "RIG_State: {counter: Counter, crc: Crc, crc_profile: e2e_p01, cycle_time_s: 0.1}",
        )
        with pytest.raises(InputError, match="rack_force_n: comes every 100 ms"):
            LinkBench(tmp_path, monkeypatch, slow)


def test_old_values_are_no_rest(bench: LinkBench) -> None:
    """Whoever goes by them lets go of a rig that still turns."""
    bench.open()
    bench.link.lead(Turning(5, Wanted(0.0, 0.0)), None, lambda: None)
    bench.frames = lambda _: []
    bench.link.lead(Turning(4), None, lambda: None)
    before_s = bench.now_s + 1e-3
    bench.link.let_go()
    assert bench.now_s - before_s > 2.0
    stopped_and_released(bench, before_s)


class TestPauses:
    """A process that is stopped (SIGSTOP), or that the machine leaves waiting."""

    def paused(
        self, bench: LinkBench, pause_s: float, ticks: int = 150, *, suspended: bool = False
    ) -> Turning:
        """Leads with one pause from FAULT_S on."""
        done: list[float] = []

        def pause() -> None:
            if bench.now_s >= FAULT_S and not done:
                done.append(bench.now_s)
                (bench.clock.suspend if suspended else bench.clock.sleep)(pause_s)

        leader = Turning(ticks)
        bench.open()
        bench.link.lead(leader, None, pause)
        return leader

    def test_a_long_one_ends_it_and_nothing_is_caught_up(self, bench: LinkBench) -> None:
        with pytest.raises(SafetyStop, match=r"this process stood still for 1\.99 s"):
            self.paused(bench, 2.0)
        assert bench.rig.control.timeouts == 1
        bench.link.let_go()
        stopped_and_released(bench, bench.commands[0][0] + FAULT_S + 1.0, in_s=1.0)
        times = [t_s for t_s, _ in bench.since(FAULT_S)]
        assert min(b - a for a, b in pairwise(times)) > 0.009

    def test_a_computer_that_was_suspended_does_not_go_on(self, bench: LinkBench) -> None:
        """The steady clock stood still with it: set-points went on where they had ended."""
        with pytest.raises(SafetyStop, match=r"this process stood still for 3\.99 s"):
            self.paused(bench, 4.0, suspended=True)
        bench.link.let_go()
        stopped_and_released(bench, bench.commands[0][0] + FAULT_S + 3.0, in_s=1.0)

    @pytest.mark.parametrize("pause_s", [0.062, 0.09])
    def test_of_more_than_50_ms_it_ends(self, bench: LinkBench, pause_s: float) -> None:
        """The rig has not timed out."""
        with pytest.raises(SafetyStop, match="is not sent"):
            self.paused(bench, pause_s)
        assert bench.rig.control.timeouts == 0
        bench.link.let_go()
        stopped_and_released(bench, FAULT_S, in_s=0.11)

    def test_a_short_one_is_not_caught_up(self, bench: LinkBench) -> None:
        leader = self.paused(bench, 0.045, ticks=60)
        assert len(leader.readings) == 60
        times = [t_s for t_s, one in bench.commands if one.enable]
        steps = [b - a for a, b in pairwise(times)]
        assert max(steps) > 0.04
        assert min(steps) > 0.009
        bench.link.let_go()

    @pytest.mark.parametrize("pause_s", [0.02, 0.3])
    def test_files_between_two_leaders_may_take_their_time(
        self, bench: LinkBench, pause_s: float
    ) -> None:
        bench.open()
        bench.link.lead(Turning(5, Wanted(0.0, 0.0)), None, lambda: None)
        bench.clock.sleep(pause_s)
        assert bench.rig.control.timeouts == (pause_s > 0.1)
        leader = Turning(60)
        bench.link.lead(leader, None, lambda: None)
        assert leader.readings[-1].speed_rad_s > 20.0, "the rig obeys again"
        bench.link.let_go()

    def test_for_longer_than_that_it_ends(self, bench: LinkBench) -> None:
        bench.open()
        bench.link.lead(Turning(5, Wanted(0.0, 0.0)), None, lambda: None)
        bench.clock.sleep(1.1)
        leader = Turning(60)
        with pytest.raises(SafetyStop, match=r"no set-point was sent for 1\.1"):
            bench.link.lead(leader, None, lambda: None)
        assert leader.readings == []
        bench.link.let_go()

    def test_a_rig_that_a_killed_program_left_is_taken_over(self, bench: LinkBench) -> None:
        bench.open()
        bench.link.lead(Turning(30), None, lambda: None)
        bench.clock.sleep(1.0)
        assert bench.state is CommandState.TIMED_OUT
        again = RigLink(bench.setup, MODEL)
        again.open(lambda: False, lambda: BusError("stopped"))
        assert str(bench.state) == str(CommandState.RELEASED)
        leader = Turning(60)
        again.lead(leader, None, lambda: None)
        assert leader.readings[-1].speed_rad_s > 20.0
        again.let_go()

    def test_a_request_for_the_command_is_nobody_who_commands(self, bench: LinkBench) -> None:
        bench.frames = lambda frames: [*frames, Frame(0, RIG_COMMAND, b"", remote=True)]
        bench.open()
        bench.link.lead(Turning(30), None, lambda: None)
        bench.link.let_go()

    def test_nothing_is_released_that_somebody_else_commands(self, bench: LinkBench) -> None:
        def with_another(frames: list[Frame]) -> list[Frame]:
            other = (
                [Frame(0, RIG_COMMAND, bytes(8))] if round(bench.now_s * 1e3) % 100 == 90 else []
            )
            return [*frames, *other]

        bench.frames = with_another
        with pytest.raises(BusError, match="another transmitter"):
            bench.open()
        assert bench.commands == []


class TestStop:
    """Whatever ended it is still there, and zeros and releases go out all the same."""

    def led_until(self, bench: LinkBench, error: type[Exception], log: Any = None) -> None:
        bench.open()
        leader = Turning()
        try:
            with pytest.raises(error):
                bench.link.lead(leader, log, lambda: None)
        finally:
            bench.link.let_go()
        assert len(leader.readings) > 30, "it was turning"

    def test_another_transmitter(self, bench: LinkBench) -> None:
        other = Frame(0, RIG_COMMAND, bytes(8))
        bench.frames = lambda frames: [*frames, other] if bench.now_s >= FAULT_S else frames
        self.led_until(bench, BusError)
        stopped_and_released(bench, FAULT_S)

    def test_a_bus_that_is_gone_and_comes_back(self, bench: LinkBench) -> None:
        back_s = FAULT_S + 1.0
        recv, send = bench.recv, bench.send

        def gone() -> None:
            if FAULT_S <= bench.now_s < back_s:
                raise BusError("the bus is gone")

        def failing_recv(timeout_s: float) -> list[Frame]:
            gone()
            return recv(timeout_s)

        def failing_send(frame: Frame) -> bool:
            gone()
            return send(frame)

        bench.recv, bench.send = failing_recv, failing_send  # type: ignore[method-assign]
        self.led_until(bench, BusError)
        stopped_and_released(bench, back_s)

    def test_a_disk_that_is_full(self, bench: LinkBench) -> None:
        class Full:
            def write(self, _: object) -> None:
                if bench.now_s >= FAULT_S:
                    raise OSError(errno.ENOSPC, "No space left on device")

        self.led_until(bench, OSError, Full())
        stopped_and_released(bench, FAULT_S)

    def test_what_cannot_be_decoded(
        self, bench: LinkBench, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        decode = bench.link._decoder.decode

        def failing(frame: Frame) -> list[Sample]:
            if bench.now_s >= FAULT_S:
                raise ValueError("not thought of")
            return decode(frame)

        monkeypatch.setattr(bench.link._decoder, "decode", failing)
        self.led_until(bench, ValueError)
        stopped_and_released(bench, FAULT_S)

    def test_it_stops_before_the_log_is_closed(self, bench: LinkBench) -> None:
        """Closing waits for the disk: whoever leads is at rest before."""
        bench.open()
        leader = Turning()

        def stop() -> None:
            if len(leader.readings) == 40:
                raise InterruptedError

        with pytest.raises(InterruptedError):
            bench.link.lead(leader, None, stop)
        assert bench.state is CommandState.RELEASED
        assert abs(bench.speed_rad_s) < 3.0
        count = len(bench.commands)
        bench.link.let_go()
        assert len(bench.commands) == count


class TestRefused:
    """A full send queue takes no set-point."""

    def test_for_longer_it_ends(self, bench: LinkBench) -> None:
        bench.accepts = lambda: not FAULT_S <= bench.now_s < FAULT_S + 0.3
        bench.open()
        leader = Turning()
        with pytest.raises(SafetyStop, match="no set-point has been taken for 50 ms"):
            bench.link.lead(leader, None, lambda: None)
        assert len(leader.readings) * 0.01 < FAULT_S + 0.1
        assert bench.link.refused >= 6
        bench.link.let_go()
        stopped_and_released(bench, FAULT_S + 0.3)

    def test_all_releases_refused_are_sent_again(self, bench: LinkBench) -> None:
        bench.open()
        bench.link.lead(Turning(20), None, lambda: None)
        released_s: list[float] = []
        send = bench.send

        def refusing(frame: Frame) -> bool:
            assert bench.rig.set_points is not None
            command = bench.rig.set_points.read(frame)
            if command is not None and not command.enable:
                released_s.append(bench.now_s)
                if len(released_s) <= 10:
                    return False
            return send(frame)

        bench.send = refusing  # type: ignore[method-assign]
        bench.link.let_go()
        assert len(released_s) == 15
        assert bench.state is CommandState.RELEASED

    def test_single_ones_are_counted(self, bench: LinkBench) -> None:
        count = [0]

        def sometimes() -> bool:
            count[0] += 1
            return count[0] % 4 == 0

        bench.open()
        bench.accepts = sometimes
        bench.link.lead(Turning(40), None, lambda: None)
        assert bench.link.refused == 30
        bench.link.let_go()


def test_a_rack_beyond_the_files_travel_ends_a_programme(bench: LinkBench, tmp_path: Path) -> None:
    plan = Plan("p", (40.0,), (0.0,), run_s=0.3, settle_s=0.1, rack_travel_m=0.004)
    run = ProgrammeRun(bench.setup, MODEL, plan, tmp_path)
    with pytest.raises(SafetyStop, match=r"rack position -?7\..* mm, the limit is 7 mm; finished"):
        run.run([])
    assert max(abs(position) for _, _, position in bench.truth) < 0.010
    assert bench.state is CommandState.RELEASED
