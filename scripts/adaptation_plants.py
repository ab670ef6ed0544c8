"""The rigs of the adaptation study: a chain of five masses, and a stranger to it.

Both are moved by the same courses. The first is the package's own rig (LuGre friction); the second
is put together from the proof's laws (Maxwell-slip friction, another integrator) and shares no
physics with what is examined.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.adaptation.gates import InjectionInputs
from eps_hil.adaptation.torque_injection import TorqueInjection
from eps_hil.compiled import njit
from eps_hil.physics import chain as places
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import Model
from eps_hil.proof.laws import sliding_level, slip_friction
from eps_hil.proof.truth import Drive, Hidden, Slip, maxwell_slip
from eps_hil.rig import manoeuvre as extra
from eps_hil.rig.plant import TRUE_SIGNALS, Plant
from eps_hil.rig.sensors import REPORTED, Sensors, SensorSettings

Floats = npt.NDArray[np.float64]

CONFIGS = Path(__file__).parents[1] / "configs"
CHAIN = load_chain(CONFIGS / "reference_chain.yaml")
SUBSTEPS = 20
WHEEL_KG_M2, BAR_NM_PER_RAD, BAR_NMS_PER_RAD = 0.04, 115.0, 0.25
MOTOR_LAG_S = 7e-4
_PLAIN = Hidden()


@dataclass(frozen=True)
class Course:
    """What driver, tyre and road do; at 1 kHz, arrays (n,).

    ``hand`` is (stiffness Nm/rad, damping Nms/rad) about ``angle_rad``; zero: hands off.
    """

    name: str
    angle_rad: Floats
    road_n: Floats
    hand: tuple[float, float] = (30.0, 1.0)
    tyre_n_per_m: float = 0.0
    tyre_n_s_per_m: float = 0.0
    assist: float = 0.0
    vehicle_m_s: float = 0.0

    @property
    def rows(self) -> int:
        """Milliseconds."""
        return len(self.angle_rad)


def parked(
    name: str, seconds: float, *, hands: bool, load_n: float = 0.0, tyre: float = 0.0
) -> Course:
    """Standing still for a torque injection, with hands on or off the wheel."""
    n = round(seconds * 1000)
    hand = (60.0, 2.0) if hands else (0.0, 0.0)
    return Course(name, np.zeros(n), np.full(n, load_n), hand, tyre)


def steered(name: str, seconds: float, seed: int, *, load_n: float = 0.0) -> Course:
    """A driver moves the wheel near the centre; no tyre force but a constant one."""
    t = np.arange(round(seconds * 1000)) * 1e-3
    rng = np.random.default_rng(seed)
    fade = np.minimum(t / 0.5, 1.0)
    angle = 0.15 * np.sin(2 * np.pi * rng.uniform(0.5, 0.7) * t) * fade
    return Course(name, angle, np.full(len(t), load_n), assist=0.2)


def driven(
    name: str, seconds: float, seed: int, *, road_n: float = 0.0, amplitude: float = 1.2
) -> Course:
    """Ordinary driving: a weave against the tyre; the road adds ``road_n`` rms (1 to 12 Hz)."""
    t = np.arange(round(seconds * 1000)) * 1e-3
    rng = np.random.default_rng(seed)
    fade = np.minimum(t / 0.8, 1.0)
    angle = amplitude * np.sin(2 * np.pi * rng.uniform(0.2, 0.3) * t + rng.uniform(0, 6.3))
    angle += 0.25 * amplitude * _noise(rng, t, 0.1, 0.6)
    road = road_n * _noise(rng, t, 1.0, 12.0)
    return Course(name, angle * fade, road * fade, (30.0, 1.0), 46e3, 500.0, 0.1, 15.0)


def _noise(rng: np.random.Generator, t: Floats, low_hz: float, high_hz: float) -> Floats:
    lines = np.linspace(low_hz, high_hz, 40)
    phases = rng.uniform(0, 2 * np.pi, (40, 1))
    total = np.sin(2 * np.pi * lines[:, None] * t + phases).sum(axis=0)
    return np.asarray(total / math.sqrt(20.0))


def gear(nominal: Model, seed: int, spread: float = 0.4) -> Model:
    """One steering gear: both friction offsets anywhere within ± ``spread``, independently."""
    rng = np.random.default_rng(1000 + seed)
    return scaled(nominal, *rng.uniform(1.0 - spread, 1.0 + spread, 2))


def scaled(nominal: Model, forth: float, back: float) -> Model:
    """The model with its friction offsets scaled."""
    f = nominal.friction
    changed = replace(
        f, offset_pos_nm=f.offset_pos_nm * forth, offset_neg_nm=f.offset_neg_nm * back
    )
    return replace(nominal, friction=changed)


class Chain:
    """The package's rig: five masses, LuGre friction."""

    def __init__(self, model: Model, course: Course) -> None:
        n = course.rows
        table = np.zeros((n + 1, extra.COLUMNS))
        table[:n, places.LOAD_FORCE] = course.road_n
        table[:, places.LOAD_STIFFNESS] = course.tyre_n_per_m
        table[:, places.LOAD_DAMPING] = course.tyre_n_s_per_m
        table[:n, places.HAND_ANGLE] = course.angle_rad
        table[:, places.HAND_STIFFNESS], table[:, places.HAND_DAMPING] = course.hand
        table[:, extra.MOTOR_DAMPING] = 5e-4
        table[:, extra.ASSIST_GAIN] = course.assist
        table[:, extra.VEHICLE_SPEED] = course.vehicle_m_s
        table[:n, extra.LATERAL_ACCELERATION] = _lateral(course)
        table[-1] = table[-2]
        self._plant = Plant(model, CHAIN, 5, table)

    def step(self, truth: Floats, override_nm: float | None) -> None:
        """Truth of this millisecond, then on."""
        self._plant.step(truth, override_nm)

    def run(self) -> Floats:
        """Truth of the whole course without an override."""
        return self._plant.run()


