"""What one file of this folder says about one effect: the whole of what the tool knows of it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.physics.model import Model
from eps_hil.unit_words import spaced

Floats = npt.NDArray[np.float64]

WIDTH = 160
"""Parameters that one effect may have (a curve takes one plus two a knot, a map its table)."""
STATES = 6
"""Numbers that one effect may remember between steps."""


_SMALLEST, _LARGEST = 1e-12, 1e12
_DIMENSIONS: Mapping[str, Mapping[str, int]] = {
    "Nm": {"Nm": 1},
    "Nm/N": {"Nm": 1, "N": -1},
    "Nm/rad": {"Nm": 1, "rad": -1},
    "Nm s/rad": {"Nm": 1, "rad": -1},
    "Nm s²/rad²": {"Nm": 1, "rad": -2},
    "1/Nm²": {"Nm": -2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1},
    "m": {"m": 1},
    "1/m": {"m": -1},
    "1/m²": {"m": -2},
    "N/m": {"N": 1, "m": -1},
}

OF_MODEL = float("nan")
"""As a probe's neutral value: the model file's own value of that parameter."""


class Instant(NamedTuple):
    """One physical instant as a kernel sees it; torques and angles at the rotor (CONTRACT 1)."""

    time_s: float
    speed_rad_s: float
    angle_rad: float
    position_m: float
    rack_force_n: float
    pinion_rad: float
    motor_torque_nm: float
    torque_sensor_nm: float
    ratio_rad_per_m: float
    """i_APA in mid travel."""


class Ratios(NamedTuple):
    """What joins rack and column to the rotor: i_pi/i_APA, and i_APA (rad/m) in mid travel."""

    sensor_to_rotor: float
    rad_per_m: float


_WHOLE_RAD_S, _NONE_RAD_S = 2.0 * math.pi * 400.0, 2.0 * math.pi * 500.0


@kernel
def resolved(rate_rad_s: float) -> float:
    """Share of a ripple that passes at this rate (rad/s of its own phase) which is counted.

    All of it below 400 Hz, none beyond 500 Hz, half of the 1 kHz at which angles are told: at a
    multiple of that a rotor would be seen in the same phase of it again and again, as if under a
    constant torque, where in truth it is over before it has moved anything.
    """
    beyond = (abs(rate_rad_s) - _WHOLE_RAD_S) / (_NONE_RAD_S - _WHOLE_RAD_S)
    return 1.0 - min(max(beyond, 0.0), 1.0)


class Slot(StrEnum):
    """Where in the simulator an effect acts; within a slot effects act in this order of files."""

    MODEL = "model"
    """On the model file's own numbers, before anything runs."""
    POSITION = "position"
    """From φ/i_APA to the rack's position (m), where it was not measured."""
    LEVEL = "level"
    """On T_fs (Nm), inside the friction model; additive terms."""
    LEVEL_FACTOR = "level_factor"
    """On T_fs, after all additive terms."""
    TORQUE = "torque"
    """On the torque sum that opposes the drive (Nm at the rotor), beside friction and load."""
    MOTOR = "motor"
    """From the reported motor torque to that on the shaft (Nm)."""
    SENSOR = "sensor"
    """From the reported torsion-bar torque to the true one (Nm, at the column)."""
    LOAD = "load"
    """On what the rack force is worth at the rotor: F/i_APA (Nm)."""
    JOINT = "joint"
    """On the joint between rotor and rack, which the simulator then runs as two masses."""
    DATA = "data"
    """In the recording only: nothing in the simulator changes."""


class Mass(StrEnum):
    """Where in a steering chain a torque of ``Slot.TORQUE`` acts; one mass has it all in one."""

    ROTOR = "rotor"
    NUT = "nut"
    RACK = "rack"


class Kind(StrEnum):
    """CONTRACT 7."""

    STRUCTURE = "structure"
    PARAMETER = "parameter"
    INSTRUMENT = "instrument"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect: name with unit, bounds inside which it makes physical sense.

    Bounds with a unit of torque, angle, force or place are those of a steering drive of ordinary
    size: a diagnosis looks between them in proportion to the machine. What a model file may say
    is ``domain``.
    """

    name: str
    unit: str
    lower: float
    upper: float
    meaning: str
    default: float | None = None
    """Used where the model file leaves the parameter out; None if it has to be given."""
    closed: bool = False
    """Whether its bounds are values like any other (a share: none, all) and not only limits."""
    per_turn: bool = False
    """Whether it counts per turn of the rotor: fewer, the farther that turns."""

    @property
    def dimensions(self) -> Mapping[str, int]:
        """Powers of Nm, N, rad and m in its unit; none of a phase, which is as wide on any rig."""
        if self.is_phase:
            return {}
        if self.per_turn:
            return {"rad": -1}
        return _DIMENSIONS.get(self.unit, {})

    @property
    def is_phase(self) -> bool:
        """Whether it is a wave's phase (rad), of which whole turns more or less say nothing."""
        return (self.lower, self.upper) == (-math.pi, math.pi)

    @property
    def domain(self) -> tuple[float, float]:
        """Between which values it makes sense on a machine of any size."""
        if not self.dimensions:
            return self.lower, self.upper
        if self.lower > 0.0:
            return _SMALLEST, _LARGEST
        return 0.0 if self.lower == 0.0 else -_LARGEST, _LARGEST

    @property
    def allowed(self) -> str:
        """The same in words: ``0.3 to 3``, ``more than 0 rad/s``."""
        unit = spaced(self.unit)
        if not self.dimensions:
            return f"{self.lower:g} to {self.upper:g}{unit}"
        if self.lower > 0.0:
            return f"more than 0{unit}"
        return f"0{unit} or more" if self.lower == 0.0 else f"a number of{unit or ' 1'}"


