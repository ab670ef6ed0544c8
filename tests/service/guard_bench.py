"""A torque guard with everything in order around it; a test spoils one thing at a time."""

from dataclasses import replace

from eps_hil.estimation.validity import Reason
from eps_hil.service.guard import ARM_PAUSE_NS, Command, Reading, Seen, TorqueGuard
from eps_hil.service.limits import Limits

MS = 1_000_000
LIMITS = Limits(
    max_torque_nm=0.5,
    max_step_nm=0.02,
    max_change_250ms_nm=0.4,
    max_driver_torque_nm=2.0,
    max_torque_error_nm=0.06,
    torque_response_s=0.01,
    ecu_status_timeout_s=0.04,
    max_motor_speed_rad_s=20.0,
    rack_position_min_m=-0.01,
    rack_position_max_m=0.02,
    max_energy_j=2.0,
    max_armed_s=60.0,
    arm_window_s=1.0,
    heartbeat_timeout_s=0.1,
    max_input_age_s=0.008,
    max_frame_gap_s=0.009,
    motor_torque_frozen_s=0.011,
    torque_sensor_frozen_s=0.012,
    motor_speed_frozen_s=0.013,
    rack_position_frozen_s=0.014,
)
INPUTS = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "rack_position_m")


class Bench:
    """``values``: what the sensors say; ``ages_ns``, ``spoil``: what is wrong with it."""

    def __init__(self, limits: Limits = LIMITS, now_ns: int = 5_000 * MS) -> None:
        self.guard = TorqueGuard(limits)
        self.now_ns = now_ns
        self.values = dict.fromkeys(INPUTS, 0.0)
        self.ages_ns = dict.fromkeys(INPUTS, 0)
        self.held: set[str] = set()
        self.reason, self.foreign, self.bus_good = Reason.FINE, False, True
        self.ecu: Reading | None = None
        self.beating = True
        self._noise = 0

    def seen(self) -> Seen:
        """Noise of a nano-unit keeps inputs from being frozen."""
        self._noise += 1
        readings = {}
        for name in INPUTS:
            value = self.values[name]
            if name not in self.held:
                value += 1e-9 * (self._noise % 2)
            readings[name] = Reading(value, self.now_ns - self.ages_ns[name])
        return Seen(
            **readings,
            ecu_state=self.ecu,
            reason=self.reason,
            foreign=self.foreign,
            bus_good=self.bus_good,
        )

    def step(self, request_nm: float | None, after_ms: float = 1.0) -> Command:
        self.now_ns += round(after_ms * MS)
        if self.beating:
            self.guard.heartbeat(self.now_ns)
        return self.guard.step(self.now_ns, request_nm, self.seen())

    def idle(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            assert self.step(None) == Command(0.0, False)

    def arm(self) -> bool:
        """Both steps, the pause between them."""
        self.idle(1)
        if not self.guard.prepare(self.now_ns):
            return False
        for _ in range(ARM_PAUSE_NS // (5 * MS)):  # within max_frame_gap_s, and quicker
            self.step(None, after_ms=5)
        return self.guard.arm(self.now_ns, self.seen())

    def inject(self, torque_nm: float, step_nm: float = 0.01, *, obey: bool = True) -> Command:
        """Ramp from zero; the ECU reports what it is told unless not ``obey``."""
        count = max(1, round(abs(torque_nm) / step_nm))
        for k in range(1, count + 1):
            command = self.step(torque_nm * k / count)
            if obey:
                self.values["motor_torque_nm"] = command.torque_nm
        return command

    def hold(self, torque_nm: float, milliseconds: int) -> Command:
        for _ in range(milliseconds):
            command = self.step(torque_nm)
        return command


def armed(limits: Limits = LIMITS) -> Bench:
    bench = Bench(limits)
    assert bench.arm()
    return bench


def injecting(torque_nm: float = 0.1, limits: Limits = LIMITS) -> Bench:
    bench = armed(limits)
    assert bench.inject(torque_nm) == Command(torque_nm, True)
    return bench


def with_limits(**changed: float | None) -> Limits:
    return replace(LIMITS, **changed)  # type: ignore[arg-type]
