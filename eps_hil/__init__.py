"""Hardware-in-the-loop service for electric power steering (EPS) over CAN.

The few names that a program or notebook needs (docs/howto-python.md):

    import eps_hil

    drive = eps_hil.load("bus.log", dbc="eps_rig.dbc", signals="eps_rig_signals.yaml")
    found = eps_hil.diagnose(drive, "reference_rig.yaml")

Importing the package is free: a name is imported when it is first used.
"""

from typing import TYPE_CHECKING, Any

from eps_hil.version import VERSION as __version__

if TYPE_CHECKING:
    from eps_hil.api.jobs import (
        changes,
        compare,
        diagnose,
        estimate,
        fit_simulator,
        identify,
        load,
        recording,
        simulate,
    )
    from eps_hil.api.recording import Recording
    from eps_hil.api.results import (
        Comparison,
        Diagnosis,
        Estimate,
        Identification,
        Simulation,
        SimulatorFit,
    )
    from eps_hil.errors import EpsHilError, InputError
    from eps_hil.physics.model import Model

_PLACES = {
    "eps_hil.api.jobs": (
        "changes",
        "compare",
        "diagnose",
        "estimate",
        "fit_simulator",
        "identify",
        "load",
        "recording",
        "simulate",
    ),
    "eps_hil.api.recording": ("Recording",),
    "eps_hil.api.results": (
        "Comparison",
        "Diagnosis",
        "Estimate",
        "Identification",
        "Simulation",
        "SimulatorFit",
    ),
    "eps_hil.errors": ("EpsHilError", "InputError"),
    "eps_hil.physics.model": ("Model",),
}
_NAMES = {name: module for module, names in _PLACES.items() for name in names}

__all__ = [
    "Comparison",
    "Diagnosis",
    "EpsHilError",
    "Estimate",
    "Identification",
    "InputError",
    "Model",
    "Recording",
    "Simulation",
    "SimulatorFit",
    "__version__",
    "changes",
    "compare",
    "diagnose",
    "estimate",
    "fit_simulator",
    "identify",
    "load",
    "recording",
    "simulate",
]


def __getattr__(name: str) -> Any:
    if name not in _NAMES:
        raise AttributeError(f"module 'eps_hil' has no attribute '{name}'")
    from importlib import import_module

    found = getattr(import_module(_NAMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
