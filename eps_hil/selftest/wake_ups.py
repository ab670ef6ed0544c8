"""How late a process is woken at 1 kHz, measured in a process of its own.

    python -m eps_hil.selftest.wake_ups SECONDS PRIORITY

prints one JSON object. A process of its own, because real-time priority must end with the
measurement, and because it shall not wait for the threads and the heap of whoever asks. It is
woken by absolute deadlines of the monotonic clock, prepared as the service is (heap frozen, memory
locked); PRIORITY 0 leaves the scheduling as it is.
"""

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from eps_hil.selftest.check import Check, Verdict, graded

PERIOD_NS = 1_000_000
PRIORITY = 20
"""What ``service.priority`` is unless the configuration says otherwise."""
_GOOD_P99_US, _LIMITED_P99_US = 500.0, 1000.0
_GOOD_MAX_MS, _LIMITED_MAX_MS = 5.0, 15.0

_REMEDY = (
    "end other programs; take a PREEMPT_RT or 'preempt=full' kernel; governor 'performance'; "
    "keep a CPU for the service (isolcpus=, taskset); no virtual machine for timing"
)


@dataclass(frozen=True, slots=True)
class WakeUps:
    """Lateness against the deadlines, and what was granted. ``refused``: why not real time.

    ``missed`` deadlines passed before the process ran again; ``busy`` and ``stolen`` are shares
    of all CPU time meanwhile: used by whatever programs, taken by a host of a virtual machine.
    """

    seconds: float
    p50_us: float
    p99_us: float
    max_us: float
    missed: int
    fifo: bool
    refused: str
    locked: bool
    busy: float | None = None
    stolen: float | None = None


def measure(seconds: float, priority: int) -> WakeUps:
    """Run the measurement as a process; OSError or ValueError where that fails."""
    command = [sys.executable, "-m", "eps_hil.selftest.wake_ups", str(seconds), str(priority)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=seconds + 60, check=False
    )
    if done.returncode:
        raise OSError(f"the measuring process ended with {done.returncode}: {done.stderr[-200:]}")
    return WakeUps(**json.loads(done.stdout))


def _main(seconds: float, priority: int) -> WakeUps:
    from eps_hil.service.realtime import hurry, quieten

    locked = quieten("auto" if priority else "off")
    granted = hurry("auto" if priority else "off", priority)
    before = _cpu_times()
    late_ns, missed = _sleep(seconds)
    busy, stolen = _shares(before, _cpu_times())
    late_ns.sort()
    fifo = granted.startswith("SCHED_FIFO")
    return WakeUps(
        seconds, _quantile_us(late_ns, 0.5), _quantile_us(late_ns, 0.99), late_ns[-1] * 1e-3,
        missed, fifo, "" if fifo else granted, locked, busy, stolen,
    )  # fmt: skip


