"""Stage 0: what is wrong with the data itself, before anything is said about physics.

Rates, gaps, jitter, lost frames, clipping, stuck values, quantisation and noise of every signal.
Clipped and stuck stretches and long gaps are barred from the diagnosis: a channel that does not
follow never turns into physics.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.diagnosis.data.entry import around, known, place
from eps_hil.diagnosis.data.noise import noise_of
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.series import Series

Floats = npt.NDArray[np.floating[Any]]
Flags = npt.NDArray[np.bool_]
Runs = npt.NDArray[np.int64]
"""(first, last + 1) of stretches of equal samples, shape (m, 2)."""
Gaps = tuple[tuple[float, float], ...]
"""(from, to) on the recording's own time, s."""

GAP = 5.0
"""So many usual steps without a good sample (none at all, or NaN) are a gap…"""
GAP_S = 0.02
"""…if it is also longer than this."""
_SURE = 4.0
"""Deviations of what jitter adds up to: there are many channels."""
_HOLES, _IN_STEP = 20, 3.1
"""After so many holes frames that keep no clock show: the cosines of where their stamps lie between
two beats have a mean of 0, its deviation 1/√(2n). More than so many of these: one in 1,000."""
LOST = 1.5
"""A step of so many usual ones is no jitter."""
CLIPPED_SAMPLES = 8
"""So many equal samples at the end of the range, entered at speed, are clipped."""
_HELD = 0.5
"""A signal that is at one end of its range for this share of the time is held there."""
STUCK_S = 0.2
"""Equal samples for this long…"""
STUCK_RUNS = 20.0
"""…and for so many usual runs of equal samples are stuck, while the rotor moves on."""
MOVED_RAD_S = 2.0
MARGIN_S = 0.1
"""Barred on both sides of what is wrong."""
_FOLLOWED = 0.1
"""Of what a stamp lies beside the beat; the beat's own step follows so that neither swings."""
_ROUNDED = 1.6
"""Times the usual step: so far apart coarse stamps may be, and no frame is missing."""
MATTERS = 0.01
"""Share of lost frames from which they are a finding."""
_ENTERED, _NEAR = 3.0, 20
_MOTION = ("motor_speed_rad_s", "motor_angle_rad", "rack_position_m")
_USED = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n", *_MOTION)


@dataclass(frozen=True)
class Channel:
    """One signal of one recording; stretches are (from s, to s) on the recording's own time."""

    signal: str
    rate_hz: float
    jitter_s: float
    lost_frames: int
    frames: int
    gaps: tuple[tuple[float, float], ...]
    clipped: tuple[tuple[float, float], ...]
    stuck: tuple[tuple[float, float], ...]
    quantum: float
    noise: float
    bad_samples: int
    uneven: bool = False
    """Long steps are there, but no whole numbers of a clock's."""

    @property
    def flags(self) -> list[str]:
        """What is wrong, in words for the JSON."""
        said = [name for name in ("clipped", "stuck", "gaps") if getattr(self, name)]
        if self.lost_frames:
            said.append("lost_frames")
        if self.uneven:
            said.append("uneven")
        if self.bad_samples:
            said.append("bad_samples")
        if self.noise > 0 and self.quantum > 4.0 * self.noise:
            said.append("coarse")
        return said

    def content(self) -> dict[str, Any]:
        """For the JSON."""
        return {
            "signal": self.signal,
            "rate_hz": round(self.rate_hz, 3),
            "jitter_s": float(f"{self.jitter_s:.3g}"),
            "lost_frames": self.lost_frames,
            "quantum": float(f"{self.quantum:.4g}"),
            "noise": float(f"{self.noise:.4g}"),
            "flags": self.flags,
            **{
                name: [[round(a, 3), round(b, 3)] for a, b in getattr(self, name)]
                for name in ("gaps", "clipped", "stuck")
                if getattr(self, name)
            },
        }


