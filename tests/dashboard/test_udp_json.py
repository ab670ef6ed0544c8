"""Datagrams as PlotJuggler's UDP server and JSON parser take them (their rules are in `Reader`)."""

import json
import socket
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.dashboard.store import Block
from eps_hil.dashboard.traces import ERROR, ESTIMATE, NAMES, POSITION
from eps_hil.dashboard.udp_json import JsonStream, address_of
from eps_hil.errors import InputError
from eps_hil.examples import CONFIGS
from eps_hil.recordings.json_rows import schema_of

ROOT = Path(__file__).parents[2]
Blocks = Callable[..., dict[str, Block]]
STATE = {
    "t_ns": 1_790_000_000_000_000_000,
    "bus": {"name": "x", "frames_per_s": 4000.0, "load": None, "lost_by_counter": 0,
            "lost_in_kernel": 0, "crc_errors": 0, "error_frames": 0},
    "estimate": {"status": "valid", "age_ms": 5.0},
    "residual": {"rms_moving_n": 6.0, "rms_resting_n": None, "why_not": ""},
}  # fmt: skip


class Reader:
    """What PlotJuggler makes of datagrams: points by the names that its list shows."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.address: tuple[str, int] = self.socket.getsockname()
        self.series: dict[str, list[tuple[float, float]]] = {}
        self.longest = 0
        self.rows: list[dict[str, Any]] = []

    def read(self) -> None:
        while True:
            try:
                data = self.socket.recv(65536)
            except BlockingIOError:
                return
            self.longest = max(self.longest, len(data))
            told = json.loads(data, parse_constant=_refuse)
            assert isinstance(told["timestamp"], float), "one without ends its use for good"
            self.rows.append(told["eps_hil"])
            self._flatten("", told, told["timestamp"])

    def _flatten(self, prefix: str, value: object, t_s: float) -> None:
        if isinstance(value, dict):
            for key, one in value.items():
                self._flatten(f"{prefix}/{key}", one, t_s)
        elif isinstance(value, int | float):
            self.series.setdefault(prefix, []).append((t_s, float(value)))


def _refuse(constant: str) -> float:
    raise AssertionError(f"{constant} is no JSON: PlotJuggler stops the stream")


@pytest.fixture
def reader() -> Iterator[Reader]:
    made = Reader()
    yield made
    made.socket.close()


@pytest.fixture
def stream(reader: Reader) -> Iterator[JsonStream]:
    made = JsonStream(reader.address)
    yield made
    made.close()


def test_every_trace_arrives_at_common_instants(
    reader: Reader, stream: JsonStream, blocks: Blocks
) -> None:
    for k in range(5):
        stream.samples(blocks(0.04 * k, 0.04 * (k + 1)))
        reader.read()
    assert (stream.sent, stream.dropped) == (200, 0)
    assert {f"/eps_hil/{name}" for name in NAMES} <= set(reader.series)
    for name, (t_ns, value) in blocks(0.0, 0.2).items():
        points = np.array(reader.series[f"/eps_hil/{name}"])
        np.testing.assert_allclose(points[:, 0], t_ns * 1e-9, rtol=0, atol=1e-6)
        np.testing.assert_allclose(points[:, 1], value, atol=1e-12)
    assert reader.longest < 1400, "a datagram fits one Ethernet frame"


def test_what_is_sent_keeps_to_its_schema(
    reader: Reader, stream: JsonStream, blocks: Blocks
) -> None:
    stream.samples(blocks(0.0, 0.04))
    reader.read()
    schema = schema_of(NAMES)
    jsonschema.Draft202012Validator.check_schema(schema)
    check = jsonschema.Draft202012Validator({**schema, "additionalProperties": False})
    for row in reader.rows:
        check.validate(row)


def test_an_invalid_estimate_is_left_out_and_loops_keep_one_time_axis(
    reader: Reader, stream: JsonStream, blocks: Blocks
) -> None:
    """PlotJuggler refuses a plot of one over the other where any instant has only one of them."""
    some = blocks(0.0, 0.2)
    some[ESTIMATE][1][50:100] = np.nan
    some[ERROR][1][50:100] = np.nan
    stream.samples(some)
    reader.read()
    assert len(reader.series[f"/eps_hil/{ESTIMATE}"]) == 150
    assert len(reader.series[f"/eps_hil/{POSITION}"]) == 200
    x = reader.series[f"/eps_hil/loops/estimate/{POSITION}"]
    y = reader.series[f"/eps_hil/loops/estimate/{ESTIMATE}"]
    assert [t for t, _ in x] == [t for t, _ in y]
    assert len(x) == 150


def test_traces_of_other_instants_are_laid_on_the_common_ones(reader: Reader) -> None:
    stream = JsonStream(reader.address, 200.0)
    t_ns = 1_790_000_000_000_300_000 + np.arange(300, dtype=np.int64) * 1_000_000
    ramp = (t_ns - t_ns[0]) * 1e-6
    later = t_ns + 400_000
    stream.samples({"rack_force_n": (t_ns, ramp), "motor_speed_rad_s": (later, ramp)})
    stream.close()
    reader.read()
    force = np.array(reader.series["/eps_hil/rack_force_n"])
    speed = np.array(reader.series["/eps_hil/motor_speed_rad_s"])
    np.testing.assert_allclose(np.diff(force[:, 0]), 0.005, atol=1e-6)
    assert set(speed[:, 0]) <= set(force[:, 0])
    np.testing.assert_allclose(force[1:, 1] - speed[-len(force) + 1 :, 1], 0.4, atol=1e-9)


def test_a_silent_trace_does_not_hold_the_others(
    reader: Reader, stream: JsonStream, blocks: Blocks
) -> None:
    stream.samples(blocks(0.0, 0.1))
    for k in range(10):
        more = blocks(0.1 + 0.04 * k, 0.14 + 0.04 * k)
        del more["torque_sensor_nm"]
        stream.samples(more)
        reader.read()
    assert len(reader.series["/eps_hil/rack_force_n"]) == 500
    assert len(reader.series["/eps_hil/torque_sensor_nm"]) == 100


def test_a_clock_set_back_begins_anew(reader: Reader, stream: JsonStream, blocks: Blocks) -> None:
    stream.samples(blocks(100.0, 100.1))
    stream.samples(blocks(0.0, 0.1))
    reader.read()
    assert len(reader.series["/eps_hil/rack_force_n"]) >= 190


def test_nobody_at_the_other_end_costs_nothing(reader: Reader, blocks: Blocks) -> None:
    stream = JsonStream(reader.address)
    reader.socket.close()
    stream.samples(blocks(0.0, 0.1))
    stream.state(STATE)
    assert stream.flush()
    stream.close()


def test_the_layout_names_what_the_stream_sends(
    reader: Reader, stream: JsonStream, blocks: Blocks
) -> None:
    stream.samples(blocks(0.0, 0.1))
    stream.state({**STATE, "residual": {"rms_moving_n": 6.0, "rms_resting_n": 8.0}})
    reader.read()
    root = ET.parse(CONFIGS / "plotjuggler.xml").getroot()
    curves = list(root.iter("curve"))
    wanted = {one.attrib["name"] for one in curves if "curve_x" not in one.attrib}
    wanted |= {one.attrib[axis] for one in curves if "curve_x" in one.attrib
               for axis in ("curve_x", "curve_y")}  # fmt: skip
    assert wanted <= set(reader.series)
    assert len(wanted) > 15


def test_the_layout_is_built_as_the_program_reads_it() -> None:
    """By the rules of its loader: names that it looks up, as many panes as are told."""
    root = ET.parse(CONFIGS / "plotjuggler.xml").getroot()
    assert root.tag == "root"
    (window,) = root.findall("tabbed_widget")
    assert window.attrib == {"name": "Main Window", "parent": "main_window"}
    assert [tab.attrib["tab_name"] for tab in window.findall("Tab")] == [
        "rack force", "hysteresis", "health"
    ]  # fmt: skip
    for splitter in root.iter("DockSplitter"):
        areas = splitter.findall("DockArea")
        assert len(areas) == int(splitter.attrib["count"])
        assert len(splitter.attrib["sizes"].split(";")) == len(areas)
        assert splitter.attrib["orientation"] in "|-"
        for area in areas:
            (plot,) = area.findall("plot")
            both = [{"curve_x", "curve_y"} <= set(one.attrib) for one in plot.findall("curve")]
            assert both
            assert all(both) == (plot.attrib["mode"] == "XYPlot")
    streamer = root.find("previouslyLoaded_Streamer")
    assert streamer is not None
    assert streamer.attrib["name"] == "UDP Server"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("127.0.0.1:9870", ("127.0.0.1", 9870)),
        ("127.0.0.1", ("127.0.0.1", 9870)),
        ("[::1]:5000", ("::1", 5000)),
    ],
)
def test_addresses(text: str, expected: tuple[str, int]) -> None:
    assert address_of(text) == expected


@pytest.mark.parametrize("text", ["", ":9870", "127.0.0.1:x", "127.0.0.1:0", "no host:9870"])
def test_what_is_no_address_is_said(text: str) -> None:
    with pytest.raises(InputError, match=r"say HOST:PORT"):
        address_of(text)


def test_the_verb_streams_a_bus_that_is_silent(
    tmp_path: Path, reader: Reader, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "c.yaml"
    config.write_text(f"""bus: {{interface: virtual, channel: stream-test}}
