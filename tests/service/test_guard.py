"""The torque guard: each limit at its edge, the latch, arming; every line and branch of it.

``scripts/test`` asks for 100 % branch coverage of guard and limits from this file alone,
``scripts/mutate_guard`` mutates both: each mutant has to fail here.
"""

import math
from dataclasses import asdict, fields

import pytest
from pydantic import TypeAdapter, ValidationError

from eps_hil.estimation.validity import Reason
from eps_hil.service.guard import (
    ARM_PAUSE_NS,
    ECU_ACTIVE,
    WINDOW_NS,
    Command,
    Reading,
    TorqueGuard,
    Trip,
)
from eps_hil.service.limits import CEILINGS, Limits

from .guard_bench import INPUTS, LIMITS, MS, Bench, armed, injecting, with_limits

ZERO = Command(0.0, False)
FROM_FILE = TypeAdapter(Limits)


def enabled_before_a_trip(bench: Bench, length: int, state: float | None = None) -> int:
    """Frames, in commands of ``length`` frames a frame of release apart, until one is refused."""
    enabled = 0
    while enabled < 500:
        for _ in range(length):
            if state is not None:
                bench.ecu = Reading(state, bench.now_ns)
            if not bench.step(0.001).enable:
                return enabled
            enabled += 1
        bench.step(None)
    return enabled


def tripped(bench: Bench, trips: Trip) -> None:
    """Latched for exactly these reasons, and silent whatever is asked for."""
    assert bench.guard.trips == trips
    assert not bench.guard.armed
    for request in (None, 0.0, 0.001, 0.1):
        assert bench.step(request) == ZERO
    assert not bench.arm()
    assert bench.guard.trips == trips


class TestArming:
    def test_the_pauses_are_what_they_are_called(self) -> None:
        assert (ARM_PAUSE_NS, WINDOW_NS, ECU_ACTIVE) == (200 * MS, 250 * MS, 1)

    def test_at_first_nothing_is_let_through_and_nothing_trips(self) -> None:
        bench = Bench()
        assert not bench.guard.armed
        assert bench.guard.energy_j == 0.0
        for request in (None, 0.1, math.nan, 9.0):
            assert bench.step(request) == ZERO
        assert (bench.guard.trips, bench.guard.reason) == (Trip.NONE, Reason.FINE)

    def test_two_steps_arm_and_a_request_passes_unchanged(self) -> None:
        bench = armed()
        assert bench.guard.armed
        assert bench.step(0.01) == Command(0.01, True)
        assert bench.step(-0.01) == Command(-0.01, True)
        assert bench.step(0.0) == Command(0.0, True)
        assert bench.step(None) == ZERO
        assert bench.guard.armed

    def test_the_second_step_alone_does_nothing(self) -> None:
        bench = Bench()
        bench.idle(5)
        assert bench.guard.arm(bench.now_ns, bench.seen()) is False
        assert not bench.guard.armed

    @pytest.mark.parametrize(
        ("pause_ms", "arms"), [(199, False), (200, True), (1000, True), (1001, False)]
    )
    def test_the_second_step_has_its_window(self, pause_ms: int, arms: bool) -> None:
        bench = Bench()
        bench.idle(1)
        assert bench.guard.prepare(bench.now_ns)
        bench.idle(pause_ms)
        assert bench.guard.arm(bench.now_ns, bench.seen()) is arms
        assert bench.guard.armed is arms

    def test_a_failed_second_step_starts_anew(self) -> None:
        bench = Bench()
        bench.idle(1)
        bench.guard.prepare(bench.now_ns)
        bench.idle(10)
        assert not bench.guard.arm(bench.now_ns, bench.seen())
        bench.idle(300)
        assert not bench.guard.arm(bench.now_ns, bench.seen())

    def test_armed_it_cannot_be_prepared_again(self) -> None:
        assert armed().guard.prepare(0) is False

    def test_it_does_not_arm_on_inputs_that_are_not_good(self) -> None:
        bench = Bench()
        bench.reason = Reason.SETTLING
        assert bench.arm() is False
        assert bench.guard.trips == Trip.NONE, "refused, not tripped"
        bench.reason = Reason.FINE
        assert bench.arm()

    def test_before_the_first_frame_it_does_not_arm(self) -> None:
        bench = Bench()
        bench.guard.prepare(0)
        assert bench.guard.obstacles(bench.now_ns, bench.seen()) & Trip.CLOCK
        assert not bench.guard.arm(ARM_PAUSE_NS, bench.seen())

    def test_disarming_needs_both_steps_again(self) -> None:
        bench = injecting()
        bench.guard.disarm()
        assert bench.step(0.1) == ZERO
        assert bench.guard.trips == Trip.NONE
        bench.guard.prepare(bench.now_ns)
        bench.guard.disarm()
        bench.idle(300)
        assert not bench.guard.arm(bench.now_ns, bench.seen())
        assert bench.arm()

    def test_after_a_trip_only_clearing_and_both_steps_lead_back(self) -> None:
        bench = injecting()
        bench.guard.trip(Trip.OPERATOR, Reason.GAP)
        assert bench.guard.reason == Reason.GAP
        tripped(bench, Trip.OPERATOR)
        assert not bench.guard.prepare(bench.now_ns)
        bench.guard.clear()
        assert (bench.guard.trips, bench.guard.reason) == (Trip.NONE, Reason.FINE)
        assert not bench.guard.armed
        assert bench.step(0.01) == ZERO
        bench.idle(300)
        assert not bench.guard.arm(bench.now_ns, bench.seen())
        assert bench.arm()
        bench.values["motor_torque_nm"] = 0.0
        assert bench.inject(0.1) == Command(0.1, True)

    def test_a_trip_between_the_steps_of_arming_is_not_armed_over(self) -> None:
        bench = Bench()
        bench.idle(1)
        bench.guard.prepare(bench.now_ns)
        bench.idle(250)
        bench.guard.trips = Trip.BUS  # as if a trip had left the first step standing
        assert not bench.guard.arm(bench.now_ns, bench.seen())

    def test_clearing_in_mid_injection_disarms(self) -> None:
        bench = injecting()
        bench.guard.clear()
        assert bench.step(0.1) == ZERO

    def test_the_first_reason_stays(self) -> None:
        bench = injecting()
        bench.guard.trip(Trip.BUS, Reason.TIME)
        bench.guard.trip(Trip.OPERATOR, Reason.GAP)
        assert (bench.guard.trips, bench.guard.reason) == (Trip.BUS, Reason.TIME)


