"""What is wrong with a configuration, mapping, model or database: errors, warnings, notes.

An error keeps a verb from starting. A warning is what starts and is probably not meant, or may do
harm. A note says what the files will do.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from eps_hil import yaml_file
from eps_hil.bus.config import describe_ids
from eps_hil.bus.database import load_database
from eps_hil.bus.mapping import SignalMapping, load_mapping
from eps_hil.check import remarks
from eps_hil.check.remarks import Level, Remark
from eps_hil.errors import EpsHilError, InputError
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import load_model
from eps_hil.programme.limits import load_limits
from eps_hil.programme.plan import Plan
from eps_hil.recordings.foreign import load_columns, maps_columns
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.manoeuvre import load_manoeuvre
from eps_hil.rig.process import RigSimulation
from eps_hil.service.calibration import calibration_settings
from eps_hil.service.config import ServiceConfig, load_config
from eps_hil.service.override_setup import prepare_override
from eps_hil.service.setup import prepare


class Kind(StrEnum):
    """Files that can be checked; the names are those of their schemas, and ``database``."""

    CONFIG = "config"
    MODEL = "model"
    CHAIN = "chain"
    SIGNALS = "signals"
    MANOEUVRE = "manoeuvre"
    PROGRAMME = "programme"
    DATABASE = "database"


@dataclass(frozen=True, slots=True)
class Checked:
    """A file, what it was taken for, and what is to say about it, errors first."""

    path: Path
    kind: Kind
    remarks: tuple[Remark, ...]

    @property
    def good(self) -> bool:
        """Whether there is no error."""
        return all(one.level is not Level.ERROR for one in self.remarks)


_BLOCKS = (Kind.CHAIN, Kind.MANOEUVRE, Kind.PROGRAMME)
DATABASES = {".dbc", ".arxml", ".kcd", ".sym"}


def kind_of(path: Path) -> Kind:
    """What a file is, by its suffix and its top-level blocks; :class:`InputError` if nothing."""
    if path.suffix.lower() in DATABASES:
        return Kind.DATABASE
    content = yaml_file.read(path)
    keys = set(content) if isinstance(content, dict) else set()
    if "bus" in keys or {"dbc", "signals"} <= keys:
        return Kind.CONFIG
    for kind in _BLOCKS:
        if kind.value in keys:
            return kind
    if "signals" in keys:
        return Kind.SIGNALS
    if "model" in keys:
        return Kind.MODEL
    known = ", ".join((*(one.value for one in _BLOCKS), "bus", "model", "signals"))
    raise InputError(path, "", "is none of our files", f"it needs one of the blocks {known}")


def check(path: Path) -> Checked:
    """Check one file with all files that it names; :class:`InputError` if it is no such file."""
    kind = kind_of(path)
    found = list(_CHECKS[kind](path))
    order = list(Level)
    return Checked(path, kind, tuple(sorted(found, key=lambda one: order.index(one.level))))


def _tried(job: Callable[[], Any]) -> tuple[Any, list[Remark]]:
    """What a job returns, and its refusal as an error."""
    try:
        return job(), []
    except InputError as error:
        place = f"{error.file}: {error.place}" if error.place else error.file
        return None, [Remark(Level.ERROR, place, error.problem, error.remedy)]
    except (EpsHilError, ValueError) as error:
        return None, [Remark(Level.ERROR, "", str(error))]


def _config(path: Path) -> Iterator[Remark]:
    config, problems = _tried(lambda: load_config(path))
    yield from problems
    if config is None:
        return
    mapping, problems = _tried(lambda: load_mapping(config.signals))
    yield from problems
    model, more = _tried(lambda: load_model(config.model))
    yield from more
    if mapping is None or model is None:
        return
    yield from remarks.of_model(config.model, model)
    database, problems = _tried(lambda: load_database(config.dbc, strict=mapping.strict))
    yield from problems
    if database is None:
        return
    yield from remarks.of_mapping(config.signals, mapping, database, model)
    parts, problems = _tried(lambda: prepare(config, path))
    yield from problems
    if parts is not None:
        heard, sent = parts.decoder.receive_ids, parts.send_ids
        yield Remark(Level.NOTE, "", f"listens to {describe_ids(sorted(heard))}")
        yield Remark(Level.NOTE, "", f"sends {describe_ids(sorted(sent))}")
        rate = 1.0 / parts.sync_period_s
        yield Remark(Level.NOTE, "", f"one estimate a {mapping.sync_message}: {rate:.0f} a second")
    yield from remarks.of_bus(path, config)
    yield from _blocks(path, config)


def _blocks(path: Path, config: ServiceConfig) -> Iterator[Remark]:
    """Blocks of single verbs, by the code that will read them."""
    if config.rig is not None:
        yield from _tried(lambda: RigSimulation(load_rig_setup(path)))[1]
    if config.investigate is not None:
        yield from _tried(lambda: load_limits(path))[1]
    if config.calibration is not None:
        yield from _tried(lambda: calibration_settings(config, path))[1]
    if config.override is not None:
        yield from _tried(lambda: prepare_override(config, path))[1]
        yield from remarks.of_override(path, config)


def _model(path: Path) -> Iterator[Remark]:
    model, problems = _tried(lambda: load_model(path, rig=True))
    yield from problems
    if model is not None:
        yield from remarks.of_model(path, model)


def _signals(path: Path) -> Iterator[Remark]:
    mapping: SignalMapping | None
    of_table, problems = _tried(lambda: maps_columns(path))
    if of_table:
        _, problems = _tried(lambda: load_columns(path))
    yield from problems
    if of_table is False:
        mapping = load_mapping(path)
        yield from remarks.of_signals(path, mapping)


def _programme(path: Path) -> Iterator[Remark]:
    yield from _tried(lambda: yaml_file.load(path, Plan, section="programme"))[1]
    yield Remark(Level.NOTE, "", "its travel is checked with a model, by `eps-hil programme`")


def _database(path: Path) -> Iterator[Remark]:
    database, problems = _tried(lambda: load_database([path]))
    yield from problems
    if database is not None:
        yield from remarks.of_database(path, database)


_CHECKS: dict[Kind, Callable[[Path], Iterator[Remark]]] = {
    Kind.CONFIG: _config,
    Kind.MODEL: _model,
    Kind.CHAIN: lambda path: iter(_tried(lambda: load_chain(path))[1]),
    Kind.SIGNALS: _signals,
    Kind.MANOEUVRE: lambda path: iter(_tried(lambda: load_manoeuvre(path))[1]),
    Kind.PROGRAMME: _programme,
    Kind.DATABASE: _database,
}
