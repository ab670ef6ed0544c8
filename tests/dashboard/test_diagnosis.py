"""One diagnosis at a time, on samples as they were stamped, ended when nobody wants it."""

import asyncio
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.dashboard import diagnosis
from eps_hil.dashboard.diagnosis import Diagnoses, Subject
from eps_hil.dashboard.marks import Marks
from eps_hil.dashboard.order import Order
from eps_hil.dashboard.server import About, Hub
from eps_hil.dashboard.store import Block, Store

T0_S = 1_790_000_000.0
Blocks = Callable[[float, float], dict[str, Block]]
SAY_SAMPLES = """
import json, sys
import numpy as np
order = json.loads(sys.stdin.readline())
print(json.dumps({"stage": "looking", "part": 0.25}), flush=True)
with np.load(order["folder"] + "/samples.npz") as kept:
    told = {name: [int(kept[name][0]), int(kept[name][-1])] for name in kept if "|" in name}
open(order["folder"] + "/result.json", "w").write(json.dumps({"told": told, "order": order}))
open(order["folder"] + "/page.html", "w").write("<p>the report</p>")
print(json.dumps({"done": True}), flush=True)
"""
NEVER_ENDS = """
import json, os, sys, time
order = json.loads(sys.stdin.readline())
open(order["folder"] + "/../pid", "w").write(str(os.getpid()))
print(json.dumps({"stage": "thinking", "part": 0.5}), flush=True)
time.sleep(600)
"""
REFUSES = """
import json
print(json.dumps({"error": "moves for less than 4 s"}), flush=True)
"""


@pytest.fixture
def store(blocks: Blocks) -> Store:
    made = Store(60.0)
    made.append(blocks(0.0, 40.0))
    return made


@pytest.fixture
def diagnoses(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Diagnoses]:
    """``diagnoses(script)``: a process that runs ``script`` stands for the real one."""

    def make(script: str, **more: Any) -> Diagnoses:
        monkeypatch.setattr(diagnosis, "COMMAND", (sys.executable, "-c", script))
        measured = ("motor_torque_nm", "motor_speed_rad_s")
        return Diagnoses(Subject(Path("m.yaml"), measured, (1_000_000, 4_000_000), **more), "rig")

    return make


async def until(told: Callable[[], Any]) -> None:
    """Wait, on a busy machine too."""
    for _ in range(3000):
        if told():
            return
        await asyncio.sleep(0.02)
    raise AssertionError("never came")


def test_it_is_given_the_samples_as_they_were_stamped(
    diagnoses: Callable[..., Diagnoses], store: Store
) -> None:
    async def session() -> dict[str, Any]:
        one = diagnoses(SAY_SAMPLES)
        one.start(store, T0_S + 10.0, T0_S + 20.0)
        await until(lambda: one.as_json()["running"] is None)
        (found,) = one.as_json()["found"]
        report = one.report(1)
        assert report is not None
        assert report.read_text() == "<p>the report</p>"
        assert one.report(2) is None
        await one.close()
        assert not report.exists()
        return found

    found = asyncio.run(session())
    begin_ns, end_ns = round((T0_S + 10.0) * 1e9), round((T0_S + 20.0) * 1e9)
    assert found["told"] == {
        "motor_torque_nm|t_ns": [begin_ns + 1_000_000, end_ns + 1_000_000],
        "motor_speed_rad_s|t_ns": [begin_ns + 4_000_000, end_ns + 4_000_000],
    }
    assert (found["from_s"], found["to_s"]) == (T0_S + 10.0, T0_S + 20.0)


def test_a_recording_is_read_by_the_process_itself(
    diagnoses: Callable[..., Diagnoses], store: Store, tmp_path: Path
) -> None:
    script = SAY_SAMPLES.replace('np.load(order["folder"] + "/samples.npz")', "open('/dev/null')")

    async def session() -> dict[str, Any]:
        one = diagnoses(
            script,
            recording=tmp_path / "bus.log",
            dbc=(tmp_path / "a.dbc",),
            signals=tmp_path / "s",
        )
        one.start(store, T0_S + 10.0, T0_S + 20.0)
        await until(lambda: one.as_json()["running"] is None)
        (found,) = one.as_json()["found"]
        await one.close()
        return dict(found["order"])

    order = asyncio.run(session())
    assert order["recording"] == str(tmp_path / "bus.log")
    assert order["dbc"] == [str(tmp_path / "a.dbc")]


