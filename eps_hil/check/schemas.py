"""JSON schemas of the YAML files, for editors that complete and check while typing."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from eps_hil.bus.mapping import SignalMapping
from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Effect
from eps_hil.physics.model import Model
from eps_hil.programme.limits import Limits
from eps_hil.programme.plan import Plan
from eps_hil.recordings.foreign import Columns
from eps_hil.rig.config import RigConfig
from eps_hil.rig.manoeuvre import Manoeuvre
from eps_hil.service.config import config_schema

Schema = dict[str, Any]
DIALECT = "https://json-schema.org/draft/2020-12/schema"


def _config() -> Schema:
    """The whole configuration; the blocks of single verbs are described where they are known."""
    schema = config_schema()
    rig = TypeAdapter(RigConfig).json_schema()
    schema.setdefault("$defs", {}).update(rig.pop("$defs", {}))
    schema["$defs"]["RigConfig"] = rig
    schema["$defs"]["InvestigateLimits"] = TypeAdapter(Limits).json_schema()
    for name, kind in (("rig", "RigConfig"), ("investigate", "InvestigateLimits")):
        schema["properties"][name] = {"anyOf": [{"$ref": f"#/$defs/{kind}"}, {"type": "null"}]}
    return schema


def block(name: str, kind: Any) -> Callable[[], Schema]:
    """A file with one top-level block; other blocks may stand beside it."""

    def made() -> Schema:
        inner = TypeAdapter(kind).json_schema()
        definitions = inner.pop("$defs", {})
        whole: Schema = {"type": "object", "properties": {name: inner}, "required": [name]}
        return {**whole, "$defs": definitions} if definitions else whole

    return made


def _model() -> Schema:
    schema = block("model", Model)()
    entry = {"anyOf": [_effect(one) for one in catalogue().values()]}
    schema["properties"]["model"]["properties"]["effects"] = {"type": "array", "items": entry}
    return schema


def _effect(effect: Effect) -> Schema:
    plain = effect.read is None
    properties: Schema = {"effect": {"const": effect.id, "description": effect.equation}}
    for one in effect.parameters:
        described = {"description": f"{one.meaning} ({one.unit})"}
        number = plain and one.name != "curve"
        low, high = one.domain
        bounds: Schema = {"type": "number", "minimum": low, "maximum": high} if number else {}
        properties[one.name] = {**bounds, **described}
    needed = [one.name for one in effect.parameters if plain and one.default is None]
    closed: Schema = {"additionalProperties": False} if plain else {}
    return {"type": "object", "properties": properties, "required": ["effect", *needed], **closed}


def _signals() -> Schema:
    """A mapping of a DBC's signals, or of a table's columns."""
    kinds = {"SignalMapping": SignalMapping, "Columns": Columns}
    definitions: Schema = {}
    for name, kind in kinds.items():
        one = TypeAdapter(kind).json_schema()
        definitions |= one.pop("$defs", {})
        definitions[name] = one
    return {
        "type": "object",
        "anyOf": [{"$ref": f"#/$defs/{name}"} for name in kinds],
        "properties": {"signals": {"type": "object"}},
        "required": ["signals"],
        "$defs": definitions,
    }


SCHEMAS: Mapping[str, Callable[[], Schema]] = {
    "config": _config,
    "model": _model,
    "chain": block("chain", ChainParameters),
    "signals": _signals,
    "manoeuvre": block("manoeuvre", Manoeuvre),
    "programme": block("programme", Plan),
}
"""By kind of file."""


def schema(kind: str) -> Schema:
    """The schema of one kind of file."""
    return titled(kind, SCHEMAS[kind]())


def titled(kind: str, content: Schema) -> Schema:
    """A kind's schema as it is printed."""
    whole = {"$schema": DIALECT, "title": f"eps_hil {kind} file", **content}
    return dict(_portable(whole))


def _portable(part: Any) -> Any:
    """Without the defaults that are files of this machine: those that come with the package."""
    if isinstance(part, list):
        return [_portable(one) for one in part]
    if not isinstance(part, dict):
        return part
    local = isinstance(part.get("default"), str) and Path(part["default"]).is_absolute()
    return {k: _portable(v) for k, v in part.items() if not (local and k == "default")}
