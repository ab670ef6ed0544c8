"""A text log line by line."""

import io
from pathlib import Path


class TextLines(io.TextIOWrapper):
    """A text file that knows its line; vendors write umlauts in whatever code page they have."""

    def __init__(self, path: Path) -> None:
        super().__init__(path.open("rb"), encoding="utf-8-sig", errors="replace")
        self.line = 0

    def __next__(self) -> str:  # type: ignore[override]  # as typeshed does itself
        self.line += 1
        return super().__next__()
