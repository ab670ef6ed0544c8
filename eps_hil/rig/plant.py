"""The rig's mechanics with the ECU's motor control, a millisecond or less per call, compiled.

The control law runs at the rate of the calls, on the ECU's own rotor sensor; what the bus shows of
it is later, noisier and coarser (sensors.py).
"""

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.physics.chain import (
    INPUTS,
    LOAD_FORCE,
    Chain,
    ChainState,
    Reading,
    build_chain,
    rest_state,
)
from eps_hil.physics.chain_effects import reported_nm
from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.chain_reading import read_out
from eps_hil.physics.chain_step import advance
from eps_hil.physics.model import Model
from eps_hil.rig.manoeuvre import (
    ASSIST_GAIN,
    LATERAL_ACCELERATION,
    MOTOR_CENTRE,
    MOTOR_DAMPING,
    MOTOR_STIFFNESS,
    MOTOR_TORQUE,
    PRELOAD_COMPENSATION,
    VEHICLE_SPEED,
    YAW_RATE,
)

Floats = npt.NDArray[np.float64]

STEPS_PER_MS = 20
TOLD = {name: name.replace("_nm", "_told_nm") for name in ("motor_torque_nm", "torque_sensor_nm")}
"""Columns of a truth row that hold what the ECU knows of a signal, at its instant, where effects
make it another than the true one."""
TRUE_SIGNALS = (
    *(name for name in Reading._fields if name not in TOLD.values()),
    "vehicle_speed_m_s",
    "lateral_acceleration_m_s2",
    "yaw_rate_rad_s",
    *TOLD.values(),
)
"""Columns of a truth row: physical values of the instant, before any sensor."""


@kernel
def motor_command_nm(
    reading: Reading, sensor_nm: float, row: Floats, rack_to_rotor: float
) -> float:
    """Motor torque that the ECU asks for: spring-damper, profile, preload compensation, assist."""
    return float(
        row[MOTOR_TORQUE]
        - row[MOTOR_STIFFNESS] * (reading.motor_angle_rad - row[MOTOR_CENTRE])
        - row[MOTOR_DAMPING] * reading.motor_speed_rad_s
        + row[PRELOAD_COMPENSATION] * row[LOAD_FORCE] / rack_to_rotor
        + row[ASSIST_GAIN] * sensor_nm
    )


@kernel
def one_step(
    chain: Chain,
    state: ChainState,
    now: Floats,
    after: Floats,
    override: bool,
    override_nm: float,
    steps: int,
    scratch: Floats,
    truth: Floats,
) -> None:
    """Write the truth of this instant, then integrate ``steps`` of ``STEPS_PER_MS`` on.

    ``now``/``after`` are set-point rows, ``scratch`` is (2, INPUTS), ``truth`` is one row of
    ``TRUE_SIGNALS``. An override takes the place of the ECU's own torque.
    """
    for k in range(INPUTS):
        scratch[1, k] = (after[k] - now[k]) * (1000.0 * (STEPS_PER_MS // steps))
    reading = read_out(chain, state, now, scratch[1])
    truth[0] = reading.motor_torque_nm
    truth[1] = reading.torque_sensor_nm
    truth[2] = reading.motor_speed_rad_s
    truth[3] = reading.motor_angle_rad
    truth[4] = reading.rack_force_n
    truth[5] = reading.rack_position_m
    truth[6] = reading.steering_wheel_angle_rad
    truth[7] = reading.steering_wheel_speed_rad_s
    truth[8] = reading.friction_torque_nm
    truth[9] = now[VEHICLE_SPEED]
    truth[10] = now[LATERAL_ACCELERATION]
    truth[11] = now[YAW_RATE]
    truth[12] = reading.motor_torque_told_nm
    truth[13] = reported_nm(chain, reading.torque_sensor_told_nm)
    command = override_nm
    if not override:
        command = motor_command_nm(reading, truth[13], now, chain.rack_to_rotor)
    advance(chain, state, command, now, after, steps, scratch)


@kernel
def _run(chain: Chain, state: ChainState, table: Floats, scratch: Floats, truth: Floats) -> None:
    for k in range(truth.shape[0]):
        one_step(chain, state, table[k], table[k + 1], False, 0.0, STEPS_PER_MS, scratch, truth[k])


class Plant:
    """Chain, state and set-points; :meth:`step` moves on by a millisecond over ``per_ms``."""

    def __init__(
        self, model: Model, parameters: ChainParameters, order: int, table: Floats, per_ms: int = 1
    ):
        self.chain = build_chain(model, parameters, order, step_s=1e-3 / STEPS_PER_MS)
        self.state = rest_state(self.chain)
        self._table = table
        self._scratch = np.zeros((2, INPUTS))
        self._row = self._part = 0
        self._per_ms, self._steps = per_ms, STEPS_PER_MS // per_ms
        self._between = np.zeros((2, table.shape[1]))

    @property
    def rows(self) -> int:
        """Milliseconds in one round of the manoeuvre."""
        return len(self._table) - 1

    def step(
        self, truth: Floats, override_nm: float | None = None, rows: Floats | None = None
    ) -> None:
        """Truth of this instant into ``truth``, then one step on; the table repeats.

        ``rows``: set-points of this step and the next, (2, COLUMNS), in the table's place.
        """
        now, after = self._table[self._row], self._table[self._row + 1]
        if self._per_ms > 1:
            change = (after - now) / self._per_ms
            self._between[0] = now + self._part * change
            self._between[1] = now + (self._part + 1) * change
            now, after = self._between
        if rows is not None:
            now, after = rows[0], rows[1]
        active = override_nm is not None
        value = 0.0 if override_nm is None else override_nm
        one_step(
            self.chain, self.state, now, after, active, value, self._steps, self._scratch, truth
        )
        self._part += 1
        if self._part == self._per_ms:
            self._part, self._row = 0, (self._row + 1) % self.rows

    def run(self) -> Floats:
        """One whole round from the present state; truth rows, shape (rows, TRUE_SIGNALS)."""
        truth = np.zeros((self.rows, len(TRUE_SIGNALS)))
        _run(self.chain, self.state, self._table, self._scratch, truth)
        return truth
