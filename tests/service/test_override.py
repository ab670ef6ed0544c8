"""The state machine: every way from state to state, each with its reason, and no other way."""

import pytest

from eps_hil.estimation.validity import Reason
from eps_hil.service.guard import ARM_PAUSE_NS, Command, Seen, Trip
from eps_hil.service.journal import as_json
from eps_hil.service.override import Override, State, Transition, trip_words

from .guard_bench import LIMITS, MS, Bench


class Session:
    """An override with good inputs, a millisecond a step."""

    def __init__(self) -> None:
        self.override = Override(LIMITS)
        self.bench = Bench()
        self.override.listen(self.bench.now_ns)

    def state(self) -> State:
        return self.override.state

    @property
    def seen(self) -> Seen:
        return self.bench.seen()

    def step(self, request_nm: float | None = None) -> Command:
        self.bench.now_ns += MS
        self.override.heartbeat(self.bench.now_ns)
        return self.override.step(self.bench.now_ns, request_nm, self.seen)

    def arm(self) -> bool:
        self.step()
        if not self.override.prepare(self.bench.now_ns):
            return False
        for _ in range(ARM_PAUSE_NS // MS):
            self.step()
        return self.override.arm(self.bench.now_ns, self.seen)

    def story(self) -> list[str]:
        return [str(each) for each in self.override.take_transitions()]


def test_a_whole_session_and_its_story() -> None:
    session = Session()
    assert session.arm()
    assert session.state() is State.ARMED
    assert session.step(0.01) == Command(0.01, True)
    assert session.state() is State.INJECTING
    session.step(None)
    session.step(0.01)
    session.override.disarm(session.bench.now_ns, "done")
    session.override.off(session.bench.now_ns, "end of the run")
    assert session.story() == [
        "off -> listening: session starts",
        "listening -> listening: arming, first step",
        "listening -> armed: arming, second step",
        "armed -> injecting: torque wanted",
        "injecting -> armed: no torque wanted",
        "armed -> injecting: torque wanted",
        "injecting -> listening: done",
        "listening -> off: end of the run",
    ]
    assert session.story() == []


def test_a_trip_is_a_fault_with_its_reasons_and_time() -> None:
    session = Session()
    session.arm()
    session.step(0.01)
    session.override.take_transitions()
    session.bench.reason = Reason.GAP
    assert session.step(0.9) == Command(0.0, False)
    trips = Trip.INVALID_INPUT | Trip.TORQUE | Trip.STEP | Trip.CHANGE_250MS
    assert session.override.take_transitions() == [
        Transition(
            session.bench.now_ns, State.INJECTING, State.FAULT,
            "torque, step, change 250ms, invalid input (gap)", trips, Reason.GAP,
        )
    ]  # fmt: skip
    for request in (0.01, None, 0.0):
        assert session.step(request) == Command(0.0, False)
    assert session.story() == [], "told once"


def test_a_journal_line_holds_time_reason_and_trips() -> None:
    transition = Transition(
        7, State.INJECTING, State.FAULT, "driver, bus", Trip.DRIVER | Trip.BUS, Reason.GAP
    )
    assert as_json(transition, 1_790_000_000_123_000_000) == {
        "utc": "2026-09-21T14:13:20.123+00:00",
        "t_ns": 7,
        "from": "injecting",
        "to": "fault",
        "why": "driver, bus",
        "trips": ["driver", "bus"],
        "input_verdict": int(Reason.GAP),
    }


def test_out_of_a_fault_only_by_the_operator() -> None:
    session = Session()
    session.arm()
    session.override.trip(session.bench.now_ns, Trip.BUS, "the queue is full")
    assert session.state() is State.FAULT
    assert not session.arm()
    session.override.disarm(session.bench.now_ns, "no way out")
    session.override.listen(session.bench.now_ns)
    assert session.state() is State.FAULT
    session.override.clear(session.bench.now_ns)
    assert session.state() is State.LISTENING
    assert session.step(0.01) == Command(0.0, False)
    assert session.arm()
    assert session.step(0.01) == Command(0.01, True)
    story = session.story()
    assert "armed -> fault: bus: the queue is full" in story
    assert "fault -> fault: arming refused: not now" in story
    assert "fault -> listening: fault cleared by the operator" in story


def test_refused_arming_says_why() -> None:
    session = Session()
    session.bench.foreign = True
    assert not session.arm()
    session.bench.foreign = False
    assert not session.override.arm(session.bench.now_ns, session.seen)
    told = session.story()[-2:]
    assert told == [
        "listening -> listening: arming refused: other transmitter",
        "listening -> listening: arming refused: the steps were not in order",
    ]


@pytest.mark.parametrize("state", ["off", "listening"])
def test_nothing_armed_nothing_to_trip(state: str) -> None:
    session = Session()
    if state == "off":
        session.override.off(session.bench.now_ns, "end")
    session.override.trip(session.bench.now_ns, Trip.OPERATOR)
    assert session.state() is State[state.upper()]
    assert session.override.guard.trips == Trip.NONE


def test_off_ends_an_injection() -> None:
    session = Session()
    session.arm()
    session.step(0.01)
    session.override.off(session.bench.now_ns, "end")
    assert session.step(0.01) == Command(0.0, False)
    session.override.off(session.bench.now_ns, "again")
    assert session.story()[-1] == "injecting -> off: end"


def test_clearing_where_there_is_no_fault_does_nothing() -> None:
    session = Session()
    session.arm()
    session.override.clear(session.bench.now_ns)
    assert session.state() is State.ARMED


def test_heartbeats_are_counted() -> None:
    session = Session()
    session.step()
    session.step()
    assert session.override.heartbeats == 2


def test_words() -> None:
    assert trip_words(Trip.NONE) == "none"
    assert trip_words(Trip.DRIVER | Trip.BUS) == "driver, bus"
    assert trip_words(Trip.INVALID_INPUT, Reason.TIME) == "invalid input (time)"
