"""By what a folder of results knows the rig that they were taken with."""

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from eps_hil import json_text, yaml_file
from eps_hil.bus.config import BusSetup
from eps_hil.errors import InputError
from eps_hil.physics.model import Model, dump_model


def fingerprint(setup: BusSetup, model: Model) -> str:
    """One number of model, databases, mapping and bus: another one, and results do not mix.

    Comments in model and mapping, and whether a lost bus is opened again, do not count.
    """
    told = hashlib.sha256(dump_model(model).encode())
    for path in setup.dbc:
        told.update(path.read_bytes())
    told.update(repr(yaml_file.read(setup.signals)).encode())
    told.update(repr(replace(setup.bus, reconnect=True)).encode())
    return told.hexdigest()


def check_same(file: Path, head: Mapping[str, Any], other: str, rig: str) -> None:
    """:class:`InputError` where a folder's ``file`` does not say what the work's ``head`` says.

    ``head["rig"]`` is a fingerprint, of what ``rig`` names. ``other``: how work was made of which
    the rest differs.
    """
    found = read_json(file)
    before = found.pop("rig", None)
    if found != {key: value for key, value in head.items() if key != "rig"}:
        problem = f"was made {other}"
    elif before is None:
        problem = f"does not say with which {rig} (an earlier version's)"
    elif before != head["rig"]:
        problem = f"was made with another {rig}"
    else:
        return
    raise InputError(file, "", problem, "use another folder")


def read_json(path: Path) -> dict[str, Any]:
    """A file of a folder of results; :class:`InputError` where it is none."""
    try:
        return dict(json_text.parse(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise InputError(path, "", f"cannot be read: {error}", "use another folder") from None
