"""Layouts for viewers, from the topics of the live node: PlotJuggler's XML, and the JSON of Lichtblick and Foxglove.

    python -m biodyn_ros.node.layouts config/layouts    # writes both files

Each shows, a tab after the other: predicted against measured acceleration, forces of joints, exposure, residual,
diagnostics. Of a block of samples the first is drawn.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

from biodyn_core.base.segments import SEAT, SEGMENTS, SENSORS
from biodyn_core.exposure.joint_forces import JOINT_NAMES
from biodyn_core.exposure.limits import EU_LIMITS
from biodyn_ros.base.files import write_text
from biodyn_ros.base.topics import (
    DIAGNOSTICS,
    EXPOSURE,
    MEASURED,
    NODE_NAME,
    PREDICTED,
    PREDICTED_BLOCK,
    RESIDUAL,
    ROLLING,
    absolute,
    status_name,
)
from biodyn_ros.base.wording import words

PREDICTED_COLOR, MEASURED_COLOR = "#d95f02", "#1b9e77"
COLORS: Final = (MEASURED_COLOR, PREDICTED_COLOR, "#7570b3", "#e7298a", "#66a61e", "#e6ab02")
ACCEL, SCALAR = "accel.linear.z", "data"
STATUS: Final = ("rate_hz", "lag_ms", "missing_s", "clock_off_ms")
"""The most useful values of a sensor's diagnostics over time."""


@dataclass(frozen=True)
class Curve:
    """A field of a topic's messages, as `accel.linear.z`, with the name that is shown.

    stamped: whether it is drawn over the stamps of its messages instead of their arrival.
    """

    topic: str
    field: str
    label: str
    color: str
    stamped: bool = False


@dataclass(frozen=True)
class Plot:
    """Curves in one drawing; levels: horizontal lines, for viewers that draw them."""

    title: str
    curves: tuple[Curve, ...]
    levels: tuple[float, ...] = ()


def motion() -> list[Plot]:
    """Each segment's predicted and measured acceleration, the seat first."""
    names = (SEAT, *SEGMENTS)
    return [
        Plot(
            f"{words(name)}, m/s²",
            tuple(
                Curve(absolute(topics[name]), ACCEL, label, color, stamped=True)
                for topics, label, color in (
                    (MEASURED, "measured", MEASURED_COLOR),
                    (PREDICTED, "predicted", PREDICTED_COLOR),
                )
                if name in topics
            ),
        )
        for name in names
    ]


def forces() -> list[Plot]:
    """The predicted force in each joint, by the segment above it."""
    named = zip(JOINT_NAMES.values(), cycle(COLORS), strict=False)
    return [
        Plot(
            "force in the joints, N, without the static weight",
            tuple(
                Curve(absolute(PREDICTED_BLOCK), f"points[0].effort[{index}]", label, color, stamped=True)
                for index, (label, color) in enumerate(named)
            ),
        )
    ]


def exposure() -> list[Plot]:
    """Exposure since reset: doses, rms, the day's value against its limits, and criteria of single shocks."""
    seat, lives = f"{EXPOSURE}/seat", ("seat", "head", "predicted/head")
    return [
        Plot("VDV since reset, m/s¹·⁷⁵", _scalars([(f"{EXPOSURE}/{name}/vdv", words(name)) for name in lives])),
        Plot("aw over the window, m/s²", _scalars([(f"{ROLLING}/{name}/aw", words(name)) for name in lives])),
        Plot(
            "A(8) so far, m/s², with action and limit value",
            _scalars([(f"{seat}/a8", "A(8)")]),
            (EU_LIMITS.deciding.action_a8_mps2 or 0.0, EU_LIMITS.deciding.limit_a8_mps2 or 0.0),
        ),
        Plot(
            "time left, s",
            _scalars(
                [(f"{seat}/time_to_action_value", "action value"), (f"{seat}/time_to_limit_value", "limit value")]
            ),
        ),
        Plot("DRI", _scalars([(f"{EXPOSURE}/dri", "since reset"), (f"{ROLLING}/dri", "over the window")])),
        Plot("HIC15 of the head", _scalars([(f"{EXPOSURE}/head/hic15", "since reset")])),
    ]


def residual() -> list[Plot]:
    """The residual between model and measurement, segment by segment."""
    return [
        Plot(
            "residual: rms of predicted less measured over the window, m/s²",
            _scalars([(topic, words(name)) for name, topic in RESIDUAL.items()]),
        )
    ]


def _tabs() -> tuple[tuple[str, list[Plot]], ...]:
    return ("motion", motion()), ("forces", forces()), ("exposure", exposure()), ("residual", residual())


def _scalars(named: Sequence[tuple[str, str]]) -> tuple[Curve, ...]:
    return tuple(
        Curve(absolute(topic), SCALAR, label, color)
        for (topic, label), color in zip(named, cycle(COLORS), strict=False)
    )


# --- PlotJuggler -----------------------------------------------------------------------------------------------------


