"""What the monitor shows at one instant: plain frozen values, for the screen and for scripts."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from eps_hil.monitor.alarm import Limits
from eps_hil.monitor.residual import Residual


@dataclass(frozen=True, slots=True)
class SignalFigures:
    """One mapped signal; ``verdict`` is the monitor's own (:mod:`eps_hil.monitor.meters`),
    ``service`` the service's, from the bus (empty where it says none).
    """

    name: str
    unit: str
    value: float
    age_s: float
    rate_hz: float
    verdict: str
    bad: int
    service: str = ""


@dataclass(frozen=True, slots=True)
class EstimateFigures:
    """The newest published estimate; ``status`` "silent" where none comes any more."""

    status: str
    reasons: str
    rack_force_n: float
    friction_torque_nm: float
    age_ms: float
    rate_hz: float
    load_cell_n: float


@dataclass(frozen=True, slots=True)
class BusFigures:
    """``load`` None: the bit rate is not known. ``lost``: by counters, and in the kernel here."""

    name: str
    state: str
    frames_per_s: float
    kbit_per_s: float
    load: float | None
    lost_by_counter: int
    lost_in_kernel: int
    crc_errors: int
    error_frames: int


@dataclass(frozen=True, slots=True)
class Figures:
    """Everything. ``told``: newest signals of the service's and the ECU's other messages.

    ``parted``: residuals whose alarm is on; ``pending``: beyond their limit, not for long yet.
    """

    t_ns: int
    bus: BusFigures
    signals: tuple[SignalFigures, ...]
    estimate: EstimateFigures
    residual: Residual
    limits: Limits
    parted: tuple[str, ...]
    pending: tuple[str, ...]
    told: Mapping[str, Mapping[str, Any]]

    def as_json(self) -> dict[str, Any]:
        """Plain values under the schema's name; a number that does not exist is null."""
        plain: dict[str, Any] = _plain(asdict(self))
        return {"schema": "eps-hil/monitor/1", **plain}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
