"""The machine: Python and libraries, CPUs, kernel, timers, clocks."""

import ctypes
import gzip
import os
import platform
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from eps_hil.selftest.check import Check, Verdict, graded

_LIBRARIES = ("numpy", "scipy", "numba", "python-can", "cantools", "msgpack", "fastcrc", "pydantic")
_EXTRAS = {
    "asammdf": "mf4", "pyarrow": "parquet", "mcap": "mcap", "matplotlib": "report",
    "jinja2": "report", "uplot-python": "report", "autosar-e2e": "e2e", "starlette": "dashboard",
    "uvicorn": "dashboard", "websockets": "dashboard", "fmpy": "fmu", "distributed": "fleet",
}  # fmt: skip
"""Library -> extra of pyproject.toml that brings it."""
_PREEMPTION = ("PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT", "PREEMPT_VOLUNTARY", "PREEMPT_NONE")


def read(path: str) -> str | None:
    """The text of a file of the system, stripped; None where there is none."""
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None


def python_and_libraries() -> list[Check]:
    """Versions against those that the package asks for."""
    versions = {name: _version(name) for name in (*_LIBRARIES, *_EXTRAS)}
    least = _least_versions()
    old = [
        f"{name} {versions[name] or 'missing'}"
        for name in _LIBRARIES
        if versions[name] is None or _numbers(str(versions[name])) < _numbers(least.get(name, "0"))
    ]
    there = [f"{name} {versions[name]}" for name in _LIBRARIES if versions[name]]
    without = sorted({extra for name, extra in _EXTRAS.items() if versions[name] is None})
    lines = [
        Check(
            "python", "Python and libraries",
            f"{platform.python_implementation()} {platform.python_version()}; {', '.join(there)}",
            "those of pyproject.toml", Verdict.NOT_GOOD if old else Verdict.GOOD,
            "older ones were not tested",
            f"pip install -U eps_hil: {', '.join(old)}" if old else "",
        )
    ]  # fmt: skip
    if without:
        lines.append(
            Check(
                "extras", "optional extras", f"missing: {', '.join(without)}", "",
                Verdict.TOLD, "other file formats, pages and figures, the live page, E2E, Dask",
                f'pip install "eps_hil[{",".join(without)}]"',
            )
        )  # fmt: skip
    return lines


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _least_versions() -> Mapping[str, str]:
    """``numpy>=2.0`` and the like of the installed package; nothing where it is not installed."""
    try:
        wanted = metadata.requires("eps_hil") or []
    except metadata.PackageNotFoundError:
        return {}
    found = (re.match(r"([\w-]+)>=([\d.]+)$", line) for line in wanted)
    return {match[1]: match[2] for match in found if match}


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version)[:3])


@dataclass(frozen=True, slots=True)
class Cpu:
    """``allowed``: CPUs this process may use; ``governors``: of all; ``virtual``: a hypervisor."""

    model: str
    allowed: int
    governors: tuple[str, ...]
    virtual: bool


def cpu() -> Cpu:
    """From /proc and /sys."""
    info = read("/proc/cpuinfo") or ""
    found = re.search(r"model name\s*:\s*(.+)", info)
    governors = {
        text
        for path in Path("/sys/devices/system/cpu").glob("cpu*/cpufreq/scaling_governor")
        if (text := read(str(path)))
    }
    return Cpu(
        found[1] if found else platform.machine(), len(os.sched_getaffinity(0)),
        tuple(sorted(governors)), " hypervisor" in info,
    )  # fmt: skip


def judge_cpu(found: Cpu) -> list[Check]:
    """CPUs for service, recorder and the rest; a clock that does not slow down between frames."""
    few = found.allowed < 2
    lines = [
        Check(
            "cpus", "CPUs for this process",
            f"{found.allowed} ({found.model}{', virtual' if found.virtual else ''})", "2",
            Verdict.LIMITED if few else Verdict.GOOD,
            "service, recorder and interrupts take turns on a single one",
            "allow more CPUs (taskset, cpuset, the virtual machine's settings)" if few else "",
            float(found.allowed),
        )
    ]  # fmt: skip
    slow = [name for name in found.governors if name != "performance"]
    if not found.governors:
        said, verdict = "none is visible (virtual machine, or fixed in firmware)", Verdict.TOLD
    else:
        said, verdict = ", ".join(found.governors), Verdict.LIMITED if slow else Verdict.GOOD
    lines.append(
        Check(
            "governor", "CPU frequency governor", said, "performance", verdict,
            "a CPU that idles 0.9 of each ms is clocked down and takes longer to wake",
            "sudo cpupower frequency-set -g performance" if slow else "",
        )
    )  # fmt: skip
    return lines


@dataclass(frozen=True, slots=True)
class Kernel:
    """``hz`` None and ``preemption`` "": the kernel does not show its configuration."""

    release: str
    preemption: str
    hz: int | None
    timer_resolution_s: float
    timer_slack_ns: int | None
    rt_runtime_us: int | None


