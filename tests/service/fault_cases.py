"""Randomised fault injection: what runs a case, and who judges it.

Run by ``scripts/fault_injection``. A fault starts at a random moment of an injection, most are
healed again after a while, and the injection goes on being wanted all the time. The judge reads
only what the ECU heard and applied:

* every command within the limits: magnitude, step from frame to frame, change in 250 ms;
* torque zero at most one ECU time-out (and one ECU cycle) after the fault began;
* zero ever after, although the fault is healed and the torque still wanted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from eps_hil.rig.ecu import Command
from eps_hil.service.limits import Limits
from eps_hil.service.override import State

from .faults import FAULTS, Fault, Make, setup_for, tight_config, tight_limits
from .lockstep import Lockstep, Sawtooth, parts_of

TIMEOUT_MS = 20
"""The simulated ECU's, configs/calibrate_udp.yaml."""
AFTER_MS = 160


@dataclass
class Outcome:
    """One case; ``zero_ms``: from the beginning of the fault to the last torque, None: it went on.

    ``wrong``: what broke the rules, in words; empty where nothing did.
    """

    fault: str
    seed: int
    must_stop: bool
    zero_ms: int | None
    peak_nm: float
    wrong: list[str] = field(default_factory=list)


def run_case(make: Make, seed: int) -> Outcome:
    """One fault at a random moment of a random injection."""
    random = np.random.default_rng(seed)
    source = Sawtooth(float(random.uniform(0.03, 0.08)), float(random.uniform(0.5, 2.0)))
    manoeuvre = str(random.choice(["parked", "parked_hands_on"]))
    bench = Lockstep(parts_of(tight_config()), source, setup_for(manoeuvre), seed)
    bench.rig._plant._table = bench.rig._plant._table.copy()
    bench.arm()
    bench.step(int(random.integers(30, 250)))
    assert bench.state is State.INJECTING, bench.story()
    fault = make(bench, random)
    _run(bench, 1)
    for _ in range(1500):
        if fault.begun():
            break
        _run(bench, 1)
    begun_ms = bench.ms - 1
    _run(bench, int(random.integers(25, 80)))
    fault.heal()
    _run(bench, AFTER_MS)
    return _judge(bench, make.__name__, seed, fault, begun_ms)


def _run(bench: Lockstep, count: int) -> None:
    """As the session's shell does: an error in the loop ends it with releases."""
    for _ in range(count):
        try:
            bench.step()
        except ZeroDivisionError:
            bench.send(bench.core.end(bench.now_ns, "error", fault=True))
            bench.dead = True
            bench.ms += 1


def _judge(bench: Lockstep, name: str, seed: int, fault: Fault, begun_ms: int) -> Outcome:
    limits, wrong = tight_limits(), []
    loud = [tick.ms for tick in bench.ticks if tick.applied_nm != 0.0]
    went_on = loud[-1] >= bench.ms - 20
    zero_ms = None if went_on else max(loud[-1] - begun_ms + 1, 0)
    if fault.must_stop and (zero_ms is None or zero_ms > TIMEOUT_MS + 1):
        wrong.append(f"torque for {'ever' if zero_ms is None else zero_ms} ms after the fault")
    if not fault.foreign:
        peak_nm = max(abs(tick.applied_nm) for tick in bench.ticks)
        if peak_nm > limits.max_torque_nm:
            wrong.append(f"{peak_nm} Nm at the motor")
    sent = [(tick.ms, c) for tick in bench.ticks for c in tick.commands]
    wrong += _commands_beyond(sent, limits)
    quiet = [ms for ms, c in sent if ms > begun_ms and not c.enable]
    if quiet and any(c.enable for ms, c in sent if ms > quiet[0]):
        wrong.append("commanded again after a release")
    peak_nm = max((abs(c.torque_nm) for _, c in sent if c.enable), default=0.0)
    return Outcome(name, seed, fault.must_stop, zero_ms, peak_nm, wrong)


def _commands_beyond(sent: Sequence[tuple[int, Command]], limits: Limits) -> list[str]:
    """The limits of the commands themselves, checked frame by frame (quantum 1 uNm).

    Where frames were lost on the way, their number (the counter tells) is the number of steps that
    lie between what was heard; a forged frame's counter tells nothing, and it gets one.
    """
    wrong, last_nm, last_counter, quantum = [], 0.0, 0, 1.1e-6
    window: list[tuple[int, float]] = []
    for ms, command in sent:
        enable = command.enable
        torque_nm = command.torque_nm if enable else 0.0
        window = [(at, nm) for at, nm in window if ms - at <= 250]
        if abs(torque_nm) > limits.max_torque_nm:
            wrong.append(f"{torque_nm} Nm commanded")
        steps = max((command.counter - last_counter) % 256, 1) if last_nm else 1
        steps = steps if steps <= AFTER_MS else 1
        if torque_nm and abs(torque_nm - last_nm) > steps * limits.max_step_nm + quantum:
            wrong.append(f"a step of {torque_nm - last_nm} Nm")
        if torque_nm and any(
            abs(torque_nm - nm) > limits.max_change_250ms_nm + quantum for _, nm in window
        ):
            wrong.append("too much in 250 ms")
        window.append((ms, torque_nm))
        last_nm, last_counter = torque_nm, command.counter
    return wrong


def cases(count: int, seed: int) -> list[tuple[int, int]]:
    """(number of the fault, seed) of ``count`` cases, every fault equally often."""
    return [(k % len(FAULTS), seed * 1_000_003 + k) for k in range(count)]


def run_numbered(case: tuple[int, int]) -> Outcome:
    """For worker processes."""
    return run_case(FAULTS[case[0]], case[1])


def table(outcomes: list[Outcome]) -> str:
    """The outcome as a Markdown table, a line for each kind of fault."""
    lines = [
        "| fault | cases | stopped | longest torque after it | largest command | wrong |",
        "|---|---|---|---|---|---|",
    ]
    for make in FAULTS:
        part = [each for each in outcomes if each.fault == make.__name__]
        if not part:
            continue
        stopped = [each.zero_ms for each in part if each.zero_ms is not None]
        longest = f"{max(stopped)} ms" if stopped else "–"
        note = "" if part[0].must_stop else " (may go on)"
        lines.append(
            f"| {make.__name__.replace('_', ' ')}{note} | {len(part)} | {len(stopped)} | {longest}"
            f" | {max(each.peak_nm for each in part) * 1e3:.0f} mNm"
            f" | {sum(bool(each.wrong) for each in part)} |"
        )
    return "\n".join(lines)
