"""What the jobs return: typed values that plot, tabulate and show themselves in a notebook."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from eps_hil.api import show
from eps_hil.api.recording import Recording
from eps_hil.estimation.score import Score
from eps_hil.estimation.stream import Trace
from eps_hil.estimation.validity import Reason
from eps_hil.growing import blocks
from eps_hil.physics.model import Model
from eps_hil.recordings import coverage
from eps_hil.report.comparison import Candidate, summary
from eps_hil.signals import ESTIMATOR_INPUTS

if TYPE_CHECKING:  # over a second of imports, which an estimate does not need
    from eps_hil.diagnosis import given_load
    from eps_hil.fmu import fit as simulator_fit
    from eps_hil.identification import result as identifying

Floats = npt.NDArray[np.float64]


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Estimate:
    """A recording's rack force; ``score`` is None where it holds no load cell.

    Rows of ``trace`` speak of physical instants (``t_ns``); use them where ``trace.valid``.
    ``latency_s``: how long after that instant the live estimator knows it; NaN for a smoother.
    """

    recording: Recording
    model: Model
    trace: Trace
    score: Score | None
    latency_s: float

    @property
    def content(self) -> dict[str, Any]:
        """As in the JSON of ``eps-hil estimate``: what does not exist is None, never NaN."""
        content: dict[str, Any] = {
            "recording": self.recording.name,
            "rows": len(self.trace.t_ns),
            "valid_share": float(self.trace.valid.mean()),
            "latency_s": _number(self.latency_s),
            "reasons": {name: rows for name, rows in self._reasons().items() if rows},
            "gaps": {name: asdict(one) for name, one in self.gaps.items()},
        }
        if self.score:
            content["rack_force_error_n"] = {
                "rms_moving": _number(self.score.rmse_moving_n),
                "rms_overall": _number(self.score.rmse_overall_n),
                "bias_moving": _number(self.score.bias_moving_n),
                "rms_of_rack_force": _number(self.score.rms_force_n),
            }
        return content

    @property
    def gaps(self) -> Mapping[str, coverage.Gaps]:
        """Where the estimator's inputs have no samples, and the load cell; by signal."""
        return coverage.gaps(self.recording.series, (*ESTIMATOR_INPUTS, "rack_force_n"))

    @property
    def why_not_valid(self) -> str:
        """Reasons and the share of all rows that each has, the largest first; empty if none."""
        told = sorted(self._reasons().items(), key=lambda one: -one[1])
        rows = max(len(self.trace.t_ns), 1)
        return ", ".join(f"{name} {100 * n / rows:.3g} % of the time" for name, n in told if n)

    def _reasons(self) -> dict[str, int]:
        """Rows by reason why they are not valid."""
        rows = {bit: 0 for bit in Reason if bit and bit.name}
        for at in blocks(len(self.trace.reason)):
            for bit in rows:
                rows[bit] += int(np.count_nonzero(self.trace.reason[at] & int(bit)))
        return {str(bit.name).lower(): count for bit, count in rows.items()}

    def save(self, path: str | Path) -> Path:
        """Write it as CSV, Parquet or MF4, by the suffix."""
        from eps_hil.recordings.write import write_table

        columns = {
            "rack_force_estimate_n": self.trace.rack_force_n,
            "friction_torque_nm": self.trace.friction_torque_nm,
            "valid": self.trace.valid,
        }
        write_table(path, columns, t_ns=self.trace.t_ns)
        return Path(path)

    def to_dataframe(self, library: str | None = None) -> Any:
        """``time_s``, ``rack_force_estimate_n``, ``friction_torque_nm``, ``valid``."""
        columns = {
            "time_s": self.trace.t_ns * 1e-9,
            "rack_force_estimate_n": self.trace.rack_force_n,
            "friction_torque_nm": self.trace.friction_torque_nm,
            "valid": self.trace.valid,
        }
        return show.dataframe(columns, library)

    def plot(self) -> Any:
        """Rack force over time, with the load cell where there is one."""
        from eps_hil.report import figures

        figure, axes = figures.subplots(1, 1, width_cm=25.0, height_cm=10.0)
        axis, start = axes[0, 0], self.recording.start_ns
        if (cell := self.recording.series.get("rack_force_n")) is not None:
            at = cell.t_ns - round(self.model.delays_s.of("rack_force_n") * 1e9)
            axis.plot((at - start) * 1e-9, cell.value, color="0.6", lw=1.5, label="load cell")
        force = np.where(self.trace.valid, self.trace.rack_force_n, np.nan)
        seconds = (self.trace.t_ns - start) * 1e-9
        axis.plot(seconds, force, color=figures.COLOURS[0], lw=0.9, label="estimate")
        axis.set(xlabel="time in s", ylabel="rack force in N")
        axis.legend(frameon=False)
        return show.shown(figure)

    def __repr__(self) -> str:
        valid = f"{len(self.trace.t_ns)} rows, {100.0 * float(self.trace.valid.mean()):.1f} % valid"
        error = f", rms error moving {self.score.rmse_moving_n:.1f} N" if self.score else ""
        return f"<Estimate of {self.recording.name}: {valid}{error}>"

    def _repr_html_(self) -> str:
        row: dict[str, object] = {
            "rows": len(self.trace.t_ns),
            "valid in %": 100.0 * float(self.trace.valid.mean()),
        }
        if self.score:
            row["rms error moving in N"] = self.score.rmse_moving_n
            row["rms error overall in N"] = self.score.rmse_overall_n
            row["load cell in N rms"] = self.score.rms_force_n
        return show.table([row], f"rack force of {self.recording.name}")