class TestRequest:
    @pytest.mark.parametrize("sign", [1, -1])
    def test_absolute(self, sign: int) -> None:
        limits = with_limits(max_change_250ms_nm=0.5)
        bench = injecting(sign * 0.25, limits)
        bench.hold(sign * 0.25, 300)
        for k in range(1, 26):
            torque_nm = sign * (0.25 + 0.01 * k)
            bench.values["motor_torque_nm"] = bench.step(torque_nm).torque_nm
        assert bench.step(sign * 0.5) == Command(sign * 0.5, True)
        assert bench.step(sign * 0.5000001) == ZERO
        tripped(bench, Trip.TORQUE)

    @pytest.mark.parametrize("torque_nm", [math.nan, math.inf, -math.inf])
    def test_no_number(self, torque_nm: float) -> None:
        bench = injecting()
        assert bench.step(torque_nm) == ZERO
        tripped(bench, Trip.NOT_FINITE)

    @pytest.mark.parametrize("sign", [1, -1])
    def test_step_from_frame_to_frame(self, sign: int) -> None:
        bench = armed(with_limits(max_step_nm=0.03125))  # exact in binary
        assert bench.step(sign * 0.03125) == Command(sign * 0.03125, True)
        assert bench.step(0.0) == Command(0.0, True)
        assert bench.step(sign * 0.03126) == ZERO
        tripped(bench, Trip.STEP)

    def test_a_step_down_is_a_step_too(self) -> None:
        bench = injecting(0.1)
        assert bench.step(0.0799) == ZERO
        tripped(bench, Trip.STEP)

    def test_zero_may_come_at_once(self) -> None:
        bench = injecting(0.35)
        assert bench.step(0.0) == Command(0.0, True)
        assert bench.guard.trips == Trip.NONE

    @pytest.mark.parametrize(("wait_ms", "trips"), [(249, Trip.CHANGE_250MS), (250, Trip.NONE)])
    def test_change_within_250_ms(self, wait_ms: int, trips: Trip) -> None:
        """From -0.2 (held until 1 ms before it starts to rise) to 0.21: 0.41 apart."""
        bench = injecting(-0.2)
        bench.hold(-0.2, 300)
        start_ns = bench.now_ns
        for k in range(1, 41):
            bench.values["motor_torque_nm"] = bench.step(-0.2 + 0.01 * k).torque_nm
        assert bench.guard.trips == Trip.NONE, "0.4 is allowed"
        while bench.now_ns < start_ns + wait_ms * MS:
            bench.step(0.2)
        bench.step(0.21)
        assert bench.guard.trips == trips

    def test_many_messages_do_not_get_round_the_250_ms(self) -> None:
        bench = armed()
        for k in range(40):
            assert bench.step(0.01 * (k + 1), after_ms=0.01).enable
        assert bench.step(0.41, after_ms=0.01) == ZERO
        tripped(bench, Trip.CHANGE_250MS)

    def test_commands_before_a_pause_count(self) -> None:
        limits = with_limits(max_change_250ms_nm=0.3001)
        bench = injecting(0.2, limits)
        bench.step(None)
        bench.values["motor_torque_nm"] = 0.0
        for k in range(1, 11):
            assert bench.step(-0.01 * k).enable
        assert bench.step(-0.11) == ZERO
        tripped(bench, Trip.CHANGE_250MS)

    def test_a_pause_starts_from_zero_again(self) -> None:
        bench = injecting(0.1)
        bench.step(None)
        assert bench.step(0.1) == ZERO
        tripped(bench, Trip.STEP)


