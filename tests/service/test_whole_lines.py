"""A file on a disk that fills up ends with a whole line, and grows on when there is room."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from eps_hil.service.whole_lines import WholeLines

FULL = """
from pathlib import Path
from eps_hil.service.whole_lines import WholeLines
folder = Path(FOLDER)
(folder / "ballast").write_bytes(bytes(100_000))
line = "x" * 999 + chr(10)
lines, written = WholeLines(folder / "log", "w"), 0
try:
    for _ in range(1_000):
        lines.append(line * 7)
        written += 7
except OSError as error:
    print(error.strerror)
print((folder / "log").read_text() == line * written, 0 < written < 300)
(folder / "ballast").unlink()
lines.append(line)
print((folder / "log").read_text() == line * (written + 1))
"""


def test_a_real_disk_that_is_full_holds_whole_lines(tmp_path: Path) -> None:
    cage = ["unshare", "--mount", "--map-root-user"]
    if shutil.which("unshare") is None or subprocess.run([*cage, "true"], check=False).returncode:
        pytest.skip("no rights to mount a small disk (unshare --mount); run as root")
    inside = f'mount -t tmpfs -o size=200k small {tmp_path} && exec "$0" -c "$1"'
    words = [*cage, "sh", "-c", inside, sys.executable, FULL.replace("FOLDER", repr(str(tmp_path)))]
    run = subprocess.run(words, check=False, capture_output=True, text=True, timeout=60)
    assert run.stdout == "No space left on device\nTrue True\nTrue\n", run.stderr


def test_appending_goes_on_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "j"
    for text in ("one\n", "two\n"):
        lines = WholeLines(path, "a")
        lines.append(text)
        lines.close()
    assert path.read_text() == "one\ntwo\n"
    lines = WholeLines(path, "w")
    lines.append("three\n")
    lines.close()
    assert path.read_text() == "three\n"
