"""The EMPS benchmark's two recordings as canonical ones, and its published model as a model file.

Electro-mechanical positioning system: a carriage on a ball screw (Janot, Gautier, Brunot, Data set
and reference models of EMPS, 2019). The axis is one mass under M q̈ = F_motor − F_friction −
F_hidden. It becomes a rotor by the scale ``ARM_M``: speed and angle are divided by it, forces are
multiplied. Results are to be scaled back; nothing but the size of numbers depends on it.

The second recording has a square wave of voltage added behind the controller. It is taken out of
the motor's force here, and is kept apart: to a diagnosis and to an estimator it is a load that no
sensor has seen.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.physics.model import Friction, Model
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

FITTED, HELD_OUT = "DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"
SOURCE = "get it from nonlinearbenchmark.org (Electro-Mechanical Positioning System)"

ARM_M = 0.01 / (2 * np.pi)
"""Travel per radian of the rotor that stands for the axis: a screw of 10 mm a turn, which makes
95 kg a rotor of 2.4e-4 kg m², the size that a diagnosis' thresholds are made for."""
PULSE_GAIN = 1.0139
"""Volts at the plant's input per volt of the recorded pulse: what rebuilding the controller's
output from positions leaves beside it."""

MASS_KG, VISCOUS_N_S_PER_M, COULOMB_N, OFFSET_N = 95.1089, 203.5034, 20.3935, -3.1648
"""The published parameters."""
BRISTLE_N_PER_M = 1e6
"""Presliding, which the published model leaves out: a contact that slides after 20 µm."""

_STEP_NS = 1_000_000
_NEEDED = ("qm", "vir", "gtau")


@dataclass(frozen=True, slots=True)
class AxisRecord:
    """One recording at 1 kHz, all shape (n,).

    ``force_n`` is the motor's as the controller asked for it; ``hidden_force_n`` opposes it (as a
    rack force does) and is for the scorer alone. Position counts from the middle of the travel,
    which is ``middle_m`` in the recording.
    """

    name: str
    position_m: Floats
    force_n: Floats
    hidden_force_n: Floats
    middle_m: float = 0.0

    def series(self, *, free_of_load: bool = False) -> Mapping[str, Series]:
        """What a diagnosis or an estimator is shown; a load of zero where there is known none."""
        t_ns = np.arange(len(self.position_m), dtype=np.int64) * _STEP_NS
        shown = {
            "motor_torque_nm": Series(t_ns, self.force_n * ARM_M),
            "motor_angle_rad": Series(t_ns, self.position_m / ARM_M),
        }
        if free_of_load:
            shown["rack_force_n"] = Series(t_ns, np.zeros(len(t_ns)))
        return shown


def read(folder: Path) -> tuple[AxisRecord, AxisRecord]:
    """(recording to fit, recording with the hidden force); ``InputError`` where one is missing."""
    return _record(folder / FITTED, pulses=False), _record(folder / HELD_OUT, pulses=True)


def _record(path: Path, *, pulses: bool) -> AxisRecord:
    from scipy.io import loadmat

    if not path.is_file():
        raise InputError(path, "", "is not there", SOURCE)
    try:
        content = loadmat(path)
    except Exception as error:  # parsers of foreign files fail in ways nobody can list
        raise InputError(path, "", f"is no MATLAB file: {error}", SOURCE) from None
    signals = {}
    for name in (*_NEEDED, "t", *(("pulses_N",) if pulses else ())):
        if name not in content:
            raise InputError(path, name, "is missing", SOURCE)
        try:
            signals[name] = np.asarray(content[name], dtype=np.float64).ravel()
        except (TypeError, ValueError):
            raise InputError(path, name, "holds no plain numbers", SOURCE) from None
        if not signals[name].size:
            raise InputError(path, name, "is empty", SOURCE)
    _check(path, signals)
    position, gain = signals["qm"], float(signals["gtau"][0])
    force = gain * signals["vir"]
    hidden = np.zeros(len(force))
    if pulses:
        hidden = -PULSE_GAIN * gain * signals["pulses_N"]
    middle = 0.5 * (float(position.min()) + float(position.max()))
    return AxisRecord(path.stem, position - middle, force + hidden, hidden, middle)


def _check(path: Path, signals: Mapping[str, Floats]) -> None:
    n = len(signals["t"])
    for name, values in signals.items():
        if name != "gtau" and len(values) != n:
            raise InputError(path, name, f"has {len(values)} samples, t has {n}")
        if not np.all(np.isfinite(values)):
            raise InputError(path, name, "holds a value that is not finite")
    if n < 2 or np.max(np.abs(np.diff(signals["t"]) - 1e-3)) > 1e-5:
        raise InputError(path, "t", "does not step by 1 ms")


def published_model() -> Model:
    """The published structure and numbers, with a bristle for presliding, as a rotor."""
    viscous = VISCOUS_N_S_PER_M * ARM_M**2
    return Model(
        inertia_kg_m2=MASS_KG * ARM_M**2,
        pinion_ratio_rad_per_m=1.0 / ARM_M,
        rack_to_rotor_ratio_rad_per_m=1.0 / ARM_M,
        friction=Friction(
            offset_pos_nm=(COULOMB_N + OFFSET_N) * ARM_M,
            offset_neg_nm=(COULOMB_N - OFFSET_N) * ARM_M,
            viscous_pos_nm_s_per_rad=viscous,
            viscous_neg_nm_s_per_rad=viscous,
            load_pos_nm_per_n=0.0,
            load_neg_nm_per_n=0.0,
            sigma0_nm_per_rad=BRISTLE_N_PER_M * ARM_M**2,
            sigma1_nm_s_per_rad=0.0,
            sigma1_speed_rad_s=0.75,
        ),
    )
