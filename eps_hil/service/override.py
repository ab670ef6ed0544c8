"""The state machine of the torque override: off, listening, armed, injecting, fault.

Pure, as the guard is that it drives. The guard decides what may be commanded; this adds where a
session stands, and keeps every transition with its time and reason for whoever records them.
"""

from dataclasses import dataclass
from enum import IntEnum

from eps_hil.estimation.validity import Reason, words
from eps_hil.service.guard import Command, Seen, TorqueGuard, Trip
from eps_hil.service.limits import Limits


class State(IntEnum):
    """``State`` of the DBC's ``EPSHIL_OverrideState``."""

    OFF = 0
    LISTENING = 1
    ARMED = 2
    INJECTING = 3
    FAULT = 4


@dataclass(frozen=True, slots=True)
class Transition:
    """From one state to another (or, for a step of the operator, the same) at ``t_ns``."""

    t_ns: int
    before: State
    after: State
    why: str
    trips: Trip = Trip.NONE
    reason: Reason = Reason.FINE

    def __str__(self) -> str:
        return f"{self.before.name.lower()} -> {self.after.name.lower()}: {self.why}"


def trip_words(trips: Trip, reason: Reason = Reason.FINE) -> str:
    """The reasons as a person reads them: ``"driver, invalid input (gap)"``."""
    named = [bit.name.lower().replace("_", " ") for bit in Trip if bit & trips and bit.name]
    said = ", ".join(named) or "none"
    return f"{said} ({words(reason)})" if reason else said


class Override:
    """Operator's decisions and frames in, commands out; times in ns of the guard's clock."""

    def __init__(self, limits: Limits) -> None:
        self.guard = TorqueGuard(limits)
        self.state = State.OFF
        self.heartbeats = 0
        self._transitions: list[Transition] = []

    def take_transitions(self) -> list[Transition]:
        """What happened since the last call."""
        taken, self._transitions = self._transitions, []
        return taken

    def listen(self, now_ns: int) -> None:
        """The session has its bus: watch, command nothing."""
        if self.state is State.OFF:
            self._go(now_ns, State.LISTENING, "session starts")

    def prepare(self, now_ns: int) -> bool:
        """First step of arming."""
        done = self.state is State.LISTENING and self.guard.prepare(now_ns)
        self._go(now_ns, self.state, "arming, first step" if done else "arming refused: not now")
        return done

    def arm(self, now_ns: int, seen: Seen) -> bool:
        """Second step of arming; refused outside its window, and on inputs that are not good."""
        obstacles = self.guard.obstacles(now_ns, seen)
        if self.state is State.LISTENING and self.guard.arm(now_ns, seen):
            self._go(now_ns, State.ARMED, "arming, second step")
            return True
        why = trip_words(obstacles, seen.reason) if obstacles else "the steps were not in order"
        self._go(now_ns, self.state, f"arming refused: {why}")
        return False

    def heartbeat(self, now_ns: int) -> None:
        """The operator's sign of life."""
        self.heartbeats += 1
        self.guard.heartbeat(now_ns)

    def disarm(self, now_ns: int, why: str) -> None:
        """Back to listening, without a fault."""
        if self.state in {State.ARMED, State.INJECTING}:
            self.guard.disarm()
            self._go(now_ns, State.LISTENING, why)

    def clear(self, now_ns: int) -> None:
        """The operator has seen the fault; to arm takes both steps again."""
        if self.state is State.FAULT:
            self.guard.clear()
            self._go(now_ns, State.LISTENING, "fault cleared by the operator")

    def trip(self, now_ns: int, trips: Trip, why: str = "") -> None:
        """A fault that was noticed outside the guard. Only an armed session can have one."""
        if self.state in {State.ARMED, State.INJECTING}:
            self.guard.trip(trips)
            self._fault(now_ns, why)

    def off(self, now_ns: int, why: str) -> None:
        """The session ends, whatever the state."""
        if self.state is not State.OFF:
            self.guard.disarm()
            self._go(now_ns, State.OFF, why)

    def step(self, now_ns: int, request_nm: float | None, seen: Seen) -> Command:
        """One frame: the command that may go onto the bus."""
        wanted = request_nm if self.state in {State.ARMED, State.INJECTING} else None
        command = self.guard.step(now_ns, wanted, seen)
        if self.guard.trips and self.state is not State.FAULT:
            self._fault(now_ns, "")
        elif command.enable and self.state is State.ARMED:
            self._go(now_ns, State.INJECTING, "torque wanted")
        elif not command.enable and self.state is State.INJECTING:
            self._go(now_ns, State.ARMED, "no torque wanted")
        return command

    def _fault(self, now_ns: int, why: str) -> None:
        trips, reason = self.guard.trips, self.guard.reason
        told = trip_words(trips, reason) + (f": {why}" if why else "")
        self._go(now_ns, State.FAULT, told, trips, reason)

    def _go(
        self,
        now_ns: int,
        after: State,
        why: str,
        trips: Trip = Trip.NONE,
        reason: Reason = Reason.FINE,
    ) -> None:
        self._transitions.append(Transition(now_ns, self.state, after, why, trips, reason))
        self.state = after
