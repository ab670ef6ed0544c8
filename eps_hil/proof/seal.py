"""Answers that can be shown later to be those that were fixed before.

The sealed file holds the cases and a random salt; its SHA-256 is published before anything is
diagnosed. The salt keeps the few possible answers from being found by trying them all.
"""

import hashlib
import json
import secrets
from pathlib import Path
from typing import Any

from eps_hil import json_text
from eps_hil.errors import InputError

SCHEMA = "eps-hil/proof-answers/1"
_SEAL_SUFFIX = ".sha256"


def digest(salt: str, cases: dict[str, Any]) -> str:
    """SHA-256 over salt and cases in canonical form (sorted keys, no blanks)."""
    text = json.dumps(cases, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(f"{SCHEMA}\n{salt}\n{text}".encode()).hexdigest()


def seal(path: Path, cases: dict[str, Any], salt: str | None = None) -> str:
    """Write the answers and, beside them, their hash (``<name>.sha256``); returns the hash."""
    salt = salt or secrets.token_hex(16)
    content = {"schema": SCHEMA, "salt": salt, "cases": cases}
    path.write_text(json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n")
    value = digest(salt, cases)
    _beside(path).write_text(value + "\n")
    return value


def open_answers(path: Path, published: str | None = None) -> dict[str, Any]:
    """The cases of a sealed file; :class:`InputError` if they are not those that were sealed.

    ``published``: the hash as it was announced; without it the one beside the file is taken,
    which shows accidents but not a forger who changes both.
    """
    try:
        content = json_text.parse(path.read_text())
        salt, cases = content["salt"], content["cases"]
        expected = published or _beside(path).read_text().strip()
    except OSError as error:
        raise InputError(path, "", f"cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise InputError(path, "", "is no file of sealed answers") from None
    found = digest(salt, cases)
    if found != expected:
        problem = f"the seal is broken: sha256 is {found[:12]}…, {expected[:12]}… was published"
        raise InputError(path, "cases", problem, "these are not the answers that were sealed")
    return dict(cases)


def opaque_id() -> str:
    """A name for a case that says nothing about it: 48 random bits."""
    return secrets.token_hex(6)


def _beside(path: Path) -> Path:
    return path.with_name(path.name + _SEAL_SUFFIX)