@dataclass(frozen=True, slots=True)
class Simulation:
    """A recording's inputs through the model: canonical ``columns`` (n,) at stamps ``t_ns``."""

    recording: Recording
    t_ns: npt.NDArray[np.int64]
    columns: Mapping[str, Floats]
    notes: tuple[str, ...]

    def save(self, path: str | Path) -> Path:
        """Write it as CSV, Parquet or MF4, by the suffix: a recording like the input."""
        from eps_hil.recordings.write import write_table

        write_table(path, self.columns, t_ns=self.t_ns)
        return Path(path)

    def to_dataframe(self, library: str | None = None) -> Any:
        """``time_s`` and the canonical columns."""
        return show.dataframe({"time_s": self.t_ns * 1e-9, **self.columns}, library)

    def plot(self) -> Any:
        """Simulated and recorded speed (or angle)."""
        from eps_hil.report import figures
        from eps_hil.report.diagnosis_evidence import label

        name = next(
            (n for n in ("motor_speed_rad_s", "motor_angle_rad") if n in self.recording.series),
            "motor_speed_rad_s",
        )
        figure, axes = figures.subplots(1, 1, width_cm=25.0, height_cm=10.0)
        axis, start = axes[0, 0], self.recording.start_ns
        if (one := self.recording.series.get(name)) is not None:
            axis.plot((one.t_ns - start) * 1e-9, one.value, color="0.6", lw=1.5, label="recorded")
        seconds = (self.t_ns - start) * 1e-9
        axis.plot(seconds, self.columns[name], color=figures.COLOURS[1], lw=0.9, label="simulated")
        axis.set(xlabel="time in s", ylabel=label(name))
        axis.legend(frameon=False)
        return show.shown(figure)

    def __repr__(self) -> str:
        return (
            f"<Simulation of {self.recording.name}: {len(self.t_ns)} rows of {len(self.columns)}>"
        )

    def _repr_html_(self) -> str:
        rows = [{"column": name, "rows": len(one)} for name, one in self.columns.items()]
        return show.table(rows, f"{self.recording.name}, simulated")