class TestGear:
    @pytest.mark.parametrize("sign", [1, -1])
    @pytest.mark.parametrize(
        ("name", "most", "trips"),
        [
            ("torque_sensor_nm", 2.0, Trip.DRIVER),
            ("motor_speed_rad_s", 20.0, Trip.SPEED),
        ],
    )
    def test_driver_and_speed(self, sign: int, name: str, most: float, trips: Trip) -> None:
        bench = injecting()
        bench.values[name] = sign * (most - 2e-9)
        assert bench.step(0.1).enable
        bench.values[name] = sign * (most + 2e-9)
        assert bench.step(0.1) == ZERO
        tripped(bench, trips)

    @pytest.mark.parametrize(("good", "bad"), [(-0.01 + 2e-9, -0.010001), (0.02 - 2e-9, 0.020001)])
    def test_position(self, good: float, bad: float) -> None:
        bench = injecting()
        bench.values["rack_position_m"] = good
        assert bench.step(0.1).enable
        bench.values["rack_position_m"] = bad
        assert bench.step(0.1) == ZERO
        tripped(bench, Trip.POSITION)

    @pytest.mark.parametrize("name", ["torque_sensor_nm", "motor_speed_rad_s", "rack_position_m"])
    @pytest.mark.parametrize("edge", [0, 1])
    def test_the_edge_itself_is_inside(self, name: str, edge: int) -> None:
        edges = {"torque_sensor_nm": (-2.0, 2.0), "motor_speed_rad_s": (-20.0, 20.0)}
        bench = injecting()
        bench.held.add(name)
        bench.values[name] = edges.get(name, (-0.01, 0.02))[edge]
        assert bench.step(0.1).enable

    def test_while_nothing_is_wanted_a_driver_may_steer(self) -> None:
        bench = armed()
        bench.values |= {"torque_sensor_nm": 9.0, "motor_speed_rad_s": 90.0}
        bench.values["rack_position_m"] = 0.05
        bench.idle(10)
        assert bench.guard.armed
        assert bench.step(0.001) == ZERO
        tripped(bench, Trip.DRIVER | Trip.SPEED | Trip.POSITION)

    def test_energy_is_the_work_of_both_signs(self) -> None:
        bench = injecting(0.125, with_limits(max_energy_j=0.25))
        before_j = bench.guard.energy_j
        bench.held.add("motor_speed_rad_s")
        spent_j = 0.0
        for k in range(98):
            bench.values["motor_speed_rad_s"] = (16.0 + 1e-6 * k) * (-1) ** k
            spent_j += 0.125 * 1e-3 * abs(bench.values["motor_speed_rad_s"])
            assert bench.step(0.125).enable
        assert bench.guard.energy_j - before_j == pytest.approx(spent_j, rel=1e-9)
        while bench.guard.trips == Trip.NONE:
            bench.values["motor_speed_rad_s"] *= -1.0
            bench.step(0.125)
        assert 0.25 < bench.guard.energy_j < 0.2521
        tripped(bench, Trip.ENERGY)

    def test_exactly_the_energy_budget_may_be_spent(self) -> None:
        bench = injecting()
        bench.guard.energy_j = 2.0
        bench.held.add("motor_speed_rad_s")
        assert bench.step(0.1).enable
        bench.guard.energy_j = math.nextafter(2.0, 3.0)
        assert bench.step(0.1) == ZERO
        tripped(bench, Trip.ENERGY)

    def test_arming_starts_the_budgets_anew(self) -> None:
        bench = injecting()
        bench.guard.disarm()
        bench.guard.energy_j = 1.9
        assert bench.arm()
        assert bench.guard.energy_j == 0.0

    def test_time_armed(self) -> None:
        bench = armed(with_limits(max_armed_s=0.5))
        bench.idle(500)
        assert bench.guard.armed
        bench.step(None)
        tripped(bench, Trip.TIME_BUDGET)

    def test_ten_minutes_are_counted_to_the_nanosecond(self) -> None:
        bench = armed(with_limits(max_armed_s=600.0))
        bench.guard._armed_ns = bench.now_ns + MS - 600_000 * MS
        bench.step(None)
        assert bench.guard.armed
        bench.guard._armed_ns = bench.now_ns + MS - 600_000 * MS - 1
        bench.step(None)
        tripped(bench, Trip.TIME_BUDGET)

    def test_no_request_spends_no_energy(self) -> None:
        bench = armed()
        bench.values["motor_speed_rad_s"] = 10.0
        bench.idle(50)
        assert bench.guard.energy_j == 0.0


