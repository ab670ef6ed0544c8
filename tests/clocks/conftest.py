"""Logs of senders with known quartzes, delays and clock faults."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

MESSAGES = ((0x101, 1e-3, 0.0, 0.0), (0x110, 2e-3, 3e-4, 12.0), (0x120, 1e-2, 1e-3, -30.0))
"""(id, period s, phase s, sender's quartz ppm slow)."""
EPOCH_S = 1_700_000_000


@pytest.fixture
def write_log(tmp_path: Path) -> Callable[..., Path]:
    """``write_log(offset_s, drift_ppm, step_s, slip_s, resolution_ns)`` -> a candump log.

    can0 is late by 15 us on average, can1 (the same frames through a gateway) by 8; one frame in
    500 of can0 waits for up to 0.8 ms and holds up those behind it; one in 1000 of 0x101 is lost.
    can1's clock has the offset and the drift; can0's steps at 17 s; 0x120 slips at 12 s.
    """

    def write(
        offset_s: float = 0.0,
        drift_ppm: float = 0.0,
        step_s: float = 0.0,
        slip_s: float = 0.0,
        resolution_ns: int = 1,
        seconds: float = 30.0,
    ) -> Path:
        rng = np.random.default_rng(7)
        rows: list[tuple[float, str, int, int]] = []
        for can_id, period, phase, ppm in MESSAGES:
            n = round(seconds / period)
            t = phase + np.arange(n) * period * (1 + 1e-6 * ppm)
            t += slip_s * (t > 12.0) * (can_id == 0x120)
            waits = (rng.random(n) < 2e-3) * rng.uniform(0.0, 8e-4, n)
            stamp = np.maximum.accumulate(t + rng.exponential(15e-6, n) + waits)
            stamp += step_s * (t > 17.0)
            other = offset_s + (t + rng.exponential(8e-6, n)) * (1 + 1e-6 * drift_ppm)
            lost = (rng.random(n) < 1e-3) & (can_id == 0x101)
            for k in np.flatnonzero(~lost).tolist():
                rows += [(stamp[k], "can0", can_id, k), (other[k], "can1", can_id, k)]
        path = tmp_path / "bus.log"
        with path.open("w") as file:
            for at, channel, can_id, k in sorted(rows):
                ns = EPOCH_S * 10**9 + round(at * 1e9)
                ns = ns // resolution_ns * resolution_ns
                data = k.to_bytes(4, "little").hex()
                file.write(f"({ns // 10**9}.{ns % 10**9:09d}) {channel} {can_id:03X}#{data}\n")
        return path

    return write


@pytest.fixture
def write_senders(tmp_path: Path) -> Callable[..., Path]:
    """``write_senders(clocks, payload, ...)`` -> a candump log in the order of arrival.

    ``clocks``: by channel what its clock says at a true time (n,), s after the epoch. ``payload``:
    ``rare`` (a counter of 32 bits), ``counter`` (of 4 bits), ``wraps`` (after 2000), ``constant``.
    Messages of ``periods`` are ``late_s`` late on average. ``silent``: from when and how long no
    message comes.
    """

    def write(
        clocks: dict[str, Callable[[np.ndarray], np.ndarray]],
        payload: str = "rare",
        periods: tuple[float, ...] = (1e-3, 1e-2, 2e-2),
        seconds: float = 30.0,
        silent: tuple[float, float] = (0.0, 0.0),
        late_s: float = 6e-5,
    ) -> Path:
        rng = np.random.default_rng(11)
        rows: list[tuple[float, float, str, int, str]] = []
        for number, period in enumerate(periods):
            k = np.arange(round(seconds / period))
            sent = 2e-4 * number + k * period * (1.0 + (8e-5, -4e-5, 1e-5)[number])
            there = (sent < silent[0]) | (sent >= sum(silent))
            for channel, clock in clocks.items():
                t = np.sort(sent + rng.exponential(late_s, len(k)))
                for at, stamp, n in zip(t[there], clock(t)[there], k[there].tolist(), strict=True):
                    data = {
                        "rare": n.to_bytes(4, "big"),
                        "counter": bytes([7, n % 16]),
                        "wraps": (n % 2000).to_bytes(2, "big"),
                    }
                    shown = data.get(payload, b"\x01\x02").hex()
                    rows.append((at, stamp, channel, 0x100 + number, shown))
        path = tmp_path / "senders.log"
        with path.open("w") as file:
            for _, stamp, channel, can_id, shown in sorted(rows):
                us = round(stamp * 1e6)
                file.write(f"({us // 10**6}.{us % 10**6:06d}) {channel} {can_id:03X}#{shown}\n")
        return path

    return write
