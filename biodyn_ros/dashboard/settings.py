"""Address of the page, and the token for reset and mark."""

from __future__ import annotations

import importlib.util
import ipaddress
import os
import secrets
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from biodyn_core.base.errors import InputError
from biodyn_core.base.settings import check_settings, setting
from biodyn_ros.base.files import OWNER_ONLY, exists, make_directory, state_directory, write_text

TOKEN_BYTES: Final = 16
TOKEN_VARIABLE: Final = "BIODYN_PAGE_TOKEN"  # noqa: S105 - the name of a variable, not a token


@dataclass(frozen=True)
class ServingSettings:
    """Address of the page."""

    page_host: str = setting("127.0.0.1", "address of the page; 0.0.0.0 gives access to other machines")
    page_port: int = setting(8711, "port of the page; 0 selects a free one", "", 0, 65535)

    def __post_init__(self) -> None:
        check_settings(self)
        try:
            ipaddress.ip_address(self.page_host)
        except ValueError:
            raise InputError(
                f"page_host is {self.page_host!r}, an address is needed: 127.0.0.1, ::1, 0.0.0.0"
            ) from None

    @property
    def loopback(self) -> bool:
        """Whether only this machine can access the page."""
        return ipaddress.ip_address(self.page_host).is_loopback


def check_page() -> None:
    """Raise InputError if the server package is not installed."""
    if importlib.util.find_spec("aiohttp") is None:
        raise InputError("the page needs aiohttp: pip install 'biodyn_ros[page]'")


def address_of(host: str, port: int, token: str) -> str:
    """The link to the page. The token follows the #, because browsers do not send that part."""
    bare = ipaddress.ip_address(host)
    name = "127.0.0.1" if host == "0.0.0.0" else "::1" if host == "::" else host  # noqa: S104 - compared, not bound
    return f"http://{f'[{name}]' if bare.version == 6 else name}:{port}/#token={token}"


def port_of(serving: ServingSettings) -> int:
    """The given port, or a free one; raises InputError if the address is not available."""
    if serving.page_port:
        return serving.page_port
    try:
        return _bound(serving)
    except OSError as error:
        raise InputError(f"page_host {serving.page_host}: the address cannot be used ({error.strerror})") from None


def port_is_free(serving: ServingSettings) -> bool:
    """Whether no other program listens at the address and port now."""
    try:
        _bound(serving)
    except OSError:
        return False
    return True


def _bound(serving: ServingSettings) -> int:
    """Bind the port, or a free one, and release it again; return it."""
    family = socket.AF_INET6 if ipaddress.ip_address(serving.page_host).version == 6 else socket.AF_INET
    with socket.socket(family) as one:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does
        one.bind((serving.page_host, serving.page_port))
        return int(one.getsockname()[1])


def page_token() -> str:
    """The token of this user's pages, stored readable by the user only; a temporary one if that is not possible.

    The child process of a node uses the node's token.
    """
    if given := os.environ.get(TOKEN_VARIABLE):
        return given
    try:
        path = state_directory() / "page.token"
        if not exists(path):
            make_directory(path.parent)
            write_text(path, secrets.token_urlsafe(TOKEN_BYTES) + "\n", mode=OWNER_ONLY)
        return _read(path)
    except (InputError, RuntimeError):
        return secrets.token_urlsafe(TOKEN_BYTES)


def _read(path: Path) -> str:
    try:
        token = path.read_text(encoding="ascii").strip()
    except (OSError, ValueError):
        token = ""
    if len(token) < TOKEN_BYTES or not all(c.isalnum() or c in "-_" for c in token):
        raise InputError(f"{path}: contains no token")
    return token