def kernel() -> Kernel:
    """From uname, /proc and the kernel's configuration, where it is readable."""
    about = os.uname()
    config = _kernel_config(about.release)
    hz = re.search(r"^CONFIG_HZ=(\d+)", config, re.MULTILINE)
    preemption = next((name for name in _PREEMPTION if name in about.version), "")
    if read("/sys/kernel/realtime") == "1":
        preemption = "PREEMPT_RT"
    if not preemption:
        preemption = next((n for n in _PREEMPTION if f"CONFIG_{n}=y" in config), "")
    return Kernel(
        about.release, preemption, int(hz[1]) if hz else None,
        time.clock_getres(time.CLOCK_MONOTONIC),
        _whole(read("/proc/self/timerslack_ns")),
        _whole(read("/proc/sys/kernel/sched_rt_runtime_us")),
    )  # fmt: skip


def _kernel_config(release: str) -> str:
    try:
        with gzip.open("/proc/config.gz", "rt", encoding="ascii", errors="replace") as file:
            return file.read()
    except (OSError, EOFError):
        return read(f"/boot/config-{release}") or ""


def _whole(text: str | None) -> int | None:
    return int(text) if text and re.fullmatch(r"-?\d+", text) else None


def judge_kernel(found: Kernel) -> list[Check]:
    """Facts, for the wake-ups are measured; but coarse timers make 1 kHz impossible."""
    hz = "unknown" if found.hz is None else str(found.hz)
    slack = "unknown" if found.timer_slack_ns is None else f"{found.timer_slack_ns / 1000:.0f} us"
    coarse = found.timer_resolution_s > 1e-4
    share = found.rt_runtime_us
    return [
        Check(
            "kernel", "kernel",
            f"{found.release}, {found.preemption or 'preemption unknown'}, HZ {hz}, "
            f"timer slack {slack}", "", Verdict.TOLD,
            "judged by the wake-ups below; HZ does not matter with high-resolution timers, "
            "slack does not with real-time priority",
        ),
        Check(
            "timers", "timer resolution", f"{found.timer_resolution_s * 1e6:g} us", "100 us",
            Verdict.NOT_GOOD if coarse else Verdict.GOOD,
            "without high-resolution timers a process is woken at the kernel's HZ",
            "boot without highres=off; a kernel with CONFIG_HIGH_RES_TIMERS" if coarse else "",
            found.timer_resolution_s, "s",
        ),
        Check(
            "rt_throttling", "real-time share of a second",
            "unknown" if share is None else f"sched_rt_runtime_us {share}", "",
            Verdict.TOLD, "950000 stops a runaway real-time program for 50 ms of each second, so "
            "that the machine can still be reached",
        ),
    ]  # fmt: skip


class _Timex(ctypes.Structure):
    """``struct timex`` (linux/timex.h); only the head is read."""

    _fields_ = (
        ("modes", ctypes.c_uint), ("offset", ctypes.c_long), ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long), ("esterror", ctypes.c_long), ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    )  # fmt: skip


_STA_UNSYNC, _STA_NANO = 0x0040, 0x2000


@dataclass(frozen=True, slots=True)
class Clock:
    """``synchronised``: the kernel's word on the wall clock; ``max_error_s`` its own bound.

    ``read_ns``: what one reading of the wall clock costs.
    """

    source: str
    read_ns: float
    synchronised: bool
    offset_s: float
    max_error_s: float


def clock() -> Clock:
    """From /sys and adjtimex (which changes nothing when ``modes`` is 0)."""
    libc = ctypes.CDLL(None, use_errno=True)
    timex = _Timex()
    if libc.adjtimex(ctypes.byref(timex)) < 0:
        raise OSError(ctypes.get_errno(), "adjtimex refused")
    begin = time.perf_counter_ns()
    for _ in range(20_000):
        time.time_ns()
    read_ns = (time.perf_counter_ns() - begin) / 20_000
    return Clock(
        read("/sys/devices/system/clocksource/clocksource0/current_clocksource") or "unknown",
        read_ns, not timex.status & _STA_UNSYNC,
        timex.offset * (1e-9 if timex.status & _STA_NANO else 1e-6), timex.maxerror * 1e-6,
    )  # fmt: skip


def judge_clock(found: Clock) -> list[Check]:
    """A clock that is quick to read, and that nobody is about to step."""
    if found.synchronised:
        said = f"synchronised, {found.offset_s * 1e3:+.3f} ms to go"
    else:
        said = f"not synchronised (error bound {found.max_error_s:.1f} s)"
    slow = graded(found.read_ns, 1_000.0, 10_000.0)
    return [
        Check(
            "clock_source", "clock source", f"{found.source}, {found.read_ns:.0f} ns a reading",
            "1000 ns", slow, "stamps are taken several times a step",
            "boot with tsc=reliable, or see why the kernel dropped it (dmesg | grep clocksource)"
            if slow != Verdict.GOOD else "", found.read_ns, "ns",
        ),
        Check(
            "clock_steps", "wall clock (step risk)", said, "synchronised",
            Verdict.GOOD if found.synchronised else Verdict.LIMITED,
            "a first synchronisation in mid-run steps the clock: the estimate starts anew",
            "" if found.synchronised else
            "start chrony (makestep only at its start) and wait for it before a run; "
            "avoid services that step (ntpdate, a virtual machine's guest tools)",
        ),
    ]  # fmt: skip


def facts() -> Sequence[Check]:
    """Python and libraries, CPU, kernel."""
    return [*python_and_libraries(), *judge_cpu(cpu()), *judge_kernel(kernel())]