@dataclass(frozen=True)
class Quality:
    """Stage 0 of one recording."""

    recording: str
    channels: tuple[Channel, ...]
    start_ns: int = 0
    """The stamp at which the recording's own time is 0."""

    def content(self) -> dict[str, Any]:
        """For the JSON's ``data_quality``."""
        return {
            "recording": self.recording,
            "channels": [one.content() for one in self.channels],
        }

    @property
    def lost(self) -> tuple[int, float]:
        """(lost frames of the input that lost most, the largest share that any of them lost).

        A hole in all inputs at once is a pause of the recording and counts as no loss.
        """
        pauses = self._pauses()
        counts = [_lost_beside(one, pauses) for one in self.inputs]
        frames = [one.frames for one in self.inputs]
        shares = [lost / max(many + lost, 1) for lost, many in zip(counts, frames, strict=True)]
        return max(counts, default=0), max(shares, default=0.0)

    def _pauses(self) -> Gaps:
        """Gaps that all inputs share, where there are several."""
        inputs = self.inputs
        common = inputs[0].gaps if len(inputs) > 1 else ()
        for one in inputs[1:]:
            common = _shared(common, one.gaps)
        return common

    @property
    def inputs(self) -> tuple[Channel, ...]:
        """What the diagnosis reads: a loss of anything else is nobody's mismatch."""
        return tuple(one for one in self.channels if one.signal in _USED)

    def barred(self, one: Prepared) -> Flags:
        """Thinned samples (m,) of the prepared recording that nothing may be concluded from."""
        return self.bad_at(one.thin_time_s)

    def bad_at(self, time_s: Floats) -> Flags:
        """Where, of instants (n,) on the recording's own time, a signal in use is not to be had."""
        bad = np.zeros(len(time_s), dtype=bool)
        for channel in self.channels:
            if channel.signal not in _USED:
                continue
            for start, end in (*channel.clipped, *channel.stuck, *channel.gaps):
                bad |= (time_s > start - MARGIN_S) & (time_s < end + MARGIN_S)
        return bad


def look_at(
    name: str, series: Mapping[str, Series], rad_per_m: float = 2500.0, angle: float = 1.0
) -> Quality:
    """Stage 0 for one recording as it was read; ``angle``: how far its rotor turns (``size.py``).

    ``rad_per_m``: rotor turn per rack travel.
    """
    start = min((int(one.t_ns[0]) for one in series.values() if len(one.t_ns) > 1), default=0)
    speed = _speed(series, rad_per_m / angle, 1.0 / angle)
    used = {signal: one for signal, one in series.items() if len(one.t_ns) > 10}
    clocks = {id(one.t_ns): one.t_ns for one in used.values()}  # columns of a table share one
    timing = {key: _timing(t_ns, start) for key, t_ns in clocks.items()}
    channels = [
        _channel(signal, one, timing[id(one.t_ns)], start, speed) for signal, one in used.items()
    ]
    return Quality(name, tuple(channels), start)


def _speed(series: Mapping[str, Series], of_rack: float, of_rotor: float) -> Mapping[str, Series]:
    """Speeds (rad/s) as of a rotor of ordinary size, by what they come from; differences where only
    a place is."""
    found = {}
    for name in _MOTION:
        if name not in series:
            continue
        one = series[name]
        good = np.isfinite(one.value)
        if np.count_nonzero(good) < 10:
            continue
        one = Series(one.t_ns[good], one.value[good])
        if name == "motor_speed_rad_s":
            found[name] = Series(one.t_ns, of_rotor * one.value)
            continue
        seconds = (one.t_ns - one.t_ns[0]) * 1e-9
        grid = np.arange(0.0, seconds[-1], 0.02)
        scale = of_rack if name == "rack_position_m" else of_rotor
        rate = np.gradient(np.interp(grid, seconds, one.value), 0.02) * scale
        found[name] = Series(one.t_ns[0] + np.round(grid * 1e9).astype(np.int64), rate)
    return found


@dataclass(frozen=True)
class _Timing:
    """What a signal's stamps say, its values aside: as :class:`Channel` has it."""

    seconds: Floats
    usual_s: float
    jitter_s: float
    lost_frames: int
    uneven: bool


def _timing(t_ns: npt.NDArray[np.int64], start: int) -> _Timing:
    seconds = (t_ns - start) * 1e-9
    steps = np.diff(seconds)
    usual = float(np.median(steps))
    regular = steps[steps < LOST * usual]
    jitter = float(np.std(regular)) if len(regular) else 0.0
    lost, uneven = _surely_lost(seconds, _beat(steps, usual), jitter) if usual > 0 else (0, False)
    return _Timing(seconds, usual, jitter, lost, uneven)


