"""A CAN log of the simulated rig without a bus or a clock, with all files that reading it takes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from eps_hil.bus.record import open_log
from eps_hil.examples import shelf
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.process import RigSimulation

_START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True, slots=True)
class LoggedRun:
    """A log in candump's format, and the reference rig's database, mapping and model file."""

    log: Path
    dbc: Path
    signals: Path
    model: Path


def write_log(
    folder: str | Path,
    *,
    effects: Sequence[Mapping[str, Any]] = (),
    manoeuvre: str = "demo",
    order: int = 2,
) -> LoggedRun:
    """One round of a manoeuvre as a recorder would have it; files go below ``folder``.

    ``effects``: entries of a model file that the rig has and the model file there does not.
    """
    config = shelf.copy("demo_udp", Path(folder))[0].path
    setup = load_rig_setup(config, manoeuvre)
    rig = replace(setup.rig, order=order)
    simulation = RigSimulation(
        replace(setup, rig=rig, model=replace(setup.model, effects=tuple(effects)))
    )
    log = Path(folder) / "bus.log"
    file = open_log(log, "can0", overwrite=True)
    for ms in range(simulation.rows):
        stamp_ns = _START_NS + ms * 1_000_000
        file.write([replace(one, t_ns=stamp_ns) for one in simulation.step(ms * 1_000_000)])
    file.close()
    return LoggedRun(
        log,
        config.parent.parent / "dbc" / "eps_rig.dbc",
        config.parent / "eps_rig_signals.yaml",
        config.parent / "reference_rig.yaml",
    )
