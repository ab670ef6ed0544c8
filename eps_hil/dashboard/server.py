"""The page's server: shows what the listener hands over, in a process that knows no bus.

All that a page can change are the marks, and it can have a stretch diagnosed. Everything is served
from this machine's own files; a request under a foreign name (DNS rebinding) or from a foreign page
is refused.
"""

import asyncio
import contextlib
import importlib.util
import ipaddress
import json
import os
import socket
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil import json_text
from eps_hil.dashboard.diagnosis import Diagnoses, Subject
from eps_hil.dashboard.events import Events
from eps_hil.dashboard.feed import Feed, answer
from eps_hil.dashboard.marks import Marks
from eps_hil.dashboard.mismatch import overview
from eps_hil.dashboard.store import Store
from eps_hil.dashboard.traces import NAMES, layout
from eps_hil.dashboard.wire import unpack
from eps_hil.errors import BusError, InputError
from eps_hil.report.page import library

LIBRARIES = ("starlette", "uvicorn", "websockets", "uplot", "jinja2")
KEPT_S = 180.0
"""What a live page can look back at, and what it can diagnose."""
_TICK_S, _OVERVIEW_S = 0.04, 1.0
_LONGEST_EXPORT_S, _EXPORT_STEP_NS = 600.0, 1_000_000
_NICE = 10
_MEDIA = {".js": "text/javascript", ".css": "text/css", ".html": "text/html"}
_REPORT_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; sandbox allow-scripts",
}
"""A diagnosis' page is self-contained: it may ask nothing, not even us."""
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def check() -> None:
    """:class:`InputError` where the extra is not installed; nothing is imported."""
    if any(importlib.util.find_spec(name) is None for name in LIBRARIES):
        raise InputError(
            "dashboard", "", "the page needs the 'dashboard' extra",
            'pip install "eps_hil[dashboard]"',
        )  # fmt: skip


