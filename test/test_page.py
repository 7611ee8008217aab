"""The page's server without ROS: access, events, and clients that are slow, numerous or hostile."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import socket
from collections.abc import Awaitable, Callable
from contextlib import asynccontextmanager

import aiohttp
import pytest
from aiohttp import web

from biodyn_core.base.errors import InputError
from biodyn_ros.base.resources import package_directory
from biodyn_ros.dashboard import connection_limiter, hub, settings, site
from biodyn_ros.dashboard.connection_limiter import ConnectionLimiter
from biodyn_ros.dashboard.hub import Hub
from biodyn_ros.dashboard.settings import ServingSettings, address_of, page_token, port_of
from biodyn_ros.dashboard.site import Site
from biodyn_ros.node.live import SNAPSHOT_RATE_HZ
from biodyn_ros.reports.downsampling import BIN_NS

TOKEN = "right-token-0123456789"  # noqa: S105 - of these tests


class FakeFeed:
    """Replaces the node: records the calls."""

    def __init__(self) -> None:
        self.called: list[str] = []

    async def call(self, name: str) -> str:
        """Record the call."""
        self.called.append(name)
        return f"done: {name}"


class Served:
    """A site that is up."""

    def __init__(self, port: int, hub: Hub, feed: FakeFeed, server: ConnectionLimiter) -> None:
        self.port, self.hub, self.feed, self.server = port, hub, feed, server

    def url(self, path: str = "/") -> str:
        """The address of a path of the page."""
        return f"http://127.0.0.1:{self.port}{path}"


@asynccontextmanager
async def served(host: str = "127.0.0.1"):
    """The site on a free port, with a node that answers."""
    events, feed = Hub(), FakeFeed()
    page = Site(ServingSettings(page_host=host), TOKEN, events)
    page.feed = feed
    server = ConnectionLimiter(page.handle)
    runner = web.ServerRunner(server, shutdown_timeout=0.2)
    await runner.setup()
    try:
        await web.TCPSite(runner, host, 0).start()
        yield Served(runner.addresses[0][1], events, feed, server)
    finally:
        await runner.cleanup()


def visit(steps: Callable[[Served, aiohttp.ClientSession], Awaitable[None]], host: str = "127.0.0.1") -> None:
    """Run the steps against a site."""

    async def run() -> None:
        async with served(host) as page, aiohttp.ClientSession() as client:
            await asyncio.wait_for(steps(page, client), 60.0)

    asyncio.run(run())


def snapshot(begin_s: float = 0.0, count: int = 2, text: str = "", stream: str = "measured") -> str:
    strip = {"begin_s": [begin_s + 0.1 * k for k in range(count)], "low": [[-1.0]] * count, "high": [[1.0]] * count}
    return json.dumps({"strip": {stream: strip}, "text": text})


# --- what is sent ----------------------------------------------------------------------------------------------------


def test_files_have_strict_security_headers():
    async def steps(page, client):
        for path, kind in (("/", "text/html"), ("/page.js", "text/javascript"), ("/page.css", "text/css")):
            async with client.get(page.url(path)) as answer:
                assert (answer.status, answer.content_type) == (200, kind)
                assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
                assert answer.headers["X-Content-Type-Options"] == "nosniff"
                source = await answer.text()
                assert "http://" not in source.replace("http://www.w3.org", "")
                assert "https://" not in source
                assert TOKEN not in source

    visit(steps)


async def read_event(stream: aiohttp.StreamReader) -> tuple[str, dict]:
    """The next event that is one."""
    while True:
        lines = (await stream.readuntil(b"\n\n")).decode().strip().splitlines()
        parts = dict(line.split(": ", 1) for line in lines if not line.startswith(":"))
        if "event" in parts:
            return parts["event"], json.loads(parts["data"])


def test_a_new_client_receives_the_last_minute_and_then_updates():
    async def steps(page, client):
        for k in range(20):
            page.hub.add(snapshot(0.2 * k))
        async with client.get(page.url("/events")) as answer:
            kind, clock_ms = await read_event(answer.content)
            assert (kind, clock_ms) == ("clock", pytest.approx(hub.clock_ms(), abs=5000.0))
            kind, minute = await read_event(answer.content)
            assert kind == "history"
            assert len(minute["measured"]["begin_s"]) == 40
            page.hub.add(snapshot(4.0, text="now"))
            kind, now = await read_event(answer.content)
            assert (kind, now["text"]) == ("snapshot", "now")
            assert clock_ms <= now["received_ms"] <= hub.clock_ms()

    visit(steps)


def test_data_of_two_nodes_of_one_name_are_marked_and_those_of_a_restarted_node_are_not(monkeypatch):
    events, now_ms = Hub(), 0.0
    monkeypatch.setattr(hub, "clock_ms", lambda: now_ms)

    def marked(source: str) -> bool:
        events.add(json.dumps({"strip": {}, "source": source}))
        return bool(json.loads(events.events(events.number - 1)[0].split("data: ")[1])["is_mixed"])

    assert [marked(source) for source in "aaabbbb"] == [False] * 7
    assert [marked(source) for source in "ccdcdd"] == [False, False, False, True, True, True]
    now_ms = hub.MIXED_MS
    assert [marked(source) for source in "dddee"] == [False] * 5


def test_a_slow_client_misses_snapshots_instead_of_receiving_them_late():
    """It reads nothing for a while: what it reads then is little that is old, then the present."""

    async def steps(page, client):
        reader, writer = await asyncio.open_connection("127.0.0.1", page.port, limit=1 << 12)
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 12)
        writer.write(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        for k in range(400):
            page.hub.add(snapshot(0.25 * k, text=f"number {k} " + "x" * 10_000))
            await asyncio.sleep(0.002)
        received = b""
        while b"present" not in received:
            with contextlib.suppress(asyncio.TimeoutError):
                received += await asyncio.wait_for(reader.read(1 << 16), 0.2)
                continue
            page.hub.add(snapshot(0.25 * 400, text="present"))
        assert len(received) < 500_000
        writer.close()

    visit(steps)


def test_the_history_covers_a_minute_and_is_cleared_at_a_leap_of_time():
    events = Hub()
    for k in range(100):
        events.add(snapshot(1.0 * k, count=10))
    minute = json.loads(events.events(-2)[0].split("data: ")[1])["measured"]
    assert (minute["begin_s"][0], len(minute["begin_s"])) == (40.0, hub.HISTORY_BINS)
    for leap_s in (5.0, 5000.0):
        events.add(snapshot(leap_s))
        minute = json.loads(events.events(-2)[0].split("data: ")[1])["measured"]
        assert minute["begin_s"] == [leap_s, leap_s + 0.1]


def test_the_history_has_the_seconds_of_the_error_too():
    events = Hub()
    for k in range(100):
        events.add(snapshot(1.0 * k, count=1, stream="error"))
    minute = json.loads(events.events(-2)[0].split("data: ")[1])["error"]
    assert (minute["begin_s"][0], len(minute["begin_s"])) == (40.0, 60)


def test_a_stream_far_behind_receives_the_history_again():
    events = Hub()
    for k in range(hub.RECENT):
        events.add(snapshot(float(k)))
    assert [event.split("\n")[0] for event in events.events(events.number - 2)] == ["event: snapshot"] * 2
    events.add(snapshot(99.0))
    assert [event.split("\n")[0] for event in events.events(0)] == ["event: history"]


NO_SNAPSHOTS = [
    "",
    "no json",
    "[1]",
    "[" * 100_000,
    '{"strip": 3}',
    '{"strip": {"measured": {"begin_s": [1], "low": [], "high": []}}}',
    '{"strip": {"measured": {"begin_s": ["x"], "low": [1], "high": [1]}}}',
    snapshot(text="x" * 2_000_000),
]


@pytest.mark.parametrize("text", NO_SNAPSHOTS, ids=range(len(NO_SNAPSHOTS)))
def test_an_invalid_snapshot_is_left_out(text):
    events = Hub()
    events.add(text)
    assert events.number == 0


def test_memory_does_not_grow_with_the_data_sent():
    events = Hub()
    for k in range(50):
        events.add(snapshot(1.0 * k).replace('"measured"', f'"other_{k}"'))
    assert events.number == 50
    assert "other" not in events.events(-2)[0]


def test_a_snapshot_cannot_inject_an_event():
    events = Hub()
    events.add(snapshot(text="\n\nevent: reset\ndata: {}\n\n"))
    (event,) = events.events(0)
    assert event.count("\n\n") == 1
    assert json.loads(event.split("data: ", 1)[1])["text"].startswith("\n\nevent")


# --- who is let in ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "status"),
    [("127.0.0.1:8711", 200), ("localhost:8711", 200), ("[::1]:8711", 200), ("evil.example", 403), ("10.1.2.3", 403),
     ("127.0.0.1.evil.example", 403), ("localhost.evil.example:80", 403), ("[evil]", 403)],
)  # fmt: skip
def test_an_unknown_host_name_is_refused(name, status):
    async def steps(page, client):
        async with client.get(page.url(), headers={"Host": name}) as answer:
            assert answer.status == status

    visit(steps)


def test_a_public_page_accepts_addresses_and_no_foreign_host_name():
    async def steps(page, client):
        for name, status in (("192.168.1.20:8711", 200), ("evil.example", 403)):
            async with client.get(page.url(), headers={"Host": name}) as answer:
                assert answer.status == status

    visit(steps, "0.0.0.0")  # noqa: S104 - on a free port, for the length of this test


def test_requests_of_another_origin_are_refused():
    async def steps(page, client):
        for path in ("/", "/events"):
            async with client.get(page.url(path), headers={"Origin": "http://evil.example"}) as answer:
                assert answer.status == 403
        foreign = {"Origin": "http://evil.example", connection_limiter.TOKEN_HEADER: TOKEN}
        async with client.post(page.url("/reset"), headers=foreign) as answer:
            assert answer.status == 403
        assert page.feed.called == []

    visit(steps)


def test_writing_needs_the_token_and_a_post():
    async def steps(page, client):
        for headers in (
            {},
            {connection_limiter.TOKEN_HEADER: ""},
            {connection_limiter.TOKEN_HEADER: TOKEN[:-1]},
            {connection_limiter.TOKEN_HEADER: "ä"},
        ):
            async with client.post(page.url("/reset"), headers=headers) as answer:
                assert answer.status == 403
        async with client.get(page.url("/reset"), headers={connection_limiter.TOKEN_HEADER: TOKEN}) as answer:
            assert answer.status == 405
        assert page.feed.called == []
        for name in ("reset", "mark"):
            async with client.post(page.url(f"/{name}"), headers={connection_limiter.TOKEN_HEADER: TOKEN}) as answer:
                assert (answer.status, await answer.json()) == (200, {"message": f"done: {name}"})
        assert page.feed.called == ["reset", "mark"]

    visit(steps)


@pytest.mark.parametrize(
    "path", ["/../page.js", "/page/../index.html", "/etc/passwd", "//", "/%2e%2e/setup.py", "/ask"]
)
def test_nothing_else_is_served(path):
    async def steps(page, client):
        assert (await response_to(page.port, f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())).startswith(
            "HTTP/1.1 404"
        )

    visit(steps)


# --- hostile clients ------------------------------------------------------------------------------------------------


async def response_to(port: int, sent: bytes) -> str:
    """The beginning of the response to these bytes."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(sent)
        return (await asyncio.wait_for(reader.read(200), 20.0)).decode("latin-1")
    except ConnectionError:
        return ""
    finally:
        writer.close()