def _sleep(seconds: float) -> tuple[list[int], int]:
    """Lateness in ns at every deadline; how many had passed before the process ran again."""
    due = time.monotonic_ns() + 10 * PERIOD_NS
    end = due + round(seconds * 1e9)
    late_ns, missed = [], 0
    while due < end:
        time.sleep(max(0, due - time.monotonic_ns()) * 1e-9)
        late = time.monotonic_ns() - due
        late_ns += [late - k * PERIOD_NS for k in range(late // PERIOD_NS + 1)]
        missed += late // PERIOD_NS
        due += (1 + late // PERIOD_NS) * PERIOD_NS  # never a burst to catch up
    return late_ns, missed


def _quantile_us(ordered: Sequence[int], share: float) -> float:
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] * 1e-3


def _cpu_times() -> list[int]:
    """First line of /proc/stat (user, nice, system, idle, iowait, irq, softirq, steal, ...)."""
    try:
        with open("/proc/stat", encoding="ascii") as file:
            return [int(word) for word in file.readline().split()[1:9]]
    except (OSError, ValueError):
        return []


def _shares(before: Sequence[int], after: Sequence[int]) -> tuple[float | None, float | None]:
    spent = [b - a for a, b in zip(before, after, strict=False)]
    whole = sum(spent)
    if len(spent) < 8 or whole <= 0:
        return None, None
    return 1.0 - (spent[3] + spent[4]) / whole, spent[7] / whole


def judge(normal: WakeUps, fifo: WakeUps) -> list[Check]:
    """Lines for both; without real-time priority the normal one is what the service will get."""
    lines = []
    for name, one, counts in (
        ("normal priority", normal, not fifo.fifo),
        ("SCHED_FIFO", fifo, fifo.fifo),
    ):
        if one is fifo and not fifo.fifo:
            continue
        verdict = max(
            graded(one.p99_us, _GOOD_P99_US, _LIMITED_P99_US),
            graded(one.max_us * 1e-3, _GOOD_MAX_MS, _LIMITED_MAX_MS),
            key=[Verdict.GOOD, Verdict.LIMITED, Verdict.NOT_GOOD].index,
        )
        lines.append(
            Check(
                "wake_ups_fifo" if one is fifo else "wake_ups_normal",
                f"1 kHz wake-ups, {name}",
                f"late p50 {one.p50_us:.0f} us, p99 {one.p99_us:.0f} us, "
                f"max {one.max_us * 1e-3:.2f} ms, {one.missed} missed in {one.seconds:g} s",
                f"p99 {_GOOD_P99_US:.0f} us, max {_GOOD_MAX_MS:.0f} ms",
                verdict if counts else Verdict.TOLD,
                "half a period is for decoding, the step and sending; after 15 ms the torque "
                "guard of the example configurations trips",
                _REMEDY if counts and verdict != Verdict.GOOD else "",
                one.p99_us,
                "us",
            )
        )
    return [*lines, *_load(normal, fifo)]


def _load(normal: WakeUps, fifo: WakeUps) -> list[Check]:
    busy = [one.busy for one in (normal, fifo) if one.busy is not None]
    stolen = [one.stolen for one in (normal, fifo) if one.stolen is not None]
    if not busy or not stolen:
        return []
    return [
        Check(
            "load", "other programs meanwhile",
            f"{max(busy):.0%} of all CPU time used, {max(stolen):.1%} taken by a host",
            "0.1% taken by a host",
            graded(max(stolen), 0.001, 0.01),
            "what a host takes from a virtual machine, no priority brings back; the busier the "
            "machine now, the more the lines around this one speak of its other programs",
            "give the virtual machine CPUs of its own, or run on the bare machine"
            if max(stolen) > 0.001
            else "",
            max(stolen),
        )
    ]  # fmt: skip


def judge_rights(fifo: WakeUps, rtprio: str, memlock: str) -> list[Check]:
    """May the service take real-time priority and lock its memory? The limits say what is set."""
    allow = "/etc/security/limits.d: '@rig - rtprio 50' and '@rig - memlock unlimited', log in anew"
    container = "; in a container --cap-add SYS_NICE --ulimit rtprio=50 --ulimit memlock=-1"
    return [
        Check(
            "sched_fifo", "real-time priority (SCHED_FIFO)",
            "granted" if fifo.fifo else "refused", "granted",
            Verdict.GOOD if fifo.fifo else Verdict.LIMITED,
            f"any busy program delays a process without it; rtprio limit {rtprio}",
            "" if fifo.fifo else allow + container,
        ),
        Check(
            "mlock", "memory locked (mlockall)",
            "granted" if fifo.locked else "refused", "granted",
            Verdict.GOOD if fifo.locked else Verdict.LIMITED,
            f"a page that has to come back from disk costs milliseconds; memlock limit {memlock}",
            "" if fifo.locked else allow + container,
        ),
    ]  # fmt: skip


if __name__ == "__main__":
    sys.stdout.write(json.dumps(asdict(_main(float(sys.argv[1]), int(sys.argv[2])))))
