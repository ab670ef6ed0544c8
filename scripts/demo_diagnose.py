"""``scripts/demo-diagnose``: hide an effect in the rig, find it over the bus, use the result."""

import argparse
import csv
import json
import os
import re
import secrets
import signal
import subprocess
import sys
import time
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from eps_hil import compiled
from eps_hil.examples import CONFIGS, DBC
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import load_model
from eps_hil.series import Series

ROOT = Path(__file__).resolve().parents[1]
MODEL = CONFIGS / "reference_rig.yaml"
SIGNALS = CONFIGS / "eps_rig_signals.yaml"
DATABASE = DBC / "eps_rig.dbc"
LIVE_S = 20.0
COMPILING_S = 600.0
COMPILED = "rig", "estimation", "diagnosis"
"""Parts of the package whose kernels the demo runs."""
RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "stribeck": {"level_nm": (0.04, 0.06), "speed_rad_s": (5.0, 10.0)},
    "viscous_friction": {"coefficient_nm_s_per_rad": (1e-3, 2e-3)},
    "coulomb_level": {"scale": (1.5, 1.8)},
    "load_dependent_friction": {"gain_nm_per_n": (6e-5, 1e-4)},
    "friction_asymmetry": {"half_difference_nm": (0.025, 0.04)},
    "motor_torque_offset": {"offset_nm": (0.04, 0.07)},
    "motor_torque_gain": {"gain": (1.1, 1.15)},
    "unmodelled_spring": {"stiffness_nm_per_rad": (0.015, 0.025)},
    "screw_ripple": {"amplitude_nm": (0.04, 0.06), "phase_rad": (-3.0, 3.0)},
    "inertia": {"scale": (1.5, 1.8)},
    "quadratic_drag": {"coefficient_nm_s2_per_rad2": (3e-5, 5e-5)},
    "rack_ratio": {"scale": (0.06, 0.1)},
}
"""Effects that forty seconds of the demo's manoeuvre show clearly, and how strong they are."""


@dataclass(slots=True)
class Process:
    """A verb of eps-hil that runs beside us; ``file`` has what it says."""

    name: str
    file: Path
    process: subprocess.Popen[bytes]

    @property
    def text(self) -> str:
        """What it said so far, a live line as lines."""
        with suppress(OSError):
            said = self.file.read_text(encoding="utf-8", errors="replace")
            return re.sub(r"\x1b\[2K", "", said).replace("\r", "\n")
        return ""

    def await_text(self, pattern: str, seconds: float) -> None:
        """Until it says so; ends the demo if it ends or says nothing of the kind."""
        begun = time.monotonic()
        while not re.search(pattern, self.text, re.M):
            waited = time.monotonic() - begun
            first = ", the first time it compiles, which is kept" if waited > 4.0 else ""
            live_line(f"{self.name} starts: {waited:.0f} s{first}")
            if self.process.poll() is not None or waited > seconds:
                fail(f"{self.name}: no '{pattern}' in {self.file}:\n{self.text[-1500:]}")
            time.sleep(0.1)

    def finish(self, seconds: float, doing: str = "") -> None:
        """Wait until it ends by itself; ``doing`` says meanwhile how long it takes."""
        begun = time.monotonic()
        while (status := self.process.poll()) is None:
            waited = time.monotonic() - begun
            if waited > seconds:
                fail(f"{self.name} did not end within {seconds:.0f} s")
            if doing:
                live_line(f"{doing}: {waited:.0f} s")
            time.sleep(0.1)
        if status:
            fail(f"{self.name} ended with status {status}:\n{self.text[-1500:]}")

    def stop(self) -> None:
        """End it as Ctrl-C would."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()


def say(text: str) -> None:
    """A line of the demo's own."""
    live_line("")
    print(f"==> {text}", flush=True)


_shown = [""]


def live_line(text: str) -> None:
    """On a terminal, one line that the next one takes the place of: nobody waits without a word."""
    if text != _shown[0] and sys.stdout.isatty():
        print("\r\x1b[2K" + (f"    {text}" if text else ""), end="", flush=True)
        _shown[0] = text


def fail(text: str) -> Any:
    """End with status 1."""
    live_line("")
    raise SystemExit(f"error: {text}")


