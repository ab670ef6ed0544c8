"""Golden replays: what the service made of a log once, kept, and compared with what it makes now.

A change of code, model or configuration that moves an estimate shows as a row of a table, with the
first and the worst place in seconds. The log goes through the service's own core, as it would live;
core and estimator know no clock, so on one machine nothing at all differs without such a change.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.bus.replay import read_log
from eps_hil.errors import InputError
from eps_hil.estimation.stream import Estimate
from eps_hil.service.config import ServiceConfig, load_config
from eps_hil.service.setup import prepare

SIGNALS = ("rack_force_estimate_n", "friction_torque_nm", "estimate_age_s")
REASON_ROWS = "reason_rows"
DEFAULT_TOLERANCES: Mapping[str, float] = {
    "rack_force_estimate_n": 0.01,
    "friction_torque_nm": 1e-5,
    "estimate_age_s": 1e-6,
    REASON_ROWS: 0.0,
}
"""By signal, in its unit: other processors round differently, and nothing else may. The last: how
many rows may differ in validity or reason, or be missing on either side."""

Int64 = npt.NDArray[np.int64]
Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Estimates:
    """All shape (n,): the stamp of the sync frame that each estimate answers, the values, and the
    reason bits. ``estimate_age_s``: how long before that stamp the instant lies that it speaks of.
    """

    t_ns: Int64
    values: Mapping[str, Float64]
    reason: Int64

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """Where the values count."""
        return np.equal(self.reason, 0)


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a golden comes from. Paths as given when it was made; hashes are SHA-256.

    ``files``: hash by role (``log``, ``configuration``, ``model``, ``signals``, ``dbc 1``...).
    ``own_frames``: frames of the log under the service's own ids, which were left out.
    """

    log: str
    config: str
    files: Mapping[str, str]
    version: str
    made: str
    own_frames: int


def run_core(
    log: Path, config: ServiceConfig, config_file: Path, channel: str | None = None
) -> tuple[Estimates, int]:
    """Every estimate of a service with this log on its bus, and how many frames were its own.

    A log that was recorded beside a service holds what that one published; another transmitter of
    those ids would make every estimate invalid, so they are left out.
    """
    parts = prepare(config, config_file)
    parts.estimator.warm_up()
    core, ours = parts.core, frozenset(parts.send_ids)
    steps: list[tuple[int, Estimate]] = []
    core.record = steps
    own = 0
    for frame in read_log(log, channel):
        if frame.can_id in ours:
            own += 1
        else:
            core.on_frames([frame])
    return _table(steps), own


def _table(steps: Sequence[tuple[int, Estimate]]) -> Estimates:
    values = {
        "rack_force_estimate_n": [row.rack_force_n for _, row in steps],
        "friction_torque_nm": [row.friction_torque_nm for _, row in steps],
        "estimate_age_s": [(sync_ns - row.t_ns) * 1e-9 for sync_ns, row in steps],
    }
    return Estimates(
        np.array([sync_ns for sync_ns, _ in steps], dtype=np.int64),
        {name: np.array(column, dtype=np.float64) for name, column in values.items()},
        np.array([int(row.reason) for _, row in steps], dtype=np.int64),
    )


def hashes(log: Path, config: ServiceConfig, config_file: Path) -> dict[str, str]:
    """SHA-256 of everything that an estimate depends on, but the code."""
    files = {
        "log": log,
        "configuration": config_file,
        "model": config.model,
        "signals": config.signals,
    } | {f"dbc {number}": path for number, path in enumerate(config.dbc, 1)}
    return {role: _sha256(path) for role, path in files.items()}


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:  # a log may be larger than the memory
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        problem = f"cannot be read: {error.strerror}"
        raise InputError(path, "", problem, "check the path") from None


def code_version() -> str:
    """Of the installed package."""
    try:
        return version("eps_hil")
    except PackageNotFoundError:
        return "unknown"


def load_pair(log: Path, config_file: Path) -> ServiceConfig:
    """The configuration; :class:`InputError` where log or configuration is not there."""
    if not log.is_file():
        raise InputError(log, "", "no such file", "name the log with --log")
    if not config_file.is_file():
        raise InputError(config_file, "", "no such file", "name it with --config")
    return load_config(config_file)