def plotjuggler() -> str:
    """The layout for PlotJuggler 3: curves are called by topic and field with slashes, diagnostics by status and key.

    Format: plot_docker.cpp and the ROS plugins of github.com/PlotJuggler (DockSplitter: "-" vertical, "|" horizontal).
    """
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", name="Main Window", parent="main_window")
    for title, plots in _tabs():
        drawn = [(plot.title, [(_series(c), c.color) for c in plot.curves]) for plot in plots]
        _tab(window, title, drawn, 2 if len(drawn) > 1 else 1)
    statuses = [
        (
            key,
            [
                (f"{DIAGNOSTICS}/{NODE_NAME}/{status_name(sensor)}/{key}", c)
                for sensor, c in zip(SENSORS, cycle(COLORS), strict=False)
            ],
        )
        for key in STATUS
    ]
    _tab(window, "diagnostics", statuses, 2)
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    plugins = ET.SubElement(root, "Plugins")
    for plugin in ("DataLoad ROS2 bags", "ROS2 Topic Subscriber"):
        how = ET.SubElement(plugins, "plugin", ID=plugin)
        for name, value in (("use_header_stamp", "true"), ("discard_large_arrays", "true"), ("max_array_size", "100")):
            ET.SubElement(how, name, value=value)
    curves = [curve for _, plots in _tabs() for plot in plots for curve in plot.curves]
    topics = dict.fromkeys((*(curve.topic for curve in curves), DIAGNOSTICS))
    ET.SubElement(how, "selected_topics", value=";".join(topics))
    ET.SubElement(root, "previouslyLoaded_Datafiles")
    ET.SubElement(root, "previouslyLoaded_Streamer", name="ROS2 Topic Subscriber")
    ET.indent(root, " ")
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ET.tostring(root, encoding='unicode')}\n"


def _series(curve: Curve) -> str:
    return "/".join((curve.topic, *curve.field.split(".")))


def _tab(window: ET.Element, title: str, plots: list[tuple[str, list[tuple[str, str]]]], columns: int) -> None:
    tab = ET.SubElement(window, "Tab", tab_name=title, containers="1")
    rows = [plots[at : at + columns] for at in range(0, len(plots), columns)]
    stack = _splitter(ET.SubElement(tab, "Container"), "-", len(rows))
    for row in rows:
        splitter = _splitter(stack, "|", len(row))
        for name, curves in row:
            area = ET.SubElement(splitter, "DockArea", name=name)
            plot = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
            ET.SubElement(plot, "limitY")
            for series, color in curves:
                ET.SubElement(plot, "curve", name=series, color=color)


def _splitter(inside: ET.Element, orientation: str, count: int) -> ET.Element:
    sizes = ";".join([f"{1.0 / count:.6f}"] * count)
    return ET.SubElement(inside, "DockSplitter", orientation=orientation, count=str(count), sizes=sizes)


# --- Lichtblick and Foxglove -----------------------------------------------------------------------------------------


def lichtblick() -> str:
    """The layout for Lichtblick and Foxglove: panels by id, and a tree that halves the screen.

    Format: PlotConfig, DiagnosticSummaryConfig and the layouts of github.com/lichtblick-suite/lichtblick.
    """
    panels: dict[str, Any] = {}
    tabs = []
    for title, plots in _tabs():
        ids = []
        for number, plot in enumerate(plots):
            ids.append(f"Plot!{title}{number}")
            panels[ids[-1]] = _plot_panel(plot)
        rows = [_halved("row", ids[at : at + 2]) for at in range(0, len(ids), 2)]
        tabs.append({"title": title, "layout": _halved("column", rows)})
    panels["DiagnosticSummary!all"] = {
        "minLevel": 0, "pinnedIds": [], "hardwareIdFilter": "", "topicToRender": DIAGNOSTICS, "sortByLevel": True,
    }  # fmt: skip
    panels["DiagnosticStatusPanel!seat"] = {
        "topicToRender": DIAGNOSTICS, "selectedHardwareId": NODE_NAME, "selectedName": status_name(SEAT),
    }  # fmt: skip
    shown = _halved("row", ["DiagnosticSummary!all", "DiagnosticStatusPanel!seat"])
    tabs.append({"title": "diagnostics", "layout": shown})
    panels["Tab!biodyn"] = {"activeTabIdx": 0, "tabs": tabs}
    document = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": "Tab!biodyn",
    }
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"


def _plot_panel(plot: Plot) -> dict[str, Any]:
    paths = [
        {
            "value": f"{curve.topic}.{curve.field}",
            "enabled": True,
            "label": curve.label,
            "color": curve.color,
            "timestampMethod": "headerStamp" if curve.stamped else "receiveTime",
        }
        for curve in plot.curves
    ]
    lines = [{"value": f"{level:g}", "enabled": True, "timestampMethod": "receiveTime"} for level in plot.levels]
    return {
        "lichtblickPanelTitle": plot.title,
        "foxglovePanelTitle": plot.title,
        "paths": [*paths, *lines],
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }


def _halved(direction: str, items: Sequence[Any]) -> Any:
    """A tree of two branches each, in which every item has the same share."""
    first, *rest = items
    if not rest:
        return first
    share = 100.0 / len(items)
    return {"direction": direction, "first": first, "second": _halved(direction, rest), "splitPercentage": share}


if __name__ == "__main__":
    for name, text in (("biodyn.xml", plotjuggler()), ("biodyn.json", lichtblick())):
        write_text(Path(sys.argv[1]) / name, text)
