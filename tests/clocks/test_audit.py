"""Injected drifts, offsets, steps and losses are found; healthy stamps have none."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.clocks.audit import audit
from eps_hil.clocks.cadence import cadence, resolution_ns
from eps_hil.clocks.corrected import write_corrected
from eps_hil.recordings.can_log import read_tagged_frames

Write = Callable[..., Path]


def test_ten_ppm_and_a_fifth_of_a_millisecond_between_channels_are_found(write_log: Write) -> None:
    found = audit(write_log(offset_s=2e-4, drift_ppm=10.0))
    (pair,) = found.pairs
    sign = 1.0 if pair.channel == "can1" else -1.0
    # the medians of both channels' lateness (10 and 5.5 us) are part of an offset
    assert sign * pair.offset_s == pytest.approx(2e-4, abs=7e-6)
    assert sign * pair.drift_ppm == pytest.approx(10.0, abs=0.2)
    assert not pair.line.steps


def test_the_quartz_of_each_sender_is_found_and_its_losses(write_log: Write) -> None:
    found = audit(write_log())
    (channel,) = [one for one in found.channels if one.channel.name == "can0"]
    told = {message.can_id: clock for message, clock in channel.messages}
    for can_id, ppm in ((0x101, 0.0), (0x110, 12.0), (0x120, -30.0)):
        clock = told[can_id]
        assert clock is not None
        assert clock.drift_ppm == pytest.approx(ppm, abs=0.1)
        assert clock.steps == ()
    fast = told[0x101]
    assert fast is not None
    frames = {m.can_id: len(m.t_ns) for m, _ in channel.messages}
    assert abs(fast.lost - (30_000 - frames[0x101])) <= 1
    assert fast.late_p50_s == pytest.approx(10e-6, abs=4e-6)
    assert channel.steps == ()
    assert channel.source.startswith("software")


@pytest.mark.parametrize("step_s", [2e-4, 1e-4])
def test_a_step_of_the_clock_is_told_from_a_message_that_slipped(
    write_log: Write, step_s: float
) -> None:
    found = audit(write_log(step_s=step_s, slip_s=4e-3))
    (channel,) = [one for one in found.channels if one.channel.name == "can0"]
    (step,) = channel.steps
    assert step.by_s == pytest.approx(step_s, rel=0.05)
    assert step.at_s == pytest.approx(17.0, abs=0.6)
    ((name, slip),) = channel.slipped
    assert name == "0x120"
    assert slip.by_s == pytest.approx(4e-3, rel=0.02)
    assert slip.at_s == pytest.approx(12.0, abs=0.6)


@pytest.mark.slow
def test_coarse_stamps_are_said_to_be_coarse_and_show_no_steps(write_log: Write) -> None:
    found = audit(write_log(resolution_ns=1_000_000))
    for channel in found.channels:
        assert channel.source == "coarse: whole multiples of 1 ms"
        assert channel.steps == ()
        for _, clock in channel.messages:
            assert clock is not None
            assert clock.steps == ()
            assert clock.drift_ci95 is not None
            assert (
                clock.drift_ci95[0]
                < {1e-3: 0.0, 2e-3: 12.0, 1e-2: -30.0}[clock.nominal_s or 0.0]
                < clock.drift_ci95[1]
            )


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".log", ".mf4"])
def test_the_corrected_copy_has_one_clock(write_log: Write, tmp_path: Path, suffix: str) -> None:
    if suffix == ".mf4":
        pytest.importorskip("asammdf")
    found = audit(write_log(offset_s=2e-4, drift_ppm=10.0, step_s=5e-4))
    target = tmp_path / f"one_clock{suffix}"
    assert write_corrected(found, target) == sum(len(one.channel.t_ns) for one in found.channels)
    (pair,) = audit(target).pairs
    assert abs(pair.offset_s) < 2e-6
    assert abs(pair.drift_ppm) < 0.1
    assert not pair.line.steps
    assert all(one.steps == () for one in audit(target).channels)


def test_a_message_without_a_cycle_has_no_clock() -> None:
    rng = np.random.default_rng(1)
    t_ns = np.cumsum(rng.exponential(1e7, 500)).astype(np.int64)
    assert cadence(t_ns, 0) is None
    assert cadence(np.arange(10, dtype=np.int64) * 10**7, 0) is None


@pytest.mark.parametrize("step", [1, 100, 1_000, 1_000_000])
def test_the_resolution_of_stamps(step: int) -> None:
    t_ns = step * np.arange(1, 1_001, 3, dtype=np.int64)
    assert resolution_ns(t_ns) == step


def test_the_verb_says_writes_and_refuses(
    write_log: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(offset_s=2e-4, seconds=10.0)
    out = tmp_path / "clocks.json"
    assert main(["clocks", str(log), "--json", str(out)]) == 0
    said = capsys.readouterr().out
    assert "best stamps on can1" in said
    assert "can0 against can1: -0.1" in said
    content = json.loads(out.read_text())
    assert content["schema"] == "eps-hil/clocks/1"
    assert {one["channel"] for one in content["channels"]} == {"can0", "can1"}
    assert main(["clocks", str(log), "--out", str(tmp_path / "copy.blf")]) == 0
    assert {name for name, _ in read_tagged_frames(tmp_path / "copy.blf")} == {"1", "2"}
    assert main(["clocks", str(log), "--out", str(tmp_path / "copy.csv")]) == 2
    assert "can be written; use .log, .blf, .asc, .mf4" in capsys.readouterr().err
    empty = tmp_path / "empty.log"
    empty.write_text("\n")
    assert main(["clocks", str(empty)]) == 2
    assert "empty.log: holds no CAN frame" in capsys.readouterr().err


def test_one_number_in_both_formats_has_two_names(tmp_path: Path) -> None:
    log = tmp_path / "x.log"
    log.write_text("".join(f"(1700000000.{k:06d}) can0 {i}#00\n" for k in range(9)
                           for i in ("123", "00000123")))  # fmt: skip
    (channel,) = audit(log).content()["channels"]
    assert [one["id"] for one in channel["messages"]] == ["0x123", "0x00000123"]
