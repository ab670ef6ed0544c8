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
_CROSS = {"linux64": ("x86_64-linux-gnu.2.17", ".so"), "win64": ("x86_64-windows-gnu", ".dll")}
"""Platforms that zig compiles for on any machine: its target, and how a library's name ends."""
_SUFFIXES = {"Linux": ("linux", ".so"), "Windows": ("win", ".dll"), "Darwin": ("darwin", ".dylib")}


def check() -> None:
    """:class:`InputError` where no C compiler is found."""
    if not _zig() and _compiler() is None:
        raise InputError(
            "--fmu", "", "no C compiler is found (cc, gcc or clang)",
            "install one, or pip install ziglang, which also makes the Windows binary",
        )  # fmt: skip


def binaries(name: str, guid: str, sources: Mapping[str, str]) -> dict[str, bytes]:
    """Compiled libraries by their path in the FMU, for as many platforms as can be made here."""
    with tempfile.TemporaryDirectory(prefix="eps_hil-fmu-") as folder:
        for file, text in sources.items():
            (Path(folder) / file).write_text(text, encoding="utf-8")
        found = {}
        for place, suffix, command in _targets():
            out = Path(folder) / f"{name}{suffix}"
            libm = [] if suffix == ".dll" else ["-fPIC", "-lm"]
            done = subprocess.run(
                [*command, *_OPTIONS, f'-DGUID="{guid}"', "-o", str(out), "fmi2.c", *libm],
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


def _targets() -> list[tuple[str, str, list[str]]]:
    if _zig():
        zig = [sys.executable, "-m", "ziglang", "cc"]
        return [(place, suffix, [*zig, "-target", target])
                for place, (target, suffix) in _CROSS.items()]  # fmt: skip
    compiler = _compiler()
    assert compiler is not None
    system, suffix = _SUFFIXES.get(platform.system(), ("linux", ".so"))
    return [(f"{system}{64 if sys.maxsize > 2**32 else 32}", suffix, [compiler])]


def _zig() -> bool:
    return importlib.util.find_spec("ziglang") is not None


def _compiler() -> str | None:
    return next((one for one in ("cc", "gcc", "clang") if shutil.which(one)), None)
