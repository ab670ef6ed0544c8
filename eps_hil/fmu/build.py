"""A C compiler on this machine, and the binaries that it makes of the FMU's source."""

import importlib.util
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from eps_hil.errors import InputError

_OPTIONS = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-shared")
_CROSS = (("Linux", "x86_64-linux-gnu.2.17"), ("Windows", "x86_64-windows-gnu"))
"""Platforms that zig compiles for on any machine, and what it calls them."""
_SYSTEMS = {
    "Linux": ("linux", "linux", ".so"),
    "Windows": ("win", "windows", ".dll"),
    "Darwin": ("darwin", "darwin", ".dylib"),
}
"""What FMI 2 and FMI 3 call a system, and how a library's name ends there."""
_MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}


def check() -> None:
    """:class:`InputError` where no C compiler is found."""
    if not _zig() and _compiler() is None:
        raise InputError(
            "--fmu", "", "no C compiler is found (cc, gcc or clang)",
            "install one, or pip install ziglang, which also makes the Windows binary",
        )  # fmt: skip


def binaries(name: str, guid: str, sources: Mapping[str, str], fmi: int) -> dict[str, bytes]:
    """Compiled libraries by their path in the FMU, for as many platforms as can be made here."""
    with tempfile.TemporaryDirectory(prefix="eps_hil-fmu-") as folder:
        for file, text in sources.items():
            (Path(folder) / file).write_text(text, encoding="utf-8")
        found = {}
        for place, suffix, command in _targets(fmi):
            out = Path(folder) / f"{name}{suffix}"
            libm = [] if suffix == ".dll" else ["-fPIC", "-lm"]
            done = subprocess.run(
                [*command, *_OPTIONS, f'-DGUID="{guid}"', "-o", str(out), f"fmi{fmi}.c", *libm],
                cwd=folder,
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode != 0:
                said = (done.stderr.strip().splitlines() or ["it says nothing"])[0]
                raise InputError("--fmu", command[0], f"the C compiler failed: {said}")
            found[f"binaries/{place}/{out.name}"] = out.read_bytes()
        return found


def _targets(fmi: int) -> list[tuple[str, str, list[str]]]:
    if _zig():
        zig = [sys.executable, "-m", "ziglang", "cc", "-target"]
        return [(*_place(system, "x86_64", fmi), [*zig, target]) for system, target in _CROSS]
    compiler = _compiler()
    assert compiler is not None
    machine = platform.machine().lower()
    return [(*_place(platform.system(), _MACHINES.get(machine, machine), fmi), [compiler])]


def _place(system: str, machine: str, fmi: int) -> tuple[str, str]:
    """A platform's folder of binaries, and how a library's name ends there."""
    two, three, suffix = _SYSTEMS.get(system, _SYSTEMS["Linux"])
    return f"{machine}-{three}" if fmi == 3 else f"{two}{64 if sys.maxsize > 2**32 else 32}", suffix


def _zig() -> bool:
    return importlib.util.find_spec("ziglang") is not None


def _compiler() -> str | None:
    return next((one for one in ("cc", "gcc", "clang") if shutil.which(one)), None)
