"""The page as a person sees it: a bag played over DDS, the live node, its page, and a real Chromium."""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import yaml
from provenances import with_spread
from ros import STARTUP_S, child, ros_graph
from streams import noisy_streams, subject, write_bag

from biodyn_core.body.synthesis import ImuStream
from biodyn_ros.node.live import SNAPSHOT_RATE_HZ

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
# Continuous integration installs one (.ci/run): there its absence is a failure, and no reason to skip.
pytestmark = pytest.mark.skipif(CHROMIUM is None and "CI" not in os.environ, reason="no Chromium here")

SECONDS = 24.0
HEAD_DIES_S = 14.0
SIZES = {"desk": (1280, 800), "tablet": (1024, 768), "phone": (390, 844), "small": (400, 640)}
EVIL = "<img src=x onerror=\"document.title='owned'\"> & co"


CUT_OFF = """[...document.body.querySelectorAll("*")].filter((each) => {
  const box = each.getBoundingClientRect();
  return box.width > 0 && (box.left < -0.5 || box.right > innerWidth + 0.5);
}).map((each) => each.outerHTML.slice(0, 80))"""

BOUNDED = """{...snapshot, rows: snapshot.rows.map((row) => ({
  ...row, force_lower_bound: true, compression_n: 1234, tension_n: 1234,
}))}"""
"""A snapshot whose peaks of force are lower bounds."""

REACHABLE = """["mark", "reset", "theme"].map((name) => {
  const button = document.getElementById(name), box = button.getBoundingClientRect();
  const inside = box.left >= 0 && box.top >= 0 && box.right <= innerWidth && box.bottom <= innerHeight;
  return inside && document.elementFromPoint((box.left + box.right) / 2, (box.top + box.bottom) / 2) === button;
})"""


def ride() -> list[ImuStream]:
    """A road whose head sensor dies on the way."""
    return [
        ImuStream(s.sensor, *(c[: round(HEAD_DIES_S * 1129.3)] for c in (s.stamps_ns, s.accel_mps2, s.gyro_radps)))
        if s.sensor == "head"
        else s
        for s in noisy_streams(SECONDS, "road", 4)
    ]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("page") / "ride.mcap", ride())


