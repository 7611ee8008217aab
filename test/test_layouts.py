"""The viewers' layouts name topics that the live node has, fields that their messages have, and panels that exist."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import AccelStamped
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory

from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.base import topics
from biodyn_ros.base.resources import config_file
from biodyn_ros.node.health import SensorHealth, sensor_status
from biodyn_ros.node.layouts import lichtblick, plotjuggler
from biodyn_ros.play.player import message_class

LAYOUTS = config_file("layouts")
TYPES: dict[str, type] = {
    **{topics.absolute(topic): AccelStamped for topic in (*topics.PREDICTED.values(), *topics.MEASURED.values())},
    **{topics.absolute(topic): Float64 for topic in topics.SCALARS},
    topics.absolute(topics.PREDICTED_BLOCK): JointTrajectory,
    topics.DIAGNOSTICS: DiagnosticArray,
}
"""Every topic that the live node publishes, as the live node publishes it."""


def xml() -> ET.Element:
    """PlotJuggler's layout."""
    return ET.parse(LAYOUTS / "biodyn.xml").getroot()


def panels() -> dict[str, Any]:
    """The panels of the layout for Lichtblick and Foxglove."""
    return json.loads((LAYOUTS / "biodyn.json").read_text(encoding="utf-8"))["configById"]


def has_number(kind: type, fields: list[str]) -> bool:
    """Whether a message type has these fields one inside the other, the last of them a number."""
    *outer, last = map(_field, fields)
    for name, of_many in outer:
        inner = kind.get_fields_and_field_types().get(name)  # type: ignore[attr-defined]
        if inner and of_many:
            inner = inner.removeprefix("sequence<").removesuffix(">")
        found = message_class(inner.replace("/", "/msg/")) if inner and "/" in inner else None
        if found is None:
            return False
        kind = found
    name, of_many = last
    number = kind.get_fields_and_field_types().get(name)  # type: ignore[attr-defined]
    return number == "sequence<double>" if of_many else number in ("double", "float")


def _field(text: str) -> tuple[str, bool]:
    """A field's name, and whether one element of it is meant, as in points[0]."""
    name, bracket, _ = text.partition("[")
    return name, bool(bracket)


def split(series: str) -> tuple[str, list[str]]:
    """A PlotJuggler series as a topic of ours and the fields behind it."""
    (topic,) = (name for name in TYPES if series.startswith(f"{name}/"))
    return topic, series.removeprefix(f"{topic}/").split("/")


@pytest.mark.parametrize(("name", "made"), [("biodyn.xml", plotjuggler), ("biodyn.json", lichtblick)])
def test_the_file_is_the_one_that_is_made(name: str, made: Any) -> None:
    # This command makes the files: python -m biodyn_ros.node.layouts config/layouts
    assert (LAYOUTS / name).read_text(encoding="utf-8") == made()


def test_an_unknown_field_is_reported() -> None:
    assert has_number(AccelStamped, ["accel", "linear", "z"])
    assert has_number(JointTrajectory, ["points[0]", "effort[2]"])
    for wrong in (["points", "effort[2]"], ["points[0]", "effort"], ["points[0]", "force[2]"]):
        assert not has_number(JointTrajectory, wrong)
    for wrong in (["accel", "linear"], ["accel", "linear", "w"], ["twist", "linear", "z"], ["header", "stamp", "sec"]):
        assert not has_number(AccelStamped, wrong)


def test_every_curve_of_plotjuggler_is_a_field_of_a_topic() -> None:
    series = [curve.attrib["name"] for curve in xml().iter("curve")]
    assert len(series) == len(set(series))
    for topic, fields in map(split, series):
        if topic == topics.DIAGNOSTICS:
            hardware, status, key = fields
            assert hardware == topics.NODE_NAME
            sensor = status.removeprefix("biodyn: ")
            assert key in sensor_status(sensor, SensorHealth(), a_pipeline()).values
        else:
            assert has_number(TYPES[topic], fields), (topic, fields)


def a_pipeline() -> Pipeline:
    """One that has seen nothing yet."""
    from streams import subject

    return Pipeline(subject())


def test_plotjuggler_subscribes_to_the_topics_that_it_draws() -> None:
    drawn = {split(curve.attrib["name"])[0] for curve in xml().iter("curve")}
    (selected,) = (element.attrib["value"].split(";") for element in xml().iter("selected_topics"))
    assert set(selected) == drawn
    (streamer,) = xml().iter("previouslyLoaded_Streamer")
    assert streamer.attrib["name"] in {plugin.attrib["ID"] for plugin in xml().iter("plugin")}


def test_plotjuggler_s_splitters_count_their_children() -> None:
    # As PlotDocker::restoreSplitter reads them: one size a child, and nothing but areas and splitters inside.
    splitters = list(xml().iter("DockSplitter"))
    assert splitters
    for splitter in splitters:
        assert splitter.attrib["orientation"] in ("-", "|")
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(splitter) == int(splitter.attrib["count"]) == len(sizes)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-4)
        assert {child.tag for child in splitter} <= {"DockSplitter", "DockArea"}
    assert all([child.tag for child in area] == ["plot"] for area in xml().iter("DockArea"))


def test_every_path_of_lichtblick_is_a_field_of_a_topic_or_a_level() -> None:
    plots = {name: panel for name, panel in panels().items() if name.startswith("Plot!")}
    assert plots
    for panel in plots.values():
        for path in panel["paths"]:
            if re.fullmatch(r"[\d.]+", path["value"]):
                continue  # a reference line
            topic, *fields = path["value"].split(".")
            assert has_number(TYPES[topic], fields), path
            stamped = TYPES[topic].get_fields_and_field_types().get("header") is not None
            assert path["timestampMethod"] == ("headerStamp" if stamped else "receiveTime")
    for name in ("DiagnosticSummary!all", "DiagnosticStatusPanel!seat"):
        assert TYPES[panels()[name]["topicToRender"]] is DiagnosticArray


def test_lichtblick_s_tree_shows_every_panel_once() -> None:
    document = json.loads((LAYOUTS / "biodyn.json").read_text(encoding="utf-8"))
    assert set(document) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    shown = [document["layout"]]
    for tab in panels()[document["layout"]]["tabs"]:
        shown += leaves(tab["layout"])
    assert sorted(shown) == sorted(panels())


def leaves(tree: Any) -> Iterator[str]:
    """The panels of a tree of halves."""
    if isinstance(tree, str):
        yield tree
        return
    assert set(tree) == {"direction", "first", "second", "splitPercentage"}
    assert tree["direction"] in ("row", "column")
    assert 0.0 < tree["splitPercentage"] < 100.0
    yield from leaves(tree["first"])
    yield from leaves(tree["second"])


@pytest.mark.parametrize("text", ["biodyn.xml", "biodyn.json"])
def test_each_layout_has_all_required_topics(text: str) -> None:
    layout = (LAYOUTS / text).read_text(encoding="utf-8")
    wanted = [
        *topics.PREDICTED.values(),
        *(topics.MEASURED[name] for name in (SEAT, *MEASURED_SEGMENTS)),
        *topics.RESIDUAL.values(),
        topics.PREDICTED_BLOCK,
        f"{topics.EXPOSURE}/seat/vdv",
        f"{topics.EXPOSURE}/seat/a8",
        f"{topics.EXPOSURE}/dri",
    ]
    assert all(topics.absolute(topic) in layout for topic in wanted)
    assert topics.DIAGNOSTICS in layout
