"""The board on which programs say what they do."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from eps_hil.board import Notice, folder, notices


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    found = folder()
    assert found == tmp_path / "eps_hil"
    return found


def test_it_is_read_while_it_is_said_and_gone_after() -> None:
    notice = Notice("calibration", "can0", "torque injection")
    assert notices("can0") == []
    notice.put(text="ramp", done=1, of=6, gates=[{"name": "speed", "met": True}])
    notice.put(text="ramp up", done=2, of=6)
    (told,) = notices("can0")
    assert (told["kind"], told["title"], told["text"]) == (
        "calibration", "torque injection", "ramp up",
    )  # fmt: skip
    assert (told["done"], told["of"]) == (2, 6)
    assert notices("can1") == [], "another bus"
    notice.end()
    assert notices("can0") == []


def test_a_last_word_stays_for_a_while(place: Path) -> None:
    notice = Notice("programme", "can0", "friction map")
    notice.end(text="all cells are done")
    (told,) = notices("can0")
    assert told["ended"]
    (path,) = place.glob("*.json")
    os.utime(path, (1, 1))
    assert notices("can0") == []
    assert not path.exists()


def test_one_whose_program_was_killed_is_thrown_away(place: Path) -> None:
    said = "from eps_hil.board import Notice; Notice('rig', 'can0', 'r').put(text='x')"
    subprocess.run([sys.executable, "-c", said], check=True)
    assert len(list(place.glob("*.json"))) == 1
    assert notices("can0") == []
    assert not list(place.glob("*.json"))


def test_nothing_that_cannot_be_said_reaches_the_caller(place: Path) -> None:
    notice = Notice("rig", "can0", "rig")
    notice.put(text="good")
    notice.put(text="x" * 9000)
    notice.put(value=float("nan"))
    notice.put(value=object())
    (told,) = notices("can0")
    assert told["text"] == "good"
    (place / "broken.json").write_text("{")
    (place / "other.json").write_text(json.dumps([1]))
    assert len(notices("can0")) == 1
    notice.end()
    notice.put(text="after the end")
    assert notices("can0") == []


def test_without_a_runtime_folder_it_lies_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    if not os.access("/dev/shm", os.W_OK):
        pytest.skip("this machine has no /dev/shm")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert folder() == Path(f"/dev/shm/eps_hil-board-{os.getuid()}")


def test_a_folder_that_others_may_write_is_not_taken(place: Path) -> None:
    place.chmod(0o777)
    found = folder()
    assert found is not None
    assert found != place