@pytest.fixture(scope="module")
def subject_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fitted subject whose name is markup."""
    path: Path = tmp_path_factory.mktemp("subject") / "evil.yaml"
    path.write_text(yaml.safe_dump(with_spread(subject()).to_dict() | {"name": EVIL}, sort_keys=False))
    return path


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Browser:
    """A page in Chromium with its console errors and its requests."""

    page: Any
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.page.on("console", lambda line: self.complaints.append(line.text) if line.type == "error" else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))

    def text(self, selector: str) -> str:
        """The visible text of an element."""
        return str(self.page.inner_text(selector))

    def until(self, condition: str, seconds: float = STARTUP_S) -> None:
        """Wait for a condition in the page, evaluated from outside: its policy forbids code from text."""
        end = time.monotonic() + seconds
        while not self.page.evaluate(condition):
            assert time.monotonic() < end, f"not within {seconds:g} s: {condition}; {self.text('body')}"
            self.page.wait_for_timeout(50)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        # Without a sandbox of its own, because tests may run as root, and look at our own page alone.
        started = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture
def browser(chromium: Any) -> Iterator[Browser]:
    """A page with a session of its own."""
    page = chromium.new_page(viewport=dict(zip(("width", "height"), SIZES["desk"], strict=True)))
    yield Browser(page)
    page.close()


@pytest.fixture(scope="module")
def without_node() -> Iterator[str]:
    """The address of a page that waits for a node."""
    port = free_port()
    with ros_graph() as graph, child(graph, "page", "--node", "/nobody", "--page-port", str(port)):
        yield f"http://127.0.0.1:{port}/"


def node_arguments(port: int, subject_file: Path, yaw: str = "0.0") -> list[str]:
    given = {"dashboard": "true", "page_port": str(port), "subject_file": str(subject_file), "yaw_deg": yaw}
    return ["live", "--ros-args", *(part for name, value in given.items() for part in ("-p", f"{name}:={value}"))]


def link(process: subprocess.Popen[str]) -> str:
    """The link that the node reports."""
    assert process.stderr is not None
    for line in process.stderr:
        if found := re.search(r"the page: (http\S+)", line):
            return found.group(1)
    raise AssertionError("the node reports no link")


def reached(browser: Browser, address: str) -> None:
    """Open the page; its process may still be on its way."""
    place = urlsplit(address)
    for _ in range(300):
        with socket.socket() as probe:
            if probe.connect_ex((place.hostname, place.port)) == 0:
                browser.page.goto(address)
                return
        browser.page.wait_for_timeout(100)
    raise AssertionError("the page is not served")


def test_a_ride_in_chromium(graph, bag, subject_file, browser, tmp_path):
    port = free_port()
    with child(graph, *node_arguments(port, subject_file)) as node:
        address = link(node)
        reached(browser, address)
        assert browser.text("#headline") == "Waiting for the node" or "Undecided" in browser.text("#headline")
        with child(graph, "play", str(bag)):
            it_updates(browser)
            it_shows_the_values_of_a_vibration_meter(browser)
            it_is_green_and_names_the_subject(browser)
            it_shows_intervals(browser)
            for name, (width, height) in SIZES.items():
                it_fits(browser, width, height, tmp_path / f"{name}.png")
            it_survives_a_reload(browser)
            it_shows_a_dead_sensor(browser)
            marks_and_resets(browser)
        it_reports_a_silent_seat(browser)
        it_tells_the_age_of_late_data(browser, address)
        it_goes_stale_when_the_node_is_killed(browser, node)
    with child(graph, *node_arguments(port, subject_file)) as node:
        assert link(node) == address, "the link stays valid"
        it_comes_back(browser)
        with child(graph, "live"):
            it_withholds_what_two_nodes_send(browser)
        browser.until("$('headline').innerText != 'Undecided: several nodes'")
    assert browser.page.title() == "biodyn live", "names are text"
    leaving = [url for url in browser.requests if not url.startswith((f"http://127.0.0.1:{port}/", "data:"))]
    assert leaving == []
    # Without the node the browser reports that the stream of events cannot be opened; there is no other error.
    assert [
        line for line in browser.complaints if "ERR_CONNECTION_REFUSED" not in line and "INCOMPLETE" not in line
    ] == []


def it_updates(browser: Browser) -> None:
    browser.until("document.querySelectorAll('.figure').length == 2")
    browser.until("snapshot.rows[0].predicted_mps2 > 0 && snapshot.rows[0].measured_mps2 > 0")
    before = browser.page.evaluate("snapshot.seconds")
    browser.until(f"snapshot.seconds > {before} + 0.9", 10.0)
    reported = browser.page.evaluate("snapshot")
    head = reported["rows"][0]
    # The page shows the reported text.
    browser.until(
        "document.querySelector('.row .values').innerText.startsWith(snapshot.rows[0].measured_mps2.toFixed(2))"
    )
    assert browser.text('.row[data-name="head"] .name').startswith("head\n")
    assert head["sensor"]["rate_hz"] == pytest.approx(1129.3, rel=1e-3)
    assert browser.complaints == []
    pixels = "$('strip').getContext('2d').getImageData(0, 0, $('strip').width, $('strip').height).data"
    assert browser.page.evaluate(f"[...{pixels}].filter(value => value).length") > 2000, "the strip is drawn"


def it_shows_the_values_of_a_vibration_meter(browser: Browser) -> None:
    """Between the band and all else, in the words and numbers of one snapshot."""
    browser.until("snapshot.meter && snapshot.meter.axes[0].aw_mps2 !== null")
    meter, shown = browser.page.evaluate("show(snapshot), [snapshot.meter, document.getElementById('meter').innerText]")
    values = [meter["counted_s"], meter["mtvv_mps2"], meter["peak_mps2"]]
    values += [each[figure] for each in meter["axes"] for figure in ("aw_mps2", "vdv_mps175")]
    assert [each["axis"] for each in meter["axes"]] == ["x", "y", "z"]
    for value in values:
        assert f"{value:#.3g}".rstrip(".") in shown, (value, shown)
    for name in ("counted", "aw", "VDV", "MTVV", "peak"):
        assert name in shown
    assert "Horizontal axes from the yaw given." in shown
    top = "['band', 'meter', 'body', 'ride'].map((id) => document.getElementById(id).getBoundingClientRect().top)"
    band_top, meter_top, body_top, ride_top = browser.page.evaluate(top)
    assert band_top < meter_top < min(body_top, ride_top)


def it_is_green_and_names_the_subject(browser: Browser) -> None:
    browser.until("document.body.dataset.tone == 'good'")
    assert browser.text("#headline") == "Below the action values so far"
    assert browser.page.evaluate("getComputedStyle($('band')).backgroundColor") == "rgb(23, 102, 58)"
    terms = browser.text("#terms")
    for term in (
        f"Subject {EVIL}", "Rolling window 10 s", "2002/44/EC", "A(8) 0.5 / 1.15 m/s²", "VDV 9.1 / 21 m/s¹·⁷⁵",
        "Predictions come from a model and are not measurements", "not validated",
    ):  # fmt: skip
        assert term in terms
    assert "governs" in browser.text("#figures")
    assert "left" in browser.text("#left-action")


def it_shows_intervals(browser: Browser) -> None:
    browser.until("snapshot.rows[0].predicted_interval_mps2 && minute.error.length > 1")
    row, shown = browser.page.evaluate(
        "show(snapshot), [snapshot.rows[0], document.querySelector('.row[data-name=\"head\"]').innerText]"
    )
    assert "{:.2f}–{:.2f}".format(*row["predicted_interval_mps2"]) in shown
    assert "{:.0f}–{:.0f}".format(*row["compression_interval_n"]) in shown
    assert "95 % interval of the true figure" in browser.text("#terms")
    assert "95 % interval" in browser.text("#ride .legend")


def it_fits(browser: Browser, width: int, height: int, picture: Path) -> None:
    browser.page.set_viewport_size({"width": width, "height": height})
    for scheme in ("light", "dark"):
        browser.page.emulate_media(color_scheme=scheme)
        browser.page.wait_for_timeout(300)
        assert browser.page.evaluate("document.documentElement.dataset.theme") == scheme
        assert browser.page.evaluate("document.documentElement.scrollWidth") <= width, "nothing sticks out"
        cells = "[...document.querySelectorAll('.row > *, .row, .figure, #left')]"
        wide = f"{cells}.filter(cell => cell.scrollWidth > cell.clientWidth + 1).map(cell => cell.className)"
        assert browser.page.evaluate(wide) == []
        shown, wider = browser.page.evaluate(f"show({BOUNDED}), [document.querySelector('.row').innerText, {wide}]")
        assert "F\u00a0≥\u00a01234 / ≥\u00a01234" in shown
        assert wider == []
        assert browser.page.evaluate(CUT_OFF) == []
        for scroll in (0, 1_000_000):
            browser.page.evaluate(f"scrollTo(0, {scroll})")
            assert browser.page.evaluate(REACHABLE) == [True, True, True], (width, scroll)
        browser.page.evaluate("scrollTo(0, 0)")
        # At arm's length, some 70 cm, 6 mm are read well: the headline has 23 px and more, the figures 25.
        for selector, least in (("#headline", 22.0), (".figure .value", 25.0), (".row .values", 18.0)):
            assert (
                float(
                    browser.page.evaluate(
                        f"parseFloat(getComputedStyle(document.querySelector('{selector}')).fontSize)"
                    )
                )
                >= least
            )
    browser.page.screenshot(path=str(picture), full_page=True)
    assert picture.stat().st_size > 20_000
    browser.page.set_viewport_size(dict(zip(("width", "height"), SIZES["desk"], strict=True)))


def it_survives_a_reload(browser: Browser) -> None:
    browser.page.reload()
    browser.until("minute.measured && minute.measured.length > 20 && minute.error.length > 1", 10.0)
    browser.until("snapshot && document.querySelectorAll('.row').length == 7", 10.0)


def it_shows_a_dead_sensor(browser: Browser) -> None:
    browser.until("document.querySelector('.row[data-name=\"head\"]').innerText.includes('silent for')")
    assert browser.page.evaluate("document.querySelector('.row[data-name=\"head\"] .dot').dataset.level") == "1"
    assert browser.page.evaluate("document.querySelector('.part[data-row=\"head\"]').dataset.level") == "1"
    silent = "[...document.querySelectorAll('.row')].filter(row => row.innerText.includes('silent for'))"
    assert browser.page.evaluate(f"{silent}.map(row => row.dataset.name)") == ["head"], "no other sensor is reported"
    browser.until("document.body.dataset.tone == 'good'", 10.0)  # the assessment uses the seat alone


def marks_and_resets(browser: Browser) -> None:
    browser.page.click("#mark")
    browser.until("$('reply').innerText.startsWith('mark 1 at')", 10.0)
    browser.until("$('marks').innerText.startsWith('mark 1 at')", 10.0)
    counted = browser.page.evaluate("snapshot.seat.counted_s")
    browser.page.click("#reset")
    assert browser.text("#reset") == "Press again to reset"
    browser.page.wait_for_timeout(600)
    assert browser.page.evaluate("snapshot.seat.counted_s") > counted, "once is not enough"
    browser.page.click("#reset")
    browser.until(f"snapshot.seat.counted_s < {counted}", 10.0)
    assert "is set to zero" in browser.text("#reply")


def it_reports_a_silent_seat(browser: Browser) -> None:
    browser.until("document.body.dataset.tone == 'none' && $('reason').innerText.includes('silent for')", 60.0)
    assert browser.text("#headline") == "Undecided: no assessment of the seat"
    assert browser.text("#left-action") == "withheld"
    assert browser.page.evaluate("getComputedStyle(document.querySelector('main')).opacity") == "0.45"


def it_tells_the_age_of_late_data(browser: Browser, address: str) -> None:
    """Over a connection that carries half of the data."""
    place = urlsplit(address)
    assert place.hostname is not None
    assert place.port is not None
    with throttled(place.hostname, place.port) as connection:
        browser.page.goto(address.replace(f":{place.port}/", f":{connection.port}/"))
        browser.until("snapshot && !document.body.classList.contains('stale')")
        sent = browser.page.evaluate("JSON.stringify(snapshot).length") * SNAPSHOT_RATE_HZ
        connection.rate_bytes_per_s = 0.5 * sent
        # In one look: on a busy machine data also fail to arrive at all for a while.
        browser.until(
            "/^Data are \\d+ s old$/.test($('headline').innerText) && document.body.dataset.tone == 'none'"
            " && $('reason').innerText.includes('connection to the page is too slow')",
            30.0,
        )
        connection.rate_bytes_per_s = math.inf
        browser.until("!document.body.classList.contains('stale')", 30.0)
    browser.page.goto(address)
    browser.requests = [url for url in browser.requests if f":{connection.port}/" not in url]
    browser.until("snapshot && !document.body.classList.contains('stale')")


class Throttled:
    """Passes connections on to a server, and back at a limited rate, through small buffers."""

    def __init__(self, host: str, port: int) -> None:
        self.rate_bytes_per_s = math.inf
        self._target = host, port
        self._server = socket.create_server((host, 0))
        self.port = int(self._server.getsockname()[1])

    def start(self) -> None:
        """Accept connections, in threads."""
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Accept no more."""
        self._server.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # closed
            while True:
                client, _ = self._server.accept()
                upstream = socket.socket()
                upstream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 12)
                upstream.connect(self._target)
                for source, sink, is_limited in ((client, upstream, False), (upstream, client, True)):
                    threading.Thread(target=self._pump, args=(source, sink, is_limited), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket, is_limited: bool) -> None:
        with contextlib.suppress(OSError), source, sink:
            while data := source.recv(1 << 11):
                sink.sendall(data)
                if is_limited:
                    time.sleep(len(data) / self.rate_bytes_per_s)


