"""Bandwidth against noise of the paper's observer: newtons and milliseconds, worked out and tried.

With the friction compensated and the rotor moving, the estimator is linear: observer (eq. 5 to 11)
and the two poles of the low-pass. Its noise is then the solution of a Lyapunov equation for white
noise on speed and torque, drawn straight between samples that are slower than its steps; its delay
and its bandwidth (−3 dB) follow from its frequency response. :func:`simulated_noise_n` runs the
estimator itself over such noise, for comparison.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from eps_hil.estimation import batch
from eps_hil.estimation.observer_design import design, force_response
from eps_hil.estimation.phases import phases
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.physics.model import Model
from eps_hil.series import Series, usual_step_ns

Floats = npt.NDArray[np.float64]

WALKS_N = tuple(float(v) for v in np.round(np.geomspace(20.0, 2000.0, 25), 1))
"""Settings of ``force_walk_n_per_sqrt_s`` that a curve goes through."""
_HERTZ = np.geomspace(0.5, 400.0, 400)
_LEAST_DWELL_S = 0.2
_EDGE_S = 0.1


@dataclass(frozen=True, slots=True)
class Noise:
    """White noise of one sample (rms): rotor speed (rad/s), and T_1m at the rotor (Nm).

    ``speed_period_s``, ``torque_period_s``: how often they are sampled; 0: at every step.
    """

    speed_rad_s: float
    torque_nm: float
    origin: str
    speed_period_s: float = 0.0
    torque_period_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Point:
    """One setting: N rms of noise at the rack, delay in s for slow forces, −3 dB in Hz.

    ``speed_share_n`` and ``torque_share_n`` are the parts of ``noise_n``; their squares add up.
    ``delay_s`` is observer and low-pass; alignment's look-back comes on top.
    """

    force_walk_n_per_sqrt_s: float
    noise_n: float
    speed_share_n: float
    torque_share_n: float
    delay_s: float
    bandwidth_hz: float


def point(model: Model, settings: EstimatorSettings, noise: Noise) -> Point:
    """The estimator's noise, delay and bandwidth for one setting, in closed form."""
    angle = settings.position == "measured"
    found = design(model, settings, angle=angle, speed=True, dt=settings.step_s)
    part = slice(0 if angle else 1, 3)
    keep = np.eye(3) - np.hstack([found.gain, np.zeros((3, 1))])
    closed, into = (keep @ found.transition)[part, part], found.gain[part, 1]
    pole = math.exp(-2 * math.pi * settings.output_low_pass_hz * settings.step_s)
    weight = 1.0 - pole if settings.low_pass else 1.0
    # The torque of a step is the mean of its ends: white noise enters it twice, half each time.
    torque = (keep @ found.input)[part]
    every = _steps(noise.speed_period_s, settings), _steps(noise.torque_period_s, settings)
    speed_n = noise.speed_rad_s * _rms(closed, into, None, weight, every[0])
    torque_n = noise.torque_nm * _rms(closed, 0.5 * torque, 0.5 * torque, weight, every[1])
    ratio = model.rack_to_rotor_ratio_rad_per_m
    a = found.transition.copy()
    if not angle:
        a[0] = 0.0  # φ without a gain is a free integrator that nothing reads
    gains = []
    for hertz in _HERTZ:
        omega = 2 * math.pi * float(hertz)
        z = np.exp(1j * omega * settings.step_s)
        filtered = (weight / (1.0 - (1.0 - weight) / z)) ** 2
        gains.append(abs(force_response(a, found.input, found.gain, ratio, settings.step_s, omega)
                         * filtered))  # fmt: skip
    under = np.flatnonzero(np.array(gains) < math.sqrt(0.5))
    delay = found.lag_s + (2 * settings.step_s * pole / (1.0 - pole) if settings.low_pass else 0.0)
    return Point(
        settings.force_walk_n_per_sqrt_s,
        math.hypot(speed_n, torque_n),
        speed_n,
        torque_n,
        delay,
        float(_HERTZ[under[0]]) if len(under) else float("inf"),
    )


def _steps(period_s: float, settings: EstimatorSettings) -> int:
    """Steps from one sample to the next."""
    return max(round(period_s / settings.step_s), 1)


