"""The package's example files by name: what each is, what it needs, and how it is copied out.

A copy keeps the folders (``configs/demo_udp.yaml``, ``dbc/eps_rig.dbc``), so that the commands in
the documentation and in the files' own comments work where the copy was made.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_hil.errors import InputError
from eps_hil.examples import CONFIGS, DBC, FOLDER

ALL = "all"
SCHEMAS = CONFIGS / "schemas"
"""JSON schemas, which the YAML files' first lines name for editors; copied along."""
_NO_PLACE = (FileExistsError, FileNotFoundError, IsADirectoryError, NotADirectoryError,
             PermissionError)  # fmt: skip
_EDITOR = "# yaml-language-server: $schema="


@dataclass(frozen=True, slots=True)
class Example:
    """One file: its name for a command, where it lies in the package, and a line about it."""

    name: str
    path: Path
    about: str

    @property
    def place(self) -> Path:
        """Where it goes below the folder that it is copied to."""
        return self.path.relative_to(FOLDER)

    def commands(self, folder: Path) -> tuple[str, ...]:
        """What the file's head says to run, for a copy below ``folder``."""
        lines = re.findall(r"^#   (eps-hil .+)$", self.path.read_text(encoding="utf-8"), re.M)
        return tuple(
            re.sub(r"\b(configs|dbc)/", lambda place: f"{folder / place[1]}/", one) for one in lines
        )


@dataclass(frozen=True, slots=True)
class Copied:
    """One file that was asked for: where it is now; ``written`` False if it was there already."""

    path: Path
    written: bool


def examples() -> tuple[Example, ...]:
    """All of them: configurations first, then what they refer to, in the order of their names."""
    files = (path for path in CONFIGS.rglob("*") if path.is_file() and SCHEMAS not in path.parents)
    ordered = sorted(files, key=lambda path: (len(path.parts), path))
    found = [Example(str(_name(path)), path, _about(path)) for path in ordered]
    return (*found, *(Example(path.name, path, _about(path)) for path in sorted(DBC.glob("*.dbc"))))


def find(name: str) -> Example:
    """The example of that name, or of that last part of one (``weave``: ``manoeuvres/weave``), or
    without its suffix.

    :class:`InputError` where there is none, or more than one.
    """
    wanted = name.removeprefix("configs/").removeprefix("dbc/").removesuffix(".yaml")
    known = examples()
    exact = [one for one in known if one.name == wanted]
    near = exact or [one for one in known if wanted in (Path(one.name).name, Path(one.name).stem)]
    if len(near) == 1:
        return near[0]
    if near:
        names = " or ".join(one.name for one in near)
        raise InputError(name, "", "names several examples", f"say {names}")
    raise InputError(name, "", "no example has this name", "`eps-hil example` lists them")


def copy(name: str, folder: Path, *, overwrite: bool = False) -> tuple[Copied, ...]:
    """Copy an example and every file it refers to below ``folder``; ``all`` for every example.

    Nothing is written, and :class:`InputError` says so, if a file of other content is in the way
    of one of them and ``overwrite`` is not set; it also names a folder that cannot be made.
    """
    first = [one.path for one in examples()] if name == ALL else [find(name).path]
    wanted = [(path, folder / path.relative_to(FOLDER)) for path in _with_references(first)]
    same = {target: _holds(target, source) for source, target in wanted}
    for _, target in wanted:
        if target.exists() and not same[target] and not overwrite:
            raise InputError(target, "", "is there already and differs", "move it, or --overwrite")
    for source, target in wanted:
        if not same[target]:
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(source.read_bytes())
            except _NO_PLACE as error:
                problem = f"cannot be made: {error.strerror}"
                raise InputError(target, "DIR", problem, "choose another folder") from None
    return tuple(Copied(target, not same[target]) for _, target in wanted)


def _with_references(first: list[Path]) -> list[Path]:
    found: list[Path] = []
    waiting = list(first)
    while waiting:
        path = waiting.pop(0)
        if path not in found:
            found.append(path)
            waiting += _references(path)
    return found


def _references(path: Path) -> list[Path]:
    """Files of the package that a YAML file's values name, relative to itself."""
    if path.suffix != ".yaml":
        return []
    from eps_hil import yaml_file

    texts = [text for text in _texts(yaml_file.read(path)) if "." in text]
    head = path.read_text(encoding="utf-8").partition("\n")[0]
    texts += [head.removeprefix(_EDITOR)] if head.startswith(_EDITOR) else []
    named = [(path.parent / text).resolve() for text in texts]
    return [file for file in named if file.is_file() and file.is_relative_to(FOLDER)]


def _texts(content: Any) -> Iterator[str]:
    match content:
        case str():
            yield content
        case dict():
            for value in content.values():
                yield from _texts(value)
        case list():
            for value in content:
                yield from _texts(value)


def _holds(target: Path, source: Path) -> bool:
    return target.is_file() and target.read_bytes() == source.read_bytes()


def _name(path: Path) -> Path:
    place = path.relative_to(CONFIGS)
    return place.with_suffix("") if place.suffix == ".yaml" else place


def _about(path: Path) -> str:
    """The description that the file gives of itself, else the first sentence at its head."""
    text = path.read_text(encoding="utf-8")
    if text.startswith(_EDITOR):
        text = text.partition("\n")[2]
    said = re.search(r"^  description: (.+)$", text, re.M) or re.search(
        r'^CM_ "([^"]+)"', text, re.M
    )
    comment = re.match(r"<\?xml.*\n<!-- (.+?) -->", text)
    if comment is not None:
        sentence = comment.group(1)
    elif said is None:
        head = re.match(r"(?:# ?.*\n)+", text)
        sentence = re.sub(r"^# ?", "", head.group(), flags=re.M) if head else ""
    else:
        sentence = said.group(1)
    return re.split(r"(?<!fig)\.(?:\s|$)", " ".join(sentence.split()), maxsplit=1)[0]