@contextlib.contextmanager
def throttled(host: str, port: int) -> Iterator[Throttled]:
    connection = Throttled(host, port)
    connection.start()
    try:
        yield connection
    finally:
        connection.close()


def it_goes_stale_when_the_node_is_killed(browser: Browser, node: subprocess.Popen[str]) -> None:
    node.send_signal(signal.SIGKILL)
    browser.until(
        "document.body.classList.contains('stale') && $('headline').innerText.startsWith('No data for')", 10.0
    )
    assert browser.page.evaluate("document.body.dataset.tone") == "none"


def it_comes_back(browser: Browser) -> None:
    browser.until("!document.body.classList.contains('stale')")


def it_withholds_what_two_nodes_send(browser: Browser) -> None:
    browser.until("document.body.dataset.tone == 'none' && $('headline').innerText == 'Undecided: several nodes'")
    assert "Give each a name of its own" in browser.text("#reason")


DRAWN = """() => {
  const bins = [...Array(600).keys()].map((k) => {
    const high = 3 + 2 * Math.sin(0.05 * k);
    return { begin: 0.1 * k, low: Array(6).fill(-high), high: Array(6).fill(high) };
  });
  snapshot = { rows: [{ name: "head", measured_column: 5, predicted_column: 5 }] };
  document.getElementById("channel").append(new Option("head"));
  minute = { measured: bins, predicted: bins };
  const words = [], points = [], pen = CanvasRenderingContext2D.prototype, own = {};
  for (const name of ["fillText", "lineTo", "fillRect"]) own[name] = pen[name];
  pen.fillText = function (text, x, y) {
    const size = this.measureText(text);
    const box = [x - size.actualBoundingBoxLeft, x + size.actualBoundingBoxRight];
    words.push([text, ...box, y - size.actualBoundingBoxAscent, y + size.actualBoundingBoxDescent]);
    own.fillText.call(this, text, x, y);
  };
  pen.lineTo = function (x, y) { points.push([x, y]); own.lineTo.call(this, x, y); };
  pen.fillRect = function (x, y, w, h) { points.push([x, y], [x + w, y + h]); own.fillRect.call(this, x, y, w, h); };
  draw();
  Object.assign(pen, own);
  const canvas = document.getElementById("strip");
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  const style = getComputedStyle(document.documentElement), count = {};
  for (const name of ["--measured", "--predicted"]) {
    const [r, g, b] = style.getPropertyValue(name).trim().slice(1).match(/../g).map((hex) => parseInt(hex, 16));
    count[name] = 0;
    for (let at = 0; at < data.length; at += 4) {
      if (data[at] === r && data[at + 1] === g && data[at + 2] === b && data[at + 3] === 255) count[name] += 1;
    }
  }
  return { words, points, count };
}"""