def _rms(
    closed: Floats, now: Floats, before: Floats | None, weight: float, every: int = 1
) -> float:
    """Standard deviation of the filtered force for unit white noise through ``now`` (and
    ``before``, the sample of a step ago), of samples that come ``every`` so many steps."""
    from scipy.linalg import solve_discrete_lyapunov

    n = len(closed)
    # states: observer, last noise, two filter poles
    a, b = np.zeros((n + 3, n + 3)), np.zeros(n + 3)
    a[:n, :n], b[:n], b[n] = closed, now, 1.0
    if before is not None:
        a[:n, n] = before
    kept = 1.0 - weight
    a[n + 1] = weight * a[n - 1]
    b[n + 1] = weight * b[n - 1]
    a[n + 1, n + 1] = kept
    a[n + 2] = weight * a[n + 1]
    b[n + 2] = weight * b[n + 1]
    a[n + 2, n + 2] = kept
    later = solve_discrete_lyapunov(a, np.outer(b, b))[:, -1]
    # What is drawn straight between samples is a triangle of each: its correlation with itself
    # weighs that of the force, and there is one of them ``every`` so many steps.
    triangle = 1.0 - np.abs(np.arange(1 - every, every)) / every
    shares = np.correlate(triangle, triangle, "full")[len(triangle) - 1 :]
    square = shares[0] * later[-1]
    for share in shares[1:]:
        later = a @ later
        square += 2.0 * share * later[-1]
    return float(np.sqrt(square / every))


def curve(
    model: Model,
    settings: EstimatorSettings,
    noise: Noise,
    walks: Sequence[float] = WALKS_N,
) -> list[Point]:
    """Points for each force walk; the low-pass moves with it.

    The low-pass keeps its ratio to the observer's bandwidth: a fast observer behind a slow filter,
    or the reverse, has more delay for the same noise.
    """
    scale = settings.output_low_pass_hz / math.sqrt(settings.force_walk_n_per_sqrt_s)
    return [
        point(model, with_walk(settings, walk, scale), noise)
        for walk in walks
    ]  # fmt: skip


def with_walk(
    settings: EstimatorSettings, walk: float, low_pass_per_root_walk: float | None = None
) -> EstimatorSettings:
    """Settings with another force walk and the low-pass that goes with it.

    The observer's poles lie at a frequency that grows with the root of the walk (its Riccati
    equation is that of a double integrator), and so does the low-pass here.
    """
    scale = low_pass_per_root_walk
    if scale is None:
        scale = settings.output_low_pass_hz / math.sqrt(settings.force_walk_n_per_sqrt_s)
    corner = min(scale * math.sqrt(walk), 0.4 / settings.step_s)
    return replace(settings, force_walk_n_per_sqrt_s=walk, output_low_pass_hz=corner)


