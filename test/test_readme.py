"""The README says what the code says: parameters, topics, commands and files that exist."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

from biodyn_ros import topics
from biodyn_ros.arguments import parser
from biodyn_ros.live import SETTINGS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def rows() -> list[str]:
    """One table row per parameter of the live node, from the fields that declare it."""
    lines = []
    for item in (item for kind in SETTINGS for item in dataclasses.fields(kind)):
        allowed = item.metadata["range"]
        default = "none" if item.default is None else str(item.default).lower() or "-"
        span = f"{allowed.lower:g} to {allowed.upper:g} {allowed.unit}".strip() if math.isfinite(allowed.lower) else ""
        lines.append(f"| `{item.name}` | {default} | {span} | {allowed.meaning} |")
    return lines


def test_the_table_of_parameters_is_the_code_s() -> None:
    for row in rows():
        assert row in README, row
    assert README.count("\n| `") >= len(rows())


def test_every_command_is_described_and_none_that_is_not_there() -> None:
    (action,) = (a for a in parser()._actions if a.dest == "command")
    there = set(action.choices)
    named = set(re.findall(r"^\| `biodyn ([a-z-]+)", README, re.MULTILINE))
    assert named == there


def test_every_topic_is_named() -> None:
    for topic in (*topics.INPUT.values(), topics.RESET, topics.MARK, topics.DIAGNOSTICS):
        assert f"`{topic}`" in README or topic.split("/")[1] in README
    for name in ("~/predicted/<segment>/accel", "~/measured/<sensor>/accel", "~/residual/<segment>", "~/exposure/dri"):
        assert f"`{name}`" in README


def test_every_file_it_points_to_exists() -> None:
    for path in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / path).exists(), path