def _lateral(course: Course) -> Floats:
    """Straight driving only at the centre: 0.2 rad of wheel are 0.4 m/s² at 15 m/s."""
    return 2.0 * course.angle_rad * (course.vehicle_m_s > 0.0)


class Stranger:
    """Rotor and steering wheel with Maxwell-slip friction: the proof's laws, 20 kHz, no LuGre."""

    def __init__(self, model: Model, course: Course) -> None:
        f = model.friction
        self._drive = Drive(
            model.inertia_kg_m2, model.pinion_ratio_rad_per_m, model.rack_to_rotor_ratio_rad_per_m,
            k0_pos=f.offset_pos_nm, k0_neg=f.offset_neg_nm,
        )  # fmt: skip
        self._slip = maxwell_slip()
        self._course, self._lateral, self._k = course, _lateral(course), 0
        self._state, self._elements = np.zeros(5), np.zeros(len(self._slip.level_share))

    def step(self, truth: Floats, override_nm: float | None) -> None:
        """Truth of this millisecond, then on."""
        c, k = self._course, self._k
        after = min(k + 1, c.rows - 1)
        hand = np.array([*c.hand, c.angle_rad[k], c.angle_rad[after] - c.angle_rad[k]])
        load = np.array(
            [c.road_n[k], c.road_n[after] - c.road_n[k], c.tyre_n_per_m, c.tyre_n_s_per_m]
        )
        command = np.nan if override_nm is None else override_nm
        _millisecond(
            self._drive,
            _PLAIN,
            self._slip,
            self._state,
            self._elements,
            command,
            c.assist,
            hand,
            load,
            truth,
        )
        truth[9], truth[10], truth[11] = c.vehicle_m_s, self._lateral[k], 0.0
        truth[12], truth[13] = truth[0], truth[1]
        self._k = after

    def run(self) -> Floats:
        """Truth of the whole course without an override."""
        truth = np.zeros((self._course.rows, len(TRUE_SIGNALS)))
        for row in truth:
            self.step(row, None)
        return truth


