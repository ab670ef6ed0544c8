"""What a person should hear beside the numbers: what is lost, what disagrees, what to record."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.identification.balance import Case
from eps_hil.identification.finding import Finding
from eps_hil.identification.gains import gain_findings
from eps_hil.identification.stages import SETTLED_SHARE, Found, Sliding
from eps_hil.identification.state import State, get

Floats = npt.NDArray[np.float64]

LEFT_OVER = 2.0
MOST_ROUGH = 0.08
_NO_SPRING = 0.35
_FARTHEST = 2.0

_WHY = {
    "inertia_kg_m2": "the rotor is hardly accelerated; record a sine sweep or a multisine",
    "friction.offset": "hardly any sliding in this direction; record constant speeds both ways",
    "friction.viscous": "too few different speeds in this direction; record constant speeds",
    "friction.load": "too few different loads in this direction; record several preloads",
    "friction.sigma1": "shows only while the rotor creeps, and not clearly here (or presliding has "
    "another form); record creeping and slow reversals",
    "friction.sigma": "too few reversals and small motions; record slow reversals",
    "torque_sensor": "no three stretches of 2 to 8 s that agree, with hands off and the rotor "
    "turning both ways; an offset would look like an asymmetry of the friction",
    "motor_torque": "no three stretches of 2 to 8 s that agree, with the motor off and the rotor "
    "turning both ways; an offset would look like an asymmetry of the friction",
}


def why_not(name: str) -> str:
    """Why a parameter is not identified, and what to record."""
    return next(words for start, words in _WHY.items() if name.startswith(start))


def check_loads(cases: Sequence[Case], start: State, state: State) -> None:
    """:class:`InputError` where a load without a cell is neither free rack nor spring.

    A force that drives the rig is a sum of spring, damper and inertia of the motion that it
    causes: then the balance closes on nothing at all, and the inertia runs away.
    """
    weights = Sliding()
    lost = [case for case in cases if not case.measured_load]
    apart = state.model.inertia_kg_m2 / start.model.inertia_kg_m2
    if lost and not 1 / _FARTHEST < apart < _FARTHEST:
        raise InputError(
            lost[0].recording.name,
            "rack_force_n",
            f"is missing, and the inertia would come out {apart:.2g} times the model file's: "
            "the load drives the rig",
            "record the load cell",
        )
    for case in cases:
        if case.measured_load:
            continue
        residual = case.residual(state)
        mine = (weights.unsettled(case, state) <= SETTLED_SHARE) & case.good
        if mine.sum() < 100:
            continue
        left = float(np.sqrt(np.mean(residual[mine] ** 2)))
        if left > _NO_SPRING * float(np.mean(case.thin_level(state)[mine])):
            raise InputError(
                case.recording.name,
                "rack_force_n",
                f"is missing, and the load is neither a free rack nor a spring ({left:.2g} Nm "
                "remain unexplained)",
                "record the load cell",
            )


def residual(cases: Sequence[Case], state: State, weights: Sliding) -> tuple[float, float]:
    """Rms (Nm) of the balance while sliding, and of what sensor noise makes of it."""
    left, noise = [], []
    for case in cases:
        mine = (weights.unsettled(case, state) <= SETTLED_SHARE) & case.good
        left.append(case.residual(state)[mine])
        noise.append(np.full(int(mine.sum()), case.floor_nm(state.model) ** 2))
    residuals, floors = np.concatenate(left), np.concatenate(noise)
    if len(residuals) == 0:
        return float("nan"), float("nan")
    return float(np.sqrt(np.mean(residuals**2))), float(np.sqrt(np.mean(floors)))


def of_fit(
    cases: Sequence[Case],
    state: State,
    found: Found,
    left_nm: float,
    floor_nm: float,
    moved_s: float,
) -> list[Finding]:
    """Findings about the fit as a whole."""
    told = []
    if left_nm > LEFT_OVER * floor_nm:
        words = (
            f"while sliding {1e3 * left_nm:.3g} mNm remain, {left_nm / floor_nm:.1f} times what "
            "sensor noise explains: the model lacks something; ask eps-hil diagnose"
        )
        told.append(Finding("left_over", "", "", words))
    if found.bristle is not None and found.rough > MOST_ROUGH:
        words = (
            f"at reversals {100 * found.rough:.0f} % of the friction remain unexplained: "
            "presliding is not LuGre's; levels are not touched by that, "
            "bristle parameters are a compromise"
        )
        told.append(Finding("presliding", "", "", words))
    for name in ("viscous_pos_nm_s_per_rad", "viscous_neg_nm_s_per_rad"):
        sigma = found.sliding.sigma(f"friction.{name}")
        if get(state, f"friction.{name}") < -3 * sigma:
            words = f"{name} came out below zero: friction falls with speed (see stribeck)"
            told.append(Finding("falling_friction", "", "", words))
    if moved_s > 0:
        words = f"all delays moved {1e3 * moved_s:.3g} ms later, so that none is negative"
        told.append(Finding("delays", "", "", words))
    for case in cases:
        if not case.measured_load:
            words = (
                "no load cell: taken as a spring with a damper; viscous friction cannot be told "
                "from its damping, nor the difference of the two offsets from its zero"
            )
            told.append(Finding("no_load_cell", case.recording.name, "rack_force_n", words))
        if not case.recording.has("torque_sensor_nm"):
            words = "no torsion bar torque: taken as hands off"
            told.append(Finding("no_torque_sensor", case.recording.name, "torque_sensor_nm", words))
    return told + gain_findings(cases, state, found.sliding)
