"""What an identification found: numbers with intervals, map, findings, and the model they make."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from eps_hil.identification.finding import Finding, Unknown
from eps_hil.identification.friction_map import FrictionMap
from eps_hil.physics.model import Model

SCHEMA = "eps-hil/identification/1"


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter: value, 95 % interval (None where not identified), what the file said.

    ``status`` is "identified", "held" (the reference of the delays) or "kept": these recordings
    cannot tell, so the model file's value stays; ``note`` says why, or what it depends on.
    """

    value: float
    unit: str
    ci95: tuple[float, float] | None
    from_model: float | None
    status: str
    note: str = ""

    def content(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "value": self.value,
            "unit": self.unit,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "from_model": self.from_model,
            "status": self.status,
            **({"note": self.note} if self.note else {}),
        }


@dataclass(frozen=True)
class Identification:
    """The result; ``parameters`` by the name in the model file's tree ("friction.offset_pos_nm").

    ``skews_s`` are differences of delays (motor speed less the signal), which is what recordings
    show; ``residual_nm`` and ``floor_nm`` are rms of the balance while sliding, and of the part
    of it that sensor noise explains. ``motor_lag`` is the part of the motor torque's delay that is
    a first-order lag, where the recordings show one.
    """

    model: Model
    parameters: Mapping[str, Estimate]
    skews_s: Mapping[str, Estimate]
    delay_reference: str
    offsets: Mapping[str, Estimate]
    loads: Mapping[str, Mapping[str, Any]]
    map: FrictionMap
    findings: tuple[Finding, ...]
    cannot_tell: tuple[Unknown, ...]
    motor_lag: Estimate | None
    recordings: tuple[str, ...]
    seconds: float
    residual_nm: float
    floor_nm: float
    presliding_misfit: float | None

    def not_identified(self) -> dict[str, str]:
        """Parameters that keep the model file's values, and why."""
        return {
            name: one.note
            for name, one in {**self.parameters, **self.offsets}.items()
            if one.status == "kept"
        }

    def content(self) -> dict[str, Any]:
        """JSON-ready; parameters nested as in the model file."""
        tree: dict[str, Any] = {}
        for name, one in self.parameters.items():
            group, _, key = name.rpartition(".")
            (tree.setdefault(group, {}) if group else tree)[key] = one.content()
        found = self.map.content()
        return {
            "schema": SCHEMA,
            "recordings": list(self.recordings),
            "seconds": self.seconds,
            "parameters": tree,
            "skews_s": {name: one.content() for name, one in self.skews_s.items()},
            "delay_reference": self.delay_reference,
            "offsets": {name: one.content() for name, one in self.offsets.items()},
            "loads": {name: dict(one) for name, one in self.loads.items()},
            "friction_map": found["cells"],
            "coverage": found["coverage"],
            "not_identified": [
                {"parameter": name, "why": why} for name, why in self.not_identified().items()
            ],
            "cannot_tell": [one.content() for one in self.cannot_tell],
            "motor_lag_s": None if self.motor_lag is None else self.motor_lag.content(),
            "findings": [one.content() for one in self.findings],
            "fit": {
                "residual_rms_nm": self.residual_nm,
                "sensor_noise_rms_nm": self.floor_nm,
                "presliding_misfit_of_level": self.presliding_misfit,
            },
        }
