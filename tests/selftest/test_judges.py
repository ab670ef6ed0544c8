"""Each line of the self-test against machines with one shortcoming."""

import time
from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.selftest import bus_listen, compute, disk, sockets, system, wake_ups
from eps_hil.selftest.check import (
    Check,
    Verdict,
    graded,
    graded_least,
    guarded,
    overall,
)
from eps_hil.selftest.wake_ups import WakeUps

GOOD = WakeUps(3.0, 20.0, 60.0, 300.0, 0, True, "", True, busy=0.1, stolen=0.0)
PLAIN = replace(GOOD, fifo=False, refused="normal priority", locked=False)


def line(verdict: Verdict) -> Check:
    return Check("x", "x", "", "", verdict)


def by_id(lines: list[Check]) -> dict[str, Check]:
    return {each.id: each for each in lines}


def test_the_worst_line_is_the_verdict_and_facts_do_not_count() -> None:
    lines = [line(Verdict.TOLD), line(Verdict.UNKNOWN), line(Verdict.GOOD)]
    assert overall(lines) == Verdict.GOOD
    assert overall([*lines, line(Verdict.LIMITED)]) == Verdict.LIMITED
    assert overall([line(Verdict.NOT_GOOD), line(Verdict.LIMITED)]) == Verdict.NOT_GOOD
    assert overall([line(Verdict.TOLD)]) == Verdict.UNKNOWN


def test_grades_at_their_limits() -> None:
    verdicts = [graded(value, 1.0, 2.0) for value in (1.0, 2.0, 2.1, float("nan"))]
    assert verdicts == [Verdict.GOOD, Verdict.LIMITED, Verdict.NOT_GOOD, Verdict.NOT_GOOD]
    verdicts = [graded_least(value, 2.0, 1.0) for value in (2.0, 1.0, 0.9)]
    assert verdicts == [Verdict.GOOD, Verdict.LIMITED, Verdict.NOT_GOOD]


def test_what_cannot_be_measured_is_a_line_and_no_traceback() -> None:
    def fails() -> list[Check]:
        raise ZeroDivisionError("on this machine")

    (said,) = guarded("clock", "the clock", fails)
    assert said.verdict == Verdict.UNKNOWN
    assert said.reason == "ZeroDivisionError: on this machine"


def test_with_real_time_priority_only_its_own_wake_ups_count() -> None:
    bad = replace(PLAIN, p99_us=9_000.0, max_us=40_000.0)
    lines = by_id(wake_ups.judge(bad, GOOD))
    assert lines["wake_ups_normal"].verdict == Verdict.TOLD
    assert lines["wake_ups_fifo"].verdict == Verdict.GOOD


def test_without_it_the_normal_ones_count() -> None:
    bad = replace(PLAIN, p99_us=9_000.0)
    lines = by_id(wake_ups.judge(bad, PLAIN))
    assert lines["wake_ups_normal"].verdict == Verdict.NOT_GOOD
    assert "PREEMPT_RT" in lines["wake_ups_normal"].remedy
    assert "wake_ups_fifo" not in lines


@pytest.mark.parametrize(
    ("late", "verdict"),
    [
        (replace(GOOD, p99_us=501.0), Verdict.LIMITED),
        (replace(GOOD, p99_us=1_001.0), Verdict.NOT_GOOD),
        (replace(GOOD, max_us=6_000.0), Verdict.LIMITED),
        (replace(GOOD, max_us=16_000.0), Verdict.NOT_GOOD),
    ],
)
def test_late_wake_ups(late: WakeUps, verdict: Verdict) -> None:
    assert by_id(wake_ups.judge(PLAIN, late))["wake_ups_fifo"].verdict == verdict


def test_a_host_that_takes_cpu_time() -> None:
    lines = by_id(wake_ups.judge(PLAIN, replace(GOOD, stolen=0.02)))
    assert lines["load"].verdict == Verdict.NOT_GOOD
    assert "load" not in by_id(wake_ups.judge(replace(PLAIN, busy=None), replace(GOOD, busy=None)))


def test_rights_that_are_refused_name_what_to_write() -> None:
    lines = by_id(wake_ups.judge_rights(PLAIN, "0", "8388608"))
    assert {each.verdict for each in lines.values()} == {Verdict.LIMITED}
    assert "rtprio 50" in lines["sched_fifo"].remedy
    assert "rtprio limit 0" in lines["sched_fifo"].reason
    assert "memlock limit 8388608" in lines["mlock"].reason
    granted = by_id(wake_ups.judge_rights(GOOD, "50", "unlimited"))
    assert {each.remedy for each in granted.values()} == {""}


def test_deadlines_that_passed_count_as_late_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """One sleep of 5.2 ms is five late wake-ups, or a pause would hardly show in p99."""
    now = [0]
    monkeypatch.setattr(time, "monotonic_ns", lambda: now[0])

    def sleep(seconds: float) -> None:
        now[0] += round(seconds * 1e9) + (5_200_000 if now[0] == 10_000_000 - 1_000_000 else 0)

    now[0] = -1_000_000
    monkeypatch.setattr(time, "sleep", sleep)
    late, missed = wake_ups._sleep(0.02)
    assert missed == 5
    assert sorted(late)[-6:] == [200_000, 1_200_000, 2_200_000, 3_200_000, 4_200_000, 5_200_000]


def test_cpu_and_governor() -> None:
    one = system.Cpu("x", 1, ("powersave", "performance"), False)
    lines = by_id(system.judge_cpu(one))
    assert lines["cpus"].verdict == Verdict.LIMITED
    assert lines["governor"].verdict == Verdict.LIMITED
    lines = by_id(system.judge_cpu(system.Cpu("x", 4, (), True)))
    assert lines["cpus"].verdict == Verdict.GOOD
    assert lines["governor"].verdict == Verdict.TOLD