dbc: [{ROOT}/dbc/eps_rig.dbc]
signals: {ROOT}/configs/eps_rig_signals.yaml
model: {ROOT}/configs/reference_rig.yaml
""")
    where = "{}:{}".format(*reader.address)
    words = ["stream", "--config", str(config), "--udp", where, "--seconds", "0.4"]
    assert main(words) == 0
    reader.read()
    assert reader.series["/eps_hil/state/bus/frames_per_s"][-1][1] == 0.0
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith(f"stream: virtual stream-test to udp {where}, JSON, 1000 instants")
    assert said[-1].endswith("datagrams sent, 0 dropped")


def test_a_clock_that_is_set_forward_is_not_filled_with_instants(
    reader: Reader, stream: JsonStream
) -> None:
    """Nor a night without the rig: each second of it would be a thousand instants."""
    t_ns = 1_790_000_000_000_000_000 + np.arange(0, 100_000_000, 1_000_000)
    for begin_ns in (0, 365 * 86_400 * 10**9):
        stream.samples({ESTIMATE: (t_ns + begin_ns, np.ones(100))})
    reader.read()
    stamps = [t_s for t_s, _ in reader.series["/eps_hil/rack_force_estimate_n"]]
    after = t_ns[1:] + 365 * 86_400 * 10**9  # the first one has no neighbour to be read off between
    assert np.allclose(stamps, np.append(t_ns, after) * 1e-9, rtol=0, atol=1e-6)
