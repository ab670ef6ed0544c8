"""Numbers that grow: in memory, and beyond that in a file without a name."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil import growing
from eps_hil.errors import EpsHilError
from eps_hil.growing import Growing, blocks


@given(st.lists(st.integers(0, 9_000), max_size=8))
def test_what_was_added_is_there_wherever_it_lies(many: list[int]) -> None:
    parts = [np.arange(n) * 7 + k for k, n in enumerate(many)]
    before, growing.IN_MEMORY = growing.IN_MEMORY, 5_000
    try:
        numbers = Growing(np.int64)
        for part in parts:
            numbers.add(part)
        assert len(numbers) == sum(many)
        found = numbers.whole()
    finally:
        growing.IN_MEMORY = before
    assert np.array_equal(found, np.concatenate([*parts, np.empty(0, np.int64)]))
    assert found.flags.writeable
    assert type(found) is np.ndarray  # compiled code knows no other


def test_the_file_has_no_name_and_goes_with_the_array(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr(growing, "IN_MEMORY", 100)

    def mapped() -> int:
        return Path("/proc/self/maps").read_text().count(str(tmp_path))

    numbers = Growing(np.float64)
    numbers.add(np.ones(5_000))
    assert mapped() == 1
    assert list(tmp_path.iterdir()) == []
    whole = numbers.whole()
    del numbers
    assert whole.sum() == 5_000
    del whole
    assert mapped() == 0


def test_a_full_disk_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(growing, "IN_MEMORY", 100)
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(EpsHilError, match=r"No space left on device: .*set TMPDIR"):
        Growing(np.float64).add(np.ones(5_000))


def test_blocks_are_all_of_it_once() -> None:
    n = 2 * (1 << 20) + 5
    at = list(blocks(n))
    assert [one.start for one in at] == [0, *(one.stop for one in at[:-1])]
    assert at[-1].stop == n
    assert list(blocks(0)) == []
