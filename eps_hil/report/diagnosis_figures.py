"""The line plots of a diagnosis' page: worst spots, evidence of each finding, hold-outs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.accept.free_run import free_runs
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.data.prepare import STEP_S
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.estimation import batch
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import Model
from eps_hil.report.diagnosis_evidence import Evidence, acts_over, label
from eps_hil.report.plots import Line, Plot, thinned

Floats = npt.NDArray[np.float64]

MOST_SPOTS = 3
AROUND_S = 1.0
"""Shown before and after a worst stretch."""
LONGEST_S = 12.0
BINS = 40
_AT_AN_END = 0.005
"""Share of samples, or of what a term does, that an axis may leave out at either end."""
MOST_ROWS = 24_000
"""Samples that all hold-outs together are drawn with."""
MOST_HOLDOUTS = 6

_LEFT = "torque residual, mNm"


def spots(evidence: Evidence, segments: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The recordings' traces around the worst stretches: title and plots, one under the other."""
    names = [one.name for one in evidence.problem.recordings]
    found: list[dict[str, Any]] = []
    for segment in segments or _largest(evidence):
        if segment["recording"] not in names or len(found) == MOST_SPOTS:
            continue
        where = evidence.parts()[names.index(segment["recording"])]
        time = evidence.signals["time_s"][where]
        first = segment["from_s"] - AROUND_S
        last = min(segment["to_s"] + AROUND_S, first + LONGEST_S)
        rows = np.arange(where.start, where.stop)[(time >= first) & (time <= last)]
        if len(rows) > 1:
            found.append({**segment, "plots": _spot(evidence, rows, f"spot{len(found)}")})
    return found


def _spot(evidence: Evidence, rows: npt.NDArray[np.int64], sync: str) -> list[Plot]:
    time, floor = evidence.signals["time_s"][rows], 2e3 * evidence.floor_nm[rows]
    plots = [
        Plot(
            f"{sync}-left",
            "",
            _LEFT,
            time,
            [*_band(floor), *_before_after(evidence, rows)],
            sync,
            200,
        )
    ]
    assumed = any(one.load_is_assumed for one in evidence.problem.recordings)
    for name in ("motor_speed_rad_s", "rack_force_n", "motor_torque_nm"):
        if name == "rack_force_n" and assumed:
            continue
        last = name == "motor_torque_nm"
        line = Line("recorded", "recorded", evidence.signals[name][rows])
        plots.append(
            Plot(
                f"{sync}-{name}",
                "time in s" if last else "",
                label(name).replace(" in ", ", "),
                time,
                [line],
                sync,
                150 if last else 130,
            )
        )
    return plots


def _band(half: Floats) -> list[Line]:
    return [
        Line("sensor noise, ±2σ", "edge", -half),
        Line("", "edge", half, band_below=True),
    ]


def _before_after(evidence: Evidence, rows: Any) -> list[Line]:
    lines = [Line("baseline model", "before", 1e3 * evidence.before_nm[rows])]
    if evidence.entries:
        lines.append(Line("with the findings", "after", 1e3 * evidence.after_nm[rows]))
    return lines


def _largest(evidence: Evidence) -> list[dict[str, Any]]:
    """Where nothing stands out: the two seconds of sliding with the most left over."""
    energy = np.where(evidence.sliding, evidence.before_nm**2, 0.0)
    best: tuple[float, dict[str, Any]] = (-1.0, {})
    for recording, part in zip(evidence.problem.recordings, evidence.parts(), strict=True):
        sums = np.convolve(energy[part], np.ones(min(250, part.stop - part.start)), mode="valid")
        k = int(np.argmax(sums))
        start = float(recording.thin_time_s[k])
        if sums[k] > best[0]:
            spot = {"recording": recording.name, "from_s": start, "to_s": start + 2.0}
            best = (float(sums[k]), spot)
    return [best[1]]