def test_coarse_timers_are_not_good() -> None:
    fine = system.Kernel("6.1", "PREEMPT", 250, 1e-9, 50_000, 950_000)
    assert by_id(system.judge_kernel(fine))["timers"].verdict == Verdict.GOOD
    coarse = replace(fine, timer_resolution_s=4e-3, hz=None, timer_slack_ns=None)
    assert by_id(system.judge_kernel(coarse))["timers"].verdict == Verdict.NOT_GOOD


def test_clocks() -> None:
    good = system.Clock("tsc", 60.0, True, 1e-5, 1e-3)
    assert {each.verdict for each in system.judge_clock(good)} == {Verdict.GOOD}
    lines = by_id(system.judge_clock(system.Clock("acpi_pm", 4_000.0, False, 0.0, 16.0)))
    assert lines["clock_source"].verdict == Verdict.LIMITED
    assert lines["clock_steps"].verdict == Verdict.LIMITED


def test_old_and_missing_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "_version", {"numpy": "1.26.4"}.get)
    monkeypatch.setattr(system, "_least_versions", lambda: {"numpy": "2.0", "scipy": "1.13"})
    lines = by_id(system.python_and_libraries())
    assert lines["python"].verdict == Verdict.NOT_GOOD
    assert "numpy 1.26.4" in lines["python"].remedy
    assert "scipy missing" in lines["python"].remedy
    assert lines["extras"].verdict == Verdict.TOLD
    assert "dashboard, e2e, fleet, fmu, mcap, mf4, parquet, report" in lines["extras"].measured


def test_versions_compare_as_numbers() -> None:
    assert system._numbers("1.10.2") > system._numbers("1.9")
    assert system._numbers("0.60.0rc1") >= system._numbers("0.60")


def test_step_and_pauses() -> None:
    slow = compute.StepCost("3 frames", 0.1, 200.0, 600.0)
    assert compute.judge_step(slow).verdict == Verdict.NOT_GOOD
    assert "(normal priority)" in compute.judge_step(slow).measured
    assert compute.judge_step(replace(slow, p99_us=100.0)).verdict == Verdict.GOOD
    assert compute.judge_collections(compute.Pauses(50.0, 0.5)).verdict == Verdict.LIMITED


def test_a_cache_that_cannot_be_written(tmp_path: Path) -> None:
    assert compute.judge_cache(tmp_path).verdict == Verdict.GOOD
    assert compute.judge_cache(compute.compiled_cache()).verdict == Verdict.GOOD
    missing = compute.judge_cache(tmp_path / "none")
    assert missing.verdict == Verdict.LIMITED
    assert "XDG_CACHE_HOME" in missing.remedy


def test_a_small_receive_buffer_stops_socketcan_and_limits_udp() -> None:
    small = sockets.Room(212_992, 278)  # the kernel's default
    assert sockets.judge_room(small, socketcan=True).verdict == Verdict.NOT_GOOD
    assert sockets.judge_room(small, socketcan=False).verdict == Verdict.NOT_GOOD
    middle = sockets.Room(1 << 20, 1_500)
    assert sockets.judge_room(middle, socketcan=False).verdict == Verdict.LIMITED
    assert sockets.judge_room(middle, socketcan=True).verdict == Verdict.NOT_GOOD
    assert "rmem_max" in sockets.judge_room(middle, socketcan=True).remedy


def test_the_room_is_what_really_stays_unread() -> None:
    small, large = sockets.receive_room(64 << 10), sockets.receive_room(256 << 10)
    assert 20 < small.frames < large.frames
    assert sockets.software_stamps().verdict == Verdict.GOOD


def test_loopback() -> None:
    late = sockets.Loopback(1_000, 100.0, 800.0, True)
    assert sockets.judge_loopback(late).verdict == Verdict.LIMITED


def test_disks(tmp_path: Path) -> None:
    fine = disk.Disk(tmp_path, 100.0, 0.01, 10**12)
    assert {each.verdict for each in disk.judge(fine, 5_490.0)} == {Verdict.GOOD}
    slow = disk.Disk(tmp_path, 1.0, 3.0, 10**9)
    lines = by_id(disk.judge(slow, 5_490.0))
    assert lines["disk_speed"].verdict == Verdict.LIMITED
    assert lines["disk_wait"].verdict == Verdict.NOT_GOOD
    assert lines["disk_room"].verdict == Verdict.NOT_GOOD
    assert disk.refused(tmp_path, PermissionError(13, "Permission denied")).verdict == (
        Verdict.NOT_GOOD
    )


def test_the_disk_is_measured_and_left_clean(tmp_path: Path) -> None:
    found = disk.measure(tmp_path, 1)
    assert found.mb_s > 0
    assert found.free_bytes > 0
    assert list(tmp_path.iterdir()) == []


def test_a_silent_bus_is_no_shortcoming_of_the_pc() -> None:
    silent = bus_listen.Heard(0, (0.0, 0.0), 0.0, 1_000.0, 0)
    assert [each.verdict for each in bus_listen.judge(silent, "can0")] == [Verdict.UNKNOWN]
    slow = bus_listen.Heard(3_000, (50.0, 200.0), 900.0, 1_000.0, 5)
    lines = by_id(bus_listen.judge(slow, "can0"))
    assert lines["bus"].verdict == Verdict.LIMITED
    assert lines["sync_rate"].verdict == Verdict.LIMITED
