"""What a demo says where the machine stood still while it ran."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from eps_hil.estimation.validity import Reason
from tests.loaded import loaded

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "demo_stalls.py"
RIG = "lateness: p50 80 us, p99 300 us, max {} us; 12 ms caught up, {} overruns\n"
MS = 1_000_000


@pytest.fixture(scope="module")
def demo() -> ModuleType:
    return loaded("scripts/demo_stalls.py")


def rows(*parts: tuple[int, int]) -> list[tuple[int, int]]:
    """Milliseconds, each with the reason of its part; a negative number: none at all."""
    found, t = [], 0
    for number, reason in parts:
        if number > 0:
            found += [((t + k) * MS, reason) for k in range(number)]
        t += abs(number)
    return found


def test_a_machine_that_keeps_up_is_not_spoken_of(demo: ModuleType) -> None:
    begun = rows((800, Reason.NOT_STARTED | Reason.GAP), (5000, 0))
    assert demo.stalls(RIG.format(900, 0), begun).lines("again") == []
    assert demo.stalls(RIG.format(900, 0), None).lines("again") == []
    worn = rows((1000, 0), (2000, Reason.RATE), (1000, 0))  # has another cause
    assert demo.stalls(RIG.format(900, 0), worn).lines("again") == []
    never = rows((3000, Reason.FRICTION_UNKNOWN))
    assert demo.stalls(RIG.format(900, 0), never).lines("again") == []


def test_what_a_stall_costs_is_counted_to_the_next_valid_estimate(demo: ModuleType) -> None:
    after = Reason.SETTLING | Reason.FRICTION_UNKNOWN
    seen = rows(
        (500, Reason.NOT_STARTED), (1000, 0), (-120, 0), (50, Reason.GAP), (830, after), (2000, 0)
    )  # fmt: skip
    found = demo.stalls(RIG.format(119_800, 1), seen)
    assert found.number == 1
    assert found.longest_ms == pytest.approx(121.0)
    assert found.invalid_share == pytest.approx(0.25, abs=0.001)
    first, second = found.lines("scripts/demo udp")
    assert first == (
        "NOTE: this machine stood still once while the rig drove, 121 ms at the longest: "
        "25 % of the run was INVALID because of it."
    )
    assert second.endswith("and repeat: scripts/demo udp")


def test_holes_between_valid_estimates_and_without_a_service(demo: ModuleType) -> None:
    seen = rows((1000, 0), (-100, 0), (1000, 0), (-200, 0), (1000, 0), (-5, 0), (1000, 0))
    found = demo.stalls(RIG.format(300, 0), seen)
    assert found.number == 2
    assert found.longest_ms == pytest.approx(201.0)
    assert found.invalid_share == pytest.approx(302 / 4304, abs=0.002)
    (line, _) = demo.stalls(RIG.format(250_000, 7), None).lines("again")
    assert "stood still 7 times while the rig drove, 250 ms at the longest: the recording" in line
    whole = demo.stalls(RIG.format(250_000, 7), rows((3000, Reason.GAP))).lines("again")
    assert "100 % of the run was INVALID" in whole[0]


def test_as_the_demo_asks_for_it(tmp_path: Path) -> None:
    rig, log = tmp_path / "rig.txt", tmp_path / "live.csv"
    rig.write_text("timing: SCHED_FIFO\n" + RIG.format(104_000, 3))
    seen = [
        *rows((9000, Reason.GAP), (3000, 0), (500, Reason.GAP), (600, 0), (400, Reason.NO_INPUT))
    ]
    lines = [f"0,0,0,{int(not reason)},{int(reason)},{t_ns}\n" for t_ns, reason in seen]
    head = "time_s,rack_force_estimate_n,friction_torque_nm,valid,reason,t_ns\n"
    log.write_text(head + "".join(lines))
    words = [sys.executable, str(SCRIPT), str(rig), str(log), "4.1", "scripts/demo vcan"]
    told = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert "3 times while the rig drove, 104 ms at the longest: 12 % of the run was" in told
    assert told.count("\n") == 2