def finding(
    evidence: Evidence, k: int, where: Sequence[Mapping[str, Any]]
) -> tuple[Plot, dict[str, float]]:
    """(what is left without finding ``k`` beside its own torque, sizes in newtons at the rack)."""
    use = evidence.sliding
    without, own = evidence.without_nm[k], evidence.without_nm[k] - evidence.after_nm
    x_label, x = acts_over(evidence.entries[k], where, evidence)
    low, high = _shown(x[use], own[use])
    edges = np.linspace(low, high, BINS + 1)
    index = np.where(use, np.digitize(x, edges) - 1, -1)
    counts = np.array([np.sum(index == i) for i in range(BINS)])
    keep = [i for i in range(BINS) if counts[i] >= 10]
    rows = [index == i for i in keep]
    centre = (0.5 * (edges[1:] + edges[:-1]))[keep]
    mean = np.array([np.mean(without[r]) for r in rows])
    error = np.array([2 * np.std(without[r]) / np.sqrt(np.sum(r) / 4) for r in rows])
    model = np.array([np.mean(own[r]) for r in rows])
    lines = [
        Line("mean ±2 standard errors", "edge", 1e3 * (mean - error)),
        Line("", "edge", 1e3 * (mean + error), band_below=True),
        Line("recordings, residual without this term", "dots", 1e3 * mean),
        Line("this term, as fitted", "after", 1e3 * model),
    ]
    plot = Plot(f"finding{k}", x_label, "torque, mNm", centre, lines, height=260)
    return plot, sizes(evidence, [k])


def sizes(evidence: Evidence, which: Sequence[int]) -> dict[str, float]:
    """Of the torque of these entries together, newtons at the rack while sliding."""
    ratio = evidence.problem.model.rack_to_rotor_ratio_rad_per_m
    own = np.sum([evidence.without_nm[k] - evidence.after_nm for k in which], axis=0)
    return {
        "rms_n": ratio * evidence.rms_nm(own),
        "peak_n": ratio * float(np.max(np.abs(own[evidence.sliding]))),
    }


def _shown(x: Floats, own: Floats) -> tuple[float, float]:
    """Ends of an axis over ``x`` (n,): nearly all of it, and nearly all that a term does there."""
    order = np.argsort(x)
    sums = np.cumsum(own[order] ** 2)
    acts = x[order][np.searchsorted(sums, [_AT_AN_END * sums[-1], (1 - _AT_AN_END) * sums[-1]])]
    low, high = np.percentile(x, [100 * _AT_AN_END, 100 * (1 - _AT_AN_END)])
    return float(min(low, acts[0])), float(max(high, acts[1]))


def unknown(finding: Mapping[str, Any]) -> Plot | None:
    """The curve of what no effect explains, with its band; None where there is none."""
    if not finding["curve"]:
        return None
    apart = finding.get("seen_in") == "kinematics"
    columns = zip(*finding["curve"], strict=True)
    x, size, band = (np.array(column, dtype=np.float64) for column in columns)
    what = "way that nothing explains" if apart else "torque that nothing explains"
    what = "torque that its model explains" if finding.get("model") else what
    lines = [
        Line("±2 standard errors", "edge", 1e3 * (size - band)),
        Line("", "edge", 1e3 * (size + band), band_below=True),
        Line(what, "before", 1e3 * size),
    ]
    name, y_label = ("unknown-apart", "φ − i·x, mrad") if apart else ("unknown", "torque, mNm")
    return Plot(name, label(finding["where"][0]["signal"]), y_label, x, lines, height=260)


