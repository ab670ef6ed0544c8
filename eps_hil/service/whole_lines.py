"""A text file that grows by whole lines only, whatever the disk does."""

import io
import os
from pathlib import Path
from typing import Literal


class WholeLines:
    """An open file, ``w`` from its beginning or ``a`` at its end; OSError if it cannot be made."""

    def __init__(self, path: Path, mode: Literal["w", "a"]) -> None:
        self._file = io.FileIO(path, mode)

    def append(self, text: str) -> None:
        """All of it or nothing, handed to the system at once; OSError where the disk refuses."""
        whole_bytes = os.fstat(self._file.fileno()).st_size
        data = memoryview(text.encode())
        try:
            while data:  # a disk that is nearly full takes a part
                data = data[self._file.write(data) or 0 :]
        except OSError:
            os.ftruncate(self._file.fileno(), whole_bytes)
            self._file.seek(whole_bytes)
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()
