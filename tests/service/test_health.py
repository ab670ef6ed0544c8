"""Figures about the service: lateness, rate, the health frame, the summary, the live line."""

import ctypes
import errno
import gc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.port import BusState, PortCounts
from eps_hil.errors import EpsHilError
from eps_hil.estimation.stream import Estimate
from eps_hil.estimation.validity import Reason
from eps_hil.service import realtime
from eps_hil.service.health import (
    TOTALS,
    Lateness,
    Loss,
    StepRate,
    Summary,
    health_values,
    totals_modulo,
)
from eps_hil.service.setup import Parts
from eps_hil.service.status_line import Snapshot

from .conftest import DATABASE, TinyRig

MS = 1_000_000
MODULO = totals_modulo(DATABASE.get_message_by_name("EPSHIL_Health"))


@given(st.lists(st.integers(0, 15 * MS), min_size=1, max_size=200), st.floats(0.01, 1.0))
def test_quantile_is_that_of_the_sorted_list_to_a_microsecond(
    late: list[int], share: float
) -> None:
    lateness = Lateness()
    for each in late:
        lateness.add(each, MS)
    ordered = sorted(late)
    exact = next(v for k, v in enumerate(ordered) if k + 1 >= share * len(ordered))
    assert exact <= lateness.quantile_ns(share) <= exact + 1_000 or lateness.quantile_ns(
        share
    ) == max(late)
    assert lateness.max_ns == max(late)
    assert lateness.overruns == sum(each > MS for each in late)


def test_stamps_of_a_foreign_clock_are_left_out() -> None:
    lateness = Lateness()
    lateness.add(-5, MS)
    lateness.add(10**15, MS)
    assert lateness.count == 0
    assert lateness.quantile_ns(0.99) == 0


def test_recent_maximum_starts_anew() -> None:
    lateness = Lateness()
    lateness.add(3 * MS, MS)
    assert lateness.take_recent_max_ns() == 3 * MS
    assert lateness.take_recent_max_ns() == 0
    assert lateness.max_ns == 3 * MS


def test_rate_is_of_the_last_second() -> None:
    rate = StepRate()
    assert rate.update(0.0, 0) == 0
    for tenth in range(1, 20):
        assert rate.update(tenth / 10, 100 * tenth) == pytest.approx(1000)
    assert rate.update(2.0, 1900) < 1000
    for tenth in range(21, 35):
        last = rate.update(tenth / 10, 1900)
    assert last == 0


def test_health_frame_carries_the_counts() -> None:
    lateness = Lateness()
    for _ in range(600):
        lateness.add(2 * MS, MS)
    assert dict.fromkeys(TOTALS, 512) == MODULO
    loss = Loss.of({"lost_frames": 3, "crc": 2, "length": 1}, PortCounts(9, 9, 4, 5, 0))
    data = FrameEncoder(DATABASE, "EPSHIL_Health").encode(
        health_values(loss, lateness, 999.6, BusState.BUS_OFF, MODULO)
    )
    told = DATABASE.decode_message("EPSHIL_Health", data)
    assert str(told["BusState"]) == "bus_off"
    assert told["StepRate"] == 1000
    assert told["MaxLateness"] == pytest.approx(2.0)
    assert told["LostFrames"] == 8
    assert told["CrcErrors"] == 3
    assert told["SendDrops"] == 4
    assert told["Overruns"] == 600 - 512  # begins again, so that the next one shows


def test_no_total_ever_stands_still() -> None:
    loss = Loss(300, 211, 1_023, 512)
    lateness = Lateness()
    told = health_values(loss, lateness, 0.0, BusState.ERROR_ACTIVE, MODULO)
    assert (told["LostFrames"], told["CrcErrors"], told["SendDrops"]) == (511, 511, 0)
    # a message of somebody else's database, with room for all
    assert health_values(loss, lateness, 0.0, BusState.LOST, {})["CrcErrors"] == 1_023


@pytest.mark.parametrize("state", BusState)
def test_bus_states_are_those_of_the_dbc(state: BusState) -> None:
    number = health_values(Loss(0, 0, 0, 0), Lateness(), 0.0, state, MODULO)["BusState"]
    choices = DATABASE.get_message_by_name("EPSHIL_Health").get_signal_by_name("BusState").choices
    assert str(choices[number]) == state.value


def test_summary_says_what_a_run_came_to(parts: Parts, rig: TinyRig) -> None:
    for k in range(400):
        parts.core.on_frames(rig.millisecond(k))
    lateness = Lateness()
    lateness.add(MS // 4, MS)
    summary = Summary.of(parts.core, lateness, Loss(1, 2, 3, 4), 0.4, 400)
    said = "\n".join(summary.lines())
    assert "400 in 0.4 s (1000 Hz)" in said
    assert f"{parts.core.valid_steps / 4:.1f} % valid" in said
    assert "1 frames by counter, 2 in the kernel, 3 with a bad CRC" in said
    assert "p50 0.250 ms" in said
    assert "somebody else" not in said
    assert "trouble" not in said
    summary = Summary.of(parts.core, lateness, Loss(1, 2, 3, 4), 0.4, 400, 2, {"health": 7})
    said = "\n".join(summary.lines())
    assert "lost and opened again 2 times" in said
    assert "trouble    health: 7" in said


def test_live_line() -> None:
    good = Estimate(0, -812.4, 0.1, True, Reason.FINE)
    line = Snapshot(good, -800.0, 22.1, 1000.0, False, False).line()
    assert "-812 N" in line
    assert "load cell     -800 N" in line
    assert line.endswith("valid")
    bad = good._replace(valid=False, reason=Reason.GAP | Reason.SETTLING)
    line = Snapshot(bad, None, 22.1, 1000.0, False, False).line()
    assert "INVALID: gap, settling" in line
    assert "load cell" not in line
    assert "no input" in Snapshot(good, None, 0.0, 0.0, True, False).line()
    assert "bus lost" in Snapshot(good, None, 0.0, 0.0, False, True).line()


def test_priority_that_is_required_and_refused_ends_the_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.sched_setscheduler", refuse)
    with pytest.raises(EpsHilError, match="CAP_SYS_NICE"):
        realtime.hurry("require", 20)
    assert "Operation not permitted" in realtime.hurry("auto", 20)


def test_memory_that_is_required_and_not_locked_ends_the_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Refusing:
        def mlockall(self, _flags: int) -> int:
            ctypes.set_errno(errno.ENOMEM)
            return -1

    monkeypatch.setattr("ctypes.CDLL", lambda *_, **__: Refusing())
    with pytest.raises(EpsHilError, match=r"locked memory refused .*CAP_IPC_LOCK"):
        realtime.quieten("require")
    assert not realtime.quieten("auto")
    gc.unfreeze()


def test_a_limit_on_locked_memory_counts_unless_a_capability_lifts_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("resource.getrlimit", lambda _: (65_536, 65_536))
    monkeypatch.setattr(realtime, "_may_lock_all", lambda: False)
    with pytest.raises(EpsHilError, match="the limit is 64 KiB"):
        realtime.quieten("require")
    gc.unfreeze()


def test_off_asks_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []
    monkeypatch.setattr("os.sched_setscheduler", lambda *a: asked.append(a))
    assert "off" in realtime.hurry("off", 20)
    assert not realtime.quieten("off")
    assert asked == []
    assert gc.get_freeze_count() > 0
    gc.unfreeze()
