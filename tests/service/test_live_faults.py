"""Faults on real sockets, by the clock of the case: what holds in lock-step holds there too."""

import subprocess
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from eps_hil.bus.config import BusConfig
from eps_hil.errors import BusError
from eps_hil.oracle.faults import case
from eps_hil.oracle.faults.drive import drive
from eps_hil.oracle.faults.in_nodes import service_stopped
from eps_hil.oracle.faults.judge import Outcome
from eps_hil.oracle.faults.live import LiveBus, LiveError
from eps_hil.oracle.faults.scene import Kind
from eps_hil.oracle.faults.traffic import World
from eps_hil.service.present import Present

pytestmark = pytest.mark.slow

SEED = 20
NAMES = (
    case.NO_FAULT, "ecu silent", "motor state silent", "sync crc wrong", "second sender of our id",
    "second ecu", "rig restarted", "ecu restarted", "service restarted", "estimates not sent",
    "clock step", "clock step half second back",
)  # fmt: skip
UDP = BusConfig("udp_multicast", "239.74.163.88", fd=True, options={"port": 43188, "hop_limit": 0})
BUSES = pytest.mark.parametrize(
    "live", ["udp_multicast", pytest.param("vcan", marks=pytest.mark.socketcan)], indirect=True
)


@pytest.fixture(scope="module")
def world() -> World:
    return World([("demo", 16)])


@pytest.fixture
def live(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[LiveBus]:
    if request.param == "udp_multicast":
        made = LiveBus(UDP)
    else:
        vcan = request.getfixturevalue("vcan0")
        made = LiveBus(BusConfig("socketcan", vcan), lambda state: link(vcan, state))
    monkeypatch.setattr(case, "drive", made.drive)
    yield made
    if request.param == "vcan":
        link("vcan0", "up")


def link(name: str, state: str) -> None:
    subprocess.run(["ip", "link", "set", name, state], check=True)


def of_length(world: World, make: Callable[..., tuple[str, int]], milliseconds: float) -> Outcome:
    kind = Kind(make, milliseconds, milliseconds)
    return case.run(world, [kind], SEED, np.random.default_rng(SEED))


@BUSES
@pytest.mark.parametrize("name", NAMES)
def test_what_is_published_on_a_bus_is_what_lock_step_says(
    live: LiveBus, world: World, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = case.single(world, name, SEED)
    assert outcome.wrong == [], "\n".join(outcome.story)
    monkeypatch.setattr(case, "drive", drive)
    imitated = case.single(world, name, SEED)
    assert outcome.worst_n == pytest.approx(imitated.worst_n, abs=5.0)
    assert outcome.valid_share == pytest.approx(imitated.valid_share, abs=0.02)
    assert imitated.valid_share > 0.3


@BUSES
def test_a_service_that_stands_still_for_two_seconds(live: LiveBus, world: World) -> None:
    """More waits in its socket then than the kernel keeps."""
    outcome = of_length(world, service_stopped, 2_000)
    assert outcome.wrong == [], "\n".join(outcome.story)
    assert outcome.valid_share > 0.3
    assert any("says   valid" in line for line in outcome.story)


@BUSES
def test_foreign_ids_at_the_full_load_of_a_bus(live: LiveBus, world: World) -> None:
    """Every frame of ours is worked through between them, to the last."""
    outcome = of_length(world, live.full_load_of_foreign_ids, 1_000)
    assert outcome.wrong == [], "\n".join(outcome.story)
    assert outcome.valid_share == 1.0
    assert live.port.counts.lost_in_kernel == 0


@pytest.mark.parametrize("live", [pytest.param("vcan", marks=pytest.mark.socketcan)], indirect=True)
def test_an_interface_that_goes_down_and_comes_back(live: LiveBus, world: World) -> None:
    outcome = of_length(world, live.interface_down_and_up, 700)
    assert outcome.wrong == [], "\n".join(outcome.story)
    assert live.openings == 2
    assert any("says   valid" in line for line in outcome.story[4:])


@BUSES
def test_several_faults_one_into_the_other(live: LiveBus, world: World) -> None:
    kinds = [case.KINDS[name] for name in ("service stopped", "rig restarted", "sync crc wrong")]
    outcome = case.run(world, kinds, SEED, np.random.default_rng(SEED))
    assert outcome.wrong == [], "\n".join(outcome.story)


@pytest.mark.parametrize("live", ["udp_multicast"], indirect=True)
def test_a_wrong_age_is_found_on_a_bus(
    live: LiveBus, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The judge sees what the socket carries: a clock that lags by 15 ms is an age too small."""
    now_ns = Present.now_ns
    monkeypatch.setattr(Present, "now_ns", lambda present: now_ns(present) - 15_000_000)
    outcome = case.single(world, case.NO_FAULT, SEED)
    assert any("off for" in line for line in outcome.wrong)


@pytest.mark.parametrize("live", ["udp_multicast"], indirect=True)
def test_a_service_that_dies_is_found_on_a_bus(
    live: LiveBus, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(_present: Present) -> int:
        raise BusError("broken")

    monkeypatch.setattr(Present, "now_ns", lost)
    with pytest.raises(LiveError, match="did not answer"):
        case.single(world, case.NO_FAULT, SEED)