@dataclass(frozen=True, slots=True)
class SignalDiff:
    """One signal over the rows that are valid on both sides; times in s since the first row.

    ``first_s``: first row beyond the tolerance, with both values; None: there is none.
    """

    signal: str
    tolerance: float
    rows: int
    beyond: int
    first_s: float | None
    first: tuple[float, float] | None
    worst_s: float
    worst: float
    rms: float

    @property
    def good(self) -> bool:
        """Within tolerance."""
        return not self.beyond


@dataclass(frozen=True, slots=True)
class ReasonDiff:
    """Rows whose reason differs, and rows that only one side has."""

    tolerance: float
    differ: int
    only_golden: int
    only_now: int
    first_s: float | None
    first: tuple[int, int] | None

    @property
    def good(self) -> bool:
        """Within tolerance."""
        return self.differ + self.only_golden + self.only_now <= self.tolerance


@dataclass(frozen=True, slots=True)
class Diff:
    """A golden beside what is estimated now. ``both_valid``: rows that the values rest on."""

    rows: int
    both_valid: int
    signals: Sequence[SignalDiff]
    reason: ReasonDiff

    @property
    def good(self) -> bool:
        """Everything within tolerance, and something was compared at all."""
        return self.both_valid > 0 and self.reason.good and all(one.good for one in self.signals)


def compare(golden: Estimates, now: Estimates, tolerances: Mapping[str, float]) -> Diff:
    """Row by row at equal sync frames; values only where both are valid."""
    left, right = common_rows(golden, now)
    since_s = (golden.t_ns[left] - golden.t_ns[0]) * 1e-9 if left.size else np.zeros(0)
    both = golden.valid[left] & now.valid[right]
    signals = [
        _signal(name, tolerances[name], since_s[both], golden.values[name][left][both],
                now.values[name][right][both])
        for name in SIGNALS
    ]  # fmt: skip
    was, is_now = golden.reason[left], now.reason[right]
    other = np.flatnonzero(was != is_now)
    at = int(other[0]) if other.size else None
    reason = ReasonDiff(
        tolerance=tolerances[REASON_ROWS],
        differ=int(other.size),
        only_golden=int(golden.t_ns.size - left.size),
        only_now=int(now.t_ns.size - right.size),
        first_s=None if at is None else float(since_s[at]),
        first=None if at is None else (int(was[at]), int(is_now[at])),
    )
    return Diff(int(golden.t_ns.size), int(both.sum()), signals, reason)


def common_rows(golden: Estimates, now: Estimates) -> tuple[Int64, Int64]:
    """Indices of the rows with equal stamps on both sides."""
    if np.array_equal(golden.t_ns, now.t_ns):  # also where a stamp came twice
        every = np.arange(golden.t_ns.size, dtype=np.int64)
        return every, every
    _, left, right = np.intersect1d(golden.t_ns, now.t_ns, return_indices=True)
    return left, right


def _signal(
    name: str, tolerance: float, since_s: Float64, golden: Float64, now: Float64
) -> SignalDiff:
    # A value that is no number on one side only is as far off as can be
    odd = np.isnan(golden) != np.isnan(now)
    error = np.where(odd, np.inf, np.nan_to_num(np.abs(now - golden), nan=0.0))
    beyond = np.flatnonzero(error > tolerance)
    at = int(beyond[0]) if beyond.size else None
    worst = int(np.argmax(error)) if error.size else 0
    finite = error[np.isfinite(error)]
    return SignalDiff(
        signal=name,
        tolerance=tolerance,
        rows=int(error.size),
        beyond=int(beyond.size),
        first_s=None if at is None else float(since_s[at]),
        first=None if at is None else (float(golden[at]), float(now[at])),
        worst_s=float(since_s[worst]) if error.size else 0.0,
        worst=float(error[worst]) if error.size else 0.0,
        rms=float(np.sqrt(np.mean(finite**2))) if finite.size else 0.0,
    )


def parse_tolerances(words: Sequence[str], before: Mapping[str, float]) -> dict[str, float]:
    """``rack_force_estimate_n=5`` and the like over ``before``; :class:`InputError` for others."""
    found = dict(before)
    for word in words:
        name, equals, value = word.partition("=")
        if name not in DEFAULT_TOLERANCES or not equals:
            known = ", ".join(DEFAULT_TOLERANCES)
            raise InputError("--tolerance", word, "is not NAME=VALUE", f"NAME is one of {known}")
        try:
            number = float(value)
        except ValueError:
            number = -1.0
        if not 0.0 <= number < float("inf"):
            raise InputError("--tolerance", word, "is not a number of 0 or more", "in the unit")
        found[name] = number
    return found