@njit
def _millisecond(
    d: Drive,
    h: Hidden,
    s: Slip,
    state: Floats,
    elements: Floats,
    command: float,
    assist: float,
    hand: Floats,
    load: Floats,
    truth: Floats,
) -> None:
    """state: rotor angle, speed, wheel angle, speed, motor torque; truth in TRUE_SIGNALS' order."""
    dt = 1e-3 / SUBSTEPS
    q, v, wheel, wheel_speed, motor = state
    to_rotor = d.pinion_rad_per_m / d.rack_rad_per_m
    asked = command
    for j in range(SUBSTEPS):
        a = j / SUBSTEPS
        place, rate = q / d.rack_rad_per_m, v / d.rack_rad_per_m
        force = load[0] + a * load[1] + load[2] * place + load[3] * rate
        target = hand[2] + a * hand[3]
        arm = hand[0] * (target - wheel) + hand[1] * (hand[3] * 1e3 - wheel_speed)
        bar = BAR_NM_PER_RAD * (wheel - q * to_rotor) + BAR_NMS_PER_RAD * (
            wheel_speed - v * to_rotor
        )
        if j == 0:
            if math.isnan(command):
                asked = assist * bar - 5e-4 * v
            truth[0], truth[1], truth[2], truth[3] = motor, bar, v, q
            truth[4], truth[5], truth[6], truth[7] = force, place, wheel, wheel_speed
        motor += (asked - motor) * dt / (MOTOR_LAG_S + dt)
        forth = sliding_level(d, h, 1.0, v, force, place, 0.0, 0.0)
        back = sliding_level(d, h, -1.0, v, force, place, 0.0, 0.0)
        friction = slip_friction(d, s, elements, v, forth, back, dt)
        if j == 0:
            truth[8] = friction
        v += dt / d.inertia_kg_m2 * (motor + to_rotor * bar - force / d.rack_rad_per_m - friction)
        q += dt * v
        wheel_speed += dt / WHEEL_KG_M2 * (arm - bar)
        wheel += dt * wheel_speed
    state[0], state[1], state[2], state[3], state[4] = q, v, wheel, wheel_speed, motor


RIGS: dict[str, Callable[[Model, Course], Chain | Stranger]] = {
    "five masses, LuGre": Chain,
    "Maxwell slip": Stranger,
}


def record(rig: str, model: Model, course: Course, seed: int) -> list[InjectionInputs]:
    """What the rig reports during a course, sample by sample."""
    truth = RIGS[rig](model, course).run()
    table = Sensors(model, SensorSettings(), seed).run(truth)
    columns = [table[:, REPORTED.index(name)] for name in InjectionInputs._fields]
    return [InjectionInputs(*row) for row in np.column_stack(columns).tolist()]


def inject(rig: str, model: Model, course: Course, injection: TorqueInjection, seed: int) -> float:
    """Run a torque injection in closed loop; seconds until it was over."""
    plant, sensors = RIGS[rig](model, course), Sensors(model, SensorSettings(), seed)
    truth, reported = np.zeros(len(TRUE_SIGNALS)), np.zeros(len(REPORTED))
    places_of = [REPORTED.index(name) for name in InjectionInputs._fields]
    torque: float | None = None
    for k in range(course.rows):
        plant.step(truth, torque)
        sensors.step(truth, reported)
        values = reported.tolist()
        inputs = InjectionInputs(*(values[i] for i in places_of))._replace(rack_force_n=math.nan)
        command = injection.step(k * 1_000_000, inputs)
        torque = command.torque_nm if command.active else None
        if injection.phase.over:
            return k * 1e-3
    return course.rows * 1e-3