def _channel(
    signal: str, one: Series, timing: _Timing, start: int, speeds: Mapping[str, Series]
) -> Channel:
    good = np.isfinite(one.value)
    value = one.value[good]
    at = timing.seconds[good]
    runs = _equal_runs(value)
    quantum = _quantum(value)
    return Channel(
        signal=signal,
        rate_hz=1.0 / timing.usual_s if timing.usual_s > 0 else 0.0,
        jitter_s=timing.jitter_s,
        lost_frames=timing.lost_frames,
        frames=len(timing.seconds),
        gaps=_gaps(timing.seconds, good),
        clipped=_clipped(value, at, runs, quantum),
        stuck=_stuck(signal, value, at, runs, speeds, start),
        quantum=quantum,
        noise=noise_of(value) if len(value) > 10 else 0.0,
        bad_samples=int(np.sum(~good)),
        uneven=timing.uneven,
    )


def _beat(steps: Floats, usual: float) -> float:
    """Between samples, on average: stamps in whole ms say 2 and 3 for a signal of 2.4 ms."""
    return max(usual, float(np.mean(steps[steps <= _ROUNDED * usual])))


def _surely_lost(seconds: Floats, usual: float, jitter: float) -> tuple[int, bool]:
    """Frames that are missing, where more are than jitter of every step by itself may add up to.

    And whether they are none, since what comes after the holes keeps no clock: such a logger is
    uneven. Frames lost of a regular clock leave whole steps.
    """
    lost, holes, cosines = _lost(seconds, usual)
    if lost <= _SURE * jitter / usual * np.sqrt(len(seconds)):
        return 0, False
    uneven = holes >= _HOLES and cosines < _IN_STEP * np.sqrt(holes / 2.0)
    return (0, True) if uneven else (lost, False)


@njit
def _lost(seconds: Floats, usual: float) -> tuple[int, int, float]:
    """Frames that are missing beside the signal's own beat, which follows the stamps slowly.

    Also the holes, and the sum of the cosines of the phases after them. What the next stamp gives
    back, or the one before took ahead, is jitter of more than half a step and no hole.

    A stamp that is late for once is jitter; some that are held up and then come all at once are
    counted while they are late, and given back when they come.
    """
    beat, step, lost = seconds[0], usual, 0.0
    holes, cosines = 0, 0.0
    last, hole, ahead = 0.0, False, 0.0
    for k in range(1, len(seconds)):
        late = (seconds[k] - beat) / step - 1.0
        missing = np.rint(late)
        lost += missing
        beside = late - missing
        if missing > ahead:
            last, hole, ahead = np.cos(2.0 * np.pi * beside), True, 0.0
            holes += 1
            cosines += last
        elif missing < 0.0 and hole:
            holes -= 1
            cosines -= last
            hole, ahead = False, 0.0
        else:
            hole, ahead = False, max(-missing, 0.0)
        beat += step * (1.0 + missing + _FOLLOWED * beside)
        step *= 1.0 + 0.25 * _FOLLOWED**2 * beside
    return max(int(lost), 0), holes, cosines


def _shared(first: Gaps, second: Gaps) -> Gaps:
    """Where both have a gap, each list in order of time."""
    found, i, j = [], 0, 0
    while i < len(first) and j < len(second):
        start, end = max(first[i][0], second[j][0]), min(first[i][1], second[j][1])
        if end - start > GAP_S:
            found.append((start, end))
        if first[i][1] < second[j][1]:
            i += 1
        else:
            j += 1
    return tuple(found)


def _lost_beside(one: Channel, pauses: Gaps) -> int:
    """Without those of holes that every input has: there the rig or the logger paused."""
    missing = sum(max(round((end - start) * one.rate_hz) - 1, 0) for start, end in pauses)
    return max(one.lost_frames - missing, 0)


def _gaps(seconds: Floats, good: Flags) -> tuple[tuple[float, float], ...]:
    """Stretches between good samples (or an end of the signal) that are too long to be bridged."""
    own = np.diff(seconds[good])
    usual = float(np.median(own)) if len(own) else 0.0
    known = good.copy()
    known[[0, -1]] = True
    at = seconds[known]
    steps = np.diff(at)
    gaps = np.flatnonzero((steps > GAP * usual) & (steps > GAP_S))
    return tuple((float(at[k]), float(at[k + 1])) for k in gaps)


