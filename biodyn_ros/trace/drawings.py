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
from biodyn_ros.trace.wording import effect_name

AMBIGUOUS_COLOUR: Final = "#e8930c"
REST_COLOUR: Final = BAND_COLOUR
SHOWN: Final = 12
"""Number of candidates that are drawn."""
_LEVELS: Final = 12


def ranking(found: Round) -> Any:
    """The best candidates of a round as bars, and the gain to exceed as a line."""
    rows = found.ranking[:SHOWN]
    best, rivals = _keys([found.chosen] if found.chosen else []), _keys(found.ambiguous_with)
    gains = [row.gain for row in rows if math.isfinite(row.gain)]
    span = max([*gains, found.threshold if math.isfinite(found.threshold) else 0.0, 1e-6])

    def fill(figure: Any) -> None:
        axes = figure.add_subplot()
        for place, row in enumerate(rows):
            chosen, rival = (row.key in keys for keys in (best, rivals))
            colour = AFTER_COLOUR if chosen else AMBIGUOUS_COLOUR if rival else REST_COLOUR
            gain = row.gain if math.isfinite(row.gain) else 0.0
            axes.barh(place, gain, color=colour, height=0.62, hatch="//" if rival and not chosen else None,
                      edgecolor="white", lw=0.0)  # fmt: skip
            note = ["chosen"] if chosen else ["about as good"] if rival else []
            note += ["screened only"] if not row.refitted else []
            note += ["objections below"] if row.objections else []
            axes.text(max(gain, 0.0) + 0.01 * span, place, ", ".join([number(row.gain), *note]), va="center",
                      fontsize=7.5, bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8})  # fmt: skip
        if math.isfinite(found.threshold):
            axes.axvline(found.threshold, color=MEASURED_COLOUR, lw=1.2, ls=(0, (4, 2)))
        names = [effect_name(*row.key) for row in rows]
        axes.set_yticks(range(len(rows)), names)
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_xlim(min([0.0, *gains]), 1.5 * span)
        axes.set_xlabel("gain: mean log ratio of squared error without over with, in events for choosing (no unit)",
                        color=SOFT_COLOUR)  # fmt: skip
        axes.grid(visible=False, axis="y")

    return drawn(10.4, 1.0 + 0.27 * len(rows), fill)


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