def test_measured_is_seen_under_a_prediction_that_equals_it_and_no_label_lies_on_the_curves(browser, without_node):
    reached(browser, without_node)
    for scheme in ("light", "dark"):
        browser.page.emulate_media(color_scheme=scheme)
        for width in (1280, 400):
            browser.page.set_viewport_size({"width": width, "height": 800})
            drawn = browser.page.evaluate(DRAWN)
            measured, predicted = drawn["count"]["--measured"], drawn["count"]["--predicted"]
            assert min(measured, predicted) > 0.3 * max(measured, predicted) > 100, (scheme, width, drawn["count"])
            xs, ys = zip(*drawn["points"], strict=True)
            assert len(drawn["words"]) >= 6
            for text, left, right, top, bottom in drawn["words"]:
                beside = right <= min(xs) or left >= max(xs) or bottom <= min(ys) or top >= max(ys)
                assert beside, (text, width)


BANDED = """() => {
  const filled = (low, high) => ({ low: Array(6).fill(low), high: Array(6).fill(high) });
  const bins = (low, high) => [...Array(600).keys()].map((k) => ({ begin: 0.1 * k, ...filled(low, high) }));
  snapshot = { rows: [{ name: "head", measured_column: 5, predicted_column: 5 }] };
  document.getElementById("channel").append(new Option("head"));
  const measured = bins(-0.1, 0.1);
  measured[590] = { begin: 59, ...filled(-4, 4) };
  const error = [...Array(30).keys()].map((s) => ({ begin: s, ...filled(-1, 1) }));
  minute = { measured, predicted: bins(-1, 1), error };
  draw();
  const canvas = document.getElementById("strip"), pen = canvas.getContext("2d");
  const data = pen.getImageData(0, 0, canvas.width, canvas.height).data;
  const band = [...Array(data.length / 4).keys()].filter((at) => data[4 * at + 3] === 153); // opacity 0.6
  const plot = (canvas.width - MARGIN.left - MARGIN.right) * (canvas.height - MARGIN.top - MARGIN.bottom);
  const late = band.filter((at) => at % canvas.width > MARGIN.left + 0.51 * (canvas.width - MARGIN.left));
  return [band.length / plot, late.length / band.length];
}"""