def listening(host: str, port: int) -> socket.socket:
    """A socket for :func:`serve`; :class:`BusError` in one line where it cannot be had."""
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        sock = socket.socket(family, socket.SOCK_STREAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
        sock.listen(128)
    except OSError as error:
        raise BusError(
            f"dashboard: cannot listen on {host} port {port}: {error.strerror}; "
            "choose another --port or --host"
        ) from None
    return sock


@dataclass(frozen=True, slots=True)
class About:
    """What the page is told once. ``recording``: its name; None for a live page."""

    title: str
    recording: str | None = None
    notes: tuple[str, ...] = ()


class Hub:
    """What all pages share. ``subject`` None: nothing can be diagnosed.

    ``anyone``: not only pages on this machine may start a diagnosis.
    """

    def __init__(
        self,
        about: About,
        store: Store,
        marks: Marks,
        subject: Subject | None = None,
        *,
        anyone: bool = False,
    ) -> None:
        self.about, self.store, self.marks = about, store, marks
        self.state, self.state_number = "", 0
        self._events = Events()
        self.ended = False
        self.diagnoses = None if subject is None else Diagnoses(subject, about.title)
        self._limit_n = 0.0 if subject is None else subject.limit_n
        self._anyone = anyone
        self._overview: tuple[int | None, str] = (None, "")

    def may_diagnose(self, peer: str) -> bool:
        """Whether a page at this address may start and cancel a diagnosis."""
        return self.diagnoses is not None and (self._anyone or _loopback(peer))

    def overview(self) -> str:
        """Where rig and model part, as a message; "" where there is nothing. Pages share one."""
        newest = self.store.newest_ns
        at, text = self._overview
        if newest is not None and (at is None or abs(newest - at) >= _OVERVIEW_S * 1e9):
            found = overview(self.store, self._limit_n)
            text = "" if found is None else json.dumps({"mismatch": found})
            self._overview = newest, text
        return text

    def take(self, message: bytes) -> None:
        """One message of the listener."""
        if message[:1] == b"S":
            self.store.append(unpack(message[1:]))
        else:
            told = json.loads(message[1:])
            self._events.see(told.get("t_ns", time.time_ns()) * 1e-9, told.get("problems", []))
            self.state = json.dumps(told | {"events": self._events.content()}, ensure_ascii=False)
            self.state_number += 1

    def layout(self, peer: str = "") -> dict[str, Any]:
        """Traces, plots, what is shown, and what a page at ``peer`` may do."""
        begin, end = self.store.oldest_ns, self.store.newest_ns
        span = None if begin is None or end is None else [begin * 1e-9, end * 1e-9]
        return layout() | {
            "title": self.about.title,
            "recording": self.about.recording,
            "notes": list(self.about.notes),
            "span": span if self.about.recording is not None else None,
            "may_diagnose": self.may_diagnose(peer),
            "can_diagnose": self.diagnoses is not None,
            "marks_file": None if self.marks.path is None else self.marks.path.name,
        }

    def export(self, begin_s: float, end_s: float) -> Iterator[str]:
        """CSV lines of all traces, each millisecond; ``time_s`` counts from ``begin_s``."""
        yield ",".join(("time_s", *NAMES)) + "\n"
        begin_ns, end_ns = round(begin_s * 1e9), round(end_s * 1e9)
        for first in range(begin_ns, end_ns + 1, 1000 * _EXPORT_STEP_NS):
            last = min(first + 1000 * _EXPORT_STEP_NS, end_ns + 1)
            at_ns = np.arange(first, last, _EXPORT_STEP_NS, dtype=np.int64)
            columns = [self.store.at(name, at_ns) for name in NAMES]
            rows = zip(at_ns, *columns, strict=True)
            yield "".join(
                f"{(int(t) - begin_ns) * 1e-9:.3f},"
                + ",".join("" if np.isnan(v) else f"{v:.9g}" for v in values) + "\n"
                for t, *values in rows
            )  # fmt: skip


def allowed_host(header: str, bound: str) -> bool:
    """Whether a request's Host names this machine by an address, or by a name it goes by."""
    host = header.rsplit(":", 1)[0] if not header.endswith("]") else header
    host = host.strip("[]").lower()
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host == "localhost" or (not _loopback(bound) and host in _own_names())
    return address.is_loopback or not _loopback(bound)


def _loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _own_names() -> set[str]:
    return {socket.gethostname().lower(), socket.getfqdn().lower()}


class Guard:
    """Refuses foreign names and foreign pages before anything else sees a request."""

    def __init__(self, app: Any, bound: str) -> None:
        self._app, self._bound = app, bound

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """One request."""
        if scope["type"] in {"http", "websocket"}:
            headers = {k.decode("latin-1"): v.decode("latin-1") for k, v in scope["headers"]}
            host, origin = headers.get("host", ""), headers.get("origin")
            foreign = origin is not None and origin.split("//", 1)[-1] != host
            if foreign or not allowed_host(host, self._bound):
                if scope["type"] == "http":
                    await send({"type": "http.response.start", "status": 403, "headers": []})
                    await send({"type": "http.response.body", "body": b"refused\n"})
                else:
                    await send({"type": "websocket.close", "code": 1008})
                return
        await self._app(scope, receive, send)


def assets() -> dict[str, str]:
    """Every file of the page by its name: our own, and the plotting library's."""
    own = files("eps_hil.dashboard") / "page"
    found = {each.name: each.read_text(encoding="utf-8") for each in own.iterdir()
             if Path(each.name).suffix in _MEDIA}  # fmt: skip
    for name in ("uPlot.iife.js", "uPlot.min.css"):
        found[name] = library(name)
    return found


def application(hub: Hub, bound: str, listener: socket.socket | None = None) -> Any:
    """The ASGI application."""
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.requests import Request
    from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
    from starlette.routing import Route, WebSocketRoute

    held = assets()

    async def page(_: Request) -> Response:
        return Response(held["index.html"], media_type="text/html", headers=_HEADERS)

    async def asset(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in held:
            return PlainTextResponse("no such file\n", 404)
        return Response(held[name], media_type=_MEDIA[Path(name).suffix], headers=_HEADERS)

    async def about(request: Request) -> Response:
        return JSONResponse(hub.layout(_peer(request)), headers=_HEADERS)

    async def report(request: Request) -> Response:
        count = request.path_params["count"]
        path = None if hub.diagnoses is None else hub.diagnoses.report(count)
        if path is None:
            return PlainTextResponse("no such diagnosis\n", 404)
        text = await asyncio.to_thread(path.read_text, encoding="utf-8")
        return Response(text, media_type="text/html", headers=_HEADERS | _REPORT_HEADERS)

    async def export(request: Request) -> Response:
        try:
            begin_s, end_s = (float(request.query_params[k]) for k in ("from", "to"))
        except (KeyError, ValueError):
            return PlainTextResponse("say from and to, in seconds\n", 400)
        if not 0.0 < end_s - begin_s <= _LONGEST_EXPORT_S:
            return PlainTextResponse(f"at most {_LONGEST_EXPORT_S:.0f} s\n", 400)
        headers = _HEADERS | {"Content-Disposition": 'attachment; filename="eps_hil.csv"'}
        lines = hub.export(begin_s, end_s)
        return StreamingResponse(lines, media_type="text/csv", headers=headers)

    async def marks(_: Request) -> Response:
        lines = (json.dumps(mark, ensure_ascii=False) + "\n" for mark in hub.marks.as_json())
        headers = _HEADERS | {"Content-Disposition": 'attachment; filename="marks.jsonl"'}
        return PlainTextResponse("".join(lines), headers=headers)

    @contextlib.asynccontextmanager
    async def lifespan(_: Any) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()

        def take() -> None:
            try:
                while message := listener.recv(1 << 20) if listener else b"":
                    hub.take(message)
            except BlockingIOError:
                return
            except OSError:
                pass
            hub.ended = True
            if listener is not None:
                loop.remove_reader(listener)

        if listener is not None:
            listener.setblocking(False)
            loop.add_reader(listener, take)
        yield
        if hub.diagnoses is not None:
            await hub.diagnoses.close()

    return Starlette(
        routes=[
            Route("/", page),
            Route("/asset/{name}", asset),
            Route("/layout.json", about),
            Route("/export.csv", export),
            Route("/marks.jsonl", marks),
            Route("/diagnosis/{count:int}.html", report),
            WebSocketRoute("/feed", lambda socket: Page(hub, socket).run()),
        ],
        middleware=[Middleware(Guard, bound=bound)],
        lifespan=lifespan,
    )


def _peer(connection: Any) -> str:
    return "" if connection.client is None else str(connection.client.host)


class Page:
    """One page's connection."""

    def __init__(self, hub: Hub, connection: Any) -> None:
        self._hub, self._socket = hub, connection
        self._feed = Feed()
        self._answers: list[tuple[float, float, int, int]] = []
        self._state_sent = self._marks_sent = self._diagnosis_sent = -1
        self._overview_sent = ""
        self._refused = ""

    async def run(self) -> None:
        """Until either side goes away."""
        from starlette.websockets import WebSocketDisconnect

        await self._socket.accept()
        sending = asyncio.ensure_future(self._send())
        try:
            while True:
                self._hear(await self._socket.receive_text())
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            sending.cancel()

    def _hear(self, text: str) -> None:
        """What a page says; what makes no sense is left out."""
        try:
            said = json_text.parse(text)
            if "drawn" in said:
                self._feed.drawn(int(said["drawn"]))
            if "view" in said:
                view = said["view"]
                self._feed.view(float(view["length_s"]), int(view["pixels"]))
            if "hold" in said:
                self._feed = Feed()
            if "ask" in said:
                ask = said["ask"]
                wanted = (float(ask["from"]), float(ask["to"]), int(ask["pixels"]))
                self._answers = [(*wanted, int(ask["number"]))]  # only the newest counts
            if "mark" in said:
                mark = said["mark"]
                t_ns = round(float(mark["t"]) * 1e9)
                self._refused = self._hub.marks.add(t_ns, str(mark["text"]))
            if self._hub.may_diagnose(_peer(self._socket)) and self._hub.diagnoses is not None:
                self._hear_of_diagnosis(said, self._hub.diagnoses)
        except (ValueError, TypeError, KeyError, OverflowError):
            return

    def _hear_of_diagnosis(self, said: dict[str, Any], diagnoses: Diagnoses) -> None:
        if "diagnose" in said:
            wanted = said["diagnose"]
            diagnoses.start(self._hub.store, float(wanted["from"]), float(wanted["to"]))
        if "cancel" in said:
            diagnoses.cancel()

    async def _send_mismatch(self) -> None:
        hub = self._hub
        if hub.diagnoses is not None and self._diagnosis_sent != hub.diagnoses.number:
            self._diagnosis_sent = hub.diagnoses.number
            await self._socket.send_text(json.dumps({"diagnosis": hub.diagnoses.as_json()}))
        if not self._feed.waits and self._overview_sent is not (text := hub.overview()):
            self._overview_sent = text
            if text:
                await self._socket.send_text(text)

    async def _send(self) -> None:
        """Until the listener ends; a page to which nothing more can be told is let go."""
        try:
            await self._tell()
        except Exception:  # the page went away in mid-sentence, or what it should be told is wrong
            with contextlib.suppress(Exception):
                await self._socket.close()

    async def _tell(self) -> None:
        hub = self._hub
        while not hub.ended:
            if self._state_sent != hub.state_number and hub.state and not self._feed.waits:
                self._state_sent = hub.state_number
                await self._socket.send_text('{"state":' + hub.state + "}")
            if self._marks_sent != len(hub.marks.marks):
                self._marks_sent = len(hub.marks.marks)
                await self._socket.send_text(json.dumps({"marks": hub.marks.as_json()}))
            if self._refused:
                said, self._refused = self._refused, ""
                await self._socket.send_text(json.dumps({"mark_refused": said}))
            await self._send_mismatch()
            while self._answers:
                found = answer(hub.store, *self._answers.pop())
                if found is not None:
                    await self._socket.send_bytes(found)
            message = self._feed.next(hub.store)
            if message is not None:
                await self._socket.send_bytes(message)
            await asyncio.sleep(_TICK_S)
        await self._socket.send_text('{"ended":true}')


def serve(hub: Hub, sock: socket.socket, bound: str, listener: socket.socket | None = None) -> None:
    """Serve until a signal ends it; the other program's priority stays above ours."""
    import uvicorn

    with contextlib.suppress(OSError):
        os.nice(_NICE)
    config = uvicorn.Config(
        application(hub, bound, listener),
        log_level="error",
        access_log=False,
        server_header=False,
        ws_max_size=1 << 14,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )
    with contextlib.suppress(KeyboardInterrupt):
        uvicorn.Server(config).run(sockets=[sock])


def serve_live(
    sock: socket.socket,
    bound: str,
    listener: socket.socket,
    about: About,
    marks: Path | None,
    subject: Subject | None,
    anyone: bool,
) -> None:
    """What the server's process runs."""
    hub = Hub(about, Store(KEPT_S), Marks(marks), subject, anyone=anyone)
    serve(hub, sock, bound, listener)
