"""A round of the randomised fault injection, every kind of fault once; and its judge judged."""

import pytest

from eps_hil.service.guard import TorqueGuard, Trip

from . import fault_cases, faults

SEED = 20


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "seed"),
    fault_cases.cases(len(faults.FAULTS), SEED),
    ids=[make.__name__ for make in faults.FAULTS],
)
def test_every_fault_ends_in_zero_and_stays_there(number: int, seed: int) -> None:
    outcome = fault_cases.run_numbered((number, seed))
    assert outcome.wrong == []
    assert outcome.peak_nm > 0.005, "there was a torque to stop"


@pytest.mark.slow
@pytest.mark.parametrize(
    "make", [faults.source_mad, faults.driver_grabs, faults.message_lost, faults.sensor_frozen]
)
def test_without_the_guard_the_judge_finds_fault(
    make: faults.Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    def let_it_pass(self: TorqueGuard, *_: object) -> Trip:
        return Trip.NONE

    for check in ("obstacles", "_demand", "_motion", "_budget"):
        monkeypatch.setattr(TorqueGuard, check, let_it_pass)
    assert fault_cases.run_case(make, 4).wrong


def test_the_table_names_every_fault() -> None:
    outcomes = [fault_cases.Outcome(make.__name__, 0, True, 3, 0.05) for make in faults.FAULTS]
    outcomes[0].wrong.append("something")
    lines = fault_cases.table(outcomes).splitlines()
    assert len(lines) == 2 + len(faults.FAULTS)
    assert lines[2] == "| bus silent | 1 | 1 | 3 ms | 50 mNm | 1 |"


def test_a_thousand_cases_meet_every_fault_thirty_times() -> None:
    numbers = [number for number, _ in fault_cases.cases(1000, 1)]
    assert min(numbers.count(k) for k in range(len(faults.FAULTS))) >= 30
    assert len({seed for _, seed in fault_cases.cases(1000, 1)}) == 1000
