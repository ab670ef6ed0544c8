"""The torques of a log go through the guard as any other wish, or they do not go at all."""

from dataclasses import replace
from itertools import pairwise

import pytest

from eps_hil.bus.database import load_database
from eps_hil.bus.e2e import E2eProfile
from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError
from eps_hil.service.command_replay import CommandReplay, LoggedCommand, read_commands
from eps_hil.service.guard import Command, Trip
from eps_hil.service.override import State
from eps_hil.service.override_setup import CommandEncoder, OverrideParts

from .lockstep import CONFIG, ROOT, Lockstep, parts_of

DATABASE = load_database([ROOT / "dbc" / "eps_rig.dbc"])
MS = 1_000_000


@pytest.fixture
def parts() -> OverrideParts:
    return parts_of()


def log_of(parts: OverrideParts, torques: list[float | None]) -> list[Frame]:
    """One command a millisecond, as an override session would have sent it."""
    encoder = CommandEncoder(DATABASE, parts.override, "eps_rig.dbc")
    return [
        replace(encoder.frame(Command(torque or 0.0, torque is not None)), t_ns=10**18 + k * MS)
        for k, torque in enumerate(torques)
    ]


def ramp(peak_nm: float, steps: int) -> list[float | None]:
    up = [peak_nm * k / steps for k in range(steps)]
    return [None] * 10 + up + up[::-1] + [None] * 10


def test_the_log_is_read_with_checks(parts: OverrideParts) -> None:
    frames = log_of(parts, [None, 0.1, 0.2, None])
    broken = replace(frames[2], data=bytes([frames[2].data[0] ^ 1]) + frames[2].data[1:])
    others = [Frame(0, 0x101, bytes(8)), Frame(0, 0x80, bytes(8), extended=True)]
    found = read_commands([*others, *frames[:2], broken, *frames[3:]], parts, "x.log")
    assert [each.t_ns for each in found] == [0, MS, 2 * MS, 3 * MS]
    # the CRC of the third is wrong
    assert [each.torque_nm for each in found] == [None, pytest.approx(0.1), None, None]


def test_where_the_ecu_wants_a_profile_its_crc_is_checked(parts: OverrideParts) -> None:
    parts = replace(parts, override=replace(parts.override, e2e=E2eProfile("p01", data_id=0x80)))
    frames = log_of(parts, [0.1, 0.2, 0.3])
    flipped = bytearray(frames[1].data)
    flipped[3] ^= 0x40
    frames[1] = replace(frames[1], data=bytes(flipped))
    found = read_commands(frames, parts, "x.log")
    assert [each.torque_nm for each in found] == [pytest.approx(0.1), None, pytest.approx(0.3)]


@pytest.mark.parametrize("every_ms", [25, 30])
@pytest.mark.parametrize("obeys", [True, False])
def test_an_ecu_that_refuses_short_commands_is_noticed(
    parts: OverrideParts, every_ms: int, obeys: bool
) -> None:
    """A log with gaps: each is a release, and no command lasts as long as the status may take."""
    commands = [LoggedCommand(k * every_ms * MS, 0.018) for k in range(40)]
    bench = Lockstep(parts, CommandReplay(commands))
    bench.arm()
    if not obeys:
        bench.rig.override.hear = lambda command, now_ns: None  # type: ignore[method-assign]
    bench.step(600)
    assert bench.core.override.guard.trips == (Trip.NONE if obeys else Trip.ECU_STATUS)


def test_a_log_without_a_torque_or_with_too_much_of_it_is_refused(parts: OverrideParts) -> None:
    with pytest.raises(InputError, match=r"no EPSHIL_TorqueOverride \(0x80\) that enables"):
        read_commands(log_of(parts, [None, None]), parts, "x.log")
    with pytest.raises(InputError, match=r"up to 0.41 Nm, and the guard allows 0.4 Nm"):
        read_commands(log_of(parts, [0.0, -0.41]), parts, "x.log")


def test_what_the_log_asked_for_reaches_the_motor_by_the_guard(parts: OverrideParts) -> None:
    wanted = ramp(0.1, 200)
    source = CommandReplay(read_commands(log_of(parts, wanted), parts, "x.log"))
    bench = Lockstep(parts, source)
    bench.step(300)
    assert source.done[0] == 0  # nobody armed: nothing was asked for, nothing was sent
    assert not [tick for tick in bench.ticks if tick.commands]
    bench.arm()
    bench.step(600)
    assert source.over
    assert bench.state is State.ARMED
    applied = [tick.applied_nm for tick in bench.ticks]
    assert max(applied) == pytest.approx(0.1, abs=0.001)
    first = next(k for k, nm in enumerate(applied) if nm > 0.0)
    asked = [nm or 0.0 for nm in wanted][11:]
    assert applied[first : first + 380] == pytest.approx(asked[:380], abs=0.0011)
    # counters are this session's own, one frame after the other
    counters = [command.counter for tick in bench.ticks for command in tick.commands]
    assert all((b - a) % 256 == 1 for a, b in pairwise(counters))


def test_a_jump_in_the_log_trips_the_guard(parts: OverrideParts) -> None:
    commands = read_commands(log_of(parts, [None, 0.0, 0.0, 0.3, 0.3]), parts, "x.log")
    bench = Lockstep(parts, CommandReplay(commands))
    bench.arm()
    bench.step(100)
    assert bench.state is State.FAULT
    assert bench.core.override.guard.trips & Trip.STEP
    assert max(abs(tick.applied_nm) for tick in bench.ticks) == 0.0


def test_letting_go_of_the_dead_man_ends_it(parts: OverrideParts) -> None:
    source = CommandReplay(read_commands(log_of(parts, [0.0] * 4_000), parts, "x.log"))
    bench = Lockstep(parts, source)
    bench.arm()
    bench.step(100)
    before = bench.state
    bench.beating = False
    bench.step(1_000)
    assert (before, bench.state) == (State.INJECTING, State.FAULT)
    assert bench.core.override.guard.trips & Trip.HEARTBEAT


def test_a_gap_in_the_log_is_a_release(parts: OverrideParts) -> None:
    source = CommandReplay([LoggedCommand(0, 0.1), LoggedCommand(100 * MS, 0.2)])
    wants = [source.step(k * MS, {}, engaged=True, now_ns=k * MS) for k in range(150)]
    assert wants[0] == wants[20] == 0.1
    assert wants[21:100] == [None] * 79
    assert wants[100] == wants[120] == 0.2
    assert wants[121:] == [None] * 29
    assert source.over


@pytest.mark.parametrize("back_ns", [0, 3_600_000 * MS])
def test_a_sample_time_that_stands_or_goes_back_is_a_release(back_ns: int) -> None:
    """By it the last command would be wanted for ever, or for an hour more."""
    source = CommandReplay([LoggedCommand(k * MS, 0.1) for k in range(1000)])
    start_ns = 10_000_000 * MS

    def wanted(t_ns: int, k: int) -> float | None:
        return source.step(start_ns + t_ns, {}, engaged=True, now_ns=k * MS)

    assert [wanted(k * MS, k) for k in range(100)] == [0.1] * 100
    stood = [wanted(99 * MS - back_ns, k) for k in range(100, 200)]
    assert stood == [0.1] * 20 + [None] * 80
    assert wanted(100 * MS, 200) == 0.1, "the guard judges what comes after"


def test_the_configuration_of_the_tests_has_a_guard() -> None:
    assert "max_torque_nm: 0.4" in CONFIG.read_text()
