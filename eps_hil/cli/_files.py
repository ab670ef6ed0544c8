"""Small things that verbs share about the files they write."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from eps_hil import provenance
from eps_hil.cli._outputs import check_apart
from eps_hil.errors import InputError
from eps_hil.json_text import plain


def write_json(path: Path, content: Any) -> None:
    """Write ``content`` whole or not at all, and where it comes from; NaN becomes null."""
    from eps_hil.recordings.files import replacing

    if isinstance(content, dict):
        content = {**content, "provenance": provenance.content()}
    text = json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def check_places(*paths: Path | None) -> None:
    """Refuse files that cannot be written before long work begins, not after it."""
    for path in paths:
        if path is None:
            continue
        if str(path) == "-":
            raise InputError(path, "", "is no file name", "standard output is /dev/stdout")
        folder = path.resolve().parent
        if path.is_dir():
            raise InputError(path, "", "is a folder, a file name was expected", "name the file")
        if not folder.is_dir():
            raise InputError(path, "", f"folder {folder} does not exist", "create it first")


def check_kept(outputs: Iterable[Path | None], inputs: Iterable[Path | None]) -> None:
    """Refuse to write over what is read, one name for two outputs, and what cannot be written."""
    from eps_hil.recordings.files import check_writable

    written = [path for path in outputs if path is not None]
    check_apart(written, inputs)
    check_places(*written)
    for path in written:
        check_writable(path)


def check_model_place(path: Path | None) -> None:
    """Refuse before long work where a model cannot be written, or would replace another file."""
    if path is None:
        return
    from eps_hil import yaml_file
    from eps_hil.recordings.files import check_writable

    check_places(path)
    check_writable(path)
    if not path.is_file() or path.stat().st_size == 0:
        return
    try:
        content = yaml_file.read(path)
    except InputError:
        content = None
    if not isinstance(content, dict) or not isinstance(content.get("model"), dict):
        raise InputError(path, "", "is no model file and would be lost", "name another file")


def outputs_for(out: Path, recordings: Sequence[Path]) -> dict[Path, Path]:
    """The output file of each recording; no two of them the same."""
    targets: dict[Path, Path] = {}
    for path in dict.fromkeys(recordings):
        target = output_for(out, path, len(recordings) > 1)
        if target in targets.values():
            problem = f"two recordings would be written to {target}"
            raise InputError(path, "--out", problem, "rename one of them, or use 'eps-hil batch'")
        targets[path] = target
    return targets


def output_for(out: Path, recording: Path, several: bool) -> Path:
    """The output file of one recording; with several recordings its name must hold {name}."""
    if "{name}" in str(out):
        return Path(str(out).replace("{name}", recording.stem))
    if several:
        raise InputError(
            out,
            "--out",
            "one file for several recordings",
            "put {name} into it, for example out/{name}_estimate.csv",
        )
    return out