@dataclass(frozen=True, slots=True)
class Identification:
    """The numbers of a rig with their intervals, and the model file that they make."""

    result: "identifying.Identification"

    @property
    def model(self) -> Model:
        """The model with what was identified."""
        return self.result.model

    def to_dataframe(self, library: str | None = None) -> Any:
        """One row a parameter: value, unit, 95 % interval, what the model file said, status."""
        rows = self._rows()
        return show.dataframe({name: [row[name] for row in rows] for name in rows[0]}, library)

    def plot(self) -> Any:
        """The friction map, measured and fitted."""
        from eps_hil.report.identification_figure import figure

        return show.shown(figure(self.result))

    def report(self, path: str | Path, model_name: str = "model") -> Path:
        """Write the page of ``eps-hil identify --report``."""
        from eps_hil.report import identification_page

        identification_page.write(self.result, Path(path), model_name)
        return Path(path)

    def _rows(self) -> list[dict[str, object]]:
        return [
            {
                "parameter": name,
                "value": one.value,
                "unit": one.unit,
                "low": one.ci95[0] if one.ci95 else None,
                "high": one.ci95[1] if one.ci95 else None,
                "model_file": one.from_model,
                "status": one.status,
            }
            for name, one in {**self.result.parameters, **self.result.offsets}.items()
        ]

    def __repr__(self) -> str:
        fitted = sum(row["status"] == "identified" for row in self._rows())
        return f"<Identification from {', '.join(self.result.recordings)}: {fitted} identified>"

    def _repr_html_(self) -> str:
        return show.table(self._rows(), ", ".join(self.result.recordings))


@dataclass(frozen=True, slots=True)
class Finding:
    """One effect that a model lacks; CONTRACT 7 says what the fields are."""

    effect: str
    confidence: float
    summary: str
    equation: str
    parameters: Mapping[str, Mapping[str, Any]]
    confusable_with: tuple[str, ...]
    next_experiment: str


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What a model lacks; ``content`` is the JSON of ``eps-hil diagnose`` (CONTRACT 7)."""

    result: "given_load.Diagnosis"
    written: Model | None = None
    """The model to go on with, where it is not that of ``result``."""

    @property
    def content(self) -> Mapping[str, Any]:
        """The result as JSON-ready values."""
        return self.result.content

    @property
    def verdict(self) -> str:
        """no_mismatch, explained, partly_explained or unknown_effect."""
        return str(self.content["verdict"])

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found, the surest first."""
        return tuple(
            Finding(
                effect=one["effect"],
                confidence=one["confidence"],
                summary=one["summary"],
                equation=one.get("equation", ""),
                parameters=one.get("parameters", {}),
                confusable_with=tuple(one.get("confusable_with", ())),
                next_experiment=one.get("next_experiment") or "",
            )
            for one in self.content["findings"]
        )

    @property
    def model(self) -> Model:
        """The model with the effects added; of changes, the second state's."""
        return self.written or self.result.model

    def to_dataframe(self, library: str | None = None) -> Any:
        """One row a parameter of a finding: effect, confidence, value, unit, 95 % interval."""
        rows = self._rows()
        names = ("effect", "confidence", "parameter", "value", "unit", "low", "high", "or_else")
        return show.dataframe({name: [row[name] for row in rows] for name in names}, library)

    def plot(self) -> Any:
        """The hold-outs' figures before and after: NRMSE of torque, fit of speed, rack force."""
        from eps_hil.report import figures
        from eps_hil.report.diagnosis_page import MEASURES

        holdout = self.content["fit"]["holdout"]
        names = [n for n in MEASURES if isinstance(holdout["augmented"].get(n), float)]
        figure, axes = figures.subplots(1, max(len(names), 1), width_cm=24.0, height_cm=8.0)
        for axis, name in zip(axes[0], names, strict=False):
            values = [holdout["baseline"].get(name) or 0.0, holdout["augmented"][name]]
            axis.bar(["baseline", "augmented"], values, color=figures.COLOURS[1::-1])
            title, unit, _ = MEASURES[name]
            axis.set_title(f"{title}, {unit}".removesuffix(", "), fontsize="small")
        return show.shown(figure)

    def report(self, path: str | Path, model_name: str = "model") -> Path:
        """Write the page of ``eps-hil diagnose --report``."""
        from eps_hil.report import diagnosis_page

        diagnosis_page.write(self.result, Path(path), model_name)
        return Path(path)

    def _rows(self) -> list[dict[str, object]]:
        found: list[dict[str, object]] = []
        for one in self.findings:
            head = {"effect": one.effect, "confidence": one.confidence}
            other = ", ".join(one.confusable_with)
            for name, number in one.parameters.items() or [("", {})]:
                low, high = number.get("ci95") or (None, None)
                rest = {"value": number.get("value"), "unit": number.get("unit", "")}
                limits = {"low": low, "high": high, "or_else": other}
                found.append({**head, "parameter": name, **rest, **limits})
        return found

    def __repr__(self) -> str:
        told = [f"{one.effect} {100 * one.confidence:.0f} %" for one in self.findings]
        return f"<Diagnosis: {', '.join([self.verdict.replace('_', ' '), *told])}>"

    def _repr_html_(self) -> str:
        told = [
            {
                "effect": one.effect,
                "confidence": f"{100 * one.confidence:.0f} %",
                "what": one.summary,
                "could also be": ", ".join(one.confusable_with),
            }
            for one in self.findings
        ]
        return show.table(told, f"verdict: {self.verdict.replace('_', ' ')}")