@contextmanager
def running(name: str, file: Path, *arguments: str) -> Iterator[Process]:
    """``eps-hil`` with these arguments, ended with the block."""
    with file.open("wb") as out:
        started = subprocess.Popen(
            [sys.executable, "-m", "eps_hil", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
        )
        one = Process(name, file, started)
        try:
            yield one
        finally:
            one.stop()


def is_compiled(folder: Path | None) -> bool:
    """Whether machine code of all that the demo runs is in the cache's folder; None: no folder."""
    parts = [] if folder is None else [folder / "functions" / part for part in COMPILED]
    return bool(parts) and all(next(part.rglob("*.nbi"), None) for part in parts)


def hidden(effect: str | None, seed: int) -> dict[str, Any]:
    """The effect to hide, with numbers, as an entry of a model file."""
    random = Random(seed)
    drawn = random.choice(sorted(RANGES))
    name = drawn if effect is None else effect
    if name not in RANGES:
        fail(f"'{name}' is not for this demo: choose {', '.join(sorted(RANGES))}")
    values = {key: random.uniform(low, high) for key, (low, high) in RANGES[name].items()}
    return {"effect": name, **{key: float(f"{value:.4g}") for key, value in values.items()}}


def config(out: Path, name: str, model: Path, port: int, *, publish: bool) -> Path:
    """A configuration on a multicast port of this demo's own."""
    path = out / f"{name}.yaml"
    path.write_text(
        f"""bus:
  interface: udp_multicast
  channel: 239.74.163.7
  fd: true
  options: {{port: {port}, hop_limit: 0}}
dbc: [{DATABASE}]
signals: {SIGNALS}
model: {model}
publish:
  enabled: {str(publish).lower()}
  message: EPSHIL_Estimate
  health_message: EPSHIL_Health
rig: {{manoeuvre: demo, order: 2}}
""",
        encoding="utf-8",
    )
    return path


def record(out: Path, rig: Path, log: Path, seconds: float) -> None:
    """One round of the rig's manoeuvre over the bus, into ``log``."""
    with running("the recorder", out / "recorder.txt", "record", str(log), "--config", str(rig),
                 "--overwrite") as recorder:  # fmt: skip
        recorder.await_text("^recording", COMPILING_S)
        with running("the rig", out / "rig.txt", "rig", "--config", str(rig), "--duration",
                     f"{seconds:g}") as simulated:  # fmt: skip
            simulated.await_text("^timing", COMPILING_S)
            simulated.finish(seconds + 60, f"the rig drives for {seconds:.0f} s")


def diagnose(out: Path, log: Path) -> dict[str, Any]:
    """The verb, as anybody would call it; its JSON."""
    command = [
        "eps-hil", "diagnose", "--model", str(MODEL), "--recording", str(log), "--dbc",
        str(DATABASE), "--signals", str(SIGNALS), "--report", str(out / "page.html"), "--json",
        str(out / "diagnosis.json"), "--write-model", str(out / "found.yaml"),
    ]  # fmt: skip
    say(" ".join(command))
    watched = sys.stderr.isatty()  # then its progress bar and what it complains of are seen there
    done = subprocess.run(
        [sys.executable, "-m", "eps_hil", *command[1:]], stdout=subprocess.PIPE,
        stderr=None if watched else subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    (out / "diagnose.txt").write_text(done.stdout + (done.stderr or ""), encoding="utf-8")
    if done.returncode:
        fail(f"diagnose ended with status {done.returncode}: {(done.stderr or '')[-800:]}")
    print("\n".join(f"    {line}" for line in done.stdout.strip().splitlines()))
    content: dict[str, Any] = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    return content


def reveal(entry: dict[str, Any], content: dict[str, Any]) -> bool:
    """What was hidden beside what was found; whether it was named."""
    numbers = ", ".join(f"{key} {value:g}" for key, value in entry.items() if key != "effect")
    say(f"hidden was: {entry['effect']} ({numbers}), {catalogue()[entry['effect']].equation}")
    found = {one["effect"]: one for one in content["findings"]}
    same = entry["effect"] in found
    for name, one in found.items():
        values = one.get("parameters", {}).items()
        told = ", ".join(f"{key} {number['value']:.4g}" for key, number in values
                         if isinstance(number.get("value"), float))  # fmt: skip
        say(f"found:      {name} ({told}), confidence {100 * one['confidence']:.0f} %")
    if not same:
        twins = [n for n, one in found.items() if entry["effect"] in one.get("confusable_with", [])]
        say(f"named: no{', but as what could also be ' + twins[0] if twins else ''}")
    return same


def _errors(text: str) -> tuple[int, list[int]]:
    """The last load cell of a service's live lines, and each line's estimate against its own.

    Two services speak at different moments: their estimates stand side by side in no table.
    """
    lines = re.findall(r"rack force\s+([+-]\d+) N\s+load cell\s+([+-]\d+) N", text)
    return (int(lines[-1][1]) if lines else 0), [int(one) - int(cell) for one, cell in lines]


def live(out: Path, rig: Path, configs: dict[str, Path], seconds: float) -> dict[str, float]:
    """Both models on the same bus at once; rms error against the load cell by name, in N."""
    with (
        running("the service", out / "service_given.txt", *_service(out, "given", configs)) as one,
        running(
            "the service with the written model",
            out / "service_found.txt",
            *_service(out, "found", configs),
        ) as two,
    ):
        for each in (one, two):
            each.await_text("^READY", COMPILING_S)
        recording = ("record", str(out / "live.log"), "--config", str(rig), "--overwrite")
        with running("the recorder", out / "recorder2.txt", *recording) as recorder:
            recorder.await_text("^recording", COMPILING_S)
            driving = ("rig", "--config", str(rig), "--duration", f"{seconds:g}")
            with running("the rig", out / "rig2.txt", *driving) as simulated:
                simulated.await_text("^timing", COMPILING_S)
                _watch(simulated, one, two)
                simulated.finish(60)
    live_line("both against the load cell in the recording")
    return _rms_errors_n(out / "live.log", {name: out / f"{name}.csv" for name in configs})


def _service(out: Path, name: str, configs: dict[str, Path]) -> list[str]:
    log = str(out / f"{name}.csv")
    return ["run", "--config", str(configs[name]), "--status-line", "--log-estimates", log]


def _watch(rig: Process, given: Process, found: Process) -> None:
    begun, shown = time.monotonic(), -2.0
    done = 0, 0
    while rig.process.poll() is None:
        now = time.monotonic() - begun
        (_, old), (cell, new) = _errors(given.text), _errors(found.text)
        if now - shown >= 1.0 and len(old) > done[0] and len(new) > done[1]:
            live_line("")
            print(
                f"    {now:4.0f} s   load cell {cell:+6.0f} N   rms error since the line before:"
                f" model as given {_rms(old[done[0] :]):4.0f} N,"
                f" written model {_rms(new[done[1] :]):4.0f} N",
                flush=True,
            )
            shown, done = now, (len(old), len(new))
        time.sleep(0.2)


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _rms_errors_n(log: Path, estimates: dict[str, Path]) -> dict[str, float]:
    import eps_hil

    cell = eps_hil.load(log, dbc=DATABASE, signals=SIGNALS).series["rack_force_n"]
    return {name: _rms_error_n(cell, path) for name, path in estimates.items()}


def _rms_error_n(cell: Series, estimates: Path) -> float:
    with estimates.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["valid"] in ("1", "True", "true")]
    t = np.array([int(row["t_ns"]) for row in rows])
    force = np.array([float(row["rack_force_estimate_n"]) for row in rows])
    inside = (t >= cell.t_ns[0]) & (t <= cell.t_ns[-1])
    if not inside.any():
        fail(f"no valid estimate in {estimates}")
    origin = cell.t_ns[0]
    true = np.interp(t[inside] - origin, cell.t_ns - origin, cell.value)
    return _rms(force[inside] - true)


def say_stalls(out: Path, command: str) -> None:
    """Where the machine stood still, the figures are its doing as well."""
    sys.path.insert(0, str(Path(__file__).parent))
    import demo_stalls

    rig, rig2, log = (out / name for name in ("rig.txt", "rig2.txt", "given.csv"))
    lines = demo_stalls.stalls(rig.read_text(encoding="utf-8"), None).lines(command)
    if not lines and rig2.exists() and log.exists():
        rows = demo_stalls.estimates(log, LIVE_S)
        lines = demo_stalls.stalls(rig2.read_text(encoding="utf-8"), rows).lines(command)
    for line in lines:
        say(line)


def main() -> int:
    """The demo; 0 if the hidden effect was named."""
    parser = argparse.ArgumentParser(prog="scripts/demo-diagnose")
    parser.add_argument("--effect", metavar="ID", help="hide this effect, not a random one")
    parser.add_argument("--seed", type=int, help="of the choice and its numbers; default: random")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "demo-diagnose")
    parser.add_argument("--no-open", action="store_true", help="do not open the page in a browser")
    given = parser.parse_args()
    out, begun = given.out, time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    seed = secrets.randbits(32) if given.seed is None else given.seed
    entry = hidden(given.effect, seed)
    chosen = f" --effect {given.effect}" if given.effect else ""
    again = f"scripts/demo-diagnose{chosen} --seed {seed}"
    for old in ("rig2.txt", "given.csv"):
        (out / old).unlink(missing_ok=True)
    truth = out / "hidden.yaml"
    replace(load_model(MODEL), effects=(entry,)).save(truth)
    port = 40000 + os.getpid() % 20000
    rig = config(out, "rig", truth, port, publish=True)

    if not is_compiled(compiled.FOLDER):
        say("compiling for this machine comes first, once: some minutes in all, before the rig "
            "drives, in the diagnosis, and before the services")  # fmt: skip
    say("an effect is hidden in the simulated rig; which one is in " + str(truth))
    say("recording 40 s of sweep, steps and weave over the bus (UDP multicast)")
    record(out, rig, out / "bus.log", 40.0)
    content = diagnose(out, out / "bus.log")
    page = out / "page.html"
    say(f"the page: {page}")
    if not given.no_open and sys.stdout.isatty() and os.environ.get("DISPLAY"):
        webbrowser.open(page.as_uri())
    named = reveal(entry, content)
    say(f"{LIVE_S:.0f} s live: the service with the model as given, and with the written one")
    configs = {
        "given": config(out, "service_given", MODEL, port, publish=False),
        "found": config(out, "service_found", out / "found.yaml", port, publish=True),
    }
    try:
        errors = live(out, rig, configs, LIVE_S)
    finally:
        say_stalls(out, again)
    say(f"rack force, rms error against the load cell: model as given {errors['given']:.1f} N, "
        f"written model {errors['found']:.1f} N")  # fmt: skip
    say(f"done in {time.monotonic() - begun:.0f} s")
    return 0 if named else 1


if __name__ == "__main__":
    sys.exit(main())
