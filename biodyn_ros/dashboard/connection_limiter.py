"""Who may come in: known hosts alone, few at once, none that dawdle; and writing is for whoever has the token."""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import socket
from typing import Any, Final

from aiohttp import web

MOST_CONNECTIONS: Final = 64
GREETING_S: Final = 5.0
"""A visitor that has not asked for anything by then is shown out."""

ANSWER_S: Final = 10.0
"""A visitor that has not taken its answer by then is shown out."""

MOST_HEADERS: Final = 8190
TOKEN_HEADER: Final = "X-Biodyn-Token"  # noqa: S105 - where the token is, not what it is

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
    """A server that lets in a bounded number of connections, each of which must soon ask for something."""

    def __init__(self, handler: Any, **kwargs: Any) -> None:
        super().__init__(self._greeted(handler), max_line_size=MOST_HEADERS, max_field_size=MOST_HEADERS, **kwargs)
        self._silent: set[Any] = set()

    def __call__(self) -> Any:
        """What answers the next connection."""
        if len(self.connections) >= MOST_CONNECTIONS:
            return _Full()
        visitor = super().__call__()
        self._silent.add(visitor)
        asyncio.get_running_loop().call_later(GREETING_S, self._show_out, visitor)
        return visitor

    def _greeted(self, handler: Any) -> Any:
        async def greeted(request: web.BaseRequest) -> web.StreamResponse:
            self._silent.discard(request.protocol)
            response: web.StreamResponse = await handler(request)
            return response

        return greeted

    def _show_out(self, visitor: Any) -> None:
        if visitor in self._silent:
            self._silent.discard(visitor)
            if visitor.transport is not None:
                visitor.transport.abort()


class _Full(asyncio.Protocol):
    """Closes at once."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Close it."""
        transport.close()


def check_host(request: web.BaseRequest, loopback: bool) -> None:
    """Refuse a name that may be anybody's: a page elsewhere could have had its own name lead to this machine."""
    name = request.host
    bare = name.partition("]")[0][1:] if name.startswith("[") else name.partition(":")[0]
    if not _ours(bare.lower(), loopback):
        raise web.HTTPForbidden(text=f"this page is not served under the name {bare[:80]!r}\n")
    origin = request.headers.get("Origin")
    if origin is not None and origin != f"http://{name}":
        raise web.HTTPForbidden(text="this page does not answer other pages\n")


def _ours(name: str, loopback: bool) -> bool:
    """An address, or a name that no stranger can give to this machine."""
    if name == "localhost":
        return True
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return not loopback and name == socket.gethostname().lower()
    return address.is_loopback or not loopback


def check_token(request: web.BaseRequest, token: str) -> None:
    """Refuse whoever does not have the token."""
    given = request.headers.get(TOKEN_HEADER, "")
    if not hmac.compare_digest(given.encode("utf-8", "surrogateescape"), token.encode()):
        raise web.HTTPForbidden(
            text="reset and mark need the link with its token, as the node or biodyn page told it\n"
        )
