"""What rig, driver and motor controller are told to do: manoeuvres as programs at 1 kHz.

A program has the columns of ``plant.PROGRAM``. Amplitudes, frequencies and phases are drawn anew
for each recording, so that no two recordings of a proof are alike; training and hold-out
recordings are put together from different manoeuvres.
"""

import numpy as np

from eps_hil.proof.plant import PROGRAM
from eps_hil.proof.truth import Drive, Floats

_COLUMN = {name: i for i, name in enumerate(PROGRAM)}
_HANDS_OFF = {"wheel_nm_s_per_rad": 0.05}


def column(name: str) -> int:
    """Where a column of ``plant.PROGRAM`` stands."""
    return _COLUMN[name]


def segment(seconds: float, **columns: Floats | float) -> Floats:
    """A program of ``seconds`` with the named columns set; hands off unless it says otherwise."""
    program = np.zeros((round(seconds * 1000), len(PROGRAM)))
    for name, values in {**_HANDS_OFF, **columns}.items():
        program[:, _COLUMN[name]] = values
    return program


def _times(seconds: float) -> Floats:
    return np.arange(round(seconds * 1000), dtype=np.float64) * 1e-3


def faded(values: Floats, seconds: float = 0.3) -> Floats:
    """``values`` with raised-cosine ends, so that segments join without a jump."""
    n = round(seconds * 1000)
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(n) / n)
    window = np.ones(len(values))
    window[:n], window[len(values) - n :] = ramp, ramp[::-1]
    return np.asarray(values * window)


def smoothed(values: Floats, seconds: float) -> Floats:
    """``values`` at 1 kHz under a Hann window of that length."""
    n = round(seconds * 1000)
    padded = np.pad(values, (n // 2, n - 1 - n // 2), mode="edge")
    window = np.hanning(n + 2)[1:-1]
    return np.asarray(np.convolve(padded, window / window.sum(), mode="valid"), dtype=np.float64)


def sweep(rng: np.random.Generator, seconds: float, top_hz: float = 4.0) -> Floats:
    """Seed paper, figs 9 to 11: sine sweep of rack force, the motor as spring-damper."""
    t = _times(seconds)
    phase = np.pi * top_hz / seconds * t**2 + rng.uniform(0, 2 * np.pi)
    return segment(
        seconds,
        force_n=faded(rng.uniform(700, 850) * np.sin(phase)),
        motor_nm_per_rad=rng.uniform(0.02, 0.028),
        motor_nm_s_per_rad=3.0e-4,
    )


def steps(rng: np.random.Generator, seconds: float) -> Floats:
    """Fig. 12: rack force in steps with standstill between them."""
    hold = rng.uniform(1.0, 1.4)
    count = int(seconds / hold) + 1
    signs = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    levels = signs * rng.uniform(0.0, 1200.0, count)
    raw = levels[(_times(seconds) / hold).astype(int)]
    return segment(
        seconds,
        force_n=faded(smoothed(raw, 0.08)),
        motor_nm_per_rad=rng.uniform(0.026, 0.034),
        motor_nm_s_per_rad=2.0e-3,
    )


def weave(rng: np.random.Generator, seconds: float) -> Floats:
    """The driver turns the wheel against a tyre-like spring, with assist."""
    t = _times(seconds)
    slow, fast = rng.uniform(0.15, 0.3), rng.uniform(0.4, 0.7)
    angle = rng.uniform(1.5, 2.2) * np.sin(2 * np.pi * slow * t + rng.uniform(0, 6))
    angle += rng.uniform(0.2, 0.5) * np.sin(2 * np.pi * fast * t + rng.uniform(0, 6))
    return segment(
        seconds,
        rig_n_per_m=rng.uniform(35e3, 50e3),
        rig_n_s_per_m=500.0,
        wheel_target_rad=faded(angle, 0.8),
        wheel_nm_per_rad=30.0,
        wheel_nm_s_per_rad=1.0,
        assist=0.1,
        motor_nm_s_per_rad=5.0e-4,
    )


def constant_speed(rng: np.random.Generator, seconds: float) -> Floats:
    """Figs 4 and 7: constant speeds both ways under preloads that the motor carries."""
    t = _times(seconds)
    stroke = seconds / 6
    speeds = rng.uniform(0.4, 1.0, 6) * np.array([40, 25, 12, 40, 25, 12])
    preloads = rng.permutation([0.0, 800.0, 1600.0, 2200.0, -800.0, -1600.0])
    which = np.minimum((t / stroke).astype(int), 5)
    direction = np.where((t / stroke) % 1.0 < 0.5, 1.0, -1.0)
    speed = smoothed(np.asarray(direction * speeds[which]), 0.12)
    preload = faded(smoothed(preloads[which], 0.25))
    target = np.cumsum(speed) * 1e-3
    return segment(
        seconds,
        force_n=preload,
        target_rad=faded(target - target.mean(), 0.5),
        motor_nm_per_rad=0.5,
        motor_nm_s_per_rad=4.0e-3,
        feed_nm=preload / Drive().rack_rad_per_m,
    )


def slow_reversals(rng: np.random.Generator, seconds: float) -> Floats:
    """Slow strokes that turn back on themselves at ever other points, hand torque in play."""
    t = _times(seconds)
    f = rng.uniform(0.08, 0.13)
    target = rng.uniform(6, 14) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6))
    target += rng.uniform(0.5, 3) * np.sin(2 * np.pi * rng.uniform(0.4, 0.7) * t)
    force = 500 * np.sin(2 * np.pi * rng.uniform(0.05, 0.11) * t + rng.uniform(0, 6))
    return segment(
        seconds,
        force_n=faded(force),
        target_rad=faded(target, 0.8),
        motor_nm_per_rad=0.4,
        motor_nm_s_per_rad=4.0e-3,
        feed_nm=faded(force) / Drive().rack_rad_per_m,
        hand_nm=faded(2.5 * np.sin(2 * np.pi * rng.uniform(0.1, 0.2) * t)),
        wheel_nm_s_per_rad=0.5,
    )


