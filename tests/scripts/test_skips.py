"""CI's verdict on what was skipped (scripts/ci/skips.py)."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.loaded import loaded

ROOT = Path(__file__).parents[2]
CHECK = loaded("scripts/ci/skips.py")
MAY = """\
SKIPPED [2] tests/bus/conftest.py:40: no vcan0 on this machine (No such device); run scripts/ci
SKIPPED [1] tests/service/conftest.py:125: SocketCAN is NOT tested here: [Errno 97]; run scripts/ci
SKIPPED [3] tests/real/test_ford_gt350.py:116: REAL DATA MISSING: no normalsport.log; set EPS_HIL
SKIPPED [1] tests/bus/test_recorder.py:605: real-time priority is not permitted here (CAP_SYS_NICE)
SKIPPED [5] tests/stop_long.py:37: stopped: what it ran until then counts
"""


def test_a_machine_without_vcan_real_data_and_rights_is_no_fault() -> None:
    assert (
        CHECK.problems(f"....ss\n{MAY}3000 passed, 12 skipped, 2 warnings in 411.20s (0:06:51)\n")
        == []
    )
    assert CHECK.problems("3000 passed in 2.1s\n") == []


@pytest.mark.parametrize(
    "reason",
    [
        "could not import 'fmpy': No module named 'fmpy'",
        "systemd-analyze is not installed",
        "needs the 'fleet' extra",
        "no C compiler",
    ],
)
def test_what_is_not_installed_is_named(reason: str) -> None:
    line = f"SKIPPED [1] tests/fmu/test_export.py:19: {reason}\n"
    log = f"{MAY}12 skipped in 1.0s\n{line}9 passed, 1 skipped in 2.0s\n"
    assert CHECK.problems(log) == [f"skipped: tests/fmu/test_export.py:19: {reason}"]


def test_a_skip_whose_reason_is_not_told_is_one() -> None:
    assert CHECK.problems(f"{MAY}13 skipped in 2.0s\n") == [
        "13 tests were skipped, and the reasons of 12 are told"
    ]


def test_it_reads_what_pytest_writes(tmp_path: Path) -> None:
    (tmp_path / "test_one.py").write_text(
        "import pytest\ndef test_it(): pytest.importorskip('no_such_package')\n"
        "def test_other(): pytest.skip('REAL DATA MISSING: ' + 'x' * 300)\n"
    )
    (tmp_path / "test_two.py").write_text("import pytest\npytest.importorskip('no_such_other')\n")
    options = re.search(r'addopts = "(.*)"', (ROOT / "pyproject.toml").read_text())
    assert options is not None
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options[1].split()]
    said = subprocess.run(
        [*words, str(tmp_path)], cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {"COLUMNS": "80"},
    ).stdout  # fmt: skip
    found = CHECK.problems(said)
    assert len(found) == 2, said
    assert "test_one.py:2: could not import 'no_such_package'" in "\n".join(found)
    assert "no_such_other" in "\n".join(found)
    (tmp_path / "log").write_text(said)
    script = [sys.executable, str(ROOT / "scripts/ci/skips.py"), str(tmp_path / "log")]
    assert subprocess.run(script, capture_output=True, check=False).returncode == 1


def test_ci_asks_for_it_and_every_step_tells_its_reasons() -> None:
    """Kernel coverage, too, which has options of its own."""
    assert " -r fs " in (ROOT / "scripts" / "kernel_coverage").read_text()
    assert 'scripts/ci/skips.py "$logs/test"' in (ROOT / ".ci" / "run").read_text()