class TestEcu:
    def test_a_torque_that_does_not_follow(self) -> None:
        """It may be late by the response time, and after that by the slack."""
        bench = armed()
        for k in range(1, 13):
            assert bench.step(0.01 * k).enable
        # 12 ms on, the commands of the last 10 ms began at 0.03; 0.06 of slack
        assert bench.guard.trips == Trip.NONE
        while bench.step(0.12).enable:
            pass
        tripped(bench, Trip.TORQUE_ERROR)

    @pytest.mark.parametrize("reported_nm", [0.1 + 0.0625, 0.1 - 0.0625])
    def test_the_slack_has_an_edge_on_both_sides(self, reported_nm: float) -> None:
        bench = injecting(0.1, with_limits(max_torque_error_nm=0.0625))
        bench.hold(0.1, 20)
        bench.held.add("motor_torque_nm")
        bench.values["motor_torque_nm"] = 0.1 + (reported_nm - 0.1) * 0.999
        assert bench.step(0.1).enable
        bench.values["motor_torque_nm"] = 0.1 + (reported_nm - 0.1) * 1.001
        assert bench.step(0.1) == ZERO
        tripped(bench, Trip.TORQUE_ERROR)

    @pytest.mark.parametrize("side", [1, -1])
    def test_the_edge_of_the_slack_is_inside(self, side: int) -> None:
        bench = injecting(0.125, with_limits(max_torque_error_nm=0.0625))
        bench.hold(0.125, 20)
        bench.held.add("motor_torque_nm")
        bench.values["motor_torque_nm"] = 0.125 + side * 0.0625
        assert bench.step(0.125).enable

    def test_the_first_commands_get_the_response_time(self) -> None:
        """Own assist may still be there; the check begins after, not at, the response time."""
        bench = armed()
        bench.values["motor_torque_nm"] = 0.3
        assert [bench.step(0.001).enable for _ in range(12)] == [True] * 11 + [False]
        tripped(bench, Trip.TORQUE_ERROR)

    def test_a_pause_gives_the_response_time_again(self) -> None:
        bench = injecting(0.1)
        bench.hold(0.1, 20)
        bench.step(None)
        bench.values["motor_torque_nm"] = 0.3
        assert [bench.step(0.001).enable for _ in range(12)] == [True] * 11 + [False]

    @pytest.mark.parametrize("length", [1, 4, 10, 11, 50])
    def test_short_commands_share_the_response_time(self, length: int) -> None:
        bench = armed()
        bench.values["motor_torque_nm"] = 0.3
        assert enabled_before_a_trip(bench, length) == 11
        tripped(bench, Trip.TORQUE_ERROR)

    def test_short_commands_that_the_ecu_follows_may_go_on(self) -> None:
        assert enabled_before_a_trip(armed(), 4) == 500

    @pytest.mark.parametrize(("judged_ms", "enabled"), [(11, 0), (12, 11)])
    def test_a_command_that_was_judged_gives_it_again(self, judged_ms: int, enabled: int) -> None:
        bench = armed()
        bench.hold(0.001, 5)
        bench.step(None)
        bench.hold(0.001, judged_ms)
        bench.step(None)
        bench.values["motor_torque_nm"] = 0.3
        assert enabled_before_a_trip(bench, 1) == enabled
        tripped(bench, Trip.TORQUE_ERROR)

    @pytest.mark.parametrize("after_ms", [4.0, 4.001])
    def test_a_frame_longer_than_the_response_time_uses_it_up(self, after_ms: float) -> None:
        bench = armed(with_limits(torque_response_s=0.004))
        bench.values["motor_torque_nm"] = 0.3
        assert bench.step(0.001).enable
        bench.step(None, after_ms=after_ms)
        assert bench.step(0.001).enable is (after_ms == 4.0)

    def test_the_first_frame_of_all_is_judged_by_nothing(self) -> None:
        """However short the response time: nothing was commanded before it."""
        bench = armed(with_limits(torque_response_s=1e-10))
        bench.values["motor_torque_nm"] = 0.3
        assert [bench.step(0.001).enable for _ in range(2)] == [True, False]

    @pytest.mark.parametrize("spent", ["torque", "status"])
    def test_arming_gives_the_ecu_its_times_again(self, spent: str) -> None:
        bench = armed()
        wrong = {"torque": (0.3, None, 11), "status": (0.0, 0.0, 41)}
        bench.values["motor_torque_nm"], state, enabled = wrong[spent]
        for _ in range(2):
            assert enabled_before_a_trip(bench, 3, state) == enabled
            bench.guard.clear()
            assert bench.arm()

    def test_commands_older_than_the_response_time_do_not_excuse(self) -> None:
        """From 0.1 straight to zero; the ECU keeps 0.1: gone 11 ms after the last 0.1."""
        bench = injecting(0.1)
        bench.hold(0.1, 20)
        assert [bench.step(0.0).enable for _ in range(11)] == [True] * 10 + [False]
        tripped(bench, Trip.TORQUE_ERROR)

    def test_the_command_in_force_counts_however_old(self) -> None:
        """Frames every 8 ms, response time 4 ms: the last command is 8 ms old, and obeyed."""
        bench = armed(with_limits(torque_response_s=0.004))
        bench.values["motor_torque_nm"] = 0.02
        for _ in range(5):
            assert bench.step(0.02, after_ms=8).enable
        bench.values["motor_torque_nm"] = 0.09
        assert bench.step(0.02, after_ms=8) == ZERO
        tripped(bench, Trip.TORQUE_ERROR)

    def test_without_a_status_message_nothing_is_asked_of_it(self) -> None:
        bench = injecting()
        assert bench.hold(0.1, 100).enable

    def test_the_status_must_say_active_after_its_time(self) -> None:
        bench = armed()
        enabled = 0
        while True:
            bench.ecu = Reading(0.0, bench.now_ns)
            if not bench.step(0.001).enable:
                break
            enabled += 1
        assert enabled == 41, "40 ms after the first command it may still be missing"
        tripped(bench, Trip.ECU_STATUS)

    @pytest.mark.parametrize("state", [0, 2, 3, 1.5, math.nan])
    def test_any_other_state_trips(self, state: float) -> None:
        bench = injecting()
        for _ in range(60):
            bench.ecu = Reading(ECU_ACTIVE, bench.now_ns)
            assert bench.step(0.1).enable
        bench.ecu = Reading(state, bench.now_ns)
        assert bench.step(0.1) == ZERO
        tripped(bench, Trip.ECU_STATUS)

    def test_a_status_that_stopped_trips(self) -> None:
        bench = injecting()
        bench.hold(0.1, 60)
        bench.ecu = Reading(ECU_ACTIVE, bench.now_ns)
        assert [bench.step(0.1).enable for _ in range(41)] == [True] * 40 + [False]
        tripped(bench, Trip.ECU_STATUS)

    @pytest.mark.parametrize("state", [0.0, math.nan])
    @pytest.mark.parametrize("length", [1, 10, 40])
    def test_short_commands_share_the_time_of_the_status(self, length: int, state: float) -> None:
        bench = armed()
        assert enabled_before_a_trip(bench, length, state) == 41
        tripped(bench, Trip.ECU_STATUS)

    def test_short_commands_that_the_ecu_confirms_may_go_on(self) -> None:
        assert enabled_before_a_trip(armed(), 4, ECU_ACTIVE) == 500

    @pytest.mark.parametrize(("after_ns", "goes_on"), [(0, False), (1, True), (MS + 1, False)])
    def test_only_what_was_said_during_a_command_confirms_it(
        self, after_ns: int, goes_on: bool
    ) -> None:
        """Not before it, and not in the future."""
        bench = armed()
        for _ in range(60):
            bench.ecu = Reading(0.0, bench.now_ns)
            bench.step(0.001)
            bench.ecu = Reading(ECU_ACTIVE, bench.now_ns + after_ns)
            bench.step(None)
        assert (bench.guard.trips == Trip.NONE) is goes_on

    def test_a_status_that_took_it_back_confirms_nothing(self) -> None:
        """Active in the first command alone: 41 ms of commands later it trips."""
        bench = armed()
        assert bench.step(0.001).enable
        bench.ecu = Reading(ECU_ACTIVE, bench.now_ns + 1)
        bench.step(None)
        assert enabled_before_a_trip(bench, 10, 0.0) == 41
        tripped(bench, Trip.ECU_STATUS)


