"""Limits on connections: number, time to the first request, host names; changes need the token."""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import socket
from typing import Any, Final

from aiohttp import web

MAX_CONNECTIONS: Final = 64
REQUEST_TIMEOUT_S: Final = 5.0
"""A connection without a request after this time is closed."""

RESPONSE_TIMEOUT_S: Final = 10.0
"""A connection that does not receive its response within this time is closed."""

MAX_HEADER_BYTES: Final = 8190
TOKEN_HEADER: Final = "X-Biodyn-Token"  # noqa: S105 - the name of a header, not a token

HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class ConnectionLimiter(web.Server):
    """A server with a bounded number of connections, which closes connections without a request."""

    def __init__(self, handler: Any, **kwargs: Any) -> None:
        limits = {"max_line_size": MAX_HEADER_BYTES, "max_field_size": MAX_HEADER_BYTES}
        idle_s = REQUEST_TIMEOUT_S  # between requests too
        super().__init__(self._noting_requests(handler), keepalive_timeout=idle_s, **limits, **kwargs)
        self._idle: set[Any] = set()

    def __call__(self) -> Any:
        """The protocol of the next connection."""
        if len(self.connections) >= MAX_CONNECTIONS:
            return _Refused()
        connection = super().__call__()
        self._idle.add(connection)
        asyncio.get_running_loop().call_later(REQUEST_TIMEOUT_S, self._disconnect_idle, connection)
        return connection

    def _noting_requests(self, handler: Any) -> Any:
        async def noting(request: web.BaseRequest) -> web.StreamResponse:
            self._idle.discard(request.protocol)
            response: web.StreamResponse = await handler(request)
            return response

        return noting

    def _disconnect_idle(self, connection: Any) -> None:
        if connection in self._idle:
            self._idle.discard(connection)
            if connection.transport is not None:
                connection.transport.abort()


class _Refused(asyncio.Protocol):
    """Closes its connection immediately."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Close the connection."""
        transport.close()


def check_host(request: web.BaseRequest, loopback: bool) -> None:
    """Refuse unknown host names, against DNS rebinding, and requests of other pages."""
    name = request.host
    bare = name.partition("]")[0][1:] if name.startswith("[") else name.partition(":")[0]
    if not _is_own(bare.lower(), loopback):
        raise web.HTTPForbidden(text=f"this page is not served under the name {bare[:80]!r}\n")
    origin = request.headers.get("Origin")
    if origin is not None and origin != f"http://{name}":
        raise web.HTTPForbidden(text="requests of other pages are refused\n")


def _is_own(name: str, loopback: bool) -> bool:
    """Whether the name is an address, or a name of this machine that foreign DNS cannot set."""
    if name == "localhost":
        return True
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return not loopback and name == socket.gethostname().lower()
    return address.is_loopback or not loopback


def check_token(request: web.BaseRequest, token: str) -> None:
    """Refuse a request without the token."""
    given = request.headers.get(TOKEN_HEADER, "")
    if not hmac.compare_digest(given.encode("utf-8", "surrogateescape"), token.encode()):
        raise web.HTTPForbidden(
            text="reset and mark need the link with the token, as printed by the node or by biodyn page\n"
        )
