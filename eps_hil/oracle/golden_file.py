"""The file of a golden replay: a line of provenance in JSON, then a table, in plain text.

    # eps-hil/golden/1 {"log": "drive.log", ...}
    t_ns,rack_force_estimate_n,friction_torque_nm,estimate_age_s,reason

Numbers are written so that they are read back bit for bit; ``.gz`` at the end of the name packs it.
"""

import gzip
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from eps_hil import json_text
from eps_hil.errors import InputError
from eps_hil.oracle.golden import DEFAULT_TOLERANCES, SIGNALS, Estimates, Provenance
from eps_hil.recordings.files import read_bytes, replacing

SCHEMA = "eps-hil/golden/1"
_COLUMNS = ("t_ns", *SIGNALS, "reason")
_TYPES = [("t_ns", "i8"), *((name, "f8") for name in SIGNALS), ("reason", "i8")]


@dataclass(frozen=True, slots=True)
class Golden:
    """A stored golden; ``tolerances`` by signal, in its unit."""

    provenance: Provenance
    tolerances: Mapping[str, float]
    estimates: Estimates


def write_golden(path: Path, golden: Golden) -> None:
    """Whole or not at all."""
    head = asdict(golden.provenance) | {"tolerances": dict(golden.tolerances)}
    kept = golden.estimates
    columns = [kept.t_ns.tolist(), *(kept.values[name].tolist() for name in SIGNALS)]
    rows = zip(*columns, kept.reason.tolist(), strict=True)
    text = f"# {SCHEMA} {json.dumps(head)}\n{','.join(_COLUMNS)}\n"
    text += "".join(f"{','.join(map(repr, row))}\n" for row in rows)
    content = text.encode("utf-8")
    with replacing(path) as temporary:
        temporary.write_bytes(gzip.compress(content, 6, mtime=0) if _packed(path) else content)


def read_golden(path: Path) -> Golden:
    """:class:`InputError` names the line of whatever is wrong."""
    content = read_bytes(path)
    try:
        text = (gzip.decompress(content) if _packed(path) else content).decode("utf-8")
    except (OSError, EOFError, ValueError) as error:
        raise InputError(path, "", f"is damaged: {error}", "make it again") from None
    first, _, rest = text.partition("\n")
    names, _, table = rest.partition("\n")
    if not first.startswith(f"# {SCHEMA} "):
        problem = f"does not begin with '# {SCHEMA}'"
        raise InputError(path, "line 1", problem, "make it with eps-hil golden make")
    if tuple(names.split(",")) != _COLUMNS:
        raise InputError(path, "line 2", f"is not {','.join(_COLUMNS)}", "make it again")
    provenance, tolerances = _head(path, first.removeprefix(f"# {SCHEMA} "))
    return Golden(provenance, tolerances, _table(path, table))


def _head(path: Path, text: str) -> tuple[Provenance, dict[str, float]]:
    try:
        head = json_text.parse(text)
        tolerances = {**DEFAULT_TOLERANCES, **head.pop("tolerances")}
        return Provenance(**head), {name: float(value) for name, value in tolerances.items()}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(path, "line 1", f"is damaged: {error}", "make it again") from None


def _table(path: Path, text: str) -> Estimates:
    if not text.strip():
        raise InputError(path, "line 3", "holds no estimates", "make it again")
    try:
        rows = np.loadtxt(io.StringIO(text), delimiter=",", dtype=_TYPES, ndmin=1, comments=None)
    except ValueError as error:
        said = " ".join(str(error).split())[:120]
        raise InputError(path, "table", f"is damaged: {said}", "make it again") from None
    values = {name: np.ascontiguousarray(rows[name]) for name in SIGNALS}
    return Estimates(rows["t_ns"].copy(), values, rows["reason"].copy())


def _packed(path: Path) -> bool:
    return path.suffix.lower() == ".gz"
