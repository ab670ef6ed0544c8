"""The part of a configuration file that every process on the bus shares.

The service and the simulated rig are processes of their own and read one file; what they must
agree on (which bus, which database, which mapping, which model) is declared here, once. Paths in
the file are relative to the file, so that a configuration can be started from any folder.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, ConfigDict, Field, with_config

from eps_hil import yaml_file
from eps_hil.errors import InputError

NAME = Annotated[str, Field(min_length=1)]


def _as_list(value: object) -> object:
    """One file may be written without the list around it."""
    return [value] if isinstance(value, str) else value


PathList = Annotated[
    tuple[Path, ...],
    BeforeValidator(_as_list, json_schema_input_type=tuple[Path, ...] | Path),
    Field(min_length=1),
]


@with_config(ConfigDict(extra="forbid", coerce_numbers_to_str=True))
@dataclass(frozen=True, slots=True)
class BusConfig:
    """Which CAN channel to open, and how.

    ``interface``: ``socketcan`` or any python-can interface; ``channel``: its channel (``vcan0``,
    a multicast address, a number); ``fd``: CAN FD frames allowed; ``options``: passed to the
    interface as they are; ``reconnect``: wait and open the channel again when the bus is lost
    (a rig gets power-cycled); ``false`` ends instead.
    """

    interface: NAME
    channel: NAME
    fd: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)
    reconnect: bool = True

    def __str__(self) -> str:
        return f"{self.interface} {self.channel}{' (CAN FD)' if self.fd else ''}"


@with_config(ConfigDict(extra="ignore"))
@dataclass(frozen=True, slots=True, kw_only=True)
class BusSetup:
    """The shared head of a configuration file; blocks of single processes stand beside it.

    ``dbc``: one or several databases, read as one; ``signals``: the mapping of CONTRACT 5;
    ``model``: the model file of CONTRACT 4.
    """

    bus: BusConfig
    dbc: PathList
    signals: Path
    model: Path


Setup = TypeVar("Setup", bound=BusSetup)


def load_bus_setup(path: str | Path) -> BusSetup:
    """The shared head of the file; every other block is left to the process that owns it."""
    return load_as(path, BusSetup)


def load_as(path: str | Path, kind: type[Setup]) -> Setup:
    """Read the file as ``kind`` (a :class:`BusSetup`), its paths made absolute.

    :class:`InputError` names line and field of a mistake, and a file that does not exist.
    """
    setup = yaml_file.load(path, kind)
    folder = Path(path).resolve().parent
    return replace(
        setup,
        dbc=tuple(_existing(path, folder, f"dbc.{i}", dbc) for i, dbc in enumerate(setup.dbc)),
        signals=_existing(path, folder, "signals", setup.signals),
        model=_existing(path, folder, "model", setup.model),
    )


def resolved(config: str | Path, given: str | Path) -> Path:
    """``given`` as an absolute path, read relative to the folder of the configuration file."""
    return (Path(config).resolve().parent / Path(given).expanduser()).resolve()


def block(path: str | Path, name: str) -> Mapping[str, Any]:
    """One top-level block of the file as plain values; empty when it is absent or blank."""
    content = yaml_file.read(path)
    found = content.get(name) if isinstance(content, dict) else None
    if found is None:
        return {}
    if not isinstance(found, dict):
        raise InputError(path, name, "must be a block of 'key: value' lines", "correct the block")
    return found


def _existing(config: str | Path, folder: Path, place: str, given: Path) -> Path:
    whole = resolved(folder / "x", given)
    if not whole.is_file():
        raise InputError(
            config, place, f"no such file: {whole}", "paths are relative to the configuration file"
        )
    return whole


def describe_ids(ids: Sequence[int]) -> str:
    """Ids in the notation of the trade, ``0x101, 0x102``; ``none`` for an empty list."""
    return ", ".join(f"0x{can_id:X}" for can_id in ids) or "none"
