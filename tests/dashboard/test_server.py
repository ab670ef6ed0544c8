"""What the server answers, and what it refuses."""

import contextlib
import http.client
import json
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eps_hil.dashboard.server import Hub, allowed_host, assets, listening
from eps_hil.dashboard.store import Block, Store
from eps_hil.dashboard.traces import NAMES
from eps_hil.errors import BusError

Blocks = Callable[[float, float], dict[str, Block]]
Start = Callable[..., Any]
T0_S = 1_790_000_000


def get(port: int, path: str, **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


def test_the_page_and_all_it_needs_come_from_here(running: Start) -> None:
    port = running().port
    status, page = get(port, "/")
    assert status == 200
    assert "http://" not in page
    assert "https://" not in page
    for name in assets():
        assert get(port, f"/asset/{name}")[0] == 200
    assert get(port, "/asset/..%2fserver.py")[0] == 404
    assert get(port, "/asset/server.py")[0] == 404
    assert json.loads(get(port, "/layout.json")[1])["recording"] is None


@pytest.mark.parametrize(
    ("host", "bound", "may"),
    [
        ("127.0.0.1:8050", "127.0.0.1", True),
        ("localhost:8050", "127.0.0.1", True),
        ("[::1]:8050", "::1", True),
        ("evil.example:8050", "127.0.0.1", False),
        ("192.0.2.7:8050", "127.0.0.1", False),
        ("192.0.2.7:8050", "0.0.0.0", True),
        ("evil.example", "0.0.0.0", False),
        ("", "127.0.0.1", False),
    ],
)
def test_names_that_a_request_may_use(host: str, bound: str, may: bool) -> None:
    assert allowed_host(host, bound) is may


def test_a_foreign_name_or_page_is_refused(running: Start) -> None:
    port = running().port
    assert get(port, "/layout.json", Host="evil.example")[0] == 403
    assert get(port, "/layout.json", Origin="http://evil.example")[0] == 403
    assert get(port, "/layout.json", Origin=f"http://127.0.0.1:{port}")[0] == 200


def test_export_is_what_was_asked_for(running: Start, blocks: Blocks) -> None:
    store = Store()
    store.append(blocks(0.0, 3.0))
    port = running(store).port
    status, text = get(port, f"/export.csv?from={T0_S + 1}&to={T0_S + 1.5}")
    assert status == 200
    lines = text.splitlines()
    assert lines[0] == ",".join(("time_s", *NAMES))
    assert len(lines) == 502
    assert lines[1].startswith("0.000,")
    row = [float(cell) for cell in lines[251].split(",")]
    assert row[0] == pytest.approx(0.25)
    assert row[1:] == pytest.approx([(k + 1) * row[1] for k in range(len(NAMES))], rel=1e-6)
    for wrong in (
        "",
        "?from=1",
        "?from=a&to=b",
        "?from=2&to=1",
        "?from=0&to=1e9",
        "?from=nan&to=1",
    ):
        assert get(port, f"/export.csv{wrong}")[0] == 400


def test_nonsense_from_a_page_ends_nothing(running: Start, blocks: Blocks) -> None:
    from websockets.sync.client import connect

    store = Store()
    store.append(blocks(0.0, 3.0))
    running_server = running(store)
    with connect(f"ws://127.0.0.1:{running_server.port}/feed") as page:
        for text in ("", "{", "[]", "7", '{"view": 1}', '{"ask": {"from": "x"}}',
                     '{"drawn": "y"}',
                     '{"mark": {"t": 1e400, "text": 1}}',
                     '{"mark": {"t": 1e12, "text": "no such year"}}',
                     '{"mark": {"t": -1e12, "text": "nor this"}}',
                     '{"view": {"length_s": 1e999}}'):  # fmt: skip
            page.send(text)
        page.send('{"view": {"length_s": 1, "pixels": 100}}')
        heard: dict[str, Any] = {}
        while isinstance(message := page.recv(timeout=60), str) or "mark_refused" not in heard:
            if isinstance(message, str):
                heard |= json.loads(message)
    assert message[:4] == b"EPS1"
    assert heard.keys() <= {"marks", "mismatch", "mark_refused"}
    assert heard["mark_refused"].endswith("is no time of this clock")


def test_a_page_that_cannot_be_told_is_let_go(
    running: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its connection stayed open without messages, so the page showed the last verdict."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    started = running()
    with connect(f"ws://127.0.0.1:{started.port}/feed") as page:
        page.recv(timeout=60)
        monkeypatch.setattr(Hub, "overview", lambda _: 1 / 0)
        with contextlib.suppress(ConnectionClosed):
            while page.recv(timeout=60):
                pass
        assert page.close_code == 1000


def test_a_websocket_of_a_foreign_page_is_refused(running: Start) -> None:
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect
    from websockets.typing import Origin

    port = running().port
    with pytest.raises(InvalidStatus):
        connect(f"ws://127.0.0.1:{port}/feed", origin=Origin("http://evil.example"))


def test_marks_go_to_the_file_and_to_every_page(running: Start, tmp_path: Path) -> None:
    from websockets.sync.client import connect

    file = tmp_path / "bus.log.marks.jsonl"
    port = running(marks=file).port
    with (
        connect(f"ws://127.0.0.1:{port}/feed") as one,
        connect(f"ws://127.0.0.1:{port}/feed") as two,
    ):
        one.send(json.dumps({"mark": {"t": T0_S + 0.5, "text": "bump"}}))
        for page in (one, two):
            while not (found := json.loads(page.recv(timeout=60))["marks"]):
                pass
            assert found[0]["text"] == "bump"
    assert json.loads(file.read_text())["t_ns"] == (2 * T0_S + 1) * 500_000_000
    assert json.loads(get(port, "/marks.jsonl")[1])["text"] == "bump"


def test_a_port_that_is_taken_is_one_line() -> None:
    sock = listening("127.0.0.1", 0)
    port = sock.getsockname()[1]
    with pytest.raises(BusError, match=rf"cannot listen on 127.0.0.1 port {port}: Address already"):
        listening("127.0.0.1", port)
    sock.close()
    with pytest.raises(BusError, match="cannot listen"):
        listening("no-such-host.invalid", 0)
    assert isinstance(sock, socket.socket)
