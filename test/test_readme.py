"""The README says what the code says: parameters, topics, commands and files that exist."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import pytest

from biodyn_ros.base import topics
from biodyn_ros.base.wording import typeset
from biodyn_ros.commands.table import NAMES
from biodyn_ros.node.live import SETTINGS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def rows() -> list[str]:
    """One table row per parameter of the live node, from the fields that declare it."""
    lines = []
    for item in (item for kind in SETTINGS for item in dataclasses.fields(kind)):
        allowed = item.metadata["range"]
        default = "none" if item.default is None else str(item.default).lower() or "-"
        span = (
            f"{allowed.lower:g} to {allowed.upper:g} {typeset(allowed.unit)}".strip()
            if math.isfinite(allowed.lower)
            else ""
        )
        lines.append(f"| `{item.name}` | {default} | {span} | {allowed.meaning} |")
    return lines


def table(head: str) -> list[str]:
    """The rows of the README's table with this head."""
    lines = README.splitlines()
    at = lines.index(head) + 2
    return lines[at : next(number for number in range(at, len(lines)) if not lines[number].startswith("|"))]


def test_the_table_of_parameters_is_the_code_s() -> None:
    assert table("| parameter | default | range | meaning |") == rows()


def test_every_command_is_described_and_none_that_is_not_there() -> None:
    named = set(re.findall(r"^\| `biodyn ([a-z-]+)", README, re.MULTILINE))
    assert named == set(NAMES)


def test_the_table_of_topics_is_the_node_s() -> None:
    """Every topic matches one name of the table, and every name some topic."""
    names = [name for row in table("| topic | type | |") for name in re.findall(r"`([^`]*)`", row.split("|")[1])]
    last = ""
    patterns = []
    for name in names:  # `.../aw` is the name before it, ending so
        last = last.rsplit("/", name.count("/"))[0] + name.removeprefix("...") if name.startswith("...") else name
        patterns.append(last)
    there = {
        *topics.INPUT.values(), *topics.PREDICTED.values(), *topics.MEASURED.values(), topics.DIAGNOSTICS,
        topics.SNAPSHOT, topics.MARKS, *(topic.replace(topics.ROLLING, topics.EXPOSURE) for topic in topics.SCALARS),
    }  # fmt: skip
    matched = {
        pattern: {t for t in there if re.fullmatch(re.sub(r"<\w+>", "[a-z_]+", re.escape(pattern)), t)}
        for pattern in patterns
    }
    assert set().union(*matched.values()) == there
    assert all(matched.values()), [pattern for pattern, found in matched.items() if not found]
    assert f"`{topics.ROLLING}/`" in README and f"`{topics.RESET}`" in README and f"`{topics.MARK}`" in README


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "QUALITY.md", "CHANGELOG.md"])
def test_every_file_it_points_to_exists(page: str) -> None:
    links = re.findall(r"\]\(([^)#:]+)\)", (ROOT / page).read_text(encoding="utf-8"))
    assert links
    for path in links:
        assert (ROOT / path).exists(), path


def test_the_quality_that_is_claimed_names_every_policy_of_rep_2004() -> None:
    text = (ROOT / "QUALITY.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([1-7])\.[iv-]+ \| ([^|]+) \| ([^|]+) \| ([^|]*) \|$", text, re.MULTILINE)
    assert {number for number, *_ in rows} == set("1234567")
    # What is claimed to be there is shown by something; only what is not there may stand alone.
    assert all(shown.strip() or re.match(r"(no|none|not)\b", state) for _, _, state, shown in rows)
    assert re.search(r"\*\*Quality Level 4\*\*", text)


def test_what_contributors_are_told_to_change_is_there() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    told = {
        "cutoff_hz": "biodyn_core/conditioning/conditioning_settings.py",
        "SEGMENT_WEIGHTS": "biodyn_core/identification/settings.py",
        "HorizontalMeter": "biodyn_core/exposure/meters.py",
        "EFFECT = SensorTransform(": "biodyn_core/effects/gain.py",
        "SENSORS": "biodyn_core/base/segments.py",
        "BagWriter": "biodyn_ros/blue_trident/importing.py",
        "encode_imu": "biodyn_ros/blue_trident/importing.py",
        "everyday": "biodyn_ros/commands/arguments.py",
        "COMMAND = Command(": "biodyn_ros/commands/compare.py",
    }
    for name, path in told.items():
        assert name in text
        assert f"]({path})" in text
        assert name in (ROOT / path).read_text(encoding="utf-8")