async def is_well(page: Served, client: aiohttp.ClientSession) -> bool:
    async with client.get(page.url()) as answer:
        return answer.status == 200


@pytest.mark.parametrize(
    "sent",
    [
        b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"a" * 100_000 + b"\r\n\r\n",
        b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 50_000 + b"\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + b"\x00" * 300,
        b"POST /reset HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99999999999999\r\n\r\n" + b"x" * 65536,
        b"POST /reset HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nFFFFFFFFFF\r\n",
        b"\x00" * 1000 + b"\r\n\r\n",
    ],
)
def test_a_huge_or_invalid_request_does_not_affect_other_clients(sent):
    async def steps(page, client):
        assert "200" not in (await response_to(page.port, sent))[:15]
        assert await is_well(page, client)

    visit(steps)


def test_an_idle_connection_is_closed(monkeypatch):
    monkeypatch.setattr(connection_limiter, "REQUEST_TIMEOUT_S", 0.3)

    async def steps(page, client):
        for sent in (b"", b"GET / HT"):
            reader, writer = await asyncio.open_connection("127.0.0.1", page.port)
            writer.write(sent)
            with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
                await asyncio.wait_for(reader.readexactly(1), 5.0)
            writer.close()
        assert await is_well(page, client)

    visit(steps)


