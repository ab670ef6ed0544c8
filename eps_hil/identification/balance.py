"""The torque balance of all recordings as rows: what is left, and what each parameter does to it.

Rows live on the clock of the motor speed; torques and rack force are read off at their delay
against it, so the motion (which friction is a nonlinear function of) never has to be shifted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from eps_hil.identification import filters
from eps_hil.identification.butterworth import low_pass
from eps_hil.identification.filters import STEP_S
from eps_hil.identification.friction_rows import COLUMNS, friction_rows
from eps_hil.identification.kinematics import FREQUENCY, Kinematics
from eps_hil.identification.prepare import Prepared
from eps_hil.identification.state import Parameter, Spring, State, get, put
from eps_hil.physics.balance import Motion, residual_nm
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
Masks = npt.NDArray[np.bool_]

SLIDING_RAD_S = 0.5
CLEAR_SIGMA = 6.0
SETTLED = 6.0
"""Path since a reversal, in units of T_fs/σ0, after which the bristle's history is forgotten."""
LOAD_HZ = 40.0
DRIFT_HZ = 0.05
"""Below this an angle made from the speed drifts, and the rack position is asked where it is."""


@dataclass
class Case:
    """One recording in the balance; rows are filtered and thinned, (m,)."""

    recording: Prepared
    motion: Kinematics
    index: int
    time_s: Floats = field(init=False)
    good: Masks = field(init=False)
    resting: Masks = field(init=False)
    _shifted: dict[tuple[str, float], Floats] = field(default_factory=dict)
    _place: tuple[float, Floats] | None = None

    def __post_init__(self) -> None:
        self.time_s = filters.thinned(self.recording.time_s)
        self.good = filters.smooth(self.recording.good.astype(np.float64)) > 0.999
        self.resting = filters.smooth(self.motion.resting.astype(np.float64)) > 1e-9

    @property
    def measured_load(self) -> bool:
        """Whether a load cell was recorded."""
        return self.recording.has("rack_force_n")

    def signal(self, name: str, late_s: float) -> Floats:
        """A signal at the instants of the speed's stamps; zeros where it was not recorded."""
        if not self.recording.has(name):
            return np.zeros(len(self.recording.time_s))
        key = (name, late_s)
        if key not in self._shifted:
            if len(self._shifted) > 24:
                self._shifted.clear()
            values = self._calm_load if name == "rack_force_n" else self.recording.raw[name]
            self._shifted[key] = filters.shifted(values, late_s)
        return self._shifted[key]

    @cached_property
    def _calm_load(self) -> Floats:
        """The rack force low-passed: in |F| noise does not average out where the force is small."""
        return low_pass(self.recording.raw["rack_force_n"], LOAD_HZ)

    def position_m(self, model: Model) -> Floats:
        """Rack position at the speed's stamps: the rotor's angle, about the rack's own centre.

        How late the rack position itself is reported nobody knows, and with a spring as the load
        every millisecond of it would be damping; so it says where the rack is, and no more.
        """
        by_rotor = self.motion.angle / model.rack_to_rotor_ratio_rad_per_m
        if not self.recording.has("rack_position_m"):
            return by_rotor
        if self._place is None or self._place[0] != model.rack_to_rotor_ratio_rad_per_m:
            apart = self.recording.raw["rack_position_m"] - by_rotor
            if self.recording.has("motor_angle_rad"):
                apart = np.full(len(apart), np.median(apart))
            else:
                apart = low_pass(apart, DRIFT_HZ, 2)
            self._place = (model.rack_to_rotor_ratio_rad_per_m, by_rotor + apart)
        return self._place[1]

    def rack_force_n(self, state: State) -> Floats:
        """Measured, or of the spring that stands in for it."""
        if self.measured_load:
            return self.signal("rack_force_n", get(state, "delays_s.rack_force"))
        spring = state.springs.get(self.index, Spring())
        rate = self.motion.speed / state.model.rack_to_rotor_ratio_rad_per_m
        reversible = spring.stiffness_n_per_m * self.position_m(state.model)
        return spring.force_n + reversible + spring.damping_n_s_per_m * rate

    def physical(self, state: State) -> Motion:
        """The motion as the physics takes it, without acceleration (that is a column)."""
        m = self.motion
        return Motion(
            self.recording.time_s,
            self.signal("motor_torque_nm", get(state, "delays_s.motor_torque")),
            self.signal("torque_sensor_nm", get(state, "delays_s.torque_sensor")),
            self.rack_force_n(state),
            self.position_m(state.model),
            m.speed,
            m.angle,
            m.travel,
            m.slip,
            np.zeros(len(m.speed)),
        )

    def residual(self, state: State) -> Floats:
        """What the torques are short of the balance, Nm at the rotor, (m,)."""
        left, _ = residual_nm(state.model, self.physical(state))
        return filters.smooth(left) - state.model.inertia_kg_m2 * self.motion.acceleration

    def linearised(self, state: State, parameters: Sequence[Parameter]) -> tuple[Floats, Floats]:
        """(residual (m,), d residual / d parameters (m, p)) around ``state``."""
        rows = friction_rows(state.model, self.physical(state))
        wanted = [COLUMNS.index(p.name) for p in parameters if p.name in COLUMNS]
        thin = filters.smooth_rows(rows[[0, *(1 + k for k in wanted)]])
        friction = {COLUMNS[k]: thin[1 + i] for i, k in enumerate(wanted)}
        residual = thin[0] - state.model.inertia_kg_m2 * self.motion.acceleration
        columns = [
            friction[p.name] if p.name in friction else self._column(state, p, residual)
            for p in parameters
        ]
        return residual, np.column_stack(columns) if columns else np.zeros((len(residual), 0))

    def _column(self, state: State, parameter: Parameter, residual: Floats) -> Floats:
        model, name = state.model, parameter.name
        if name == "inertia_kg_m2":
            return -self.motion.acceleration
        if name.startswith("spring"):
            if not name.startswith(f"spring{self.index}."):
                return np.zeros(len(residual))
            moved = put(state, name, get(state, name) + parameter.step)
            return (self.residual(moved) - residual) / parameter.step
        signal, per_unit = _torque(name, model)
        return per_unit * filters.derivative(self.signal(signal, get(state, name)))

    def noise_variance(self, state: State, name: str) -> float:
        """What noise adds to the mean square of a parameter's column."""
        if name == "inertia_kg_m2":
            return self.motion.acceleration_variance
        if not name.startswith("delays_s."):
            return 0.0
        signal, per_unit = _torque(name, state.model)
        if not self.recording.has(signal):
            return 0.0
        density = np.full(len(FREQUENCY), self.recording.density[signal])
        if signal == "rack_force_n":
            density *= filters.low_pass_power(FREQUENCY, LOAD_HZ)
        return per_unit**2 * filters.derivative_variance(density, FREQUENCY)

    def floor_nm(self, model: Model) -> float:
        """Rms that sensor noise alone leaves in the rows."""
        density = self.recording.density
        share = float(np.sum(filters.kernel() ** 2)) / (2 * STEP_S)
        torque = density.get("motor_torque_nm", 0.0)
        torque += model.sensor_to_rotor**2 * density.get("torque_sensor_nm", 0.0)
        torque += density.get("rack_force_n", 0.0) / model.rack_to_rotor_ratio_rad_per_m**2
        moved = model.inertia_kg_m2**2 * self.motion.acceleration_variance
        return float(np.sqrt(share * torque + moved))

    def unsettled(self, state: State) -> Floats:
        """Share of the filter's length in which the bristle has a history (or nobody knows), (m,).

        Path since the last rest or reversal below SETTLED bristle lengths T_fs/σ0.
        """
        m, law = self.motion, state.model.friction
        speed = m.speed
        direction = np.sign(np.where(np.abs(speed) > self.slowest, speed, 0.0))
        path = np.cumsum(np.abs(speed)) * STEP_S
        turned = np.flatnonzero((np.diff(direction, prepend=0.0) != 0) | (direction == 0))
        last = np.zeros(len(speed), dtype=np.int64)
        last[turned] = turned
        since = path - path[np.maximum.accumulate(last)]
        level = self.level(state)
        settled = (direction != 0) & (since > SETTLED * level / law.sigma0_nm_per_rad)
        return filters.smooth((~settled).astype(np.float64))

    @property
    def slowest(self) -> float:
        """Speed (rad/s) above which the sign of the speed is certain."""
        return max(SLIDING_RAD_S, CLEAR_SIGMA * self.motion.speed_sigma)

    def thin_level(self, state: State) -> Floats:
        """T_fs at the rows, Nm, (m,)."""
        return filters.thinned(self.level(state))

    def level(self, state: State) -> Floats:
        """T_fs of eq. 3 along the motion, Nm, (n,)."""
        f, speed = state.model.friction, self.motion.speed
        load = np.abs(self.rack_force_n(state))
        forth = f.offset_pos_nm + f.viscous_pos_nm_s_per_rad * np.abs(speed)
        back = f.offset_neg_nm + f.viscous_neg_nm_s_per_rad * np.abs(speed)
        forth, back = forth + f.load_pos_nm_per_n * load, back + f.load_neg_nm_per_n * load
        return np.maximum(np.where(speed >= 0, forth, back), 1e-3)


def _torque(name: str, model: Model) -> tuple[str, float]:
    """Signal whose delay a parameter is, and torque at the rotor per unit of it."""
    return {
        "delays_s.motor_torque": ("motor_torque_nm", 1.0),
        "delays_s.torque_sensor": ("torque_sensor_nm", model.sensor_to_rotor),
        "delays_s.rack_force": ("rack_force_n", -1.0 / model.rack_to_rotor_ratio_rad_per_m),
    }[name]


def cases(recordings: Sequence[Prepared], motions: Sequence[Kinematics]) -> list[Case]:
    """The recordings as rows of one balance."""
    return [Case(r, m, k) for k, (r, m) in enumerate(zip(recordings, motions, strict=True))]