def dwell(rng: np.random.Generator, seconds: float) -> Floats:
    """Rests of growing length, each ended by a torque ramp until the rack breaks away."""
    rests = rng.permutation([0.15, 0.3, 0.6, 1.2, 2.0])
    rests = rests * (seconds - 5 * 1.2) / rests.sum()
    torque, sign = np.zeros(0), 1.0 if rng.uniform() < 0.5 else -1.0
    for rest in rests:
        n = round(rest * 1000)
        ramp = np.interp(_times(1.2), [0, 0.9, 1.0, 1.2], [0, 1, 1, 0]) * rng.uniform(0.3, 0.45)
        torque = np.concatenate([torque, np.zeros(n), sign * ramp])
        sign = -sign
    feed = np.zeros(round(seconds * 1000))
    m = min(len(feed), len(torque))
    feed[:m] = torque[:m]
    return segment(
        seconds, rig_n_per_m=6.0e4, rig_n_s_per_m=8.0e3, feed_nm=feed, wheel_nm_s_per_rad=0.5
    )


def multisine(rng: np.random.Generator, seconds: float) -> Floats:
    """Broad excitation by the motor, fig. 5, against a spring-damper."""
    t = _times(seconds)
    hz = np.linspace(0.5, 7.0, 25)
    lines = np.sin(2 * np.pi * hz[:, None] * t + rng.uniform(0, 2 * np.pi, (25, 1))).sum(axis=0)
    feed = faded(lines / np.std(lines) * rng.uniform(0.35, 0.45))
    return segment(seconds, rig_n_per_m=1.2e5, rig_n_s_per_m=4.0e3, feed_nm=feed)


def motor_off(rng: np.random.Generator, seconds: float) -> Floats:
    """The rig moves the rack to and fro, the motor is switched off: what each sensor reads then."""
    t = _times(seconds)
    phase = 2 * np.pi * rng.uniform(0.4, 0.6) * t + rng.uniform(0, 2 * np.pi)
    return segment(
        seconds,
        force_n=faded(rng.uniform(700, 1000) * np.sin(phase)),
        rig_n_per_m=1.0e5,
        rig_n_s_per_m=3.0e4,
        motor_off=1.0,
    )


def training(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Programs of the two training recordings, 48 and 45 s."""
    first = [sweep(rng, 16.0), constant_speed(rng, 15.0), steps(rng, 9.0), motor_off(rng, 8.0)]
    second = [weave(rng, 14.0), slow_reversals(rng, 11.0), dwell(rng, 12.0), multisine(rng, 8.0)]
    return np.concatenate(first), np.concatenate(second)


def holdout(rng: np.random.Generator) -> Floats:
    """Program of the recording that judges, 39 s: other mixtures of the same rig."""
    parts = [weave(rng, 9.0), sweep(rng, 9.0, 3.0), slow_reversals(rng, 8.0), dwell(rng, 8.0)]
    return np.concatenate([*parts, motor_off(rng, 5.0)])


def held(rng: np.random.Generator, program: Floats) -> Floats:
    """The same with the motor always on, and a hand that is never still at the wheel."""
    held = program[program[:, _COLUMN["motor_off"]] == 0.0].copy()
    t = _times(len(held) * 1e-3)
    swing = np.sin(2 * np.pi * rng.uniform(0.2, 0.3) * t + rng.uniform(0, 2 * np.pi))
    held[:, _COLUMN["hand_nm"]] += faded(rng.uniform(1.0, 1.5) * swing)
    held[:, _COLUMN["wheel_nm_s_per_rad"]] += 0.5
    return held


def poor(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Two recordings with hardly any excitation: straight driving, a little steps."""
    t = _times(20.0)
    calm = segment(
        20.0,
        rig_n_per_m=40e3,
        rig_n_s_per_m=500.0,
        wheel_target_rad=faded(0.15 * np.sin(2 * np.pi * 0.2 * t + rng.uniform(0, 6)), 0.8),
        wheel_nm_per_rad=30.0,
        wheel_nm_s_per_rad=1.0,
        assist=0.1,
        motor_nm_s_per_rad=5.0e-4,
    )
    return calm, weave(rng, 10.0)
