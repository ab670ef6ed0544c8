"""``eps-hil run`` with several configurations."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from eps_hil.bus.port import Port, open_port
from eps_hil.cli._several import check, names_of, of_rig
from eps_hil.cli.main import main

ROOT = Path(__file__).parents[2]


def written(path: Path, port: int, more: str = "") -> Path:
    path.write_text(
        f"bus: {{interface: udp_multicast, channel: 239.74.163.84, fd: true,\n"
        f"      options: {{port: {port}, hop_limit: 0}}}}\n"
        f"dbc: {ROOT}/dbc/eps_rig.dbc\nsignals: {ROOT}/configs/eps_rig_signals.yaml\n"
        f"model: {ROOT}/configs/reference_rig.yaml\n{more}"
    )
    return path


def test_two_rigs_cannot_publish_one_message_on_one_bus(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = written(tmp_path / "a.yaml", 43184), written(tmp_path / "b.yaml", 43184)
    assert main(["run", "--config", str(one), "--config", str(other)]) == 2
    assert "a.yaml publishes EPSHIL_Estimate (0x120) on this bus too" in capsys.readouterr().err
    check([one, written(tmp_path / "b.yaml", 43185)])
    check([one, written(tmp_path / "b.yaml", 43184, "publish: {enabled: false}\n")])


def test_two_rigs_on_one_bus_need_ids_of_their_own_for_all_that_they_send(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By id, whatever the database calls it; friction levels and suggestions too."""
    text = (ROOT / "dbc" / "eps_rig.dbc").read_text()
    for name in ("Estimate", "Health", "Verdict"):
        text = text.replace(f"EPSHIL_{name}", f"Second_{name}")
    same, other = tmp_path / "same.dbc", tmp_path / "other.dbc"
    same.write_text(text)
    for can_id, moved in ((288, 298), (289, 299), (1024, 1025)):
        text = re.sub(
            rf"^(BO_|CM_ (?:BO_|SG_)|VAL_) {can_id} ", rf"\g<1> {moved} ", text, flags=re.M
        )
        text = re.sub(rf"^(BA_ .*(?:BO_|SG_)) {can_id} ", rf"\g<1> {moved} ", text, flags=re.M)
    other.write_text(text)
    publish = "publish: {message: Second_Estimate, health_message: Second_Health"
    verdict, publish = f"{publish}}}\n", f"{publish}, verdict_message: Second_Verdict}}\n"
    one = written(tmp_path / "a.yaml", 43184)

    def second(dbc: Path, more: str = "") -> Path:
        path = written(tmp_path / "b.yaml", 43184, publish + more)
        path.write_text(path.read_text().replace(str(ROOT / "dbc" / "eps_rig.dbc"), str(dbc)))
        return path

    assert main(["run", "--config", str(one), "--config", str(second(same))]) == 2
    assert "publishes Second_Estimate (0x120) on this bus too" in capsys.readouterr().err
    check([one, second(other)])
    shared = written(tmp_path / "b.yaml", 43184, verdict)
    assert main(["run", "--config", str(one), "--config", str(shared)]) == 2
    assert "publishes EPSHIL_Verdict (0x121) on this bus too" in capsys.readouterr().err
    adaptation = "adaptation: {method: none}\n"
    one = written(tmp_path / "a.yaml", 43184, adaptation)
    assert main(["run", "--config", str(one), "--config", str(second(other, adaptation))]) == 2
    assert "publishes EPSHIL_FrictionLevels (0x150)" in capsys.readouterr().err


def test_names_and_files_of_each_rig() -> None:
    assert names_of([Path("x/a.yaml"), Path("x/b.yaml")]) == ["a", "b"]
    assert names_of([Path("x/a.yaml"), Path("y/a.yaml")]) == ["x/a.yaml", "y/a.yaml"]
    assert of_rig(Path("logs/e.csv"), "rig1") == Path("logs/e-rig1.csv")


