"""A recording that a program holds: canonical signals, as a table, as a figure."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.api import show
from eps_hil.errors import InputError
from eps_hil.recordings import recording as plain
from eps_hil.series import usual_step_ns
from eps_hil.signals import CANONICAL

_FIRST = ("motor_speed_rad_s", "motor_torque_nm", "torque_sensor_nm", "rack_force_n")


@dataclass(frozen=True, slots=True)
class Recording(plain.Recording):
    """Canonical signals of one file (``eps_hil.load``); ``series[name]`` has ``t_ns``, ``value``.

    ``notes``: what the reader had to leave out or mend. Of arrays: ``eps_hil.recording``.
    """

    def __post_init__(self) -> None:
        """:class:`InputError` for signals that no reader would make."""
        for name, one in self.series.items():
            if not len(one.t_ns):
                raise InputError(self.name, name, "holds no sample", "leave it out")
            if one.t_ns.dtype != np.int64 or one.value.dtype != np.float64:
                kinds = f"stamps of {one.t_ns.dtype} and values of {one.value.dtype}"
                raise InputError(self.name, name, f"has {kinds}", "int64 (ns) and float64")
            if len(one.t_ns) > 1 and not bool((one.t_ns[1:] > one.t_ns[:-1]).all()):
                raise InputError(self.name, name, "has stamps that do not increase", "sort them")
        if not self.series:
            raise InputError(self.name, "", "holds no signal", "give at least one")

    @property
    def start_ns(self) -> int:
        """The first stamp of any signal."""
        return min(int(one.t_ns[0]) for one in self.series.values())

    def to_dataframe(self, library: str | None = None) -> Any:
        """Every sample: ``time_s`` and a column a signal, NaN where it has no sample.

        ``library``: "pandas" or "polars"; None: whichever is installed.
        """
        from eps_hil.recordings.table import from_series

        t_ns, columns = from_series(self.series)
        return show.dataframe({"time_s": t_ns * 1e-9, **columns}, library)

    def save(self, path: str | Path) -> Path:
        """Write it as CSV, Parquet, MF4 or MCAP, by the suffix."""
        from eps_hil.recordings.write import write_series

        write_series(path, self.series, source=self.name)
        return Path(path)

    def plot(self, signals: Sequence[str] = ()) -> Any:
        """A matplotlib figure, one panel a signal (default: what an estimate is made of)."""
        from eps_hil.report import figures
        from eps_hil.report.diagnosis_evidence import label

        chosen = list(signals) or [name for name in _FIRST if name in self.series]
        for name in chosen:
            if name not in self.series:
                there = ", ".join(sorted(self.series))
                raise InputError(self.name, name, "is not recorded", f"it holds {there}")
        count = len(chosen)
        figure, axes = figures.subplots(count, 1, width_cm=25.0, height_cm=2.0 + 4.0 * count)
        for axis, name in zip(axes[:, 0], chosen, strict=True):
            one = self.series[name]
            axis.plot(
                (one.t_ns - self.start_ns) * 1e-9, one.value, color=figures.COLOURS[0], lw=0.8
            )
            axis.set_ylabel(label(name), fontsize="small")
        axes[-1, 0].set_xlabel("time in s")
        return show.shown(figure)

    def __repr__(self) -> str:
        end_ns = max(int(one.t_ns[-1]) for one in self.series.values())
        seconds = (end_ns - self.start_ns) * 1e-9
        return f"<Recording {self.name}: {len(self.series)} signals, {seconds:.1f} s>"

    def _repr_html_(self) -> str:
        rows = [
            {
                "signal": name,
                "unit": CANONICAL[name].unit if name in CANONICAL else "",
                "samples": len(one.t_ns),
                "rate in Hz": round(1e9 / usual_step_ns(one.t_ns), 3)
                if len(one.t_ns) > 1
                else None,
                "from s": (int(one.t_ns[0]) - self.start_ns) * 1e-9,
                "to s": (int(one.t_ns[-1]) - self.start_ns) * 1e-9,
            }
            for name, one in self.series.items()
        ]
        return show.table(rows, self.name) + "".join(
            f"<p>{escape(note)}</p>" for note in self.notes
        )
