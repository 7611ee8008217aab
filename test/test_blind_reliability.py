"""Bins of probabilities, the expected calibration error, and the error by chance."""

from __future__ import annotations

import numpy as np
import pytest

from blind.tracing.reliability import DRAWS, Bin, bin_table, bins, calibration_error, error_by_chance
from blind.tracing.shares import share_text, wilson


def test_the_bins_count_what_is_right() -> None:
    answers = [(0.72, True), (0.78, False), (0.75, True), (0.05, False), (0.8, True), (1.0, True), (0.95, False)]
    assert bins(answers) == [
        Bin(0.0, 0.1, 1, 0.05, 0),
        Bin(0.7, 0.8, 3, pytest.approx(0.75), 2),
        Bin(0.8, 0.9, 1, 0.8, 1),  # the lower edge belongs to a bin
        Bin(0.9, 1.0, 2, pytest.approx(0.975), 1),  # ... and 1 to the last
    ]
    assert bins(answers)[1].share == pytest.approx(2 / 3) and bins(answers)[1].interval == wilson(2, 3)


def test_the_table_has_a_row_for_each_bin_with_answers() -> None:
    head, _, *rows = bin_table([(0.95, True)] * 3 + [(0.95, False)], "bodies")
    assert head == "| probability of the most probable answer | bodies | mean probability | right |"
    assert rows == ["| 0.9 to 1.0 | 4 | 0.95 | 75.0 % (30.1 to 95.4) |"]
    assert share_text(0, 0) == "-"


def test_the_calibration_error_is_the_weighted_distance_of_the_bins() -> None:
    assert calibration_error([(0.95, True)] * 19 + [(0.95, False)]) == pytest.approx(0.0)
    assert calibration_error([(0.5, True)] * 10) == pytest.approx(0.5)
    assert calibration_error([(0.25, False)] * 3 + [(1.0, True)]) == pytest.approx(0.75 * 0.25)


def test_the_error_by_chance_is_that_of_a_binomial() -> None:
    """Of n answers with p = 1/2 in one bin the error is |k / n - 1/2|; n = 100: median 0.03 to 0.04, 95 % 0.10."""
    median, most = error_by_chance([(0.5, True)] * 100)
    assert median == pytest.approx(0.03, abs=0.0101) and most == pytest.approx(0.098, abs=0.0101)
    assert error_by_chance([(1.0, False)] * 10) == (0.0, 0.0)


def test_the_error_by_chance_is_that_of_its_slow_twin() -> None:
    rng = np.random.default_rng(5)
    p = rng.uniform(0.2, 1.0, 60)
    slow = [calibration_error([(one, bool(rng.random() < one)) for one in p]) for _ in range(400)]
    median, most = error_by_chance([(one, True) for one in p])
    assert DRAWS > 400 and median == pytest.approx(np.median(slow), abs=0.01)
    assert most == pytest.approx(np.quantile(slow, 0.95), abs=0.02)
