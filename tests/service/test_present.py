"""Time that is not believed where the clock was set."""

from hypothesis import given
from hypothesis import strategies as st

from eps_hil.service.present import UNKNOWN, Present

MS = 1_000_000


class Clocks:
    def __init__(self) -> None:
        self.wall, self.steady = 1_790_000_000_000 * MS, 77 * MS
        self.present = Present(lambda: self.wall, lambda: self.steady)

    def go_on(self, ns: int) -> None:
        self.wall += ns
        self.steady += ns


@given(st.lists(st.integers(0, 60_000 * MS)))
def test_time_that_only_passes_is_told(spent: list[int]) -> None:
    clocks = Clocks()
    for ns in spent:
        clocks.go_on(ns)
        assert clocks.present.now_ns() == clocks.wall
    assert clocks.present.steps == 0


@given(st.integers(2 * MS, 10**15), st.sampled_from([-1, 1]), st.integers(0, 900 * MS))
def test_a_clock_that_was_set_is_told_once(size: int, sign: int, spent: int) -> None:
    clocks = Clocks()
    clocks.go_on(spent)
    clocks.wall += sign * size
    assert clocks.present.now_ns() == UNKNOWN
    assert clocks.present.now_ns() == clocks.wall
    assert clocks.present.steps == 1


def test_slewing_is_no_step() -> None:
    clocks = Clocks()
    for _ in range(1_000):
        clocks.go_on(MS)
        clocks.wall += MS // 2_000  # 500 ppm
        assert clocks.present.now_ns() == clocks.wall
