"""Drawings of traces: the ladder of candidates, and the surface of a joint."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from biodyn_core.tracing.findings import Candidate, Round, Surface
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
RUNGS: Final = 12
_LEVELS: Final = 12


def ladder(found: Round) -> Any:
    """The best candidates of a round as bars, and the line that a gain had to exceed."""
    rungs = found.ladder[:RUNGS]
    took, rivals = _keys([found.taken] if found.taken else []), _keys(found.ambiguous_with)
    gains = [rung.gain for rung in rungs if math.isfinite(rung.gain)]
    span = max([*gains, found.threshold if math.isfinite(found.threshold) else 0.0, 1e-6])

    def fill(figure: Any) -> None:
        axes = figure.add_subplot()
        for place, rung in enumerate(rungs):
            taken, rival = (_keys([rung]) <= keys for keys in (took, rivals))
            colour = AFTER_COLOUR if taken else AMBIGUOUS_COLOUR if rival else REST_COLOUR
            gain = rung.gain if math.isfinite(rung.gain) else 0.0
            axes.barh(place, gain, color=colour, height=0.62, hatch="//" if rival and not taken else None,
                      edgecolor="white", lw=0.0)  # fmt: skip
            note = ["taken"] if taken else ["could be as well"] if rival else []
            note += ["screened only"] if not rung.refitted else []
            note += ["objections below"] if rung.against else []
            axes.text(max(gain, 0.0) + 0.01 * span, place, ", ".join([number(rung.gain), *note]), va="center",
                      fontsize=7.5, bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8})  # fmt: skip
        if math.isfinite(found.threshold):
            axes.axvline(found.threshold, color=MEASURED_COLOUR, lw=1.2, ls=(0, (4, 2)))
        names = [effect_name(rung.applied.effect.name, rung.applied.site) for rung in rungs]
        axes.set_yticks(range(len(rungs)), names)
        axes.set_ylim(len(rungs) - 0.4, -0.6)
        axes.set_xlim(min([0.0, *gains]), 1.5 * span)
        axes.set_xlabel("gain: mean log ratio of squared error without over with, in events that choose (no unit)",
                        color=SOFT_COLOUR)  # fmt: skip
        axes.grid(visible=False, axis="y")

    return drawn(10.4, 1.0 + 0.27 * len(rungs), fill)


def surface_map(surface: Surface) -> Any:
    """What force a joint lacks over stretch and its rate, empty where the data never were."""
    known = surface.force_n[np.isfinite(surface.force_n)]
    most = float(np.abs(known).max()) if known.size and np.abs(known).max() > 0.0 else 1.0

    def fill(figure: Any) -> None:
        from matplotlib.colors import BoundaryNorm

        axes = figure.add_subplot()
        # Few levels keep the colour bar a drawing; the norm is even about nothing.
        levels = BoundaryNorm(np.linspace(-most, most, _LEVELS + 1), 256)
        drawing = axes.pcolormesh(
            1e3 * surface.stretch_m, surface.rate_mps, np.ma.masked_invalid(surface.force_n), cmap="PuOr", norm=levels,
            shading="nearest",
        )  # fmt: skip
        axes.set_xlabel("stretch, mm (negative is compression)", color=SOFT_COLOUR)
        axes.set_ylabel("rate of stretch, m/s", color=SOFT_COLOUR)
        axes.patch.set(hatch="////", edgecolor=REST_COLOUR)  # shows where nothing is drawn over it
        axes.grid(visible=False)
        figure.colorbar(drawing, ax=axes, label="missing force, N", format="%.3g")

    return drawn(6.4, 3.4, fill)


def _keys(candidates: Sequence[Candidate]) -> set[tuple[str, str]]:
    return {(candidate.applied.effect.name, candidate.applied.site) for candidate in candidates}
