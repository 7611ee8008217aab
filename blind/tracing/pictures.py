"""Pictures of the page of the study, as SVG: the reliability diagram, and accuracy against the ratio."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from biodyn_ros.reports.drawing import BAND_COLOUR, MEASURED_COLOUR, OTHER_COLOUR, SOFT_COLOUR, drawn
from blind.tracing.curves import MEASURES, Curve, RatioBin
from blind.tracing.reliability import BINS, Bin, Confidence, bins
from blind.tracing.rows import STRONG, WEAK

RELIABILITY: Final = "tracing_reliability.svg"
BY_RATIO: Final = "tracing_ratio.svg"
TENTHS: Final = np.arange(BINS + 1) / BINS
TICKS: Final = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)


def reliability_picture(answers: Sequence[Confidence]) -> str:
    """Share of right answers against their mean probability, and below it the number of answers in each bin."""
    found = bins(answers)

    def fill(figure: Any) -> None:
        top, below = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 1.0))
        top.plot([0.0, 1.0], [0.0, 1.0], color=SOFT_COLOUR, lw=0.9, ls="--", label="perfect calibration")
        _points(top, found, [one.mean for one in found])
        top.set_ylabel("share right", color=SOFT_COLOUR)
        top.set_ylim(-0.03, 1.03)
        top.legend(loc="lower right", frameon=False)
        middles = [0.5 * (one.low + one.high) for one in found]
        below.bar(middles, [one.records for one in found], width=0.9 / BINS, color=BAND_COLOUR)
        for middle, one in zip(middles, found, strict=True):
            below.text(middle, one.records, str(one.records), ha="center", va="bottom", fontsize=7.0)
        below.set_ylim(0.0, 1.25 * max(one.records for one in found))
        below.set_ylabel("answers", color=SOFT_COLOUR)
        below.set_xlabel("probability of the most probable answer", color=SOFT_COLOUR)
        below.set_xlim(-0.02, 1.02)
        below.set_xticks(TENTHS)

    return f"{drawn(5.2, 5.4, fill)}"


def ratio_picture(groups: Mapping[str, Sequence[Curve]]) -> str:
    """For each group and measure the share by ratio: bins with intervals, the curve with its band, each record."""

    def fill(figure: Any) -> None:
        panels = figure.subplots(len(groups), len(MEASURES), sharex=True, sharey=True, squeeze=False)
        for line, curves in zip(panels, groups.values(), strict=True):
            for axes, curve in zip(line, curves, strict=True):
                _curve(axes, curve)
            line[0].set_ylabel("share of records", color=SOFT_COLOUR)
        for axes in panels[-1]:
            axes.set_xlabel("ratio of the hidden effect", color=SOFT_COLOUR)

    return f"{drawn(10.4, 0.4 + 2.6 * len(groups), fill)}"


def _curve(axes: Any, curve: Curve) -> None:
    axes.set_title(f"{curve.measure}: {curve.group}", loc="left", fontweight="bold")
    axes.set_xscale("log")
    for limit in (WEAK, STRONG):
        axes.axvline(limit, color=SOFT_COLOUR, lw=0.8, ls=":")
    if curve.fit is not None:
        ratios = np.geomspace(curve.ratios.min(), curve.ratios.max(), 81)
        middle, low, high = curve.fit.at(ratios)
        axes.fill_between(ratios, low, high, color=OTHER_COLOUR, alpha=0.2, lw=0.0)
        axes.plot(ratios, middle, color=OTHER_COLOUR, lw=1.5)
    _points(axes, curve.bins, [one.middle for one in curve.bins])
    # One stroke for each record, above for a hit and below for none, all as one line with gaps.
    for hit, ends in ((True, (1.03, 1.07, np.nan)), (False, (-0.07, -0.03, np.nan))):
        mine = curve.ratios[curve.hits == hit]
        axes.plot(np.repeat(mine, 3), np.tile(ends, mine.size), color=MEASURED_COLOUR, lw=0.5)
    axes.set_ylim(-0.1, 1.1)
    axes.set_yticks([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    axes.minorticks_off()
    axes.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])


def _points(axes: Any, found: Sequence[Bin] | Sequence[RatioBin], at: Sequence[float]) -> None:
    """The share of each bin with its interval."""
    shares = np.array([one.share for one in found])
    low, high = np.array([one.interval for one in found]).T
    # Rounding may put the limit of an interval beyond a share of 0 or 1.
    axes.errorbar(
        at, shares, [np.maximum(shares - low, 0.0), np.maximum(high - shares, 0.0)], color=MEASURED_COLOUR, ls="",
        marker="o", ms=4.0, lw=1.0, capsize=2.0, label="bins with Wilson's 95 % interval",
    )  # fmt: skip
