"""Reading of pages in tests: the visible text and the drawings."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from biodyn_ros.reports import drawing

NASTY = "/data/<script>alert('x')</script> & \"rail\" $x$.mcap"
VOID = {"meta", "br", "path", "use", "rect", "link", "hr", "img"}


class Page(HTMLParser):
    """Reads a page, remembers its text and tags, and fails on tags that do not close."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.pieces: list[str] = []
        self.feed(source)
        self.close()
        assert self.open == []
        self.text = " ".join("".join(self.pieces).split())

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        """Open a tag."""
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: Any) -> None:
        """Note a tag that closes itself."""
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Close the innermost tag."""
        if tag not in VOID:
            assert self.open.pop() == tag
        if tag not in {"sup", "b"}:
            self.pieces.append(" ")

    def handle_data(self, data: str) -> None:
        """Keep the visible text."""
        if not self.open or self.open[-1] != "style":
            self.pieces.append(data)


class Line(NamedTuple):
    """A line of a drawing: its points (n, 2) as shares of its panel, from the lower left, and its dashes."""

    points: NDArray[np.float64]
    dashed: bool


def lines(svg: str, colour: str, width: float) -> list[Line]:
    """Every line of one colour and width inside a panel, in the order drawn."""
    boxes = {
        name: [float(value) for value in box]
        for name, *box in re.findall(
            r'<clipPath id="(\w+)">\s*<rect x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)"', svg
        )
    }
    found = []
    for path in re.findall(r"<path [^>]*>", svg):
        style = re.search(r'style="([^"]*)"', path)
        clip = re.search(r'clip-path="url\(#(\w+)\)"', path)
        if not (style and clip) or f"stroke: {colour}" not in style[1] or "fill: none" not in style[1]:
            continue
        if float((re.search(r"stroke-width: ([\d.]+)", style[1]) or ["", "1"])[1]) != width:
            continue
        x, y, wide, high = boxes[clip[1]]
        numbers = re.findall(r"[ML] (-?[\d.]+) (-?[\d.]+)", re.search(r' d="([^"]*)"', path)[1])
        points = np.array([(float(a), float(b)) for a, b in numbers])
        points = np.column_stack([(points[:, 0] - x) / wide, 1.0 - (points[:, 1] - y) / high])
        found.append(Line(points, "stroke-dasharray" in style[1]))
    return found


def assert_self_contained(source: str) -> None:
    """No request leaves the page, and every name that a drawing points to is its own."""
    assert set(re.findall(r'(\S*)="https?://', source)) <= {"xmlns", "xmlns:xlink"}
    assert not re.search(r"https?://", re.sub(r'xmlns(:\w+)?="[^"]*"', "", source))
    assert not re.search(r"@import|<script|<link|src=|url\((?!#)", source)
    assert all(link.startswith(("#", "data:image/png;base64,")) for link in re.findall(r'xlink:href="([^"]*)', source))
    for svg in re.findall(r"<svg.*?</svg>", source, flags=re.DOTALL):
        own = set(re.findall(r' id="([^"]+)"', svg))
        assert set(re.findall(r'(?:href="|url\()#([^")]+)', svg)) <= own
    assert len(source) < 1_500_000


def svg_text(svg: str) -> str:
    """The texts of a drawing."""
    return " | ".join(html.unescape(text) for text in re.findall(r"<text[^>]*>([^<]*)</text>", svg))


@cache
def _drawing_modules() -> list[Any]:
    """The modules with figures; commands import them when they write a page."""
    package = Path(drawing.__file__).parents[1]
    paths = [path for path in sorted(package.rglob("*.py")) if re.search(r"\bdrawn\(", path.read_text("utf-8"))]
    modules = [import_module(".".join(path.relative_to(package.parent).with_suffix("").parts)) for path in paths]
    return [module for module in modules if module is not drawing and getattr(module, "drawn", None) is drawing.drawn]


@contextmanager
def no_drawings() -> Iterator[None]:
    """Empty drawings of which no figure is made, for tests of texts alone."""

    def empty(width_in: float, height_in: float, fill: object) -> Any:
        return drawing.drawn(width_in, height_in, lambda figure: None)

    with empty_drawings(), pytest.MonkeyPatch.context() as patch:
        for module in _drawing_modules():
            patch.setattr(module, "drawn", empty)
        yield


@contextmanager
def empty_drawings() -> Iterator[None]:
    """Draw figures but return empty drawings: layout and SVG take almost all the time of a page."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda engine, figure: None)
        patch.setattr(FigureCanvasSVG, "print_svg", lambda canvas, file, **options: file.write("<svg></svg>"))
        yield
