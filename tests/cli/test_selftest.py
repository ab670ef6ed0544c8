"""``eps-hil selftest`` as a user meets it."""

import json
from pathlib import Path

import pytest

from eps_hil.cli import selftest
from eps_hil.cli.main import main
from eps_hil.selftest import (
    can_interface,
    compute,
    disk,
    run,
    sockets,
    system,
    wake_ups,
)
from eps_hil.selftest.check import Check, Verdict, guarded
from eps_hil.service.config import load_config
from eps_hil.service.setup import prepare

ROOT = Path(__file__).parents[2]


def test_the_whole_of_it_measures_this_machine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "s.json"
    status = main(["selftest", "--quick", "--folder", str(tmp_path), "--json", str(file)])
    out = capsys.readouterr()
    content = json.loads(file.read_text())
    verdicts = {line["verdict"] for line in content["checks"]}
    assert status == (1 if "not good" in verdicts else 0)
    assert content["schema"] == "eps-hil/selftest/1"
    assert out.out.splitlines()[-1].startswith(f"{content['verdict']}: ")
    measured = {line["id"]: line for line in content["checks"]}
    assert {"python", "wake_ups_normal", "step", "gc", "loopback", "disk_speed"} <= set(measured)
    assert measured["step"]["value"] > 1.0
    assert 0.0 < measured["wake_ups_normal"]["value"] < 1e6
    for line in content["checks"]:
        wanting = line["verdict"] in {"limited", "not good"}
        assert bool(line["remedy"]) or not wanting, line
        assert line["reason"] or line["verdict"] == "told", line
    assert out.err == ""  # no progress in a pipe


def scripted(monkeypatch: pytest.MonkeyPatch, *verdicts: Verdict) -> None:
    lines = [Check(f"c{k}", "a line", "1", "2", v, "why") for k, v in enumerate(verdicts)]
    monkeypatch.setattr(run, "checks", lambda plan, began: iter(lines))


@pytest.mark.parametrize(
    ("verdict", "strict", "status"),
    [
        (Verdict.GOOD, False, 0),
        (Verdict.LIMITED, False, 0),
        (Verdict.LIMITED, True, 1),
        (Verdict.NOT_GOOD, False, 1),
        (Verdict.UNKNOWN, False, 1),
    ],
)
def test_status(
    monkeypatch: pytest.MonkeyPatch, verdict: Verdict, strict: bool, status: int
) -> None:
    scripted(monkeypatch, verdict)
    assert main(["selftest", *(["--strict"] if strict else [])]) == status


def test_a_machine_that_lacks_everything_gets_no_traceback(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every measurement fails in a way that nobody thought of."""

    def fails(*_: object, **__: object) -> None:
        raise RuntimeError("not on this machine")

    for module, names in (
        (system, ("facts", "clock")),
        (wake_ups, ("measure",)),
        (compute, ("compiled_cache", "service_step", "collections")),
        (sockets, ("loopback", "receive_room", "software_stamps")),
        (disk, ("measure",)),
        (can_interface, ("kernel_has_can",)),
    ):
        for name in names:
            monkeypatch.setattr(module, name, fails)
    assert main(["selftest", "--quick", "--folder", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert "unknown: nothing could be measured" in said.out
    assert "Traceback" not in said.out + said.err


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (line,) = run._disk(tmp_path / "none", 1, 1000.0)
    assert line.verdict == Verdict.NOT_GOOD


def test_a_wrong_configuration_is_status_2_before_anything_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "c.yaml"
    file.write_text("bus: [\n")
    assert main(["selftest", "--config", str(file)]) == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert said.out == ""


def test_a_result_that_cannot_be_written_is_refused_before_anything_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run, "checks", lambda *_: pytest.fail("it measures"))
    assert main(["selftest", "--json", str(tmp_path / "none" / "pc.json")]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_a_socketcan_configuration_asks_for_the_kernel_and_the_interface(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(
        f"bus: {{interface: socketcan, channel: can77}}\ndbc: {ROOT}/dbc/eps_rig.dbc\n"
        f"signals: {ROOT}/configs/eps_rig_signals.yaml\nmodel: {ROOT}/configs/reference_rig.yaml\n"
    )
    plan = run.Plan(file, 0.1, tmp_path, quick=True)
    parts = prepare(load_config(file), file)
    found = [
        line for id, what, measure in run._bus(plan, parts) for line in guarded(id, what, measure)
    ]
    assert found[0].id == "socketcan"
    assert Verdict.NOT_GOOD in {line.verdict for line in found}
    assert found[-1].verdict == Verdict.UNKNOWN  # the bus cannot be opened, and says why
    assert "can77" in found[-1].reason or "SocketCAN" in found[-1].reason


def test_the_table_shows_each_remedy() -> None:
    from io import StringIO

    from rich.console import Console

    lines = [Check("a", "a line", "9 ms", "1 ms", Verdict.NOT_GOOD, "the reason", "the remedy")]
    out = StringIO()
    selftest.show(Console(file=out, width=100), lines, Verdict.NOT_GOOD)
    assert "the remedy" in out.getvalue()
    assert "the reason" in out.getvalue()