async def ends(reader: asyncio.StreamReader) -> bool:
    """Whether a connection without data ends within a second."""
    try:
        return await asyncio.wait_for(reader.read(1), 1.0) == b""
    except ConnectionError:
        return True
    except TimeoutError:
        return False


def test_connections_above_the_limit_are_refused_until_others_close(monkeypatch):
    monkeypatch.setattr(connection_limiter, "MAX_CONNECTIONS", 10)

    async def steps(page, client):
        crowd = [await asyncio.open_connection("127.0.0.1", page.port) for _ in range(50)]
        turned_away = await asyncio.gather(*(ends(reader) for reader, _ in crowd))
        assert sum(turned_away) >= 40
        for _, writer in crowd:
            writer.close()
        for _ in range(50):
            await asyncio.sleep(0.1)
            with contextlib.suppress(aiohttp.ClientError):
                if await is_well(page, client):
                    return
        pytest.fail("no room again")

    visit(steps)


def test_streams_are_limited_and_end_with_their_clients(monkeypatch):
    monkeypatch.setattr(site, "MAX_STREAMS", 2)
    monkeypatch.setattr(site, "KEEP_ALIVE_S", 0.1)

    async def steps(page, client):
        held = [await client.get(page.url("/events")) for _ in range(2)]
        async with client.get(page.url("/events")) as answer:
            assert answer.status == 503
        for stream in held:
            stream.close()
        for _ in range(50):
            await asyncio.sleep(0.1)
            async with client.get(page.url("/events")) as answer:
                if answer.status == 200:
                    return
        pytest.fail("no room again")

    visit(steps)


