"""What an FMU's library prints goes nowhere: our output is what a pipe reads."""

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Within it, what C code of this process writes to the standard output is dropped."""
    _flush()
    try:
        kept = os.dup(1)
    except OSError:  # no standard output is there
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        _flush()
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def _flush() -> None:
    """Python's and C's own buffers; those of another C library than ours stay as they are."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        sys.stdout.flush()
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).fflush(None)
