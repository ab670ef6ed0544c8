"""The rig that every figure is measured on, and what was identified on it, made once and shared."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from eps_hil.examples import CONFIGS
from eps_hil.identification.constant_speed import Cell, FrictionMap, cells_of, fitted, measured_map
from eps_hil.identification.identify import identify
from eps_hil.identification.result import Estimate
from eps_hil.physics.chain_parameters import ChainParameters, load_chain
from eps_hil.physics.model import Friction, Model, load_model
from eps_hil.rig.config import REFERENCE_CHAIN
from eps_hil.rig.manoeuvre import (
    ConstantSpeedGrid,
    Driver,
    Manoeuvre,
    Motor,
    Segment,
    load_manoeuvre,
)
from eps_hil.rig.offline import SimulatedRecording, simulate_recording
from eps_hil.rig.plant import Plant
from eps_hil.rig.profile import Steps
from eps_hil.rig.sensors import REPORTED, Sensors, SensorSettings
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

_ROBOT = Driver(stiffness_nm_per_rad=400.0, damping_nm_s_per_rad=12.0)
_RUN_S = 0.8
_FIRST_BRISTLE = {
    "sigma0_nm_per_rad": 3.0,
    "sigma1_nm_s_per_rad": 0.05,
    "sigma1_speed_rad_s": 1.0,
}
"""Where the search for the bristle's parameters begins: a third off and more."""

STEP_LEVELS_N = (1000.0, 0.0, -1000.0, 500.0, 0.0)
STEP_S = 4.0
"""Fig. 12: rack force in steps, each held until nothing moves and long enough for a slope."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Speeds (rotor, rad/s), preloads (N) and repetitions of the friction identification."""

    speeds_rad_s: tuple[float, ...]
    preloads_n: tuple[float, ...]
    repetitions: int


FULL_GRID = Grid(
    (2.0, 5.0, 10.0, 20.0, 30.0, 40.0), (0.0, 500.0, 1000.0, 1500.0, 2000.0, 2500.0, 3000.0), 3
)
QUICK_GRID = Grid((5.0, 20.0, 40.0), (0.0, 1000.0, 3000.0), 1)


class Workbench:
    """Simulated recordings of the reference rig, each made once; deterministic by ``seed``."""

    def __init__(self, seed: int = 0, quick: bool = False) -> None:
        self.seed, self.quick = seed, quick
        self.model: Model = load_model(CONFIGS / "reference_rig.yaml")
        self.chain: ChainParameters = load_chain(REFERENCE_CHAIN)
        self._made: dict[tuple[str, bool], SimulatedRecording] = {}

    @property
    def grid(self) -> Grid:
        """Which cells the friction is measured in."""
        return QUICK_GRID if self.quick else FULL_GRID

    def manoeuvre(self, name: str) -> Manoeuvre:
        """A manoeuvre of configs/manoeuvres, or ``steps`` with rests long enough for a slope.

        Quick runs shorten sweeps.
        """
        whole = load_manoeuvre(name)
        if len(whole.segments) > 1:
            return whole
        (segment,) = whole.segments
        if name == "steps":
            held = Steps(levels=STEP_LEVELS_N, hold_s=STEP_S - 0.05, rise_s=0.05)
            force = replace(segment.rack_force_n, steps=held)
            segment = replace(segment, duration_s=STEP_S * len(STEP_LEVELS_N), rack_force_n=force)
        elif self.quick:
            segment = replace(segment, duration_s=16.0)
        return replace(whole, segments=(segment,))

    def recording(self, name: str, *, sensors: bool = True) -> SimulatedRecording:
        """What the rig records in a manoeuvre; ``sensors=False``: late, but without noise."""
        if (name, sensors) not in self._made:
            settings = SensorSettings() if sensors else SensorSettings(noise=False, quantise=False)
            self._made[name, sensors] = simulate_recording(
                self.model,
                self.chain,
                self.manoeuvre(name),
                sensors=settings,
                seed=self.seed + len(name),
            )
        return self._made[name, sensors]

    @cached_property
    def cells(self) -> list[Cell]:
        """Mean friction of every constant-speed pass of the identification."""
        found: list[Cell] = []
        for speed in self.grid.speeds_rad_s:
            manoeuvre = _identification(speed, self.grid.preloads_n)
            table = manoeuvre.table()
            # The plant repeats itself exactly; what differs between repetitions is sensor noise.
            truth = Plant(self.model, self.chain, 5, table).run()
            for repetition in range(self.grid.repetitions):
                sensors = Sensors(self.model, SensorSettings(), self.seed + 1000 + repetition)
                time_s = np.arange(len(truth)) / 1000.0
                reported = dict(zip(REPORTED, sensors.run(truth).T, strict=True))
                found += cells_of(
                    {"time_s": time_s} | reported, table, self.model, _settled_s(speed)
                )
        return found

    @cached_property
    def map(self) -> FrictionMap:
        """The measured 2Q-map (fig. 4)."""
        return measured_map(self.cells)

    @cached_property
    def fit(self) -> tuple[Friction, Mapping[str, float]]:
        """The 2Q-fa of eq. 3 (fig. 7, table 2) and the half width of each 95 % interval."""
        return fitted(self.cells, self.model.friction)

    @cached_property
    def bristle(self) -> Mapping[str, Estimate]:
        """σ0, σ1,0 and ω_σ1 by field of the friction block, from the sweep's and a weave's motion.

        The identification starts from the static friction found and from a bristle that is wrong.
        """
        names = ("sine_sweep",) if self.quick else ("sine_sweep", "weave")
        recordings = {name: series(self.recording(name).columns) for name in names}
        start = replace(self.fit[0], **_FIRST_BRISTLE)
        found = identify(recordings, replace(self.model, friction=start)).parameters
        return {name: found[f"friction.{name}"] for name in _FIRST_BRISTLE}

    @cached_property
    def identified(self) -> Model:
        """The model that figs 5 and 9 to 12 use: friction as identified, not as simulated."""
        bristle = {name: one.value for name, one in self.bristle.items()}
        return replace(self.model, friction=replace(self.fit[0], **bristle))


def series(columns: Mapping[str, Floats]) -> dict[str, Series]:
    """Columns of a recording as the estimator takes them."""
    t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
    return {name: Series(t_ns, value) for name, value in columns.items() if name != "time_s"}


def _settled_s(speed_rad_s: float) -> float:
    """The torsion bar winds up by twice the friction, 1.5 rad of the rotor at most here."""
    return 0.4 + 2.0 / speed_rad_s


def _identification(speed_rad_s: float, preloads_n: tuple[float, ...]) -> Manoeuvre:
    """One speed, both ways, at all preloads; slow passes need not travel far."""
    wheel = speed_rad_s / 20.0  # i_APA / i_pi of the reference rig, near enough for a set-point
    sweep = ConstantSpeedGrid(
        wheel_speeds_rad_s=(wheel,),
        preloads_n=preloads_n,
        travel_rad=wheel * (_settled_s(speed_rad_s) + _RUN_S),
        change_s=0.8,
        turn_s=0.2,
    )
    motor = Motor(preload_compensation=1.0)
    segment = Segment(constant_speed_grid=sweep, driver=_ROBOT, motor=motor)
    return Manoeuvre(name="identification", segments=(segment,))
