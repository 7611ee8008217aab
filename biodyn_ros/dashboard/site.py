"""The HTTP server of the page: three files, a stream of events, and two actions; until a signal or end of input."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import threading
from collections.abc import Callable
from typing import Any, Final

from aiohttp import web

from biodyn_core.base.errors import InputError
from biodyn_ros.base.resources import package_directory
from biodyn_ros.base.shutdown import Shutdown
from biodyn_ros.dashboard.connection_limiter import (
    HEADERS,
    RESPONSE_TIMEOUT_S,
    ConnectionLimiter,
    check_host,
    check_token,
)
from biodyn_ros.dashboard.feed import SERVICES, Feed
from biodyn_ros.dashboard.hub import Hub
from biodyn_ros.dashboard.settings import ServingSettings, address_of, page_token

FILES: Final = {"/": "index.html", "/page.js": "page.js", "/page.css": "page.css"}
TYPES: Final = {"html": "text/html", "js": "text/javascript", "css": "text/css"}

MAX_STREAMS: Final = 16
UNSENT_BYTES: Final = 32_000
"""Buffer of the system for a stream: three snapshots; without it the system keeps megabytes, that is minutes."""

KEEP_ALIVE_S: Final = 1.0
"""Without a snapshot a stream sends a comment at this interval, which detects closed connections."""


class Site:
    """Handles all requests by `handle`."""

    def __init__(self, serving: ServingSettings, token: str, hub: Hub) -> None:
        self._loopback, self._token, self._hub = serving.loopback, token, hub
        directory = package_directory("page")
        self._files = {path: (directory / name).read_text(encoding="utf-8") for path, name in FILES.items()}
        self._streams = 0
        self.feed: Feed | None = None

    async def handle(self, request: web.BaseRequest) -> web.StreamResponse:
        """Handle one request; a stream of events lasts until its client disconnects."""
        try:
            check_host(request, self._loopback)
            if request.method == "GET" and request.path == "/events":
                return await self._stream(request)
            response = await self._response(request)
        except web.HTTPException as refused:
            response = web.Response(status=refused.status, text=refused.text)
        return await _sent(request, response)

    async def _response(self, request: web.BaseRequest) -> web.Response:
        path = request.path
        if path in self._files:
            _check_method(request, "GET", "HEAD")
            return web.Response(text=self._files[path], content_type=TYPES[FILES[path].rpartition(".")[2]])
        if path[1:] in SERVICES:
            _check_method(request, "POST")
            check_token(request, self._token)
            return await self._call(path[1:])
        raise web.HTTPNotFound(text="page not found\n")

    async def _call(self, name: str) -> web.Response:
        if self.feed is None:
            raise web.HTTPServiceUnavailable(text="not connected to ROS yet\n")
        try:
            return web.json_response({"message": await self.feed.call(name)})
        except TimeoutError as error:
            raise web.HTTPServiceUnavailable(text=f"{error}\n") from None

    async def _stream(self, request: web.BaseRequest) -> web.StreamResponse:
        if self._streams >= MAX_STREAMS:
            raise web.HTTPServiceUnavailable(text=f"the page is already open {MAX_STREAMS} times\n")
        response = web.StreamResponse(headers=HEADERS | {"Content-Type": "text/event-stream"})
        self._streams += 1
        try:
            await response.prepare(request)
            _bound_unsent(request)
            await self._follow(response)
        except (ConnectionError, asyncio.TimeoutError):
            if request.transport is not None:
                request.transport.abort()  # the client does not receive its data
        finally:
            self._streams -= 1
        return response

    async def _follow(self, response: web.StreamResponse) -> None:
        number, events = self._hub.number, ["retry: 1000\n\n", *self._hub.first_events()]
        while True:
            data = "".join(events).encode()
            for at in range(0, len(data), UNSENT_BYTES):  # a slow client may take longer for all of it
                await asyncio.wait_for(response.write(data[at : at + UNSENT_BYTES]), RESPONSE_TIMEOUT_S)
            is_new = await self._hub.wait(number, KEEP_ALIVE_S)
            events = self._hub.events(number) if is_new else [": nothing new\n\n"]
            number = self._hub.number


def _bound_unsent(request: web.BaseRequest) -> None:
    """Bound the data that wait for a slow client: it misses snapshots instead of receiving all of them late."""
    transport = request.transport
    if transport is None:  # the client has disconnected
        return
    transport.set_write_buffer_limits(high=0)
    transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, UNSENT_BYTES)


def _check_method(request: web.BaseRequest, *allowed: str) -> None:
    if request.method not in allowed:
        raise web.HTTPMethodNotAllowed(request.method, allowed)


async def _sent(request: web.BaseRequest, response: web.Response) -> web.Response:
    """Send the response; disconnect on a timeout."""
    response.headers.update(HEADERS)
    try:
        await asyncio.wait_for(_send(request, response), RESPONSE_TIMEOUT_S)
    except asyncio.TimeoutError:
        if request.transport is not None:
            request.transport.abort()
    return response


async def _send(request: web.BaseRequest, response: web.Response) -> None:
    await response.prepare(request)
    await response.write_eof()


def serve(node: str, serving: ServingSettings, on_ready: Callable[[str], None], until_input_ends: bool = False) -> None:
    """Serve the page of a node, by its full name, until SIGINT or SIGTERM; `on_ready` is called with the link.

    Raises InputError if the address is in use or the name is invalid.
    """
    with Shutdown("biodyn page") as shutdown:
        asyncio.run(_serve(node, serving, on_ready, until_input_ends, shutdown))


async def _serve(
    node: str, serving: ServingSettings, on_ready: Callable[[str], None], until_input_ends: bool, shutdown: Shutdown
) -> None:
    loop, ended, hub, token = asyncio.get_running_loop(), asyncio.Event(), Hub(), page_token()
    shutdown.on_request(lambda: loop.call_soon_threadsafe(ended.set))
    if until_input_ends:
        threading.Thread(target=_wait_for_input, daemon=True).start()
    site = Site(serving, token, hub)
    runner = web.ServerRunner(ConnectionLimiter(site.handle), shutdown_timeout=0.1)
    await runner.setup()
    try:
        port = await _listen(runner, serving)
        site.feed = Feed(node, hub.add, loop)
        try:
            on_ready(address_of(serving.page_host, port, token))
            await ended.wait()
        finally:
            shutdown.stage = "its ROS node"
            site.feed.close()
    finally:
        shutdown.stage = "its connections"
        await runner.cleanup()


async def _listen(runner: Any, serving: ServingSettings) -> int:
    """Start to listen and return the port."""
    place = web.TCPSite(runner, serving.page_host, serving.page_port)
    try:
        await place.start()
    except OSError as error:
        where = f"{serving.page_host}:{serving.page_port}"
        why = (error.strerror or str(error)).rpartition(": ")[2]
        raise InputError(f"the page cannot be served at {where} ({why}); set another port with page_port") from None
    return int(runner.addresses[0][1])


def _wait_for_input() -> None:
    # By file descriptor, because Python cannot exit while another thread holds the buffer of sys.stdin.
    with contextlib.suppress(OSError):
        while os.read(0, 4096):
            pass
    os.kill(os.getpid(), signal.SIGTERM)  # bounds the shutdown as after any signal
