"""A page's server on made-up samples, and a headless Chromium to look at it."""

import importlib.util
import os
import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.dashboard.diagnosis import Subject
from eps_hil.dashboard.marks import Marks
from eps_hil.dashboard.server import About, Hub, application, listening
from eps_hil.dashboard.store import Block, Store
from eps_hil.dashboard.traces import NAMES

CHROMIUM = shutil.which("chromium") or "/usr/bin/chromium"
OPTIONS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
T0_NS = 1_790_000_000_000_000_000
PATIENCE_MS = 120_000
"""For anything the browser is to show; a busy machine takes long, and nothing depends on it."""


def made_up(begin_s: float, end_s: float, t0_ns: int = T0_NS) -> dict[str, Block]:
    """A sine of another amplitude in each trace, 1 kHz; trace k has amplitude k + 1."""
    k = np.arange(round(begin_s * 1e3), round(end_s * 1e3), dtype=np.int64)
    wave = np.sin(2 * np.pi * 0.5 * k * 1e-3)
    return {name: (t0_ns + k * 1_000_000, (i + 1.0) * wave) for i, name in enumerate(NAMES)}


@pytest.fixture
def blocks() -> Callable[..., dict[str, Block]]:
    """``blocks(begin_s, end_s)``: samples of all traces."""
    return made_up


class Running:
    """A server in a thread; ``end()`` takes it away."""

    def __init__(self, hub: Hub, listener: socket.socket | None = None, port: int = 0) -> None:
        import uvicorn

        sock = listening("127.0.0.1", port)
        self.hub = hub
        self.port: int = sock.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/"
        config = uvicorn.Config(
            application(hub, "127.0.0.1", listener), log_level="error",
            ws_per_message_deflate=False, timeout_graceful_shutdown=1,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, kwargs={"sockets": [sock]})
        self._thread.start()

    def end(self) -> None:
        self._server.should_exit = True
        self._thread.join(60)


@pytest.fixture
def running() -> Iterator[Callable[..., Running]]:
    """``running(store=None, marks=None, recording=None, listener=None, subject=None)``."""
    started: list[Running] = []

    def start(
        store: Store | None = None,
        marks: Path | None = None,
        recording: str | None = None,
        listener: socket.socket | None = None,
        subject: Subject | None = None,
    ) -> Running:
        hub = Hub(About("test bus", recording), store or Store(60.0), Marks(marks), subject)
        started.append(Running(hub, listener))
        return started[-1]

    yield start
    for each in started:
        each.end()


def _missing() -> str:
    if importlib.util.find_spec("playwright") is None:
        return "playwright is not installed (pip install playwright)"
    return "" if Path(CHROMIUM).exists() else "there is no Chromium (apt-get install chromium)"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """The browser; where there is none the test is skipped, or fails if that is forbidden.

    Ended with the file: playwright's loop runs in this thread until then, and no ``asyncio.run``
    of another test could.
    """
    if missing := _missing():
        said = f"THE PAGE WAS NOT TESTED: {missing}"
        if os.environ.get("EPS_HIL_REQUIRE_CHROMIUM") == "1":
            pytest.fail(said)
        pytest.skip(said)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=OPTIONS, timeout=PATIENCE_MS)
        yield browser
        browser.close()


@pytest.fixture
def open_page(chromium: Any) -> Iterator[Callable[..., Any]]:
    """``open_page(url, width, height, scheme, eval_)``; errors of a script or elsewhere fail.

    ``eval_``: without the page's Content-Security-Policy, which forbids the tests' own questions.
    """
    contexts, errors = [], []

    def open_(
        url: str, width: int = 1366, height: int = 768, scheme: str = "light", eval_: bool = True
    ) -> Any:
        context = chromium.new_context(
            viewport={"width": width, "height": height}, color_scheme=scheme, bypass_csp=eval_
        )
        contexts.append(context)
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: _no_policy(said.text, errors))
        page.on("request", lambda asked: _only(url, asked.url, errors))
        page.goto(url)
        return page

    yield open_
    for context in contexts:
        context.close()
    assert errors == []


def _only(own: str, asked: str, errors: list[str]) -> None:
    if not asked.startswith((own, "data:", "blob:")):
        errors.append(f"asks elsewhere: {asked}")


def _no_policy(said: str, errors: list[str]) -> None:
    if "Content Security Policy" in said:
        errors.append(said)
