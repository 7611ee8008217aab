"""What is served: three files, a stream of events, and two buttons; until a signal comes, or the input ends."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import threading
from collections.abc import Callable
from typing import Any, Final

from aiohttp import web

from biodyn_core.base.errors import InputError
from biodyn_ros.base.resources import package_directory
from biodyn_ros.base.shutdown import Shutdown
from biodyn_ros.dashboard.connection_limiter import ANSWER_S, HEADERS, ConnectionLimiter, check_host, check_token
from biodyn_ros.dashboard.feed import SERVICES, Feed
from biodyn_ros.dashboard.hub import Hub
from biodyn_ros.dashboard.settings import ServingSettings, address_of, page_token

FILES: Final = {"/": "index.html", "/page.js": "page.js", "/page.css": "page.css"}
TYPES: Final = {"html": "text/html", "js": "text/javascript", "css": "text/css"}

MOST_STREAMS: Final = 16
BEAT_S: Final = 1.0
"""A stream that has nothing to say says so: then whoever has gone is noticed."""


class Site:
    """Answers requests: `handle` is all that a visitor can reach."""

    def __init__(self, serving: ServingSettings, token: str, hub: Hub) -> None:
        self._loopback, self._token, self._hub = serving.loopback, token, hub
        directory = package_directory("page")
        self._files = {path: (directory / name).read_text(encoding="utf-8") for path, name in FILES.items()}
        self._streams = 0
        self.feed: Feed | None = None

    async def handle(self, request: web.BaseRequest) -> web.StreamResponse:
        """Answer one request; a stream of events lasts as long as its visitor."""
        try:
            check_host(request, self._loopback)
            if request.method == "GET" and request.path == "/events":
                return await self._stream(request)
            response = await self._answer(request)
        except web.HTTPException as refused:
            response = web.Response(status=refused.status, text=refused.text)
        return await _delivered(request, response)

    async def _answer(self, request: web.BaseRequest) -> web.Response:
        path = request.path
        if path in self._files:
            _check_method(request, "GET", "HEAD")
            return web.Response(text=self._files[path], content_type=TYPES[FILES[path].rpartition(".")[2]])
        if path[1:] in SERVICES:
            _check_method(request, "POST")
            check_token(request, self._token)
            return await self._ask(path[1:])
        raise web.HTTPNotFound(text="there is no such page\n")

    async def _ask(self, name: str) -> web.Response:
        if self.feed is None:
            raise web.HTTPServiceUnavailable(text="no node yet\n")
        try:
            return web.json_response({"message": await self.feed.ask(name)})
        except TimeoutError as error:
            raise web.HTTPServiceUnavailable(text=f"{error}\n") from None

    async def _stream(self, request: web.BaseRequest) -> web.StreamResponse:
        if self._streams >= MOST_STREAMS:
            raise web.HTTPServiceUnavailable(text=f"{MOST_STREAMS} are looking on already\n")
        response = web.StreamResponse(headers=HEADERS | {"Content-Type": "text/event-stream"})
        self._streams += 1
        try:
            await response.prepare(request)
            await self._follow(response)
        except (ConnectionError, asyncio.TimeoutError):
            if request.transport is not None:
                request.transport.abort()  # one that does not take what it asked for
        finally:
            self._streams -= 1
        return response

    async def _follow(self, response: web.StreamResponse) -> None:
        number, events = self._hub.number, ["retry: 1000\n\n", *self._hub.events(-2)]
        while True:
            await asyncio.wait_for(response.write("".join(events).encode()), ANSWER_S)
            came = await self._hub.wait(number, BEAT_S)
            events = self._hub.events(number) if came else [": nothing new\n\n"]
            number = self._hub.number


def _check_method(request: web.BaseRequest, *allowed: str) -> None:
    if request.method not in allowed:
        raise web.HTTPMethodNotAllowed(request.method, allowed)


async def _delivered(request: web.BaseRequest, response: web.Response) -> web.Response:
    """The answer, sent before long or not at all."""
    response.headers.update(HEADERS)
    try:
        await asyncio.wait_for(_send(request, response), ANSWER_S)
    except asyncio.TimeoutError:
        if request.transport is not None:
            request.transport.abort()
    return response


async def _send(request: web.BaseRequest, response: web.Response) -> None:
    await response.prepare(request)
    await response.write_eof()


def serve(node: str, serving: ServingSettings, told: Callable[[str], None], until_input_ends: bool = False) -> None:
    """Serve the page of a node by its full name until SIGINT or SIGTERM; `told` is called with the link once it is up.

    Raises InputError where the address is taken, or the name is none.
    """
    with Shutdown("biodyn page") as shutdown:
        asyncio.run(_serve(node, serving, told, until_input_ends, shutdown))


async def _serve(
    node: str, serving: ServingSettings, told: Callable[[str], None], until_input_ends: bool, shutdown: Shutdown
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
        site.feed = Feed(node, hub.take, loop)
        try:
            told(address_of(serving.page_host, port, token))
            await ended.wait()
        finally:
            shutdown.stage = "its ROS node"
            site.feed.close()
    finally:
        shutdown.stage = "the visitors' connections"
        await runner.cleanup()


async def _listen(runner: Any, serving: ServingSettings) -> int:
    """Begin to listen; returns the port."""
    place = web.TCPSite(runner, serving.page_host, serving.page_port)
    try:
        await place.start()
    except OSError as error:
        where = f"{serving.page_host}:{serving.page_port}"
        why = (error.strerror or str(error)).rpartition(": ")[2]
        raise InputError(f"the page cannot be served at {where} ({why}); page_port names another port") from None
    return int(runner.addresses[0][1])


def _wait_for_input() -> None:
    # The descriptor itself: Python cannot end while another thread holds the buffer of sys.stdin.
    with contextlib.suppress(OSError):
        while os.read(0, 4096):
            pass
    os.kill(os.getpid(), signal.SIGTERM)  # the end is bounded as behind any signal