def test_the_interval_is_a_band_around_the_prediction_while_it_is_known(browser, without_node):
    reached(browser, without_node)
    for scheme in ("light", "dark"):
        browser.page.emulate_media(color_scheme=scheme)
        area, late = browser.page.evaluate(BANDED)
        # Half of the time, from -2 to 2 on axes from -4.4 to 4.4, but for the measurement and the lines.
        assert 0.8 * 0.5 * 4.0 / 8.8 < area < 0.5 * 4.0 / 8.8
        assert late < 0.01


def test_without_the_token_the_page_is_read_only(browser, without_node):
    reached(browser, without_node)
    assert browser.page.is_disabled("#mark")
    assert browser.page.is_disabled("#reset")
    assert "open the link" in browser.text("#reply")
    browser.page.wait_for_timeout(2000)
    assert browser.text("#headline") == "Waiting for the node"
    assert browser.page.evaluate("document.body.dataset.tone") == "none"
    assert browser.complaints == []


def test_the_page_ends_with_its_input_and_a_taken_port_is_one_line(graph):
    port = free_port()
    with child(graph, "page", "--page-port", str(port), "--until-input-ends") as first:
        # The tests' own input ends at once.
        assert first.wait(30) == 0
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", port))
        taken.listen()
        with child(graph, "page", "--page-port", str(port)) as second:
            assert second.wait(30) == 2
            errors = second.stderr.read()
    assert errors.count("\n") == 1
    assert f"cannot be served at 127.0.0.1:{port} (" in errors
