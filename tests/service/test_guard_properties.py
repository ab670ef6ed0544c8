"""No sequence of requests, frames and times gets a command past the limits, or one after a trip.

The judge below knows the limits and what a rig saw, not how the guard works.
"""

import math
from collections import deque

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from eps_hil.estimation.validity import Reason
from eps_hil.service.guard import Command, Trip

from .guard_bench import INPUTS, LIMITS, MS, Bench

ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)
SMALL = st.floats(-0.6, 0.6)
MILLISECONDS = st.one_of(
    st.just(1.0), st.floats(0.0, 3.0), st.floats(-2.0, 400.0), st.sampled_from([8.0, 9.0, 250.0])
)


class GuardMachine(RuleBasedStateMachine):
    """A hostile requester, a hostile rig, a hostile clock, and an operator who is only a person."""

    @initialize()
    def start(self) -> None:
        self.bench = Bench()
        self.bench.step(None)
        self.sent: deque[tuple[int, float]] = deque()
        self.last = 0.0
        self.dead = False
        """A trip was seen and the operator has not cleared it."""
        self.entitled = False
        """Both steps of arming were taken since the last trip, clearing or disarming."""
        self.prepared_ns: int | None = None

    # The operator.

    @rule()
    def prepare(self) -> None:
        if self.bench.guard.prepare(self.bench.now_ns):
            self.prepared_ns = self.bench.now_ns

    @rule()
    def arm(self) -> None:
        before_ns, self.prepared_ns = self.prepared_ns, None
        if self.bench.guard.arm(self.bench.now_ns, self.bench.seen()):
            assert before_ns is not None
            assert 200 * MS <= self.bench.now_ns - before_ns <= 1_000 * MS
            assert not self.dead
            self.entitled = True

    @rule()
    def arm_as_one_should(self) -> None:
        self.recover()
        if self.bench.arm():
            assert not self.dead
            self.entitled = True
        self.last = 0.0
        self.sent.append((self.bench.now_ns, 0.0))

    @rule()
    def clear(self) -> None:
        self.bench.guard.clear()
        self.dead = self.entitled = False
        self.prepared_ns = None

    @rule()
    def disarm(self) -> None:
        self.bench.guard.disarm()
        self.entitled, self.prepared_ns = False, None
        self.last = 0.0

    @rule(trips=st.sampled_from([each for each in Trip if each]))
    def outside_trip(self, trips: Trip) -> None:
        self.bench.guard.trip(trips)
        self.dead, self.entitled = True, False
        self.last = 0.0

    @rule(beating=st.booleans())
    def hold_or_let_go(self, beating: bool) -> None:
        self.bench.beating = beating

    # The rig.

    @rule(name=st.sampled_from(INPUTS), value=st.one_of(ANY_FLOAT, SMALL))
    def input_reads(self, name: str, value: float) -> None:
        self.bench.values[name] = value

    @rule(name=st.sampled_from(INPUTS), age_ms=st.floats(-5.0, 50.0))
    def input_is_late(self, name: str, age_ms: float) -> None:
        self.bench.ages_ns[name] = round(age_ms * MS)

    @rule(name=st.sampled_from(INPUTS))
    def input_freezes(self, name: str) -> None:
        self.bench.held.add(name)

    @rule(
        reason=st.sampled_from([Reason.GAP, Reason.BAD_SAMPLE, Reason.TIME]),
        foreign=st.booleans(),
        bus_good=st.booleans(),
    )
    def service_says(self, reason: Reason, foreign: bool, bus_good: bool) -> None:
        self.bench.reason, self.bench.foreign, self.bench.bus_good = reason, foreign, bus_good

    @rule()
    def recover(self) -> None:
        bench = self.bench
        bench.values = dict.fromkeys(INPUTS, 0.0)
        bench.ages_ns = dict.fromkeys(INPUTS, 0)
        bench.held.clear()
        bench.reason, bench.foreign, bench.bus_good = Reason.FINE, False, True
        bench.beating = True

    # Frames.

    @rule(request=st.one_of(st.none(), ANY_FLOAT, SMALL, SMALL), after_ms=MILLISECONDS)
    def frame(self, request: float | None, after_ms: float) -> None:
        self.judge(request, after_ms)

    @precondition(lambda self: self.entitled)
    @rule(step=st.floats(-0.021, 0.021), count=st.integers(1, 60), after_ms=MILLISECONDS)
    def ramp(self, step: float, count: int, after_ms: float) -> None:
        for _ in range(count):
            self.judge(self.last + step, after_ms)
            self.bench.values["motor_torque_nm"] = self.last

    def judge(self, request: float | None, after_ms: float) -> None:
        bench, before_ns = self.bench, self.bench.now_ns
        command = bench.step(request, after_ms)
        now_ns = bench.now_ns
        if bench.guard.trips:
            self.dead, self.entitled = True, False
        if command.enable:
            assert request == command.torque_nm
            self.judge_enabled(command, now_ns, now_ns - before_ns)
        else:
            assert command == Command(0.0, False)
        self.last = command.torque_nm
        self.sent.append((now_ns, self.last))

    def judge_enabled(self, command: Command, now_ns: int, gap_ns: int) -> None:
        bench, torque_nm = self.bench, command.torque_nm
        assert self.entitled
        assert not self.dead
        assert abs(torque_nm) <= LIMITS.max_torque_nm
        if torque_nm != 0.0:
            assert abs(torque_nm - self.last) <= LIMITS.max_step_nm
            recent = [past for t_ns, past in self.sent if now_ns - t_ns <= 250 * MS]
            assert all(abs(torque_nm - past) <= LIMITS.max_change_250ms_nm for past in recent)
        assert 0 <= gap_ns <= LIMITS.max_frame_gap_s * 1e9
        assert abs(bench.values["torque_sensor_nm"]) <= LIMITS.max_driver_torque_nm + 1e-8
        assert abs(bench.values["motor_speed_rad_s"]) <= LIMITS.max_motor_speed_rad_s + 1e-8
        position_m = bench.values["rack_position_m"]
        assert LIMITS.rack_position_min_m - 1e-8 <= position_m <= LIMITS.rack_position_max_m
        assert math.isfinite(bench.values["motor_torque_nm"])
        assert all(0 <= age <= LIMITS.max_input_age_s * 1e9 for age in bench.ages_ns.values())
        assert bench.reason == Reason.FINE
        assert bench.bus_good
        assert not bench.foreign

    @invariant()
    def a_trip_and_an_armed_guard_exclude_each_other(self) -> None:
        if hasattr(self, "bench"):
            assert not (self.bench.guard.trips and self.bench.guard.armed)


TestGuardMachine = GuardMachine.TestCase
TestGuardMachine.settings = settings(
    max_examples=60, stateful_step_count=60, deadline=None, derandomize=True
)
