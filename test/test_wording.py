"""Counts, numbers and units in messages: singular and plural, three digits side by side, one notation per medium."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from biodyn_core.base.wording import counted, number, number_below
from biodyn_ros.base.wording import left_range, span, typeset, unchanging

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (counted(0, "shock"), "0 shocks"),
        (counted(1, "shock"), "1 shock"),
        (counted(2, "shock"), "2 shocks"),
        (counted(1, "sample is", "samples are"), "1 sample is"),
        (counted(3, "sample is", "samples are"), "3 samples are"),
        (unchanging(1, 0)[0], "1 sample with an unchanging value counted as missing: stuck sensor?"),
        (unchanging(0, 2)[0], "2 samples with an axis that does not change while another one moves: dead axis?"),
        (left_range(1), "left its range at 1 sample: no prediction there, restarted at rest"),
    ],
)
def test_a_count_has_its_singular_and_plural(text: str, wanted: str) -> None:
    assert text == wanted


PLURALS = (
    "samples|shocks|messages|recordings|events|subjects|topics|bytes|stamps|settings|types|files|evaluations|cases"
)


def test_no_message_prints_a_count_before_a_fixed_plural() -> None:
    """Names of constants, such as MOST_FILES, are numbers that are known to be many."""
    counts = re.compile(rf"\{{[^{{}}A-Z]*\}} (?:more |raw |such )?(?:{PLURALS})\b")
    found = [
        f"{path.name}: {line.strip()}"
        for package in ("biodyn_core", "biodyn_ros")
        for path in sorted((ROOT / package).rglob("*.py"))
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(r"\bf['\"]", line) and counts.search(line)
    ]
    assert found == []


@pytest.mark.parametrize(
    ("value", "limit", "shown"),
    [
        (9.0996, 9.1, "9.0996"),
        (9.09, 9.1, "9.09"),
        (0.49999, 0.5, "0.49999"),
        (0.03536, 0.5, "0.0354"),
        (0.0, 0.5, "0"),
        (9.2, 9.1, "9.20"),
    ],
)
def test_a_figure_below_its_limit_is_not_rounded_up_to_it(value: float, limit: float, shown: str) -> None:
    assert number_below(value, limit) == shown


def test_pages_have_superscripts_and_windows_have_milliseconds() -> None:
    assert typeset("8.85 m/s^1.75, 0.5 m/s^2, 3 m/s^1.5") == "8.85 m/s¹·⁷⁵, 0.5 m/s², 3 m/s¹·⁵"
    assert span([0.82263, 0.83763]) == "0.823 to 0.838"
    assert span(None) == number(None) == "–"


def test_a_template_never_has_a_unit_of_its_own_notation() -> None:
    for template in (ROOT / "biodyn_ros" / "templates").glob("*.j2"):
        assert not re.search(r"m/s(?:<sup>|\^)", template.read_text(encoding="utf-8")), template.name
