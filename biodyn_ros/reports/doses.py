"""Drawings of doses and injury criteria as bars: measured filled, predicted hatched, each with its number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from biodyn_core.exposure.injury import DRI_BANDS
from biodyn_ros.base.wording import bound
from biodyn_ros.reports.drawing import MEASURED_COLOUR, PREDICTED_COLOUR, SOFT_COLOUR, drawn
from biodyn_ros.reports.intervals import Interval

VDV_LABEL: Final = "VDV, Wk-weighted, vertical, m/s¹·⁷⁵"

_WIDTH_IN: Final = 10.4
_STYLES: Final[dict[str, Any]] = {
    "measured": {"color": "#52606d"},
    "predicted": {"facecolor": "#ffe3d3", "edgecolor": PREDICTED_COLOUR, "hatch": "////", "lw": 0.8},
}

_ERROR_BAR: Final[dict[str, Any]] = {"ecolor": MEASURED_COLOUR, "elinewidth": 1.1, "capsize": 3.0, "fmt": "none"}


class Pair(NamedTuple):
    """A row of bars: label, measured and predicted value (None: not known), and whether they are lower bounds.

    predicted_interval: the 95 % interval of the prediction, drawn as an error bar.
    """

    label: str
    measured: float | None
    predicted: float | None
    measured_bound: bool = False
    predicted_bound: bool = False
    note: str = ""
    predicted_interval: Interval | None = None


def doses(rows: Sequence[Pair], label: str) -> Any:
    """Doses by sensor or segment in the given order; label: quantity and unit."""

    def fill(figure: Any) -> None:
        _pairs(figure.add_subplot(), rows, label)

    return drawn(_WIDTH_IN, 0.7 + 0.44 * len(rows), fill)


def injury(dri: Sequence[Pair], hic: Sequence[Pair]) -> Any:
    """The Dynamic Response Index with the edges of its bands, and the Head Injury Criterion."""

    def fill(figure: Any) -> None:
        left, right = figure.subplots(1, 2)
        _pairs(left, dri, "DRI of the measured seat, no unit", sides=False)
        for edge, _ in DRI_BANDS[:-1]:
            left.axvline(edge, color=SOFT_COLOUR, lw=0.9, ls=(0, (3, 2)))
            above = {"transform": left.get_xaxis_transform(), "ha": "center", "va": "bottom"}
            left.text(edge, 1.0, f"{edge:g}", fontsize=7, color=SOFT_COLOUR, **above)
        left.set_xlim(right=max(left.get_xlim()[1], 1.08 * DRI_BANDS[-2][0]))
        _pairs(right, hic, "HIC of the head, g^2.5 s")

    return drawn(_WIDTH_IN, 0.9 + 0.44 * max(len(dri), len(hic), 2), fill)


def _pairs(axes: Any, rows: Sequence[Pair], label: str, sides: bool = True) -> None:
    span = _span(rows)
    for place, row in enumerate(rows):
        both = (
            ("measured", row.measured, row.measured_bound, None),
            ("predicted", row.predicted, row.predicted_bound, row.predicted_interval),
        )
        here = [side for side in both if side[1] is not None]
        for number, (side, value, lower, interval) in enumerate(here):
            at = place + (0.2 * (2 * number - 1) if len(here) == 2 else 0.0)
            axes.barh(at, value, height=0.36, **_STYLES[side])
            if interval:
                _draw_interval(axes, value, at, interval)
            _write(
                axes,
                (interval[1] if interval else value) + 0.01 * span,
                at,
                f"{bound(value, lower)}{f' {side}' if sides else ''}{row.note}",
                MEASURED_COLOUR,
            )
        if not here:
            _write(axes, 0.01 * span, place, f"not known{row.note}", SOFT_COLOUR)
    axes.set_yticks(range(len(rows)), [row.label for row in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlim(0.0, 1.3 * span)
    axes.set_xlabel(label, color=SOFT_COLOUR)
    axes.grid(visible=False, axis="y")
    axes.tick_params(length=2.5, width=0.6)


def _draw_interval(axes: Any, value: float, place: float, interval: Interval) -> None:
    lower, upper = interval
    axes.errorbar(value, place, xerr=[[value - lower], [upper - value]], **_ERROR_BAR)


def _span(rows: Sequence[Pair]) -> float:
    """The largest value or end of an interval."""
    ends = (value for row in rows for value in (row.measured, row.predicted, *(row.predicted_interval or ())))
    return max((value for value in ends if value is not None), default=0.0) or 1.0


def _write(axes: Any, x: float, y: float, text: str, colour: str) -> None:
    ground = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
    axes.text(x, y, text, va="center", fontsize=7.5, color=colour, bbox=ground)