class TestLink:
    @pytest.mark.parametrize("wanted", [None, 0.1])
    @pytest.mark.parametrize("name", INPUTS)
    def test_an_old_input(self, name: str, wanted: float | None) -> None:
        bench = injecting()
        bench.ages_ns[name] = 8 * MS
        bench.step(wanted)
        assert bench.guard.armed
        bench.ages_ns[name] = 8 * MS + 1
        bench.step(wanted)
        tripped(bench, Trip.STALE_INPUT)

    def test_an_input_from_the_future(self) -> None:
        bench = injecting()
        bench.ages_ns["torque_sensor_nm"] = -1
        assert bench.step(0.1) == ZERO
        tripped(bench, Trip.STALE_INPUT)

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    @pytest.mark.parametrize("name", INPUTS)
    def test_an_input_that_is_no_number(self, name: str, value: float) -> None:
        bench = injecting()
        bench.values[name] = value
        assert bench.step(None) == ZERO
        assert bench.guard.trips & Trip.NOT_FINITE
        assert not bench.guard.trips & ~(Trip.NOT_FINITE | Trip.ENERGY)

    @pytest.mark.parametrize(("name", "after_ms"), list(zip(INPUTS, (11, 12, 13, 14), strict=True)))
    def test_a_frozen_input(self, name: str, after_ms: int) -> None:
        bench = armed()
        bench.held.add(name)
        bench.values[name] += 1e-3
        bench.idle(after_ms + 1)
        assert bench.guard.armed
        bench.step(None)
        tripped(bench, Trip.FROZEN_INPUT)

    @pytest.mark.parametrize("name", INPUTS)
    def test_a_sensor_may_be_allowed_to_be_silent(self, name: str) -> None:
        field = name.rsplit("_nm", 1)[0].removesuffix("_rad_s").removesuffix("_m") + "_frozen_s"
        bench = armed(with_limits(**{field: None}))
        bench.held.add(name)
        bench.idle(100)
        assert bench.guard.armed

    @pytest.mark.parametrize("reason", [each for each in Reason if each])
    def test_the_services_verdict(self, reason: Reason) -> None:
        bench = injecting()
        bench.reason = reason
        assert bench.step(0.1) == ZERO
        assert bench.guard.reason == reason
        tripped(bench, Trip.INVALID_INPUT)

    def test_another_transmitter(self) -> None:
        bench = injecting()
        bench.foreign = True
        assert bench.step(None) == ZERO
        tripped(bench, Trip.OTHER_TRANSMITTER)

    def test_the_bus(self) -> None:
        bench = injecting()
        bench.bus_good = False
        assert bench.step(None) == ZERO
        tripped(bench, Trip.BUS)

    def test_a_gap_between_decisions(self) -> None:
        bench = injecting()
        assert bench.step(0.1, after_ms=9).enable
        bench.step(0.1, after_ms=9.001)
        tripped(bench, Trip.CLOCK)

    def test_a_long_gap_empties_the_window_and_still_trips(self) -> None:
        bench = injecting()
        assert bench.step(0.1, after_ms=10_000) == ZERO
        assert bench.guard.trips & Trip.CLOCK

    def test_time_backwards(self) -> None:
        bench = injecting()
        assert bench.step(0.1, after_ms=0).enable, "two frames of one instant are no fault"
        bench.step(0.1, after_ms=-0.001)
        tripped(bench, Trip.CLOCK)

    def test_the_heartbeat(self) -> None:
        bench = injecting()
        bench.beating = False
        assert bench.hold(0.1, 100).enable
        assert bench.step(0.1) == ZERO
        tripped(bench, Trip.HEARTBEAT)

    def test_arming_is_a_sign_of_life(self) -> None:
        bench = armed()
        bench.beating = False
        assert bench.hold(0.01, 100).enable
        assert bench.step(0.01) == ZERO

    def test_a_heartbeat_from_the_future(self) -> None:
        bench = injecting()
        bench.beating = False
        bench.guard.heartbeat(bench.now_ns + 10 * MS)
        assert bench.step(0.1) == ZERO
        tripped(bench, Trip.HEARTBEAT)

    def test_without_a_request_nobody_needs_to_hold_the_key(self) -> None:
        bench = armed()
        bench.beating = False
        bench.idle(500)
        assert bench.guard.armed

    def test_all_reasons_are_told(self) -> None:
        bench = injecting()
        bench.reason, bench.foreign, bench.bus_good = Reason.GAP, True, False
        bench.values["torque_sensor_nm"] = 5.0
        bench.step(0.7)
        told = Trip.INVALID_INPUT | Trip.OTHER_TRANSMITTER | Trip.BUS | Trip.DRIVER
        tripped(bench, told | Trip.TORQUE | Trip.STEP | Trip.CHANGE_250MS)