@dataclass(frozen=True, slots=True)
class SimulatorFit:
    """Parameters of a simulator that recordings ask for; ``notes``: how it was understood."""

    result: "simulator_fit.Fitted"
    notes: tuple[str, ...]

    @property
    def content(self) -> Mapping[str, Any]:
        """The result as JSON-ready values, as ``identify --simulation --json`` writes them."""
        return self.result.content()

    @property
    def values(self) -> Mapping[str, float]:
        """Each parameter's value, as ``diagnose(simulation_values=…)`` takes them."""
        return {name: float(one["value"]) for name, one in self.result.parameters.items()}

    def to_dataframe(self, library: str | None = None) -> Any:
        """One row a parameter: value, value before, unit, 95 % interval."""
        rows = self._rows()
        return show.dataframe({name: [row[name] for row in rows] for name in rows[0]}, library)

    def _rows(self) -> list[dict[str, object]]:
        rows: list[dict[str, object]] = []
        for name, one in self.result.parameters.items():
            low, high = one["ci95"] or (None, None)
            head = {"parameter": name, "value": one["value"], "before": one["before"]}
            rows.append({**head, "unit": one["unit"], "low": low, "high": high})
        return rows

    def __repr__(self) -> str:
        told = [f"{name} = {value:.4g}" for name, value in self.values.items()]
        return f"<SimulatorFit: {', '.join(told)}>"

    def _repr_html_(self) -> str:
        return show.table(self._rows(), "parameters of the simulator")


@dataclass(frozen=True, slots=True)
class Comparison:
    """Variants of the estimator against the load cell, the full one first."""

    recording: Recording
    model: Model
    candidates: tuple[Candidate, ...]

    def to_dataframe(self, library: str | None = None) -> Any:
        """One row a variant: rms errors in N overall, moving, at rest; share of valid rows."""
        rows = summary(self.candidates)
        return show.dataframe({name: [row[name] for row in rows] for name in rows[0]}, library)

    def plot(self, path: str | Path | None = None) -> Any:
        """Rack force over time, all variants and the load cell; written where ``path`` says."""
        from eps_hil.report import comparison, comparison_figure

        cell = self.recording.series["rack_force_n"]
        begin = comparison.start_ns(self.recording.series)
        figure = comparison_figure.figure(self.candidates, cell, self.model, begin_ns=begin)
        if path is not None:
            comparison_figure.save(figure, path)
        return show.shown(figure)

    def __repr__(self) -> str:
        told = [f"{one.name} {one.score.rmse_moving_n:.1f}" for one in self.candidates]
        return f"<Comparison on {self.recording.name}, rms error moving in N: {', '.join(told)}>"

    def _repr_html_(self) -> str:
        rows = [
            {
                "estimate": one["estimate"],
                "what": one["what"],
                "moving": one["rmse_moving_n"],
                "at rest": one["rmse_resting_n"],
                "overall": one["rmse_overall_n"],
                "valid in %": 100.0 * one["valid_share"],
            }
            for one in summary(self.candidates)
        ]
        return show.table(rows, f"rms error in N, {self.recording.name}")
