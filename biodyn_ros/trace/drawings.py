"""Drawings of a trace: the ranking of candidates, the surface of a joint, and missing forces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from biodyn_core.tracing.findings import RankedCandidate, RestoringForce, Round, Surface
from biodyn_ros.base.wording import number
from biodyn_ros.reports.drawing import (
    BAND_COLOUR,
    MEASURED_COLOUR,
    SOFT_COLOUR,
    drawn,
)
from biodyn_ros.reports.residuals import AFTER_COLOUR, BEFORE_COLOUR, BEFORE_DASHES
from biodyn_ros.trace.wording import effect_name, probability

AMBIGUOUS_COLOUR: Final = "#e8930c"
REST_COLOUR: Final = BAND_COLOUR
SHOWN: Final = 12
"""Number of candidates that are drawn."""
_LEVELS: Final = 12


def ranking(found: Round) -> Any:
    """The most probable candidates of a round: their probabilities as bars, and beside them their gains."""
    rows = found.ranking[:SHOWN]
    chosen, rivals = _keys([found.chosen] if found.chosen else []), _keys(found.rivals)
    notes = ["chosen" if row.key in chosen else "also possible" if row.key in rivals else "" for row in rows]
    probabilities, gains = (
        [value if math.isfinite(value) else 0.0 for value in values]
        for values in ([row.probability for row in rows], [row.gain for row in rows])
    )
    of_gains = [", ".join([number(row.gain), *([] if row.refitted else ["screened only"])]) for row in rows]

    def fill(figure: Any) -> None:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.0, 0.8))
        of_probabilities = [
            ", ".join([probability(row.probability), *([note] if note else [])])
            for row, note in zip(rows, notes, strict=True)
        ]
        _bars(left, probabilities, of_probabilities, notes, 1.0)
        _bars(right, gains, of_gains, notes, max([*gains, 1e-6]))
        left.set_yticks(range(len(rows)), [effect_name(*row.key) for row in rows])
        left.set_ylim(len(rows) - 0.4, -0.6)
        left.set_xticks(np.linspace(0.0, 1.0, 6))
        left.set_xlabel("probability", color=SOFT_COLOUR)
        right.tick_params(axis="y", length=0)
        right.set_xlabel("gain: mean log ratio of squared error without\nover with, in events for choosing (no unit)",
                         color=SOFT_COLOUR)  # fmt: skip

    return drawn(10.4, 1.2 + 0.27 * len(rows), fill)


def _bars(axes: Any, values: Sequence[float], texts: Sequence[str], notes: Sequence[str], most: float) -> None:
    """Horizontal bars from the top, each with its text; the colour follows the note, and rivals are hatched."""
    colours = {"chosen": AFTER_COLOUR, "also possible": AMBIGUOUS_COLOUR}
    for place, (value, text, note) in enumerate(zip(values, texts, notes, strict=True)):
        axes.barh(place, value, color=colours.get(note, REST_COLOUR), height=0.62,
                  hatch="//" if note == "also possible" else None, edgecolor="white", lw=0.0)  # fmt: skip
        axes.text(max(value, 0.0) + 0.015 * most, place, text, va="center", fontsize=7.5,
                  bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8})  # fmt: skip
    axes.set_xlim(min([0.0, *values]), 1.4 * most)
    axes.grid(visible=False, axis="y")


def surface_map(surface: Surface) -> Any:
    """The missing force of a joint over stretch and rate, empty outside the data."""
    known = surface.force_n[np.isfinite(surface.force_n)]
    most = float(np.abs(known).max()) if known.size and np.abs(known).max() > 0.0 else 1.0

    def fill(figure: Any) -> None:
        from matplotlib.colors import BoundaryNorm

        axes = figure.add_subplot()
        # Few levels keep the colour bar small; the norm is symmetric about zero.
        levels = BoundaryNorm(np.linspace(-most, most, _LEVELS + 1), 256)
        drawing = axes.pcolormesh(
            1e3 * surface.stretch_m, surface.rate_mps, np.ma.masked_invalid(surface.force_n), cmap="PuOr", norm=levels,
            shading="nearest",
        )  # fmt: skip
        axes.set_xlabel("stretch, mm (negative is compression)", color=SOFT_COLOUR)
        axes.set_ylabel("rate of stretch, m/s", color=SOFT_COLOUR)
        axes.patch.set(hatch="////", edgecolor=REST_COLOUR)  # visible outside the data
        axes.grid(visible=False)
        figure.colorbar(drawing, ax=axes, label="missing force, N", format="%.3g")

    return drawn(6.4, 3.4, fill)


def force_panels(found: RestoringForce) -> Any:
    """The missing force before and after, and beside it the measured force with the law, over stretch or rate."""
    profile, by_rate = (found.over_rate, True) if found.over_rate_first else (found.over_stretch, False)
    x = profile.at if by_rate else 1e3 * profile.at
    label = _coordinate(found, by_rate)

    def fill(figure: Any) -> None:
        panels = figure.subplots(1, 2 if found.effects else 1, squeeze=False, sharey=True)[0]
        for axes in panels:
            axes.axhline(0.0, color=SOFT_COLOUR, lw=0.6)
            axes.set_xlabel(label, color=SOFT_COLOUR)
        panels[0].set_ylabel("force, N", color=SOFT_COLOUR)
        panels[0].set_title("missing force", loc="left", fontweight="bold")
        panels[0].plot(
            x, profile.before_n, color=BEFORE_COLOUR, lw=1.1, ls=BEFORE_DASHES, marker="o", ms=4.0, mfc="white"
        )
        if found.effects:
            panels[0].plot(x, profile.after_n, color=AFTER_COLOUR, lw=1.1, marker="s", ms=3.2)
            panels[1].fill_between(x, profile.lower_n, profile.upper_n, color=BAND_COLOUR, alpha=0.6, lw=0.0)
            panels[1].plot(x, profile.law_n, color=AFTER_COLOUR, lw=1.4)
            panels[1].plot(x, profile.measured_n, color=MEASURED_COLOUR, lw=0.0, marker="o", ms=4.0)
            panels[1].set_title("force of the effect", loc="left", fontweight="bold")

    return drawn(10.4 if found.effects else 6.4, 3.0, fill)


def _coordinate(found: RestoringForce, by_rate: bool) -> str:
    if found.joint:
        return "rate of stretch, m/s" if by_rate else "stretch, mm (negative is compression)"
    return "velocity relative to the seat, m/s" if by_rate else "displacement relative to the seat, mm"


def _keys(candidates: Sequence[RankedCandidate]) -> set[tuple[str, str]]:
    return {one.key for one in candidates}
