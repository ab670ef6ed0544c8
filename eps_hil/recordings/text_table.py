"""Text tables as other tools write them -> columns by those tools' names.

Commas, semicolons or tabs; decimal commas; quotes; UTF-16; a line ``sep=;``, lines of comment above
the names and lines of units below them. Only the columns that somebody asks for are looked at, so
any text may stand in the others. The text is brought into the plain form of
:mod:`~eps_hil.recordings.csv_file`, line for line, and read as that is.
"""

import codecs
import csv
import io
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eps_hil.errors import InputError
from eps_hil.recordings.csv_file import (
    NOT_FINITE,
    NUMBER,
    LineOfRow,
    cells_of,
    check_width,
    column_is_empty,
    first_line,
    lines_of,
    refuse_cell,
    with_line_feeds,
)
from eps_hil.recordings.files import read_bytes
from eps_hil.recordings.table import Floats, NamedColumns, check_once, shown

_UNIT_LINES = 3
"""At most so many lines of units stand between the names and the numbers."""
_SIGNS = ";\t,"
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_NO_VALUE = {"n/a", "#n/a", "na", "null", "none", "missing"}
_EDGES = (b" ,", b", ", b" \n", b"\n ", b"\t,", b",\t", b"\t\n", b"\n\t")
"""Blanks around cells; those within them are nothing to look at."""
_EXPORT = "export it again"


@dataclass(frozen=True, slots=True)
class _Head:
    """The names, where they stand, what separates them, and all that follows their line."""

    names: list[str]
    line: int
    sign: str
    body: bytes


def read_text(path: Path, wanted: Sequence[str] | None) -> NamedColumns:
    """The ``wanted`` columns that a text table has, its time first (None: all that hold numbers).

    :class:`InputError` names line and column of what is wrong in them, and nothing in others.
    """
    head = _head(path, _utf8(path, read_bytes(path)), wanted or ())
    names = head.names
    body = _plain(path, head, wanted)
    columns = {name: k for k, name in enumerate(names) if name and wanted and name in wanted}
    time = columns.get(wanted[0], -1) if wanted else 0
    body = _without_units(path, body, list(columns.values()) or range(len(names)), time)
    names, body = _even(path, names, body)
    _refuse_comments(path, body)
    line_of = LineOfRow(body)
    check_width(path, body, len(names), line_of)
    if wanted is not None:
        check_once(path, f"line {head.line}", names, wanted)
        found = _cells(path, body, columns) if columns else {}
    else:
        found = _all_numbers(path, body, names)
    if found:
        blank = np.logical_and.reduce([np.isnan(one) for one in found.values()])
        if blank.all():
            raise InputError(path, line_of(0), "all cells are empty", "a recording needs rows")
        if blank.any():  # as a spreadsheet leaves them below its data
            line_of.keep(np.flatnonzero(~blank))
            found = {name: one[~blank] for name, one in found.items()}
    return NamedColumns(tuple(names), found, line_of)


def _utf8(path: Path, content: bytes) -> bytes:
    if content.startswith(_UTF16):
        try:
            content = content.decode("utf-16").encode()
        except UnicodeError:
            raise InputError(path, "", "is broken UTF-16 text", "save it as UTF-8") from None
    content = content.removeprefix(codecs.BOM_UTF8)
    if b"\0" in content:
        line = f"line {1 + content[: content.index(0)].count(10)}"
        raise InputError(path, line, "holds binary data", "a text table was expected")
    return with_line_feeds(content) if b"\r" in content else content


def _head(path: Path, content: bytes, wanted: Sequence[str]) -> _Head:
    sign, comment, begin, number = "", "", 0, 0
    while begin < len(content):
        end = content.find(b"\n", begin)
        end = len(content) if end < 0 else end
        number += 1
        line, since = _text(content[begin:end]).strip(" "), begin
        begin = end + 1
        if number == 1 and line.lower().startswith("sep=") and len(line) == 5:
            sign = line[4]
        elif line.startswith("#"):
            comment = line
        elif line.strip():
            above = sign or max(_SIGNS, key=_outside_quotes(line).count)
            if comment and all(map(_is_number, _split(path, line, above, number))):
                # the names stand behind a '#', as numpy writes them
                above = sign or max(_SIGNS, key=_outside_quotes(comment).count)
                names = _split(path, comment, above, number - 1)
                if names[0] not in wanted:
                    names[0] = names[0].lstrip("# ")
                return _Head(names, number - 1, above, content[since:])
            names = _split(path, line, above, number)
            if all(map(_is_number, names)):
                remedy = "add a line of names"
                raise InputError(path, f"line {number}", "holds numbers, no column names", remedy)
            return _Head(names, number, above, content[begin:])
    raise InputError(path, "", "is empty", _EXPORT)


def _text(line: bytes) -> str:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("cp1252", errors="replace")  # as Western spreadsheets write it


def _outside_quotes(line: str) -> str:
    return "".join(line.split('"')[::2])


def _split(path: Path, line: str, sign: str, number: int) -> list[str]:
    try:
        cells = next(csv.reader([line], delimiter=sign, skipinitialspace=True, strict=True), [])
    except csv.Error:
        raise InputError(path, f"line {number}", "quotes do not match", "mend them") from None
    return [cell.strip() for cell in cells]


def _is_number(cell: str) -> bool:
    return bool(NUMBER.fullmatch(cell.strip().replace(",", ".")))


def _is_value(cell: str) -> bool:
    """A number, or what stands in the place of one."""
    return _is_number(cell) or bool(NOT_FINITE.fullmatch(cell)) or cell.lower() in _NO_VALUE


