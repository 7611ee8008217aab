"""Where the page is served, and the token without which nobody may reset or mark."""

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
TOKEN_VARIABLE: Final = "BIODYN_PAGE_TOKEN"  # noqa: S105 - where the token is, not what it is


@dataclass(frozen=True)
class ServingSettings:
    """Where the page is served."""

    page_host: str = setting("127.0.0.1", "address at which the page is served; 0.0.0.0 lets other machines look on")
    page_port: int = setting(8711, "port of the page; 0 takes any that is free", "", 0, 65535)

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
        """Whether nobody but this machine reaches it."""
        return ipaddress.ip_address(self.page_host).is_loopback


def check_page() -> None:
    """Raise InputError where the page cannot be served at all."""
    if importlib.util.find_spec("aiohttp") is None:
        raise InputError("the page needs aiohttp: pip install 'biodyn_ros[page]'")


def address_of(host: str, port: int, token: str) -> str:
    """What a person opens. The token stands behind the #, which browsers keep to themselves."""
    bare = ipaddress.ip_address(host)
    name = "127.0.0.1" if host == "0.0.0.0" else "::1" if host == "::" else host  # noqa: S104 - it is read, not bound to
    return f"http://{f'[{name}]' if bare.version == 6 else name}:{port}/#token={token}"


def port_of(serving: ServingSettings) -> int:
    """The port that is asked for, or one that is free now; raises InputError where the address is not here."""
    if serving.page_port:
        return serving.page_port
    family = socket.AF_INET6 if ipaddress.ip_address(serving.page_host).version == 6 else socket.AF_INET
    try:
        with socket.socket(family) as found:
            found.bind((serving.page_host, 0))
            return int(found.getsockname()[1])
    except OSError as error:
        raise InputError(f"page_host {serving.page_host}: nothing can be served there ({error.strerror})") from None


def page_token() -> str:
    """The token of this user's pages, made once and kept, readable by its owner alone; else one for this time.

    A page that is a node's child has the node's, whatever is kept.
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
        raise InputError(f"{path}: holds no token")
    return token
