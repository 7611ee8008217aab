"""Drawings of a fit's page and of a campaign's: estimates within Table 1, their correlation, their profiles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from biodyn_core.body.parameters import PARAMETERS
from biodyn_ros.base.wording import number, parameter_name, with_interval
from biodyn_ros.reports.drawing import MEASURED_COLOUR, OTHER_COLOUR, PREDICTED_COLOUR, SOFT_COLOUR, drawn

Document = dict[str, Any]

ESTIMATE_COLOUR: Final = OTHER_COLOUR
RANGE_COLOUR: Final = "#d5dce2"
MARKERS: Final[dict[str, Any]] = {
    "identifiable": {"marker": "o", "markerfacecolor": ESTIMATE_COLOUR},
    "weakly identifiable": {"marker": "D", "markerfacecolor": "#a5d0f5"},
    "not identifiable": {"marker": "o", "markerfacecolor": "white"},
    "on its bound": {"marker": "s", "markerfacecolor": PREDICTED_COLOUR, "markeredgecolor": PREDICTED_COLOUR},
}
"""The marker of each degree; shape and filling differ as well as colour."""

LABELLED_CORRELATION: Final = 0.5
"""Cells with at least this correlation show their number."""

_WIDTH_IN: Final = 10.4
_PLACE: Final = "place between the bounds of Table 1, logarithmic, no unit"
_BOUNDS: Final = {parameter.name: (parameter.lower, parameter.upper) for parameter in PARAMETERS}


class Estimate(NamedTuple):
    """One parameter of one subject, as drawn; identifiability is a key of `MARKERS`."""

    value: float
    lower: float
    upper: float
    identifiability: str


def estimates_of(document: Document) -> dict[str, Estimate]:
    """All fitted parameters of a fit.json."""
    degrees = document["identifiable"]
    return {
        name: Estimate(of["value"], of["lower"], of["upper"], "on its bound" if of["at_bound"] else degrees[name])
        for name, of in document["intervals"].items()
    }


def place(name: str, value: float) -> float:
    """The position of a value between the bounds of Table 1, 0 to 1, logarithmic."""
    lower, upper = _BOUNDS[name]
    return math.log(max(value, 1e-300) / lower) / math.log(upper / lower)


def intervals(document: Document) -> Any:
    """Estimates of the joint fit with their 95 % intervals, and those of single cases beneath as ticks."""
    found = estimates_of(document)
    singles = [values_of(case["parameters"]) for case in document["cases"]] if len(document["cases"]) > 1 else []

    def fill(figure: Any) -> None:
        axes = figure.add_subplot()
        for row, (name, estimate) in enumerate(found.items()):
            lower, upper = _BOUNDS[name]
            axes.plot([0.0, 1.0], [row, row], color=RANGE_COLOUR, lw=5.0, solid_capstyle="butt", zorder=1)
            for values in singles:
                at = min(max(place(name, values[name]), 0.0), 1.0)
                axes.plot([at, at], [row + 0.12, row + 0.42], color=MEASURED_COLOUR, lw=0.9)
            _interval(axes, name, estimate, row)
            unit = document["intervals"][name]["unit"]
            shown = "" if unit == "-" else f" {unit}"
            axes.text(-0.01, row, f"{lower:g}", ha="right", va="center", fontsize=7, color=SOFT_COLOUR)
            axes.text(1.01, row, f"{upper:g}", ha="left", va="center", fontsize=7, color=SOFT_COLOUR)
            axes.text(1.08, row, _label(estimate, shown), va="center", fontsize=7.5)
        axes.set_yticks(range(len(found)), [parameter_name(name) for name in found])
        axes.set_ylim(len(found) - 0.3, -0.7)
        axes.set_xlim(-0.11, 1.66)
        axes.set_xticks((0.0, 0.25, 0.5, 0.75, 1.0))
        axes.set_xlabel(_PLACE, color=SOFT_COLOUR, loc="left")
        axes.grid(visible=False, axis="y")
        axes.tick_params(length=2.5, width=0.6)

    return drawn(_WIDTH_IN, 0.6 + 0.31 * len(found), fill)


def correlation(document: Document) -> Any | None:
    """Correlation of the estimates, the lower triangle; None for a single one."""
    names = document["correlation"]["names"]
    if len(names) < 2:
        return None
    matrix = np.array(document["correlation"]["matrix"])[1:, :-1]

    def fill(figure: Any) -> None:
        from matplotlib.colors import BoundaryNorm

        axes = figure.add_subplot()
        below = np.tril(np.ones(matrix.shape, dtype=bool))
        levels = BoundaryNorm(np.linspace(-1.0, 1.0, 9), 256)
        drawing = axes.imshow(np.ma.masked_where(~below, matrix), cmap="PuOr", norm=levels, interpolation="none")
        for row, column in np.argwhere(below & (np.abs(matrix) >= LABELLED_CORRELATION)).tolist():
            axes.text(column, row, f"{matrix[row, column]:+.2f}", ha="center", va="center", fontsize=6.5, color="white")
        short = [parameter_name(name) for name in names]
        axes.set_xticks(range(len(names) - 1), short[:-1], rotation=55, ha="right", rotation_mode="anchor", fontsize=7)
        axes.set_yticks(range(len(names) - 1), short[1:], fontsize=7)
        axes.grid(visible=False)
        axes.tick_params(length=0.0)
        label = "correlation of the estimates' logarithms, no unit"
        figure.colorbar(drawing, ax=axes, label=label, format="%.2f", ticks=np.linspace(-1.0, 1.0, 9), shrink=0.8)

    return drawn(8.4, 1.6 + 0.33 * len(names), fill)


def profiles(document: Document) -> Any | None:
    """The profile likelihood of every profiled parameter with its 95 % threshold; None without profiles."""
    found = document["profiles"]
    if not found:
        return None
    rows = -(-len(found) // 3)

    def fill(figure: Any) -> None:
        grid = figure.add_gridspec(rows, min(3, len(found)))
        for number_of, (name, profile) in enumerate(found.items()):
            axes = figure.add_subplot(grid[number_of // 3, number_of % 3])
            _profile(axes, profile)
            unit = document["intervals"][name]["unit"]
            axes.set_title(parameter_name(name), loc="left", fontweight="bold")
            axes.set_xlabel("value, no unit" if unit == "-" else f"value, {unit}", color=SOFT_COLOUR)
            if number_of % 3 == 0:
                axes.set_ylabel("rise of the objective\nover the 95 % limit, no unit", color=SOFT_COLOUR)

    return drawn(_WIDTH_IN if len(found) > 1 else 5.2, 2.5 * rows, fill)


def subjects(estimates: Sequence[dict[str, Estimate]]) -> Any:
    """Estimates of many subjects side by side, a row for each parameter and a number for each subject."""

    def fill(figure: Any) -> None:
        axes = figure.add_subplot()
        step = 0.7 / max(len(estimates), 1)
        for row, parameter in enumerate(PARAMETERS):
            axes.axhspan(row - 0.42, row + 0.42, color="#f4f6f8" if row % 2 else "white", zorder=0)
            for nth, one in enumerate(estimates):
                if parameter.name not in one:
                    continue
                at = row - 0.35 + (nth + 0.5) * step
                _interval(axes, parameter.name, one[parameter.name], at, size=3.5)
                right = place(parameter.name, one[parameter.name].upper)
                axes.text(right + 0.008, at, str(nth + 1), va="center", fontsize=5.5, color=SOFT_COLOUR)
        axes.set_yticks(range(len(PARAMETERS)), [parameter_name(parameter.name) for parameter in PARAMETERS])
        axes.set_ylim(len(PARAMETERS) - 0.5, -0.5)
        axes.set_xlim(-0.03, 1.05)
        axes.set_xlabel(_PLACE, color=SOFT_COLOUR)
        axes.grid(visible=False, axis="y")
        axes.tick_params(length=2.5, width=0.6)

    return drawn(_WIDTH_IN, 1.0 + len(PARAMETERS) * max(0.3, min(0.09 * len(estimates), 1.2)), fill)


def values_of(parameters: Document) -> dict[str, float]:
    """The values of a mapping of parameters by the name of each."""
    found = {}
    groups = {name: iter(of) if isinstance(of, list) else iter([of]) for name, of in parameters.items()}
    for parameter in PARAMETERS:
        found[parameter.name] = float(next(groups[parameter.group]))
    return found


def _interval(axes: Any, name: str, estimate: Estimate, row: float, size: float = 5.5) -> None:
    """One estimate; a parameter on its bound has no interval of its own."""
    ends = [place(name, value) for value in (estimate.lower, estimate.upper)]
    if estimate.identifiability != "on its bound":
        axes.plot(ends, [row, row], color=ESTIMATE_COLOUR, lw=0.4 * size, solid_capstyle="butt", zorder=2)
    axes.plot(place(name, estimate.value), row, color=ESTIMATE_COLOUR, ms=size, ls="none", zorder=3,
              markeredgewidth=0.9, **MARKERS[estimate.identifiability])  # fmt: skip


def _label(estimate: Estimate, unit: str) -> str:
    if estimate.identifiability == "on its bound":
        return f"{number(estimate.value)}{unit}, on its bound"
    value, lower, upper = with_interval(estimate.value, estimate.lower, estimate.upper)
    return f"{value} ({lower} to {upper}){unit}, {estimate.identifiability}"


def _profile(axes: Any, profile: Document) -> None:
    """Rises in multiples of the 95 % limit, and the interval where they are below it."""
    values, rise = np.array(profile["values"]), np.array(profile["rise"]) / profile["threshold"]
    axes.plot(values, np.minimum(rise, 4.0), color=ESTIMATE_COLOUR, lw=1.3, marker="o", ms=3.0)
    axes.axhline(1.0, color=SOFT_COLOUR, lw=0.9, ls=(0, (3, 2)))
    for end, left in ((profile["lower"], True), (profile["upper"], False)):
        if end is None:
            axes.text(0.02 if left else 0.98, 0.94, "open", transform=axes.transAxes, fontsize=7.5, va="top",
                      ha="left" if left else "right", color=PREDICTED_COLOUR)  # fmt: skip
        else:
            axes.axvline(end, color=PREDICTED_COLOUR, lw=0.9, ls=(0, (1.0, 1.4)))
    axes.set_ylim(-0.1, 1.08 * max(1.2, min(4.0, float(rise.max()))))
    axes.tick_params(length=2.5, width=0.6)
