"""CAN in the kernel, and the interface of the configuration: state, bit rate, restart, queue."""

import fcntl
import json
import shutil
import socket
import struct
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_hil.bus.load import EXTENDED_BITS, classic_bits
from eps_hil.selftest.check import Check, Verdict, graded
from eps_hil.selftest.system import read

_AF_CAN, _CAN_RAW, _ARPHRD_CAN = 29, 1, 280
_SIOCETHTOOL, _ETHTOOL_GET_TS_INFO = 0x8946, 0x41
_RX_HARDWARE = 1 << 2  # SOF_TIMESTAMPING_RX_HARDWARE, linux/net_tstamp.h
_LONGEST_QUEUE = 64
_FULL, _BUSY = 0.9, 0.7


@dataclass(frozen=True, slots=True)
class Interface:
    """One CAN interface; None where the kernel or ``ip`` does not say."""

    name: str
    up: bool
    virtual: bool
    mtu: int | None = None
    queue: int | None = None
    state: str | None = None
    bitrate: int | None = None
    restart_ms: int | None = None
    berr_reporting: bool | None = None
    hardware_stamps: bool | None = None


def kernel_has_can() -> str:
    """Empty if raw CAN sockets can be had, else why not."""
    try:
        socket.socket(_AF_CAN, socket.SOCK_RAW, _CAN_RAW).close()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def interfaces() -> Sequence[Interface]:
    """All CAN interfaces of this machine: by ``ip``, or by /sys where there is no ``ip``."""
    names = [
        path.name for path in sorted(Path("/sys/class/net").glob("*"))
        if read(f"{path}/type") == str(_ARPHRD_CAN)
    ]  # fmt: skip
    if not names:
        return []
    told = {str(link.get("ifname")): link for link in _ip_links()}
    return [interface_of(name, told.get(name) or _from_sys(name)) for name in names]


def _ip_links() -> list[dict[str, Any]]:
    if shutil.which("ip") is None:
        return []
    done = subprocess.run(
        ["ip", "-details", "-json", "link", "show"],
        capture_output=True, text=True, timeout=10, check=False,
    )  # fmt: skip
    try:
        found = json.loads(done.stdout or "[]")
    except ValueError:
        return []
    return [link for link in found if isinstance(link, dict)]


def _from_sys(name: str) -> dict[str, Any]:
    folder = f"/sys/class/net/{name}"
    flags = int(read(f"{folder}/flags") or "0", 16)
    return {
        "flags": ["UP"] if flags & 1 else [],
        "mtu": int(read(f"{folder}/mtu") or 0) or None,
        "txqlen": int(read(f"{folder}/tx_queue_len") or 0),
    }


def interface_of(name: str, link: Mapping[str, Any]) -> Interface:
    """From one entry of ``ip -details -json link show`` (iproute2)."""
    info = link.get("linkinfo") or {}
    kind, data = info.get("info_kind"), info.get("info_data") or {}
    controller = kind == "can"
    restart = data.get("restart_ms")
    modes = {str(mode).upper() for mode in data.get("ctrlmode") or ()}
    return Interface(
        name,
        "UP" in (link.get("flags") or ()),
        kind in {"vcan", "vxcan"} or (kind is None and name.startswith(("vcan", "vxcan"))),
        link.get("mtu"),
        link.get("txqlen"),
        data.get("state"),
        (data.get("bittiming") or {}).get("bitrate"),
        (0 if restart is None else int(restart)) if controller else None,
        "BERR-REPORTING" in modes if controller else None,
        hardware_stamps(name),
    )


def hardware_stamps(name: str) -> bool | None:
    """Whether the controller stamps what it receives (ethtool's ``GET_TS_INFO``)."""
    import ctypes

    info = ctypes.create_string_buffer(struct.pack("=IIiI3II3I", _ETHTOOL_GET_TS_INFO, *[0] * 10))
    request = struct.pack("16sP8x", name.encode()[:15], ctypes.addressof(info))
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            fcntl.ioctl(sock.fileno(), _SIOCETHTOOL, request)
    except OSError:
        return None
    return bool(struct.unpack_from("=II", info.raw)[1] & _RX_HARDWARE)


def judge_kernel(refused: str, found: Sequence[Interface], wanted: bool) -> Check:
    """SocketCAN counts where the configuration asks for it."""
    names = ", ".join(f"{one.name} ({'up' if one.up else 'down'})" for one in found)
    said = f"no ({refused})" if refused else f"yes; interfaces: {names or 'none'}"
    good = Verdict.GOOD if not refused else Verdict.NOT_GOOD
    return Check(
        "socketcan", "SocketCAN in the kernel", said, "yes" if wanted else "",
        good if wanted else Verdict.TOLD, "the service has its own socket there",
        "sudo modprobe can_raw vcan can_dev; a kernel without CAN: interface: udp_multicast, or "
        "docs/howto-real-vcan.md" if refused else "",
    )  # fmt: skip


