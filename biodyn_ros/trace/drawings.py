"""Drawings of a trace: the ranking of candidates, and the surface of a joint."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from biodyn_core.tracing.findings import RankedCandidate, Round, Surface
from biodyn_ros.base.wording import number
from biodyn_ros.reports.drawing import (
    BAND_COLOUR,
    MEASURED_COLOUR,
    SOFT_COLOUR,
    drawn,
)
from biodyn_ros.reports.residuals import AFTER_COLOUR
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


def _keys(candidates: Sequence[RankedCandidate]) -> set[tuple[str, str]]:
    return {one.key for one in candidates}