def test_an_unread_stream_is_closed_and_delays_no_other(monkeypatch):
    monkeypatch.setattr(site, "RESPONSE_TIMEOUT_S", 0.5)

    async def steps(page, client):
        _, writer = await asyncio.open_connection("127.0.0.1", page.port, limit=1)
        writer.write(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        gone = False
        for k in range(300):
            page.hub.add(snapshot(0.2 * k, text="x" * 200_000))
            await asyncio.sleep(0.01)
            gone = not any(c.transport is not None and not c.transport.is_closing() for c in page.server.connections)
            if gone:
                break
        assert gone, "it is still there"
        writer.close()
        assert await is_well(page, client)

    visit(steps)


# --- where it is served ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "expected"),
    [({"page_host": "everywhere"}, "page_host is 'everywhere', an address is needed"),
     ({"page_port": 70_000}, "page_port is 70000, allowed are 0 to 65535")],
)  # fmt: skip
def test_an_invalid_address_is_refused_in_one_line(given, expected):
    with pytest.raises(InputError, match=expected):
        ServingSettings(**given)


def test_the_link_has_the_token_in_its_fragment():
    assert address_of("127.0.0.1", 80, "t") == "http://127.0.0.1:80/#token=t"
    assert address_of("0.0.0.0", 80, "t") == "http://127.0.0.1:80/#token=t"  # noqa: S104 - read, not bound to
    assert address_of("::1", 80, "t") == "http://[::1]:80/#token=t"


def test_the_token_file_is_private_and_an_invalid_one_is_replaced(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    token, file = page_token(), tmp_path / "biodyn" / "page.token"
    assert (page_token(), file.stat().st_mode & 0o777) == (token, 0o600)
    assert len(token) >= settings.TOKEN_BYTES
    file.write_text("short\n")
    assert page_token() not in ("short", token)
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/none")
    assert page_token() != page_token()
    monkeypatch.setenv(settings.TOKEN_VARIABLE, "of_the_node")  # which a child shares, wherever it may write
    assert page_token() == "of_the_node"


def test_the_port_of_a_page_is_known_before_it_serves() -> None:
    assert port_of(ServingSettings(page_port=8765)) == 8765
    assert 1024 <= port_of(ServingSettings(page_port=0)) < 65536
    with pytest.raises(InputError, match=r"page_host 192\.0\.2\.1: the address cannot be used"):
        port_of(ServingSettings(page_host="192.0.2.1", page_port=0))


def test_browser_server_and_node_agree_on_bins_minute_and_pace() -> None:
    """The page's script cannot import them: it is held to them."""
    script = (package_directory("page") / "page.js").read_text(encoding="utf-8")
    index = (package_directory("page") / "index.html").read_text(encoding="utf-8")
    constants = dict(re.findall(r"^const ([A-Z_]+) = ([0-9.]+);", script, re.MULTILINE))
    assert float(constants["BIN_S"]) == hub.BIN_S == 1e-9 * BIN_NS
    assert float(constants["MINUTE_S"]) == hub.HISTORY_S and f"Last {hub.HISTORY_S:.0f} s" in index
    assert float(constants["STALE_MS"]) == 6 * 1000.0 / SNAPSHOT_RATE_HZ
    assert hub.RECENT == 3 * SNAPSHOT_RATE_HZ
