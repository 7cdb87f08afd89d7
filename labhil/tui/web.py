"""The terminal UI in a browser: each opened page has a process of its own, ``labhil tui``.

``web_gate.py`` decides who may open a page; the page itself is ``web.html``. The terminal in the page and its
protocol are those of textual-serve.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shlex
import signal
import socket
import sys
from collections.abc import Awaitable, Callable, Sequence
from importlib.resources import files
from pathlib import Path

from aiohttp import WSMsgType, web
from textual_serve.app_service import AppService
from textual_serve.download_manager import DownloadManager

from labhil.errors import UsageError
from labhil.terminal import complain, show
from labhil.tui.shutdown import SERVER
from labhil.tui.web_gate import Gate, is_loopback

ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
CELLS = range(1, 1001)
"""Possible numbers of columns, and of rows, of a page."""

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def serve_web(folder: Path, connect: Sequence[str], *, light: bool, host: str, port: int) -> int:
    """Serve the terminal UI until SIGINT, SIGTERM or SIGHUP.

    The first line of the output is the address to open. Beyond the loopback, and where the system does not
    identify the user of a connection, it holds a token without which nobody is admitted.

    Args:
        folder: Folder of recordings and results.
        connect: Buses to watch.
        light: Whether the screen is dark on light.
        host: The address to listen at; only the loopback needs no token.
        port: The port; 0 for a free one.

    Returns:
        0, the exit status.

    Raises:
        UsageError: There is no such folder, or nobody can listen at that address.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: expected a folder for recordings, found none")
    listener = _listen(host, port)
    options = ["--folder", str(folder), *(part for endpoint in connect for part in ("--connect", endpoint))]
    command = [sys.executable, "-P", "-m", "labhil", "tui", *options, *(["--light"] if light else [])]
    os.environ[SERVER] = str(os.getpid())
    # without exec a shell would be the parent of the process of the page, and outlive it
    pages = WebServer("exec " + shlex.join(command), Gate.at(host))
    with listener:
        asyncio.run(_serve(pages, listener, _display_host(host)))
    return 0


class WebServer:
    """Answer the requests of browsers.

    Args:
        command: Command of the process of a page, which a shell runs.
        gate: Decides who is admitted.
    """

    def __init__(self, command: str, gate: Gate) -> None:
        self._command, self.gate = command, gate
        self._downloads = DownloadManager()
        self._services: set[AppService] = set()

    def app(self) -> web.Application:
        """Return the application with all routes behind the gate."""
        app = web.Application(middlewares=[self._admit])
        app.add_routes([web.get("/", self._page), web.get("/ws", self._terminal)])
        app.add_routes([web.static("/static", Path(str(files("textual_serve"))) / "static")])
        return app

    async def close(self) -> None:
        """End the process of every page, and with it, in order, the run that it started."""
        await asyncio.gather(*(service.stop() for service in self._services.copy()))

    @web.middleware
    async def _admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        refusal = self.gate.refusal(request)
        if refusal:
            raise web.HTTPForbidden(text=f"labhil: {refusal}\n")
        answer = self.gate.welcome(request) or await handler(request)
        if not answer.prepared:
            answer.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
            answer.headers["Referrer-Policy"] = "no-referrer"
        return answer

    async def _page(self, request: web.Request) -> web.Response:
        text = (files("labhil.tui") / "web.html").read_text(encoding="utf-8")
        size = _whole_number(request.query.get("fontsize"), 15, range(6, 61))
        return web.Response(text=text.replace("FONT_SIZE", str(size)), content_type="text/html")

    async def _terminal(self, request: web.Request) -> web.WebSocketResponse:
        connection = web.WebSocketResponse(heartbeat=15)
        await connection.prepare(request)
        service = AppService(
            self._command,
            write_bytes=connection.send_bytes,
            write_str=connection.send_str,
            close=_closer(connection),
            download_manager=self._downloads,
        )
        self._services.add(service)
        try:
            width = _whole_number(request.query.get("width"), 80, CELLS)
            height = _whole_number(request.query.get("height"), 24, CELLS)
            await service.start(width, height)
            await _follow(connection, service)
        finally:
            try:
                await service.stop()
            finally:
                self._services.discard(service)
        return connection


async def _follow(connection: web.WebSocketResponse, service: AppService) -> None:
    """Forward what the page sends until it is closed; a message outside its protocol ends it."""
    async for message in connection:
        if message.type is not WSMsgType.TEXT:
            continue
        try:
            await _forward(message.json(), connection, service)
        except (ValueError, TypeError, KeyError, IndexError) as error:
            await connection.close(code=1008, message=f"not understood: {error}"[:100].encode())
            return


async def _forward(message: list[object], connection: web.WebSocketResponse, service: AppService) -> None:
    match message:
        case ["stdin", str(keys)]:
            await service.send_bytes(keys.encode())
        case ["resize", {"width": int(width), "height": int(height)}] if width in CELLS and height in CELLS:
            await service.set_terminal_size(width, height)
        case ["ping", sent]:
            await connection.send_json(["pong", sent])
        case ["blur", *_]:
            await service.blur()
        case ["focus", *_]:
            await service.focus()
        case _:
            raise ValueError(f"expected stdin, resize, ping, blur or focus, found {str(message)[:60]}")


def _closer(connection: web.WebSocketResponse) -> Callable[[], Awaitable[None]]:
    async def close() -> None:
        await connection.close()

    return close


def _whole_number(text: str | None, default: int, allowed: range) -> int:
    return int(text) if text is not None and text.isdecimal() and int(text[:6]) in allowed else default


def _listen(host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, protocol)
    except (OSError, OverflowError) as error:
        raise UsageError(f"--host {host}: expected an address of this machine: {error}") from error
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
    except OSError as error:
        listener.close()
        raise UsageError(
            f"--host {host} --port {port}: nobody can listen there: {error.strerror}; "
            "--port 0 takes a free one"
        ) from error
    return listener


def _display_host(host: str) -> str:
    """The host for a browser: an address for "every interface" cannot be opened."""
    if host in ("", "0.0.0.0", "::"):
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host


async def _serve(pages: WebServer, listener: socket.socket, host: str) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in ENDINGS:
        loop.add_signal_handler(number, ended.set)
    runner = web.AppRunner(pages.app(), access_log=None, shutdown_timeout=5.0)
    await runner.setup()
    try:
        await web.SockSite(runner, listener).start()
        show(f"http://{host}:{listener.getsockname()[1]}/{pages.gate.query}")
        if not is_loopback(listener.getsockname()[0]):
            complain(
                "reachable from other machines, and not encrypted: whoever has the address above is let in"
            )
        await ended.wait()
        with contextlib.suppress(TimeoutError):  # a process that is still at work sees the end of this one
            await asyncio.wait_for(pages.close(), timeout=40.0)
    finally:
        await runner.cleanup()
