"""CSV -> :class:`Table`: one header line of canonical names, then numbers.

The whole body goes through one call, of pyarrow where that is installed and of ``numpy.loadtxt``
otherwise or if anything is unusual. Only when both fail is the file read again, cell by cell, to
name the line and column.
"""

import csv
import io
import re
from collections.abc import Callable, Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.errors import InputError
from eps_hil.recordings.arrow_numbers import numbers
from eps_hil.recordings.files import first_line_and_rest
from eps_hil.recordings.table import (
    EPOCH_S,
    MARK_REMEDY,
    TIME_NS,
    Floats,
    Stamps,
    Table,
    clocks_apart,
    largest_second,
    seconds_to_ns,
    shown,
    usable_columns,
)
from eps_hil.signals import TIME

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")
_DIGITS = 28
_WORTH_ARROW = 100_000
"""Bytes from which it is worth while to load pyarrow."""
_LOOK = 4096
"""Bytes that are looked at first: the whole would be copied."""
_PIECE = 1 << 18
"""Bytes that stay in the processor's cache while one sign after the other is looked for."""
_NUL, _RETURN, _BLANKS, _QUOTE, _WORD = b"\0", b"\r", b" \t", b'"', b"nN"
_WHAT = "a CSV file with one header line of canonical names was expected"


def read_csv(path: Path, *, ignore_unknown: bool = False) -> Table:
    """Read one CSV file; :class:`InputError` names file, line and column of anything wrong."""
    first, body = first_line_and_rest(path)
    signs = _signs(body, _NUL + _RETURN + _BLANKS + _QUOTE + _WORD)
    header, body = _split(path, *_as_text(path, first, body, signs))
    names = _names(path, header, body)
    columns, notes = usable_columns(path, names, "line 1", ignore_unknown=ignore_unknown)
    body = _plain(path, body, names, columns, signs)
    if not (body[:_LOOK].strip(b"\n") or body.strip(b"\n")):
        raise InputError(path, "line 2", "nothing follows the header", "a recording needs rows")
    used = list(columns.values())
    line_of = LineOfRow(body)
    exact: Stamps | None = None
    fast = None if signs & {*_WORD} else _plainly(body, len(names), columns)
    if fast is None:
        check_width(path, body, len(names), line_of)
        cells = cells_of(path, body, columns)
    else:
        cells, exact = fast
    blank = np.isnan(cells).all(axis=1) if np.isnan(cells[:, 0]).any() else np.zeros(0, bool)
    if blank.any():  # lines of nothing but commas, as a spreadsheet leaves below its data
        line_of.keep(np.flatnonzero(~blank))
        cells = cells[~blank]
    if not len(cells):
        raise InputError(path, "line 2", "all cells are empty", "a recording needs rows")
    values = {name: cells[:, used.index(index)] for name, index in columns.items()}
    t_ns = _stamps(path, body, values, columns, line_of, exact)
    signals = {k: np.ascontiguousarray(v) for k, v in values.items() if k not in (TIME, TIME_NS)}
    if TIME_NS in values:
        notes += clocks_apart(values.get(TIME), t_ns)
    return Table(t_ns, signals, line_of, notes)


class LineOfRow:
    """Row number -> "line 17"; found only when somebody asks, blank lines counted."""

    def __init__(self, body: bytes) -> None:
        self._body = body
        self._kept: Stamps | None = None

    @property
    def rows(self) -> Stamps | slice:
        """Those that stay."""
        return slice(None) if self._kept is None else self._kept

    def keep(self, rows: Stamps) -> None:
        """Rows that stay after others were dropped."""
        self._kept = rows

    def kept(self, cells: list[bytes]) -> list[bytes]:
        """The given cells of all rows, for the rows that stay."""
        return cells if self._kept is None else [cells[row] for row in self._kept]

    def __call__(self, row: int) -> str:
        """The line of a row, for a person."""
        wanted = row if self._kept is None else int(self._kept[row])
        for seen, (number, _) in enumerate(lines_of(self._body)):
            if seen == wanted:
                return f"line {number}"
        return f"row {row + 1}"