def holdouts(diagnosis: Diagnosis, evidence: Evidence) -> list[dict[str, Any]]:
    """For each recording kept from the fit, before and after: torque residual, simulated speed,
    and rack force where it was measured."""
    shown = list(zip(diagnosis.judged, evidence.parts(), strict=True))[:MOST_HOLDOUTS]
    most = MOST_ROWS // max(1, len(shown))
    result = []
    for number, (one, part) in enumerate(shown):
        sync = f"holdout{number}"
        rows = part.start + thinned(evidence.before_nm[part], most // 2)
        time = evidence.signals["time_s"][rows]
        left = Plot(
            f"{sync}-torque",
            "",
            _LEFT,
            time,
            [*_band(2e3 * evidence.floor_nm[rows]), *_before_after(evidence, rows)],
            sync,
            220,
        )
        plots = [left, *_speed(diagnosis, evidence, one, sync, most // 2)]
        if not one.prepared.load_is_assumed:  # else there is nothing to compare an estimate with
            plots.append(_force(diagnosis, one, evidence, part, sync, most // 2))
        plots[-1] = replace(plots[-1], x_label="time in s")
        result.append({"name": one.prepared.name, "plots": plots})
    return result


def _speed(
    diagnosis: Diagnosis, evidence: Evidence, one: Holdout, sync: str, most: int
) -> list[Plot]:
    """Error of the freely simulated speed; empty where the rotor does not slide long enough.

    A load that nobody measured is what the written model makes of its own motion: the force that
    was fitted in its place is in no file.
    """
    ready, given, written = one.prepared, evidence.problem.model, evidence.augmented
    if diagnosis.beside_load is not None and diagnosis.given is not None:
        ready, given, written = ready.as_measured(), diagnosis.given, diagnosis.model
    time, before, measured = free_runs(ready, given, one.quality)
    if len(time) == 0:
        return []
    errors = [("baseline model", "before", before - measured)]
    if evidence.entries:
        # a finding may shift the speed itself, and so which half seconds begin while sliding
        then, after, measured = free_runs(ready, written, one.quality)
        time, of_before, of_after = np.intersect1d(time, then, return_indices=True)
        if len(time) == 0:
            return []
        errors = [
            ("baseline model", "before", errors[0][2][of_before]),
            ("with the findings", "after", (after - measured)[of_after]),
        ]
    keep = thinned(errors[0][2], most)
    # between two stretches nothing was simulated: no line there
    starts = np.flatnonzero(np.diff(time) > 2 * STEP_S) + 1
    rows = np.unique(np.concatenate([keep, starts]))
    lines = []
    for name, style, values in errors:
        shown = values[rows].copy()
        shown[np.isin(rows, starts)] = np.nan
        lines.append(Line(name, style, shown))
    return [Plot(f"{sync}-speed", "", "speed error, rad/s", time[rows], lines, sync, 180)]


def _force(
    diagnosis: Diagnosis, one: Any, evidence: Evidence, part: slice, sync: str, most: int
) -> Plot:
    time, cell = evidence.signals["time_s"][part], evidence.signals["rack_force_n"][part]
    start = min(int(series.t_ns[0]) for series in one.series.values())
    before = _estimated(one.series, diagnosis.problem.model, start, time)
    lines = [("load cell", "recorded", cell), ("estimate, baseline model", "before", before)]
    rows = thinned(np.nan_to_num(before - cell), most)
    if evidence.entries:
        after = _estimated(one.series, diagnosis.model, start, time)
        lines.append(("estimate, with the findings", "after", after))
    return Plot(
        f"{sync}-force",
        "time in s",
        "rack force, N",
        time[rows],
        [Line(name, style, values[rows]) for name, style, values in lines],
        sync,
        260,
    )


def _estimated(series: Any, model: Model, start: int, time: Floats) -> Floats:
    """The estimator's rack force at ``time`` (s after ``start``); NaN where it is not valid."""
    trace: Trace = batch.estimate(dict(series), model)
    seconds = (trace.t_ns - start) * 1e-9
    if len(seconds) < 2:
        return np.full(len(time), np.nan)
    force = np.interp(time, seconds, trace.rack_force_n, left=np.nan, right=np.nan)
    nearest = np.clip(np.searchsorted(seconds, time), 0, len(seconds) - 1)
    return np.where(trace.valid[nearest], force, np.nan)
