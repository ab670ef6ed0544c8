"""A frame as a line of a candump log, as can-utils write it.

python-can's writer has one class for all error frames, and no length for a remote request.
"""

from eps_hil.bus.frame import Frame

_ERROR, _BUS_ERROR = 0x2000_0000, 0x80
_BRS, _ESI = 1, 2


def candump_line(frame: Frame, channel: str) -> str:
    """The line with its end, stamped to the microsecond.

    An error frame without a class (of a format that has none) is a bus error.
    """
    seconds, microseconds = divmod((frame.t_ns + 500) // 1000, 1_000_000)
    if frame.error:
        name, end = f"{_ERROR | (frame.can_id or _BUS_ERROR):08X}", ""
    else:
        name = f"{frame.can_id:08X}" if frame.extended else f"{frame.can_id:03X}"
        end = " T" if frame.own else " R"
    content = frame.data.hex().upper()
    if frame.remote:
        content = f"R{frame.remote_length or ''}"
    elif frame.fd:
        content = f"#{_BRS * frame.brs | _ESI * frame.esi:X}{content}"
    return f"({seconds}.{microseconds:06d}) {channel} {name}#{content}{end}\n"
