"""Nothing but an armed override can send a torque: the rule of the ports, and what it names."""

import uuid
from collections.abc import Callable
from pathlib import Path

import pytest

from eps_hil.bus import commands
from eps_hil.bus.commands import Kind
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import Port, SendRule, open_port
from eps_hil.bus.socketcan_bus import SocketCanBus
from eps_hil.errors import BusError, InputError

ROOT = Path(__file__).parents[2]
OWN_DBC = ROOT / "dbc" / "eps_rig.dbc"

FOREIGN = """VERSION ""
BU_: A
BO_ 512 LKA_Steering: 8 A
 SG_ LkaTorqueReq : 0|16@1- (0.01,0) [-10|10] "Nm" A
BO_ 513 Engine: 8 A
 SG_ TorqueFrequency : 0|16@1- (0.01,0) [-10|10] "Hz" A
 SG_ EngineTorque : 16|16@1- (0.01,0) [-10|10] "Nm" A
BO_ 514 Lift: 8 A
 SG_ Height : 0|16@1- (0.01,0) [-10|10] "m" A
BO_ 128 Harmless: 8 A
 SG_ Height : 0|16@1- (0.01,0) [-10|10] "m" A
BO_ 2566844570 Bench_Drive: 8 A
 SG_ Level : 0|16@1- (0.01,0) [-10|10] "" A
BO_ 515 Told_Torque: 8 A
 SG_ TorqueRequestEcho : 0|16@1- (0.01,0) [-10|10] "Nm" A
BA_DEF_ BO_ "EpsHilCommand" ENUM "No","Torque","SetPoint";
BA_DEF_DEF_ "EpsHilCommand" "No";
BA_ "EpsHilCommand" BO_ 2566844570 1;
BA_ "EpsHilCommand" BO_ 515 0;
"""


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    path = tmp_path / "foreign.dbc"
    path.write_text(FOREIGN)
    return path


def opened(interface: str, udp_port: int, **rule: object) -> Port:
    if interface == "virtual":
        return open_port("virtual", uuid.uuid4().hex, **rule)  # type: ignore[arg-type]
    if interface == "udp_multicast":
        options = {"port": udp_port, "hop_limit": 0}
        return open_port("udp_multicast", "239.74.163.2", options=options, **rule)  # type: ignore[arg-type]
    return open_port("socketcan", "vcan0", **rule)  # type: ignore[arg-type]


INTERFACES = pytest.mark.parametrize(
    "interface",
    ["virtual", "udp_multicast", pytest.param("socketcan", marks=pytest.mark.socketcan)],
)


@pytest.fixture
def port_of(
    request: pytest.FixtureRequest, udp_port: int
) -> Callable[..., Port]:  # vcan only where it is asked for
    def made(interface: str, **rule: object) -> Port:
        if interface == "socketcan":
            request.getfixturevalue("vcan")
        port = opened(interface, udp_port, **rule)
        request.addfinalizer(port.close)
        return port

    return made


@INTERFACES
@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("can_id", [0x80, 0xA0])
def test_no_port_sends_a_command_unless_it_was_opened_for_it(
    interface: str, can_id: int, extended: bool, port_of: Callable[..., Port]
) -> None:
    port = port_of(interface)
    with pytest.raises(BusError, match=f"id 0x{can_id:X} commands a torque or a rig"):
        port.send(Frame(0, can_id, bytes(8), extended=extended))
    assert port.counts.sent == 0
    assert port.send(Frame(0, 0x81, bytes(8)))


@INTERFACES
def test_what_may_never_be_sent_beats_what_may(
    interface: str, port_of: Callable[..., Port]
) -> None:
    with pytest.raises(BusError, match="0x200 commands a torque or a rig"):
        port_of(interface, send_ids=(0x100, 0x200), never_send_ids=(0x200,))
    port = port_of(interface, never_send_ids=(0x18FF0001,))
    with pytest.raises(BusError, match="0x18FF0001 commands"):
        port.send(Frame(0, 0x18FF0001, b"", extended=True))


@INTERFACES
def test_an_id_that_a_driver_would_cut_to_a_command_is_refused(
    interface: str, port_of: Callable[..., Port]
) -> None:
    """0x880 has 12 bits; a driver that masks 11 of them would put 0x080 on the wire."""
    port = port_of(interface)
    with pytest.raises(BusError, match="0x880 does not fit"):
        port.send(Frame(0, 0x880, bytes(8)))
    assert port.counts.sent == 0


def test_the_rule_alone() -> None:
    SendRule("p", None, ()).check(Frame(0, 0x80, b""))  # an override session's port
    with pytest.raises(BusError, match="not configured to send id 0x81"):
        SendRule("p", (0x82,)).check(Frame(0, 0x81, b""))
    with pytest.raises(BusError, match="not configured"):
        SendRule("p", ()).check(Frame(0, 0x1, b""))