def _equal_runs(value: Floats) -> Runs:
    """(first, last + 1) of every stretch of equal samples."""
    edges = np.flatnonzero(np.diff(value) != 0) + 1
    edges = np.concatenate([[0], edges, [len(value)]])
    return np.column_stack([edges[:-1], edges[1:]])


def _quantum(value: Floats) -> float:
    """The step that values come in; 0 where they come in none."""
    levels = np.unique(value)
    if len(levels) < 3 or len(levels) > 0.5 * len(value):
        return 0.0
    return float(np.min(np.diff(levels)[np.diff(levels) > 1e-12 * np.ptp(levels)]))


def _clipped(
    value: Floats, at: Floats, runs: Runs, quantum: float
) -> tuple[tuple[float, float], ...]:
    """Runs at either end of the range that the signal ran into rather than came to rest at."""
    if not len(value):
        return ()
    high, low = float(np.max(value)), float(np.min(value))
    share = {end: np.count_nonzero(value == end) / len(value) for end in (high, low)}
    if sum(share.values()) >= 1.0:  # no other value than these
        return ()
    ends = [end for end in share if share[end] < _HELD]
    typical = max(float(np.median(np.abs(np.diff(value)))), quantum)
    found = []
    long = runs[runs[:, 1] - runs[:, 0] >= CLIPPED_SAMPLES]
    for first, last in long[np.isin(value[long[:, 0]], ends)].tolist():
        before = abs(value[first] - value[max(first - _NEAR, 0)])
        after = abs(value[min(last + _NEAR, len(value)) - 1] - value[first])
        if max(before, after) > _ENTERED * typical:
            found.append((float(at[first]), float(at[last - 1])))
    return tuple(found)


def _stuck(
    signal: str,
    value: Floats,
    at: Floats,
    runs: Runs,
    speeds: Mapping[str, Series],
    start: int,
) -> tuple[tuple[float, float], ...]:
    """Long runs of equal samples while another signal shows the rotor moving."""
    lengths = runs[:, 1] - runs[:, 0]
    if len(runs) < 10:
        return ()
    usual = float(np.median(lengths))
    others = [
        ((one.t_ns - start) * 1e-9, np.abs(one.value))
        for name, one in speeds.items()
        if name != signal
    ]
    found = []
    held = at[runs[:, 1] - 1] - at[runs[:, 0]]
    for first, last in runs[(held > STUCK_S) & (lengths >= STUCK_RUNS * usual)].tolist():
        for seconds, speed in others:
            begin = np.searchsorted(seconds, at[first], "right")
            inside = speed[begin : np.searchsorted(seconds, at[last - 1], "left")]
            if len(inside) and float(np.median(inside)) > MOVED_RAD_S:
                found.append((float(at[first]), float(at[last - 1])))
                break
    return tuple(found)


def finding(qualities: list[Quality]) -> dict[str, Any] | None:
    """``dropped_frames`` as a finding, where enough are lost to matter."""
    worst = max(qualities, key=lambda one: one.lost[1], default=None)
    if worst is None or worst.lost[1] < MATTERS:
        return None
    from eps_hil.physics.effects.catalogue import catalogue

    effect = catalogue()["dropped_frames"]
    count = sum(one.lost[0] for one in qualities)
    losing = [channel for channel in worst.inputs if channel.lost_frames]
    places = [place("time_s", a, b, 0.0) for channel in losing for a, b in channel.gaps[:2]]
    signals = ", ".join(channel.signal for channel in losing)
    return known(
        effect.id,
        f"{effect.sentence.format(count=count)} They carry {signals}.",
        {"count": around(float(count), 0.0)},
        0.99,
        "time stamps",
        where=places[:2],
    )


def remarks(qualities: list[Quality]) -> list[str]:
    """Which recordings were logged unevenly: the instants are known, so nothing is wrong."""
    found = {
        one.recording: [channel.signal for channel in one.inputs if channel.uneven]
        for one in qualities
    }
    return [
        f"{name}: logged unevenly, by no regular clock ({', '.join(signals)}): "
        "frames lost cannot be counted"
        for name, signals in found.items()
        if signals
    ]
