"""What the 1- to 5-mass chains answer to a recorded motor torque, for comparison with a rig.

The recorded torque is run through each chain in time, friction and all, and the simulated signals
go through the same estimator as the measured ones. Friction makes the plant's response depend on
amplitude and on what else moves at the time; a describing function holds for one sine alone, while
here every bias of estimator and excitation is the same on both sides. :func:`linear_response` is
the closed form without friction: a limit case for tests, and a measure of what friction does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.identification.butterworth import low_pass
from eps_hil.identification.frequency_response import (
    INPUT,
    Complexes,
    Floats,
    Response,
    ResponseSettings,
    Stretch,
    responses,
)
from eps_hil.physics.chain import (
    INPUTS,
    LOAD_DAMPING,
    LOAD_POSITION,
    LOAD_STIFFNESS,
    RACK,
    ROAD_WHEELS,
    ROTOR,
    STEERING_WHEEL,
    Chain,
    ChainState,
    build_chain,
    ratios,
    rest_state,
)
from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.chain_reading import read_out
from eps_hil.physics.chain_step import advance
from eps_hil.physics.model import Model

ORDERS = (1, 2, 3, 4, 5)
_STEPS_PER_MS = 20
_LEAST_ROWS = 100
"""Two periods of the filter's corner: its own ends are most of a shorter stretch."""
_SIGNALS = (
    "motor_speed_rad_s",
    "rack_position_m",
    "steering_wheel_speed_rad_s",
    "rack_force_n",
)


@dataclass(frozen=True, slots=True)
class Load:
    """The linear motor as a spring-damper at the end of the chain, about ``position_m``."""

    stiffness_n_per_m: float
    damping_n_s_per_m: float
    position_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Agreement:
    """One chain against the measurement for one output, over the trusted lines.

    ``gain_error``: rms of |G_chain − G|/|G| (magnitude and phase together); ``magnitude_error_db``
    and ``phase_error_deg``: rms; ``inside``: share of the lines within the 95 % band.
    """

    order: int
    output: str
    gain_error: float
    magnitude_error_db: float
    phase_error_deg: float
    inside: float
    lines: int


def fitted_load(parts: Sequence[Stretch]) -> Load:
    """Spring and damper of the linear motor by least squares: F = k (x − x0) + d ẋ.

    Stretches that are too short for the filter are left out. ``ValueError`` where rack force or
    rack position is missing, or what comes out is no spring.
    """
    rows, target = [], []
    for part in parts:
        if "rack_force_n" not in part.columns or "rack_position_m" not in part.columns:
            raise ValueError(
                "rack_force_n and rack_position_m are needed to find the load's spring"
            )
        if part.rows < _LEAST_ROWS:
            continue
        x = _smoothed(part.columns["rack_position_m"])
        rows.append(np.column_stack([x, np.gradient(x, 1e-3), np.ones_like(x)]))
        target.append(_smoothed(part.columns["rack_force_n"]))
    if not rows:
        raise ValueError(f"no stretch without gaps is as long as {_LEAST_ROWS} ms")
    (k, d, constant), *_ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(target), rcond=None)
    if k <= 0.0 or d < 0.0:
        raise ValueError(f"the rack force is no spring-damper's ({k:.3g} N/m, {d:.3g} Ns/m)")
    return Load(float(k), float(d), float(-constant / k))


def simulated(
    part: Stretch, model: Model, parameters: ChainParameters, order: int, load: Load
) -> Stretch:
    """The outputs of a chain of ``order`` masses under the recorded shaft torque, from rest.

    What is recorded is torque at the shaft, so motor dead time and lag are not applied again.
    """
    prompt = replace(parameters, motor_dead_time_s=0.0, motor_time_constant_s=0.0)
    chain = build_chain(model, prompt, order, step_s=1e-3 / _STEPS_PER_MS)
    state = rest_state(chain)
    start = part.columns["rack_position_m"][0] if "rack_position_m" in part.columns else 0.0
    state.angle_rad[:] = start * model.rack_to_rotor_ratio_rad_per_m
    row = np.zeros(INPUTS)
    row[LOAD_STIFFNESS], row[LOAD_DAMPING] = load.stiffness_n_per_m, load.damping_n_s_per_m
    row[LOAD_POSITION] = load.position_m
    out = np.zeros((part.rows, len(_SIGNALS)))
    _drive(chain, state, part.columns[INPUT], row, np.zeros_like(row), np.zeros((2, INPUTS)), out)
    return Stretch({INPUT: part.columns[INPUT]} | dict(zip(_SIGNALS, out.T.copy(), strict=True)))