@pytest.mark.socketcan
def test_python_can_programs_on_our_socket_send_no_command_either(vcan: str) -> None:
    import can

    with SocketCanBus(vcan) as bus, pytest.raises(can.CanOperationError, match="commands a torque"):
        bus.send(can.Message(arbitration_id=0x80, is_extended_id=False, data=bytes(8)))


def test_the_projects_own_database_marks_its_commands() -> None:
    found = commands.of_database(load_database([OWN_DBC]))
    assert {i: (one.name, one.kind) for i, one in found.items()} == {
        0x80: ("EPSHIL_TorqueOverride", Kind.TORQUE),
        0xA0: ("RIG_Command", Kind.SET_POINT),
    }
    assert found == commands.OWN


def test_the_mark_counts_where_the_name_says_nothing(tmp_path: Path) -> None:
    """The same database under other names: the attribute alone tells."""
    text = OWN_DBC.read_text().replace("EPSHIL_TorqueOverride", "A").replace("RIG_Command", "B")
    (tmp_path / "x.dbc").write_text(text)
    found = commands.of_database(load_database([tmp_path / "x.dbc"]))
    assert {i: one.kind for i, one in found.items()} == {0x80: Kind.TORQUE, 0xA0: Kind.SET_POINT}


def test_the_name_counts_where_there_is_no_mark(tmp_path: Path) -> None:
    lines = [line for line in OWN_DBC.read_text().splitlines() if "EpsHilCommand" not in line]
    (tmp_path / "x.dbc").write_text("\n".join(lines))
    assert commands.of_database(load_database([tmp_path / "x.dbc"])) == commands.OWN


def test_a_foreign_database_is_read_by_marks_mapping_and_suspicion(
    foreign: Path, tmp_path: Path
) -> None:
    signals = tmp_path / "s.yaml"
    signals.write_text(
        "signals:\n  motor_torque_nm: {message: Engine, signal: EngineTorque}\ncommands: [Lift]\n"
    )
    database, certain = commands.load_commands([foreign], signals, torque=["Engine"])
    assert {one.name: one.kind for one in certain.values()} == {
        "Engine": Kind.TORQUE,
        "Lift": Kind.SET_POINT,
        "Bench_Drive": Kind.TORQUE,
    }
    assert 0x18FEF65A in certain or 2566844570 & 0x1FFF_FFFF in certain
    left_out = commands.of_replay((database, certain))
    names = {one.name for one in left_out.values()}
    # 0x80 is this database's Harmless, 0xA0 nobody's; the echo is marked as no command.
    assert names == {"Engine", "Lift", "Bench_Drive", "LKA_Steering", "RIG_Command"}
    assert left_out[512].kind is Kind.SUSPECTED


def test_a_command_by_one_of_two_databases_is_one(foreign: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare.dbc"
    bare.write_text(
        'VERSION ""\nBU_: A\nBO_ 514 Lift: 8 A\n SG_ Height : 0|8@1+ (1,0) [0|9] "" A\n'
    )
    first = commands.load_commands([bare], None, beside=["Lift", "Bench_Drive"])
    second = commands.load_commands([foreign], None, torque=["Engine"])
    for known in ((first, second), (second, first)):
        names = {one.name for one in commands.of_replay(*known).values()}
        assert names == {"Lift", "Engine", "Bench_Drive", "LKA_Steering", "RIG_Command"}


def test_without_a_database_the_projects_own_ids_are_left_out() -> None:
    assert commands.of_replay() == commands.OWN


def test_a_marked_message_that_does_not_exist_is_refused(foreign: Path, tmp_path: Path) -> None:
    signals = tmp_path / "s.yaml"
    signals.write_text(
        "signals:\n  motor_torque_nm: {message: Engine, signal: EngineTorque}\ncommands: [Lifd]\n"
    )
    with pytest.raises(InputError, match="has no message Lifd; nearest: Lift"):
        commands.load_commands([foreign], signals)


def test_only_the_override_and_the_programme_open_a_port_for_commands() -> None:
    """Every other ``open_port`` of the package keeps the default, or names more than that."""
    allowed = {
        "service/override_session.py",  # all commands but the one that its guard judges
        "programme/link.py",  # every command of a torque
        "service/loop.py",  # all commands of its configuration
        "rig/process.py",  # all commands of its database
        "cli/replay.py",  # all, and what looks like one
    }
    passed_on = {"bus/port.py", "bus/socketcan.py", "bus/udp_multicast.py", "bus/python_can.py"}
    package = ROOT / "eps_hil"
    found = {
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if "never_send_ids=" in path.read_text()
    }
    assert found - passed_on - {"cli/_bus_options.py", "service/override_setup.py"} == allowed