def simulated_noise_n(
    model: Model, settings: EstimatorSettings, noise: Noise, seconds: float = 20.0, seed: int = 0
) -> float:
    """N rms at the rack when the estimator itself runs over the noise, sliding at 20 rad/s.

    Friction compensation and limiter are at work; the noise that the friction model adds is in it.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds / settings.step_s)
    f, ratio = model.friction, model.rack_to_rotor_ratio_rad_per_m
    force, speed = 500.0, 20.0
    level = f.offset_pos_nm + f.viscous_pos_nm_s_per_rad * speed + f.load_pos_nm_per_n * force
    t_ns = np.arange(n, dtype=np.int64) * round(settings.step_s * 1e9)

    def sampled(value: float, rms: float, period_s: float) -> Series:
        every = _steps(period_s, settings)
        noisy = value + rms * rng.standard_normal(n)
        return Series(t_ns[::every].copy(), noisy[::every].copy())

    torque = force / ratio + level
    series = {
        "motor_torque_nm": sampled(torque, noise.torque_nm, noise.torque_period_s),
        "motor_speed_rad_s": sampled(speed, noise.speed_rad_s, noise.speed_period_s),
    }
    plain = replace(model, effects=())
    unjudged = replace(settings.plausibility, enabled=False)  # a torque without noise stands still
    settings = replace(settings, kind="observer", plausibility=unjudged)
    trace = batch.estimate(series, plain, settings)
    settled = trace.valid & (trace.t_ns > 2_000_000_000)
    return float(np.std(trace.rack_force_n[settled]))


def assumed_noise(settings: EstimatorSettings) -> Noise:
    """The noise that the settings are made for."""
    return Noise(settings.speed_noise_rad_s, settings.torque_noise_nm, "the settings")


def dwell_noise(series: Mapping[str, Series], model: Model) -> Noise | None:
    """Noise of a recording's rests, from second differences (motion leaves no trace in them).

    None where no rest of 0.2 s is found, or speed or torque are not recorded. The torsion bar's
    noise is reflected to the rotor and added.
    """
    if "motor_speed_rad_s" not in series or "motor_torque_nm" not in series:
        return None
    speed = series["motor_speed_rad_s"]
    good = np.isfinite(speed.value)
    t_s, value = (speed.t_ns[good] - speed.t_ns[0]) * 1e-9, speed.value[good]
    if len(t_s) < 50:
        return None
    step = float(np.median(np.diff(t_s)))
    window = max(1, round(0.05 / step))
    smooth = np.convolve(value, np.ones(window) / window, mode="same")
    edges = np.flatnonzero(np.diff(np.concatenate([[0], phases(smooth, step).rest, [0]])))
    spans = [
        (t_s[a] + _EDGE_S, t_s[b - 1] - _EDGE_S)
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if t_s[b - 1] - t_s[a] > _LEAST_DWELL_S + 2 * _EDGE_S
    ]
    if not spans:
        return None
    rms = {
        name: _white(series[name], speed.t_ns[0], spans)
        for name in ("motor_speed_rad_s", "motor_torque_nm", "torque_sensor_nm")
        if name in series
    }
    torque = math.hypot(
        rms["motor_torque_nm"], model.sensor_to_rotor * rms.get("torque_sensor_nm", 0.0)
    )
    seconds = sum(until - since for since, until in spans)
    return Noise(
        rms["motor_speed_rad_s"],
        torque,
        f"{seconds:.1f} s of rest in the recording",
        usual_step_ns(speed.t_ns) * 1e-9,
        usual_step_ns(series[_louder(rms, model)].t_ns) * 1e-9,
    )


def _louder(rms: Mapping[str, float], model: Model) -> str:
    """The torque whose noise is more at the rotor: its sample period is taken for both."""
    sensor = model.sensor_to_rotor * rms.get("torque_sensor_nm", 0.0)
    return "torque_sensor_nm" if sensor > rms["motor_torque_nm"] else "motor_torque_nm"


def _white(one: Series, origin_ns: int, spans: Sequence[tuple[float, float]]) -> float:
    """Rms of the white part of a signal inside the spans: second differences over √6."""
    t_s = (one.t_ns - origin_ns) * 1e-9
    squares = []
    for since, until in spans:
        part = one.value[(t_s >= since) & (t_s <= until)]
        bend = np.diff(part[np.isfinite(part)], 2)
        squares.append(bend**2)
    every = np.concatenate(squares) if squares else np.zeros(0)
    return float(np.sqrt(np.mean(every) / 6.0)) if len(every) else 0.0


def advise(now: Point, points: Sequence[Point], signal_hz: float = 4.0) -> list[str]:
    """What follows from the curve: where the setting stands, what half the noise or delay costs.

    ``signal_hz``: the fastest rack force of interest; what the bandwidth takes from it is said.
    """
    said = [
        f"Now: {now.noise_n:.1f} N rms, {1e3 * now.delay_s:.1f} ms, {now.bandwidth_hz:.0f} Hz; "
        f"the noise is {_percent(now.speed_share_n, now.noise_n)} % from the speed, "
        f"{_percent(now.torque_share_n, now.noise_n)} % from the torque."
    ]
    quieter = [p for p in points if p.noise_n <= 0.5 * now.noise_n]
    faster = [p for p in points if p.delay_s <= 0.5 * now.delay_s]
    if quieter:
        p = min(quieter, key=lambda q: q.delay_s)
        said.append(
            f"Half the noise: force_walk_n_per_sqrt_s {p.force_walk_n_per_sqrt_s:g} gives "
            f"{p.noise_n:.1f} N, {1e3 * p.delay_s:.1f} ms, {p.bandwidth_hz:.0f} Hz."
        )
    if faster:
        p = min(faster, key=lambda q: q.noise_n)
        said.append(
            f"Half the delay: force_walk_n_per_sqrt_s {p.force_walk_n_per_sqrt_s:g} gives "
            f"{p.noise_n:.1f} N, {1e3 * p.delay_s:.1f} ms, {p.bandwidth_hz:.0f} Hz."
        )
    if now.bandwidth_hz < 3.0 * signal_hz:
        said.append(
            f"The bandwidth is less than three times the {signal_hz:g} Hz of interest: the force's "
            f"peaks are cut; go faster."
        )
    return said


def _percent(part: float, whole: float) -> int:
    return round(100.0 * (part / whole) ** 2) if whole > 0.0 else 0
