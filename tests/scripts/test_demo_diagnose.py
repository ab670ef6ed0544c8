"""``scripts/demo-diagnose``: hides, records over a bus, names, and shows the better rack force."""

import math
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from eps_hil.physics.effects.catalogue import catalogue
from tests.loaded import loaded

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "demo_diagnose.py"


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, SCRIPT, *arguments], capture_output=True, text=True, check=False
    )


def test_what_it_cannot_hide_it_says() -> None:
    found = run("--effect", "gremlins")
    assert found.returncode == 1
    assert "'gremlins' is not for this demo: choose " in found.stderr
    known = found.stderr.rsplit("choose ", 1)[1].strip().split(", ")
    assert set(known) <= set(catalogue())
    assert len(known) >= 8


def test_an_estimate_is_compared_with_the_load_cell_of_its_own_moment() -> None:
    """Services say their lines at different moments: at 700 N and 2 Hz that is hundreds of N."""
    demo = loaded("scripts/demo_diagnose.py")

    def service(*moments: float, error: float) -> str:
        lines = ["READY", "rack force       +0 N  load cell        - N     0 Hz  no input"]
        for t in moments:
            cell = 700.0 * math.sin(4.0 * math.pi * t)
            lines.append(f"rack force {cell + error:+8.0f} N  load cell {cell:+8.0f} N   1000 Hz")
        return "\n".join(lines)

    cell, given = demo._errors(service(0.0, 0.125, error=-30.0))
    _, found = demo._errors(service(0.08, 0.2, 0.3, error=2.0))
    assert (cell, given) == (700, [-30, -30])
    assert len(found) == 3
    assert demo._rms(found) == pytest.approx(2.0, abs=1.0)


def test_where_something_must_be_compiled_it_says_so_before_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    demo = loaded("scripts/demo_diagnose.py")

    def ends(*_: object) -> None:
        raise SystemExit

    def said() -> str:
        with pytest.raises(SystemExit):
            demo.main()
        return str(capsys.readouterr().out.splitlines()[0])

    monkeypatch.setattr(demo, "record", ends)
    monkeypatch.setattr(sys, "argv", ["demo", "--out", str(tmp_path / "out")])
    monkeypatch.setattr(demo.compiled, "FOLDER", tmp_path)
    for part in demo.COMPILED:
        assert said().startswith("==> compiling for this machine comes first, once: some minutes")
        kept = tmp_path / "functions" / part / "deeper" / "kernel.nbi"
        kept.parent.mkdir(parents=True)
        kept.touch()
    assert said().startswith("==> an effect is hidden")
    monkeypatch.setattr(demo.compiled, "FOLDER", None)
    assert said().startswith("==> compiling")


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_it_names_what_it_hid_and_the_written_model_is_better(tmp_path: Path) -> None:
    found = run("--effect", "coulomb_level", "--seed", "1", "--out", str(tmp_path), "--no-open")
    assert found.returncode == 0, found.stdout[-2000:] + found.stderr[-2000:]
    lines = found.stdout.splitlines()
    shown = next(k for k, line in enumerate(lines) if "hidden was: coulomb_level" in line)
    assert not any("coulomb_level" in line for line in lines[: lines.index(_diagnosing(lines))])
    assert any(line.startswith("==> found:      coulomb_level") for line in lines[shown:])
    assert sum("load cell" in line and "written model" in line for line in lines) >= 5
    last = next(line for line in lines if "rms error against the load cell" in line)
    given, written = (float(one) for one in re.findall(r"([\d.]+) N", last))
    assert written < 0.7 * given
    assert (tmp_path / "page.html").stat().st_size > 10_000
    held = yaml.safe_load((tmp_path / "found.yaml").read_text())["model"]["effects"]
    assert "coulomb_level" in [one["effect"] for one in held]


def _diagnosing(lines: list[str]) -> str:
    return next(line for line in lines if line.startswith("==> eps-hil diagnose"))