def chain_responses(
    parts: Sequence[Stretch],
    model: Model,
    parameters: ChainParameters,
    load: Load,
    settings: ResponseSettings | None = None,
    orders: Sequence[int] = ORDERS,
) -> dict[int, dict[str, Response]]:
    """Responses of each chain to the recorded torques, by number of masses and output."""
    return {
        order: responses(
            [simulated(part, model, parameters, order, load) for part in parts], settings
        )
        for order in orders
    }


def agreement(measured: Response, chain: Response, order: int) -> Agreement:
    """How far a chain's response is from the measured one; NaN where no line is trusted."""
    keep = measured.trusted & (np.abs(measured.gain) > 0)
    if not keep.any():
        return Agreement(order, measured.output, *(float("nan"),) * 4, 0)
    ratio = chain.gain[keep] / measured.gain[keep]
    away = np.abs(chain.gain[keep] - measured.gain[keep])
    return Agreement(
        order,
        measured.output,
        _rms(np.abs(ratio - 1.0)),
        _rms(20.0 * np.log10(np.maximum(np.abs(ratio), 1e-12))),
        _rms(np.degrees(np.angle(ratio))),
        float(np.mean(away <= measured.radius[keep])),
        int(keep.sum()),
    )


def linear_response(
    model: Model,
    parameters: ChainParameters,
    order: int,
    load: Load,
    frequency_hz: Floats,
) -> Mapping[str, Complexes]:
    """Closed form without friction: (−ω² M + jω D + K) q = e_rotor; outputs of fig. 5 per Nm."""
    chain = build_chain(model, parameters, order)
    group, n = chain.group, chain.inertia.size
    square = model.rack_to_rotor_ratio_rad_per_m**2
    stiffness, damping = chain.stiffness.copy(), chain.damping.copy()
    end = group[ROAD_WHEELS]
    stiffness[end, end] += load.stiffness_n_per_m / square
    damping[end, end] += load.damping_n_s_per_m / square
    torque = np.zeros(n)
    torque[group[ROTOR]] = 1.0
    s = 2j * np.pi * np.asarray(frequency_hz)
    q = np.array(
        [
            np.linalg.solve(np.diag(chain.inertia) * w * w + damping * w + stiffness, torque)
            for w in s
        ]
    )
    side = ratios(model, parameters)
    x_end = q[:, end] / side[RACK]
    return {
        "motor_speed_rad_s": s * q[:, group[ROTOR]],
        "rack_position_m": q[:, group[RACK]] / side[RACK],
        "steering_wheel_speed_rad_s": s * q[:, group[STEERING_WHEEL]] / side[STEERING_WHEEL],
        "rack_force_n": (load.stiffness_n_per_m + s * load.damping_n_s_per_m) * x_end,
    }


@kernel
def _drive(
    chain: Chain,
    state: ChainState,
    torque_nm: Floats,
    row: Floats,
    rate: Floats,
    scratch: Floats,
    out: Floats,
) -> None:
    for k in range(out.shape[0]):
        reading = read_out(chain, state, row, rate)
        out[k, 0] = reading.motor_speed_rad_s
        out[k, 1] = reading.rack_position_m
        out[k, 2] = reading.steering_wheel_speed_rad_s
        out[k, 3] = reading.rack_force_n
        after = torque_nm[k + 1] if k + 1 < out.shape[0] else torque_nm[k]
        # The mean of both ends: a torque held from its sample on would be half a sample late.
        advance(chain, state, 0.5 * (torque_nm[k] + after), row, row, _STEPS_PER_MS, scratch)


def _smoothed(value: Floats) -> Floats:
    """Zero-phase low-pass at 20 Hz: force and position alike, so their relation stays."""
    return low_pass(value, 20.0, 2)


def _rms(value: npt.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(value))))
