"""README, docs and CONTRIBUTING agree with the code and with each other: tables, links, names and files."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import pytest

from biodyn_ros.base import topics
from biodyn_ros.base.wording import typeset
from biodyn_ros.commands.table import NAMES
from biodyn_ros.node.settings import SETTINGS
from blind.recovery import page as recovery
from blind.sessions import page as sessions_study
from blind.tracing import page as tracing_study
from conformance import page as conformance

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
LIVE_NODE = (ROOT / "docs" / "live_node.md").read_text(encoding="utf-8")
COMMANDS = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("bags/*.md"), *ROOT.glob("docs/**/*.md")])
MOST_CHARACTERS = 12_000


def test_the_readme_is_short() -> None:
    assert len(README) <= MOST_CHARACTERS


NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?(?:e-\d+)?")


def test_every_number_of_the_results_is_on_a_page_that_its_row_links_to() -> None:
    """So that a study repeated since does not leave an older result on the first page."""
    results = table(README, "| question | result | required | met |")
    assert len(results) > 9
    for row in results:
        _, question, result, *_ = row.split("|")
        pages = re.findall(r"\]\((docs/\w+\.md)[^)]*\)", result)
        linked = "".join((ROOT / page).read_text(encoding="utf-8") for page in pages).replace(",", "")
        numbers = NUMBER.findall(re.sub(r"\]\([^)]*\)", "", result))
        missing = {one.replace(",", "") for one in numbers} - set(NUMBER.findall(linked))
        assert pages and not missing, (question, missing)


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


def table(page: str, head: str) -> list[str]:
    """The rows of the table of a page with this head."""
    lines = page.splitlines()
    at = lines.index(head) + 2
    return lines[at : next(number for number in range(at, len(lines)) if not lines[number].startswith("|"))]


def test_the_table_of_parameters_equals_the_declared_parameters() -> None:
    assert table(LIVE_NODE, "| parameter | default | range | meaning |") == rows()


def test_the_tables_of_commands_list_the_existing_commands() -> None:
    def listed(page: str) -> list[str]:
        return re.findall(r"^\| `biodyn ([a-z-]+)", page, re.MULTILINE)

    assert set(listed(COMMANDS)) == set(NAMES)
    assert len(listed(README)) == 5
    assert set(listed(README)) < set(NAMES)


@pytest.mark.parametrize(
    ("page", "head"),
    [
        pytest.param(README, "| topic | type | direction and content |", id="README"),
        pytest.param(LIVE_NODE, "| topic | type | |", id="live_node"),
    ],
)
def test_the_tables_of_topics_list_the_topics_of_the_node(page: str, head: str) -> None:
    """Every topic matches one name of the table, and every name some topic."""
    names = [name for row in table(page, head) for name in re.findall(r"`([^`]*)`", row.split("|")[1])]
    last = ""
    patterns = []
    for name in names:  # `.../aw` is the name before it, ending so
        last = last.rsplit("/", name.count("/"))[0] + name.removeprefix("...") if name.startswith("...") else name
        patterns.append(last)
    there = {
        *topics.INPUT.values(), *topics.PREDICTED.values(), *topics.MEASURED.values(), topics.DIAGNOSTICS,
        topics.SNAPSHOT, topics.MARKS, topics.PREDICTED_BLOCK, topics.MEASURED_BLOCK,
        *(topic.replace(topics.ROLLING, topics.EXPOSURE) for topic in topics.SCALARS),
    }  # fmt: skip
    matched = {
        pattern: {t for t in there if re.fullmatch(as_regex(pattern), t)}
        for pattern in patterns
        if pattern not in (topics.RESET, topics.MARK)
    }
    assert set().union(*matched.values()) == there
    assert all(matched.values()), [pattern for pattern, found in matched.items() if not found]
    assert f"`{topics.RESET}`" in page and f"`{topics.MARK}`" in page


def as_regex(pattern: str) -> str:
    """A name of the tables as a regular expression: `<sensor>` stands for one name, `...` at the end for any rest."""
    return re.sub(r"<\w+>", "[a-z_]+", re.escape(pattern)).replace(r"\.\.\.", ".+")


def test_the_rolling_topics_are_described() -> None:
    assert f"`{topics.ROLLING}/`" in LIVE_NODE


def anchors(page: Path) -> set[str]:
    """The anchors that GitHub gives to the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "") for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", [pytest.param(page, id=str(page.relative_to(ROOT))) for page in PAGES])
def test_every_relative_link_leads_to_a_file_and_a_heading(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if re.match(r"https?:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_the_index_lists_every_page() -> None:
    listed = set(re.findall(r"\]\((\w+\.md)\)", (ROOT / "docs" / "README.md").read_text(encoding="utf-8")))
    assert listed == {page.name for page in (ROOT / "docs").glob("*.md")} - {"README.md"}


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("conformance", conformance.HEAD),
        ("recovery", recovery.HEAD),
        ("tracing_study", tracing_study.HEAD),
        ("sessions_study", sessions_study.HEAD),
    ],
)
def test_a_generated_page_begins_with_the_text_of_its_generator(name: str, head: str) -> None:
    assert (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8").startswith(head)


def test_the_claimed_quality_names_every_policy_of_rep_2004() -> None:
    text = (ROOT / "QUALITY.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([1-7])\.[iv-]+ \| ([^|]+) \| ([^|]+) \| ([^|]*) \|$", text, re.MULTILINE)
    assert {number for number, *_ in rows} == set("1234567")
    # Each claim has evidence; only a missing item may be without.
    assert all(shown.strip() or re.match(r"(no|none|not)\b", state) for _, _, state, shown in rows)
    assert re.search(r"\*\*Quality Level 4\*\*", text)


def test_the_names_in_contributing_exist_in_the_linked_files() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    files = {
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
    for name, path in files.items():
        assert name in text
        assert f"]({path})" in text
        assert name in (ROOT / path).read_text(encoding="utf-8")
