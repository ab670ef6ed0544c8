"""Error frames of a candump log are no traffic, whatever their class."""

from pathlib import Path

from eps_hil.bus import replay
from eps_hil.bus.frame import Frame

TEXT = (
    "(1757617431.821276) can0 20000004#0004000000000000\n"
    "(1757617431.821277) can1 20000080#\n"
    "(1757617431.821278) can0 00000004#0102 R\n"
    "(1757617431.821279) can0 004#R8 T\n"
)


def test_no_error_is_a_data_frame(tmp_path: Path) -> None:
    """Class 4 (the controller's) came as data of id 4, and would have been sent."""
    log = tmp_path / "a.log"
    log.write_text(TEXT)
    found = list(replay.read_log(log))
    assert [(f.error, f.can_id, f.data, f.remote, f.remote_length) for f in found] == [
        (True, 0x4, bytes([0, 4, 0, 0, 0, 0, 0, 0]), False, 0),
        (True, 0x80, b"", False, 0),
        (False, 0x4, b"\x01\x02", False, 0),
        (False, 0x4, b"", True, 8),
    ]
    assert [type(frame) for frame in replay.read_log(log, "can1")] == [Frame]