def lines_of(body: bytes) -> Iterator[tuple[int, bytes]]:
    """Lines that are not blank, with their numbers in a file of one line above the body."""
    for number, line in enumerate(body.split(b"\n"), start=2):
        if line:
            yield number, line


def first_line(body: bytes) -> bytes:
    """The first one that is not blank."""
    begin = 0
    while body.startswith(b"\n", begin):
        begin += 1
    return body[begin : body.find(b"\n", begin)]


def _signs(text: bytes, wanted: bytes) -> set[int]:
    """Which of the ``wanted`` signs a text holds."""
    missing = {*wanted}
    for start in range(0, len(text), _PIECE):
        missing -= {sign for sign in missing if text.find(sign, start, start + _PIECE) >= 0}
    return {*wanted} - missing


def _as_text(path: Path, first: bytes, body: bytes, signs: set[int]) -> tuple[bytes, bytes]:
    """The first line and the body (which holds ``signs``) with line feeds alone between lines."""
    if first[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(path, "", "is UTF-16 text", "save it as 'CSV UTF-8'")
    first = first.removeprefix(b"\xef\xbb\xbf")
    if _NUL in first or signs & {*_NUL}:
        number = 1 if _NUL in first else 2 + body[: body.index(_NUL)].count(b"\n")
        raise InputError(path, f"line {number}", "holds binary data", _WHAT)
    if not (first.strip() or body[:_LOOK].strip() or body.strip()):
        raise InputError(path, "", "is empty", _WHAT)
    line = first.removesuffix(_RETURN)
    if _RETURN in line:  # between lines, as it once was
        line, _, body = with_line_feeds(first + b"\n" + body).partition(b"\n")
    elif signs & {*_RETURN}:
        body = with_line_feeds(body)
    return line, body


def with_line_feeds(text: bytes) -> bytes:
    """Line feeds alone between lines."""
    return text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def _split(path: Path, first: bytes, body: bytes) -> tuple[str, bytes]:
    try:
        header = first.decode("utf-8")
    except UnicodeDecodeError as error:
        problem = f"is not UTF-8 text (byte 0x{first[error.start]:02x})"
        raise InputError(path, "line 1", problem, _WHAT) from None
    for sign, name in ((";", "a semicolon"), ("\t", "a tab")):
        if header.count(sign) > header.count(","):
            comma = bool(_DECIMAL_COMMA.search(body[:4096].decode("latin-1")))
            more = " and numbers have a decimal comma" if comma else ""
            problem = f"columns are separated by {name}, not a comma{more}"
            remedy = "export with ',' between columns and '.' in numbers"
            raise InputError(path, "line 1", problem, remedy)
    return header, body if body.endswith(b"\n") else body + b"\n"


def _names(path: Path, header: str, body: bytes) -> list[str]:
    header = re.sub(r"[ \t]*,[ \t]*", ",", header.strip())
    try:
        names = [name.strip() for name in next(csv.reader([header], strict=True), [])]
    except csv.Error:
        raise InputError(path, "line 1", "quotes do not match", _WHAT) from None
    if not names:
        raise InputError(path, "line 1", "is blank", _WHAT)
    if all(NUMBER.fullmatch(name) for name in names):
        raise InputError(path, "line 1", "holds numbers, no column names", _WHAT)
    commas = body.count(b",", 0, body.find(b"\n"))
    if names[-1] == "" and (commas == len(names) - 2 or column_is_empty(body, len(names) - 1)):
        names.pop()  # a comma that ends the header line, as some loggers write it
    return names


def column_is_empty(body: bytes, commas: int) -> bool:
    """Whether every line has so many commas, and ends with one."""
    return all(line.count(b",") == commas and line.endswith(b",") for _, line in lines_of(body))


def _plain(
    path: Path, body: bytes, names: list[str], columns: dict[str, int], signs: set[int]
) -> bytes:
    """The body without quotes, blanks around cells, and commas that end every line."""
    if signs & {*_BLANKS}:
        body = re.sub(rb"[ \t]*([,\n])[ \t]*", rb"\1", body.lstrip(b" \t"))
    if signs & {*_QUOTE}:
        body = _unquoted(path, body, set(columns.values()), names)
    first = first_line(body)
    if first.count(b",") == len(names) and column_is_empty(body, len(names)):
        body = body.replace(b",\n", b"\n")
    return body


def _unquoted(path: Path, body: bytes, used: set[int], names: list[str]) -> bytes:
    """Quoted cells made plain; a comma inside quotes of a number column is a decimal comma."""
    lines = []
    for number, line in enumerate(body.decode("latin-1").split("\n")[:-1], start=2):
        try:
            row = next(csv.reader([line], strict=True), [])
        except csv.Error:
            raise InputError(path, f"line {number}", "quotes do not match", "mend them") from None
        for index, cell in enumerate(row):
            if "," in cell and index in used:
                refuse_cell(path, number, names[index], cell)
        lines.append(",".join(cell.replace(",", " ") for cell in row))
    return ("\n".join(lines) + "\n").encode("latin-1")


def check_width(path: Path, body: bytes, width: int, line_of: LineOfRow) -> None:
    """Refuse a line of more or fewer cells."""
    data = np.frombuffer(body, dtype=np.uint8)
    ends = np.flatnonzero(data == ord("\n"))
    commas = np.searchsorted(np.flatnonzero(data == ord(",")), ends)
    cells = np.diff(commas, prepend=0) + 1
    cells = cells[np.diff(ends, prepend=-1) > 1]  # without blank lines
    wrong = cells != width
    if wrong.any():
        row = int(np.argmax(wrong))
        last = row == len(cells) - 1 and cells[row] < width
        remedy = "the file may be cut off there" if last else "mend the line"
        problem = f"{cells[row]} cells where the header has {width}"
        raise InputError(path, line_of(row), problem, remedy)


def cells_of(path: Path, body: bytes, columns: dict[str, int]) -> Floats:
    """All used cells, shape (rows, used): NaN for empty ones, infinite for NaN and infinity."""
    text = body.lower()
    if len(text) > _WORTH_ARROW and b"nan" not in text:
        found = _by_arrow(text, list(columns.values()), first_line(text).count(b",") + 1)
        if found is not None:
            return found[0]
    text = text.replace(b"nan", b"inf")
    if text.startswith(b",") or b",," in text or b"\n," in text or b",\n" in text:
        text = _filled(text)
    try:
        return np.loadtxt(
            io.BytesIO(text),
            delimiter=",",
            comments=None,
            encoding="latin-1",
            usecols=list(columns.values()),
            ndmin=2,
        )
    except ValueError as error:
        _locate(path, body, columns)
        raise InputError(path, "", f"is not readable as CSV: {error}", _WHAT) from None


def _plainly(
    body: bytes, width: int, columns: dict[str, int]
) -> tuple[Floats, Stamps | None] | None:
    """All used cells, and stamps to the nanosecond where floats do not hold them.

    None where anything is unusual, and is looked at closely: lines of another width.
    """
    if len(body) < _WORTH_ARROW:
        return None
    used, exact = list(columns.values()), None
    if TIME_NS in columns:
        exact = (columns[TIME_NS], 0)
    elif TIME in columns:
        first = first_line(body).split(b",")
        try:
            exact = (columns[TIME], 9) if float(first[columns[TIME]]) >= EPOCH_S else None
        except (ValueError, IndexError):
            return None
    return _by_arrow(body, used, width, exact)


def _by_arrow(
    text: bytes, used: list[int], width: int, exact: tuple[int, int] | None = None
) -> tuple[Floats, Stamps | None] | None:
    """As ``numpy.loadtxt`` to the last bit, and faster; None where it has doubts.

    ``exact``: a column of stamps with so many decimal places, which are given as integers too.
    """
    try:
        import pyarrow
        from pyarrow import csv as arrow
    except ImportError:  # the parquet extra
        return None
    names = [str(index) for index in range(width)]
    wanted = {str(index): pyarrow.float64() for index in used}
    if exact is not None:
        wanted[str(exact[0])] = pyarrow.decimal128(_DIGITS, exact[1])
    try:
        table = arrow.read_csv(
            pyarrow.py_buffer(text),
            arrow.ReadOptions(column_names=names),
            arrow.ParseOptions(quote_char=False),
            arrow.ConvertOptions(
                column_types=wanted, null_values=[""], include_columns=list(wanted)
            ),
        )
    except pyarrow.ArrowException:
        return None
    cells = np.empty((len(table), len(wanted)), order="F")
    stamps: Stamps | None = None
    for k, name in enumerate(wanted):
        if exact is not None and name == str(exact[0]):
            stamps = _integers(table[name])
            if stamps is None:
                return None
            cells[:, k] = stamps / 10.0 ** exact[1]
            continue
        numbers(table[name], cells[:, k])
    return cells, stamps


def _integers(column: Any) -> Stamps | None:
    """Decimal numbers of pyarrow in units of their last place; None where a cell is empty."""
    if column.null_count:
        return None
    parts = []
    for chunk in column.chunks:  # 16 bytes each, the lower half first
        halves = np.frombuffer(chunk.buffers()[1], np.int64)[2 * chunk.offset :]
        parts.append(halves[: 2 * len(chunk)].reshape(-1, 2))
    low, high = np.concatenate(parts).T if parts else (np.empty(0, np.int64),) * 2
    return None if (low >> 63 != high).any() else np.ascontiguousarray(low)


def _filled(text: bytes) -> bytes:
    text = text.replace(b",,", b",nan,").replace(b",,", b",nan,")
    text = text.replace(b"\n,", b"\nnan,").replace(b",\n", b",nan\n")
    return b"nan" + text if text.startswith(b",") else text


def _locate(path: Path, body: bytes, columns: dict[str, int]) -> None:
    """Raise for the first cell that is no number."""
    for number, line in lines_of(body):
        cells = line.decode("utf-8", errors="backslashreplace").split(",")
        for name, index in columns.items():
            cell = cells[index].strip()
            if cell and not NUMBER.fullmatch(cell) and not NOT_FINITE.fullmatch(cell):
                refuse_cell(path, number, name, cell)


def refuse_cell(path: Path, line: int, column: str, cell: str) -> None:
    """:class:`InputError` for a cell that is no number."""
    place = f"line {line}, column {column}"
    if _DECIMAL_COMMA.fullmatch(cell):
        problem = f"{shown(cell)} has a decimal comma"
        raise InputError(path, place, problem, "export with '.' in numbers")
    remedy = "correct the cell, or empty it and " + MARK_REMEDY
    raise InputError(path, place, f"{shown(cell)} is not a number", remedy)


def _stamps(
    path: Path,
    body: bytes,
    values: dict[str, Floats],
    columns: dict[str, int],
    line_of: LineOfRow,
    known: Stamps | None,
) -> Stamps:
    """The exact nanosecond that the text names; from floats while those are exact."""
    name = TIME_NS if TIME_NS in columns else TIME
    seconds = values[name] * 1e-9 if name == TIME_NS else values[name]
    if largest_second(path, seconds, line_of, column=f"column {name}") < EPOCH_S:
        return seconds_to_ns(seconds)
    if known is not None:
        return known if len(known) == len(seconds) else known[line_of.rows]
    index = columns[name]
    cells = line_of.kept([line.split(b",", index + 1)[index] for _, line in lines_of(body)])
    exact: Callable[[bytes], int] = _integer if name == TIME_NS else _nanoseconds
    return np.fromiter((exact(cell) for cell in cells), dtype=np.int64, count=len(cells))


def _nanoseconds(cell: bytes) -> int:
    whole, _, fraction = cell.partition(b".")
    if whole.isdigit() and (fraction.isdigit() or not fraction) and len(fraction) <= 9:
        return int(whole) * 1_000_000_000 + int(fraction.ljust(9, b"0"))
    return round(Decimal(cell.decode()) * 1_000_000_000)


def _integer(cell: bytes) -> int:
    return int(cell) if cell.isdigit() else round(Decimal(cell.decode()))