@dataclass(frozen=True, slots=True)
class Probe:
    """How a diagnosis looks for an effect: where it vanishes, and what shapes it may have."""

    amplitude: str
    """The parameter that the residual depends on (nearly) linearly."""
    neutral: float
    """Its value at which the effect is not there."""
    step: float
    """A change of it that is small, and large against rounding."""
    shapes: tuple[Mapping[str, float], ...] = ({},)
    """Starting values of the other parameters that between them cover what is plausible."""
    phase: str | None = None
    """A phase: the probe then looks at two quadratures at once."""
    scan: str = ""
    """A parameter whose starting values come from the data: see ``diagnosis/balance/probes.py``."""
    least: float = 0.0
    """A smaller change than this is how rigs are built and sampled: fitted, but no finding.

    A share of the model file's own value where that is the neutral one.
    """
    one_sided: bool = False
    """Whether only values above the neutral one are this effect: what bends the other way is
    something else, and must not go under its name."""
    lowest: "Callable[[Model], float] | None" = None
    """The least amplitude that friction can have on a rig of this model."""


class Joint(NamedTuple):
    """What joins the rotor and the mass behind it; everything at the rotor."""

    stiffness_nm_per_rad: float
    damping_nm_s_per_rad: float
    gap_rad: float
    behind_share: float
    """Share of J_1m that sits behind the joint."""


RIGID = Joint(400.0, 0.02, 0.0, 0.33)
"""As stiff as a belt drive should be: resonance far above what a recording shows."""

Kernel = Callable[[Floats, Floats, Instant, float], float]
"""(parameters (WIDTH,), state (STATES,), instant, value) -> new value of the slot."""
Advance = Callable[[Floats, Floats, Instant, float], None]
"""(parameters, state, instant, Δt in s): moves the state on, once a step."""


@dataclass(frozen=True, slots=True)
class Effect:
    """An entry of the catalogue (CONTRACT 8)."""

    id: str
    kind: Kind
    slot: Slot
    equation: str
    parameters: tuple[Parameter, ...]
    sentence: str
    """One sentence that a rig engineer understands; {parameter} places are filled in."""
    sentence_negative: str = ""
    """The sentence for a negative amplitude (given without its sign); empty: the same one."""
    words: Callable[[Mapping[str, Any]], str] | None = None
    """Picks the sentence by the values, where one does not fit all."""
    twins: Mapping[str, str] = field(default_factory=dict)
    """Effects that recordings may not tell from this one -> the experiment that does."""
    kernel: Kernel | None = None
    advance: Advance | None = None
    elsewhere: Mapping[Slot, Kernel] = field(default_factory=dict)
    """Kernels of other slots in which it acts too; what remembers acts in one slot."""
    slots: Mapping[Slot, Kernel] = field(default_factory=dict)
    """Kernels of an effect whose entry says where it acts (``slot_of``): in one of these."""
    slot_of: Callable[[Mapping[str, Any]], Slot] | None = None
    read: Callable[[Mapping[str, Any]], dict[str, Any]] | None = None
    """Checks an entry that holds more than numbers; ``ValueError`` says what is wrong."""
    numbers: Callable[[Mapping[str, Any]], list[float]] | None = None
    """Beside ``read``: its values as the kernel takes them."""
    outside: Callable[[Floats, Instant], bool] | None = None
    """Whether an instant is beyond the range that the effect is known in (compiled)."""
    change: Callable[[Model, Mapping[str, Any]], Model] | None = None
    """For ``Slot.MODEL``: the model with the effect's numbers worked in."""
    left: Callable[[Mapping[str, Any]], Mapping[str, float] | None] | None = None
    """Beside ``change``: the numbers of what still acts at run time; worked in, they change
    nothing more. None, or an answer of None: nothing."""
    mass: Mass = Mass.ROTOR
    """Which mass of a chain a torque of it acts on."""
    told: Kernel | None = None
    """For a sensor's error: the reported value from the true one, as a simulated rig's sensor has
    it. Called once a sample in order, so it may keep its memory up itself."""
    joint: Callable[[Joint, Mapping[str, Any]], Joint] | None = None
    """For ``Slot.JOINT``: the joint with the effect in it."""
    probe: Probe | None = None
    """None: this tool cannot look for it yet."""
    stage: int = 0
    """Place among the effects of its slot, on the way from what is reported to what acts."""
    at_reversal: bool = False
    """Whether it changes the friction level while the rotor turns round: how a bristle goes along
    with that is open, so a reversal tells nothing of its stiffness then."""
    over_time: bool = False
    """Whether it depends on how long the recording has run: only then its place is a time."""
    title: str = ""
    """Its name in the field; empty: the id in words."""
    simulated: bool = True
    """Whether simulator and estimator can use it (a model file may then hold it)."""
    on_bus: bool = False
    """Beside not ``simulated``: a simulated rig's model file may hold it all the same, since it
    acts on what the rig reports."""

    @property
    def name(self) -> str:
        """Its name in the field, as a page or a terminal shows it."""
        return self.title or self.id.replace("_", " ").capitalize()

    def wording(self, values: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
        """The sentence for these values, and the values to fill it with."""
        filled = dict(values)
        amplitude = self.probe.amplitude if self.probe is not None else ""
        if self.sentence_negative and filled[amplitude] < 0.0:
            filled[amplitude] = -filled[amplitude]
            return self.sentence_negative, filled
        return self.words(filled) if self.words is not None else self.sentence, filled