def _plain(path: Path, head: _Head, wanted: Sequence[str] | None) -> bytes:
    """What follows the names, commas between cells and points in numbers.

    Its lines keep their numbers: as many blank ones stand before it as above the names.
    """
    body = head.body if head.body.endswith(b"\n") else head.body + b"\n"
    used = {k for k, name in enumerate(head.names) if wanted and name in wanted}
    if b'"' in body:
        body = "".join(_unquoted(path, head, body, used)).encode("latin-1")
    elif head.sign != ",":
        if b"," in body and b"." in body:
            marks = _DecimalMarks(path, head.names, used)
            for k, line in enumerate(io.BytesIO(body)):
                marks.see(head.line + k + 1, line.decode("latin-1").split(head.sign))
        body = body.replace(b",", b".").replace(head.sign.encode(), b",")
    if body[:1] in (b" ", b"\t") or any(edge in body for edge in _EDGES):
        body = re.sub(rb"[ \t]*([,\n])[ \t]*", rb"\1", body.lstrip(b" \t"))
    return b"\n" * (head.line - 1) + body


class _DecimalMarks:
    """Refuses a table whose used numbers have commas and points: one sign parts thousands."""

    def __init__(self, path: Path, names: Sequence[str], used: Collection[int]) -> None:
        self._path, self._names, self._used = path, names, used
        self._comma: tuple[int, str, str] | None = None
        self._point = False

    def see(self, number: int, cells: Sequence[str]) -> None:
        """The cells of line ``number``."""
        for k in self._used:
            cell = cells[k].strip() if k < len(cells) else ""
            if "." in cell:
                self._point = self._point or _is_number(cell)
            elif "," in cell and self._comma is None and _is_number(cell):
                self._comma = (number, self._names[k], cell)
        if self._comma is not None and self._point:
            line, name, cell = self._comma
            problem = f"'{cell}' has a comma where other numbers have points"
            remedy = "export it with one decimal sign and nothing between thousands"
            raise InputError(self._path, f"line {line}, column {shown(name)}", problem, remedy)


def _unquoted(path: Path, head: _Head, body: bytes, used: Collection[int]) -> Iterator[str]:
    text = io.StringIO(body.decode("latin-1"), newline="")
    rows = csv.reader(text, delimiter=head.sign, skipinitialspace=True, strict=True)
    marks = _DecimalMarks(path, head.names, () if head.sign == "," else used)
    before = 0
    try:
        for row in rows:
            number = head.line + before + 1
            if head.sign == ",":
                for k, cell in enumerate(row):
                    if "," in cell and k in used:
                        refuse_cell(path, number, head.names[k], cell)
            marks.see(number, row)
            yield ",".join(cell.replace(",", ".").replace("\n", " ") for cell in row)
            yield "\n" * (rows.line_num - before)
            before = rows.line_num
    except csv.Error:
        place = f"line {head.line + before + 1}"
        raise InputError(path, place, "quotes do not match", "mend them") from None


def _without_units(path: Path, body: bytes, used: Collection[int], time: int) -> bytes:
    """Without the lines above the data: no column of them that is used holds a number.

    A "1" is a unit too, though not of ``time``.
    """
    seen, begin, number, last = 0, 0, 2, 2
    while begin < len(body):
        end = body.index(b"\n", begin)
        cells = [cell.decode("latin-1") for cell in body[begin:end].split(b",")]
        told = [(k, cells[k]) for k in used if k < len(cells)]
        if any(_is_value(cell) and (cell != "1" or k == time) for k, cell in told):
            return body[:begin].count(b"\n") * b"\n" + body[begin:]
        if any(cells):
            seen, last = seen + 1, number
        if seen > _UNIT_LINES:
            break
        begin, number = end + 1, number + 1
    raise InputError(path, f"line {last}", "no line of numbers follows the names", _EXPORT)


def _even(path: Path, names: list[str], body: bytes) -> tuple[list[str], bytes]:
    """Without the separators that end the names' line, or all others."""
    width = first_line(body).count(b",") + 1
    names = names[:]
    if names[-1] == "" and (width == len(names) - 1 or column_is_empty(body, len(names) - 1)):
        names.pop()
    if width == len(names) + 1:
        if not column_is_empty(body, len(names)):
            place = f"line {next(lines_of(body))[0]}"
            problem = f"{width} cells where there are {len(names)} names"
            remedy = "name every column (R: write.csv, row.names = FALSE)"
            raise InputError(path, place, problem, remedy)
        body = body.replace(b",\n", b"\n")
    return names, body


def _refuse_comments(path: Path, body: bytes) -> None:
    """A '#' before some lines: whether they count, only who wrote it knows."""
    if b"\n#" not in body and not body.startswith(b"#"):
        return
    lines = list(lines_of(body))
    marked = [number for number, line in lines if line.startswith(b"#")]
    if len(marked) < len(lines):
        place = f"line {marked[0]}"
        raise InputError(path, place, "begins with '#'", "take the line out, or the '#'")


def _cells(path: Path, body: bytes, columns: dict[str, int]) -> dict[str, Floats]:
    cells = cells_of(path, body, columns)
    return {name: np.ascontiguousarray(cells[:, k]) for k, name in enumerate(columns)}


def _all_numbers(path: Path, body: bytes, names: list[str]) -> dict[str, Floats]:
    first = [cell.decode("latin-1") for cell in first_line(body).split(b",")]
    columns = {
        name: k
        for k, (name, cell) in enumerate(zip(names, first, strict=True))
        if name and (not cell or _is_number(cell))
    }
    try:
        return _cells(path, body, columns)
    except InputError:  # text further down
        found: dict[str, Floats] = {}
        for name, k in columns.items():
            try:
                found |= _cells(path, body, {name: k})
            except InputError:
                continue
        return found