def test_one_at_a_time_with_progress_and_cancelled_at_once(
    diagnoses: Callable[..., Diagnoses], store: Store
) -> None:
    async def session() -> None:
        one = diagnoses(NEVER_ENDS)
        one.start(store, T0_S, T0_S + 20.0)
        await until(lambda: (one.as_json()["running"] or {}).get("part") == 0.5)
        assert one.as_json()["running"]["stage"] == "thinking"
        one.start(store, T0_S, T0_S + 30.0)
        assert one.as_json()["running"]["to_s"] == T0_S + 20.0, "the second has to wait"
        pid = int((Path(one._folder.name) / "pid").read_text())
        begun = time.monotonic()
        one.cancel()
        await until(lambda: one.as_json()["running"] is None)
        assert one.as_json() == {"running": None, "said": "cancelled", "found": []}
        await until(lambda: not alive(pid))
        assert time.monotonic() - begun < 60.0, "it did not wait for the end of the sleep"
        await one.close()

    asyncio.run(session())


def test_the_servers_end_ends_it(diagnoses: Callable[..., Diagnoses], store: Store) -> None:
    async def session() -> None:
        one = diagnoses(NEVER_ENDS)
        one.start(store, T0_S, T0_S + 20.0)
        await until(lambda: (one.as_json()["running"] or {}).get("part") == 0.5)
        pid = int((Path(one._folder.name) / "pid").read_text())
        await one.close()
        assert not alive(pid)

    asyncio.run(session())


def test_nothing_of_it_is_left_when_the_server_has_ended(
    diagnoses: Callable[..., Diagnoses], store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that is ended, but not waited for, would outlive the loop with its pipes."""
    made: list[asyncio.subprocess.Process] = []
    create = asyncio.create_subprocess_exec

    async def kept(*args: Any, **more: Any) -> asyncio.subprocess.Process:
        made.append(await create(*args, **more))
        return made[-1]

    monkeypatch.setattr(asyncio, "create_subprocess_exec", kept)

    async def session() -> None:
        one = diagnoses(NEVER_ENDS)
        one.start(store, T0_S, T0_S + 20.0)
        await until(lambda: (one.as_json()["running"] or {}).get("part") == 0.5)
        await one.close()
        (process,) = made
        assert process.returncode is not None
        assert process._transport.is_closing(), "its pipes are closed"  # type: ignore[attr-defined]

    asyncio.run(session())


def alive(pid: int) -> bool:
    """Whether a process runs; one that is only not waited for yet does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_what_the_samples_lack_is_said(diagnoses: Callable[..., Diagnoses], store: Store) -> None:
    async def said(begin_s: float, end_s: float, of: Store = store) -> str:
        one = diagnoses(REFUSES)
        one.start(of, begin_s, end_s)
        await until(lambda: one.as_json()["running"] is None)
        await one.close()
        return str(one.as_json()["said"])

    assert asyncio.run(said(T0_S, T0_S + 20.0)) == "moves for less than 4 s"
    assert "mark 8 s or more" in asyncio.run(said(T0_S, T0_S + 5.0))
    assert "mark 8 s or more" in asyncio.run(said(T0_S, float("nan")))
    assert "at most 15 min" in asyncio.run(said(T0_S, T0_S + 5000.0))
    assert "not kept" in asyncio.run(said(T0_S - 100.0, T0_S - 50.0))
    assert "nothing to diagnose" in asyncio.run(said(T0_S, T0_S + 20.0, Store(60.0)))


@pytest.mark.parametrize(
    ("peer", "anyone", "may"),
    [
        ("127.0.0.1", False, True),
        ("::1", False, True),
        ("192.168.1.7", False, False),
        ("192.168.1.7", True, True),
        ("", False, False),
    ],
)
def test_who_may_start_one(store: Store, peer: str, anyone: bool, may: bool) -> None:
    hub = Hub(About("rig"), store, Marks(None), Subject(Path("m.yaml")), anyone=anyone)
    assert hub.may_diagnose(peer) is may
    assert hub.layout(peer)["may_diagnose"] is may
    assert not Hub(About("rig"), store, Marks(None)).may_diagnose("127.0.0.1")


def test_an_order_survives_its_way(tmp_path: Path) -> None:
    order = Order("rig", 1, 2, "m.yaml", str(tmp_path), dbc=("a", "b"))
    again = json.loads(order.line())
    assert Order(**{**again, "dbc": tuple(again["dbc"])}) == order


def test_memory_is_bounded(blocks: Blocks) -> None:
    """Whatever comes, a live store keeps its window, in no more than twice the room."""
    store = Store(5.0)
    for second in range(30):
        store.append(blocks(float(second), second + 1.0))
    for name in ("motor_torque_nm", "motor_speed_rad_s"):
        track = store.tracks[name]
        assert len(track.t_ns) == 5001
        assert len(track._t_ns) < 3 * 5001
    assert np.isfinite(store.tracks["motor_torque_nm"].value).all()
