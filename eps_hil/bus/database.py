"""CAN databases by cantools, with every failure told in one line."""

import copy
import difflib
import functools
import logging
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from eps_hil.errors import InputError


def load_database(paths: Sequence[str | Path], *, strict: bool = True) -> Any:
    """One cantools ``Database`` from one or several files (DBC, ARXML, KCD, SYM).

    ``strict=False`` also takes files with overlapping signals, or signals longer than their
    message. A message that several files define alike is kept once; :func:`find_message` refuses
    one that they define differently. :class:`InputError` for a missing or broken file, naming the
    line where there is one.
    """
    from cantools.database import Database

    logging.getLogger("cantools").addHandler(logging.NullHandler())  # what is wrong, we say
    parts = [_load(Path(path), strict=strict) for path in paths]
    if len(parts) == 1:
        loaded = parts[0]
    else:
        messages = {_layout(message): message for part in parts for message in part.messages}
        nodes = [node for part in parts for node in part.nodes]
        loaded = Database(messages=list(messages.values()), nodes=nodes, strict=strict)
    loaded.eps_hil_files = " + ".join(str(path) for path in paths)
    return loaded


def _layout(message: Any) -> tuple[Any, ...]:
    """All that decides how a message's frames are read and written."""
    return (
        message.name, message.frame_id, message.is_extended_frame, message.is_fd, message.length,
        message.cycle_time, message.is_container,
        tuple(sorted(map(_signal_layout, message.signals), key=repr)),
    )  # fmt: skip


def _signal_layout(signal: Any) -> tuple[Any, ...]:
    return (
        signal.name, signal.start, signal.length, signal.byte_order, signal.is_signed,
        signal.is_float, signal.scale, signal.offset, signal.minimum, signal.maximum, signal.unit,
        signal.is_multiplexer, signal.multiplexer_signal, repr(signal.multiplexer_ids),
        repr(signal.choices),
    )  # fmt: skip


def _load(path: Path, *, strict: bool) -> Any:
    from cantools.database.errors import Error, UnsupportedDatabaseFormatError

    try:
        loaded = copy.copy(_parsed(path, path.read_bytes(), strict))
    except FileNotFoundError:
        raise InputError(path, "", "no such file", "check the path") from None
    except OSError as error:
        raise InputError(path, "", f"cannot be read: {error.strerror}") from None
    except UnsupportedDatabaseFormatError as error:
        raise _refused(path, error, strict) from None
    except Error as error:
        raise _refused(path, error, strict) from None
    except Exception as error:  # parsers of foreign files fail in ways nobody can list
        problem = f"not readable as a CAN database: {type(error).__name__}: {error}"
        raise InputError(path, "", problem, "mend the file") from None
    if not hasattr(loaded, "messages"):
        raise InputError(path, "", "holds no CAN messages (a diagnostics file?)", "give a DBC")
    return loaded


@functools.lru_cache(maxsize=8)
def _parsed(path: Path, _content: bytes, strict: bool) -> Any:
    """Once for each content: an eighth of a second for ours. Nobody changes what is returned."""
    from cantools import database

    return database.load_file(path, strict=strict)


def find_message(database: Any, name: str) -> Any | None:
    """The message called ``name``, or None; :class:`InputError` where there are several."""
    found = [message for message in database.messages if message.name == name]
    if len(found) > 1:
        raise InputError(
            getattr(database, "eps_hil_files", "database"), name,
            f"{len(found)} different messages have this name", "keep the one that is meant",
        )  # fmt: skip
    return found[0] if found else None


def nearest(name: str, known: Iterable[str]) -> str:
    """``"nearest: A, B"`` for a person who mistyped ``name``; what exists if nothing is near."""
    names = list(known)
    lower = {each.lower(): each for each in names}
    close = difflib.get_close_matches(name.lower(), list(lower), n=3, cutoff=0.5)
    if close:
        return "nearest: " + ", ".join(lower[each] for each in close)
    shown = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
    return f"there is: {shown}" if names else "there is none"


def _refused(path: Path, error: Any, strict: bool) -> InputError:
    """Syntax and consistency told apart: the second may be read with ``strict: false``."""
    from cantools.database.errors import Error, ParseError

    reason = error
    for suffix in (path.suffix.lower(), ".dbc"):
        reason = getattr(error, f"e_{suffix[1:]}", None) or reason
        if reason is not error:
            break
    if isinstance(reason, Error) and not isinstance(reason, ParseError):
        remedy = "mend the file, or set 'strict: false' in the mapping" if strict else "mend it"
        return InputError(path, "", f"inconsistent database: {reason}", remedy)
    said = re.split(r": \"", str(reason), maxsplit=1)[0]  # textparser repeats the line itself
    return InputError(path, "", f"not a CAN database: {said}", "mend the file at that place")