class TestLimits:
    def test_the_bits_of_a_trip(self) -> None:
        """They are on the bus and in journals."""
        names = (
            "NOT_FINITE TORQUE STEP CHANGE_250MS DRIVER TORQUE_ERROR ECU_STATUS SPEED POSITION "
            "ENERGY TIME_BUDGET HEARTBEAT OTHER_TRANSMITTER STALE_INPUT INVALID_INPUT "
            "FROZEN_INPUT BUS CLOCK OPERATOR"
        )
        assert {each.name: int(each) for each in Trip} == {
            name: 2**bit for bit, name in enumerate(names.split())
        }
        assert int(Trip.NONE) == 0

    def test_every_limit_has_a_ceiling(self) -> None:
        assert {field.name for field in fields(Limits)} == set(CEILINGS)

    def test_the_ceilings(self) -> None:
        """Written out a second time: nobody moves one without being asked twice."""
        assert list(CEILINGS.values()) == [
            1.0, 0.05, 0.5, 5.0, 0.3, 0.05, 0.2, 60.0, 0.06, 0.06,
            50.0, 600.0, 30.0, 1.0, 0.1, 0.05, 1.0, 1.0, 1.0, 1.0,
        ]  # fmt: skip

    @pytest.mark.parametrize("name", list(CEILINGS))
    def test_a_limit_may_reach_its_ceiling_and_not_go_beyond(self, name: str) -> None:
        ceiling = CEILINGS[name]
        other = {"rack_position_min_m": {"rack_position_max_m": 0.06}}.get(name, {})
        if name == "rack_position_min_m":
            assert getattr(with_limits(**other, **{name: -ceiling}), name) == -ceiling
        else:
            assert getattr(with_limits(**other, **{name: ceiling}), name) == ceiling
        for beyond in (math.nextafter(ceiling, math.inf), math.inf, math.nan, -2 * ceiling):
            with pytest.raises(ValueError, match=f"{name} .* is beyond its ceiling"):
                with_limits(**other, **{name: beyond})

    @pytest.mark.parametrize("name", [each for each in CEILINGS if "rack_position_m" not in each])
    def test_zero_is_no_limit(self, name: str) -> None:
        other = {"max_torque_nm": {"max_torque_error_nm": 5e-324}}.get(name, {})
        least = 1e-323 if other else 5e-324
        assert getattr(with_limits(**other, **{name: least}), name) > 0
        with pytest.raises(ValueError, match=name):
            with_limits(**{name: 0.0})

    @pytest.mark.parametrize("name", ["rack_position_min_m", "rack_position_max_m"])
    def test_the_window_may_lie_on_one_side_of_the_centre(self, name: str) -> None:
        assert getattr(with_limits(**{name: 0.0}), name) == 0.0

    @pytest.mark.parametrize("low", [0.02, 0.03])
    def test_a_window_needs_two_ends(self, low: float) -> None:
        with pytest.raises(ValueError, match="rack_position_min_m is not below"):
            with_limits(rack_position_min_m=low)

    @pytest.mark.parametrize("error_nm", [0.3, 0.2])
    def test_a_missing_torque_must_be_noticed_within_what_is_commanded(
        self, error_nm: float
    ) -> None:
        """An ECU that ignores every command reports 0 Nm, which would never be too far off."""
        with pytest.raises(ValueError, match=r"max_torque_error_nm .* is not below max_torque_nm"):
            with_limits(max_torque_nm=0.2, max_torque_error_nm=error_nm)
        least = with_limits(max_torque_nm=0.2, max_torque_error_nm=0.1999)
        assert least.max_torque_error_nm < least.max_torque_nm

    @pytest.mark.parametrize("name", [each for each in CEILINGS if "frozen" not in each])
    def test_none_of_them_can_be_left_out(self, name: str) -> None:
        with pytest.raises(TypeError):
            with_limits(**{name: None})

    @pytest.mark.parametrize("name", list(CEILINGS))
    def test_a_file_beyond_a_ceiling_is_told_the_field(self, name: str) -> None:
        from_file = FROM_FILE.validate_python
        good = asdict(LIMITS)
        low = {
            "rack_position_min_m": -0.06, "rack_position_max_m": -0.0001,
            "max_torque_nm": math.nextafter(LIMITS.max_torque_error_nm, 1.0),
        }.get(name, 5e-324)  # fmt: skip
        high = {"rack_position_min_m": 0.0199}.get(name, CEILINGS[name])
        for value in (low, high):
            assert getattr(from_file(good | {name: value}), name) == value
        ceiling = CEILINGS[name]
        lowest = math.nextafter(-ceiling, -math.inf) if "position_m" in name else 0.0
        above = math.nextafter(ceiling, math.inf)
        beyond = (lowest, above, math.inf, -math.inf, math.nan)
        no_numbers: tuple[object, ...] = (True, str(low), "much")  # `yes` in YAML is True
        for wrong in beyond + no_numbers:
            with pytest.raises(ValidationError) as caught:
                from_file(good | {name: wrong})
            (problem,) = caught.value.errors()
            assert problem["loc"][0] == name

    @pytest.mark.parametrize("name", list(CEILINGS))
    def test_a_file_without_a_limit_is_refused(self, name: str) -> None:
        given = asdict(LIMITS)
        del given[name]
        with pytest.raises(ValidationError) as caught:
            FROM_FILE.validate_python(given)
        assert [problem["loc"] for problem in caught.value.errors()] == [(name,)]

    def test_a_guard_keeps_its_limits(self) -> None:
        assert TorqueGuard(LIMITS).limits is LIMITS