@pytest.mark.slow
def test_a_killed_service_comes_back_and_the_other_never_notices(tmp_path: Path) -> None:
    configs = [
        written(tmp_path / f"{name}.yaml", port) for name, port in (("a", 43186), ("b", 43187))
    ]
    words = [sys.executable, "-m", "eps_hil.cli", "run", "--config", str(configs[0])]
    words += ["--config", str(configs[1]), "--journal", str(tmp_path / "j.jsonl")]
    words += ["--log-estimates", str(tmp_path / "e.csv")]
    ready: list[str] = []
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as fleet:
        assert fleet.stdout is not None
        for line in fleet.stdout:
            if line == "READY\n":
                break
        children = Path(f"/proc/{fleet.pid}/task/{fleet.pid}/children").read_text().split()
        assert len(children) == 2
        os.kill(int(children[0]), signal.SIGKILL)
        for line in fleet.stdout:
            ready.append(line)
            if line == "[a] READY\n":
                break
        fleet.terminate()
        rest = fleet.stdout.read()
    assert fleet.returncode == 0
    assert "[a] ended with status -9; started anew in 1 s\n" in ready
    assert not any(line.startswith("[b]") for line in ready)
    assert rest.count("] steps      ") == 2  # both end with their summaries
    logs = sorted(path.name for path in tmp_path.glob("e-*.csv"))
    assert logs == ["e-a.csv", "e-a_0002.csv", "e-b.csv"]  # the log of before is kept


class Estimates(threading.Thread):
    """What one rig's bus is told: (when, status of the DBC) of every estimate."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        options = {"port": port, "hop_limit": 0}
        self._port: Port = open_port(
            "udp_multicast", "239.74.163.84", fd=True, receive_ids=[0x120], options=options
        )
        self.seen: list[tuple[float, int]] = []
        self.over = threading.Event()

    def run(self) -> None:
        while not self.over.is_set():
            for frame in self._port.recv(0.1):
                self.seen.append((frame.t_ns * 1e-9, frame.data[1] >> 4 & 3))
        self._port.close()

    def wait_valid(self, count: int = 500, within_s: float = 60) -> None:
        until_s = time.monotonic() + within_s
        while sum(status == VALID for _, status in self.seen[-count:]) < count:
            assert time.monotonic() < until_s, self.seen[-5:]
            time.sleep(0.05)

    def since(self, when_s: float) -> list[int]:
        return [status for at, status in self.seen if at > when_s]


VALID = 2


@pytest.mark.slow
def test_a_rig_and_a_service_that_die_leave_the_other_rig_valid(tmp_path: Path) -> None:
    """Two simulated rigs on two buses under one command; one loses its service, then its rig."""
    more = "rig: {manoeuvre: weave, loop: true}\nservice: {realtime: auto}\n"
    ports = {"a": 43188, "b": 43189}
    configs = {name: written(tmp_path / f"{name}.yaml", ports[name], more) for name in ports}
    words = [sys.executable, "-m", "eps_hil.cli"]
    both = [word for path in configs.values() for word in ("--config", str(path))]
    rigs, heard = {}, {name: Estimates(port) for name, port in ports.items()}
    with subprocess.Popen(
        [*words, "run", *both, "--journal", str(tmp_path / "j.jsonl")],
        stdout=subprocess.PIPE, text=True,
    ) as fleet:  # fmt: skip
        try:
            assert fleet.stdout is not None
            for line in fleet.stdout:
                if line == "READY\n":
                    break
            for name, path in configs.items():
                heard[name].start()
                rigs[name] = subprocess.Popen(
                    [*words, "rig", "--config", str(path)], stdout=subprocess.DEVNULL
                )
            for each in heard.values():
                each.wait_valid(within_s=180)  # the rigs may have to compile first
            began_s = time.time()
            children = Path(f"/proc/{fleet.pid}/task/{fleet.pid}/children").read_text().split()
            os.kill(int(children[0]), signal.SIGKILL)
            for line in fleet.stdout:
                if line == "[a] READY\n":
                    break
            again_s = time.time()
            time.sleep(0.2)
            heard["a"].wait_valid()
            assert heard["a"].since(again_s)
            rigs["a"].kill()
            time.sleep(1.5)
            assert set(heard["a"].since(time.time() - 0.5)) == {3}  # invalid: no input
        finally:
            fleet.terminate()
            ended_s = time.time()
            for rig in rigs.values():
                rig.kill()
                rig.wait()
            for each in heard.values():
                each.over.set()
    other = [status for at, status in heard["b"].seen if began_s < at < ended_s]
    assert len(other) > 0.9e3 * (ended_s - began_s)
    assert set(other) == {VALID}