def judge_interface(name: str, found: Sequence[Interface], load_bit_s: float) -> list[Check]:
    """The channel of the configuration; ``load_bit_s``: what its messages put on the bus."""
    one = next((each for each in found if each.name == name), None)
    if one is None or not one.up:
        said = "does not exist" if one is None else "is down"
        remedy = (
            f"sudo ip link add dev {name} type vcan && sudo ip link set {name} up, or for a "
            f"controller: sudo ip link set {name} type can bitrate 1000000 && "
            f"sudo ip link set {name} up"
        )
        return [
            Check("interface", f"CAN interface {name}", said, "up", Verdict.NOT_GOOD,
                  "the bus of the configuration", remedy)
        ]  # fmt: skip
    up = Check(
        "interface", f"CAN interface {name}",
        "up, virtual" if one.virtual else f"up, {one.state or 'state unknown'}", "up, ERROR-ACTIVE",
        Verdict.GOOD if one.virtual or one.state in {None, "ERROR-ACTIVE"} else Verdict.LIMITED,
        "other states mean errors on the wire: termination, bit rate, nobody who acknowledges",
        "" if one.virtual or one.state in {None, "ERROR-ACTIVE"} else
        "check 120 ohm at both ends, the bit rate of all nodes, and that another node is on",
    )  # fmt: skip
    lines = [up, _queue(one)]
    return lines if one.virtual else [*lines, *_controller(one, load_bit_s)]


def _queue(one: Interface) -> Check:
    length = one.queue
    verdict = Verdict.UNKNOWN if length is None else graded(float(length), _LONGEST_QUEUE, 1000.0)
    if one.virtual:
        verdict = Verdict.TOLD
    return Check(
        "txqueuelen", f"{one.name}: send queue", f"{length} frames", f"{_LONGEST_QUEUE} frames",
        verdict, f"a full queue hands the bus frames that are {_LONGEST_QUEUE * 0.12:.0f} ms old",
        f"sudo ip link set {one.name} txqueuelen 10" if verdict is Verdict.LIMITED else "",
        None if length is None else float(length), "frames",
    )  # fmt: skip


def _controller(one: Interface, load_bit_s: float) -> list[Check]:
    rate = one.bitrate
    share = load_bit_s / rate if rate else float("nan")
    return [
        Check(
            "bitrate", f"{one.name}: bit rate",
            f"{rate / 1e3:g} kbit/s, {share:.0%} used by the configured messages"
            if rate else "unknown", f"{_BUSY:.0%}",
            graded(share, _BUSY, _FULL) if rate else Verdict.UNKNOWN,
            "the fuller the bus, the later the frames of a high id; stuff bits come on top",
            "" if rate and share <= _BUSY else f"sudo ip link set {one.name} type can bitrate "
            "1000000 on all nodes, or CAN FD", share if rate else None,
        ),
        Check(
            "restart_ms", f"{one.name}: restart after bus-off", f"{one.restart_ms} ms", "over 0",
            Verdict.GOOD if one.restart_ms else Verdict.LIMITED,
            "with 0 a bus-off lasts until somebody restarts the interface",
            "" if one.restart_ms else f"sudo ip link set {one.name} down; "
            f"sudo ip link set {one.name} type can restart-ms 100; sudo ip link set {one.name} up",
        ),
        Check(
            "berr_reporting", f"{one.name}: bus error reports",
            "on" if one.berr_reporting else "off", "", Verdict.TOLD,
            "on, each bus error is a frame: shows a bad wire, and loads the CPU on a very bad one",
        ),
        Check(
            "hardware_stamps", f"{one.name}: stamps of the controller",
            {True: "yes", False: "no", None: "the driver does not say"}[one.hardware_stamps], "",
            Verdict.TOLD, "bus.options: {hardware_stamps: true} takes the interrupt's lateness out",
        ),
    ]  # fmt: skip


def load_bit_s(messages: Sequence[tuple[Any, float | None]]) -> float:
    """Bits per second of (message of cantools, cycle time in s), half the stuff bits in."""
    return sum(_bits(message) / cycle_s for message, cycle_s in messages if cycle_s)


def _bits(message: Any) -> float:
    longer = EXTENDED_BITS if message.is_extended_frame else 0
    return sum(classic_bits(min(message.length, 8))) / 2 + longer
