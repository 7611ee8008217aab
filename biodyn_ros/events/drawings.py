"""Drawings of a session: its seat over time with rests, events by loading condition, and faults."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.sessions.findings import Findings
from biodyn_ros.base.wording import words
from biodyn_ros.reports.drawing import BAND_COLOUR, MEASURED_COLOUR, OTHER_COLOUR, PREDICTED_COLOUR, SOFT_COLOUR, drawn

COLUMNS: Final = 1200
"""Points of a curve: more than the pixels of a page are not visible."""

WIDTH_IN: Final = 10.0
CASE_COLOURS: Final = (OTHER_COLOUR, PREDICTED_COLOUR, "#2f9e44", "#9c36b5", "#e8a200")
REST_COLOUR: Final = "#868e96"
FAULT_COLOUR: Final = "#c92a2a"

Bar = tuple[float, float]
"""Begin and length, s."""


def timeline(found: Findings) -> Any:
    """Peak and rms of the seat over time, and below it one row for rests, each condition and each faulty sensor."""
    rows = timeline_rows(found)
    lines = found.timeline
    time_s, peak = decimated(lines.peak_mps2 / STANDARD_GRAVITY_MPS2, lines.width_s, np.nanmax)
    _, square = decimated((lines.rms_mps2 / STANDARD_GRAVITY_MPS2) ** 2, lines.width_s, np.nanmean)

    def fill(figure: Any) -> None:
        above, below = figure.subplots(
            2, 1, sharex=True, gridspec_kw={"height_ratios": [2.0, 0.25 + 0.22 * len(rows)], "hspace": 0.02}
        )
        above.fill_between(time_s, peak, color=BAND_COLOUR, linewidth=0.0, label="peak")
        above.plot(time_s, np.sqrt(square), color=MEASURED_COLOUR, linewidth=0.8, label="rms")
        above.set_ylabel("seat, vertical, g", color=SOFT_COLOUR)
        above.set_ylim(bottom=0.0)
        above.legend(loc="upper right", frameon=False, ncols=2)
        for number, (_, bars, colour) in enumerate(rows):
            below.broken_barh(bars, (len(rows) - 1 - number + 0.15, 0.7), facecolors=colour, linewidth=0.0)
        below.set_yticks([len(rows) - 0.5 - number for number in range(len(rows))], [name for name, _, _ in rows])
        below.set_ylim(0.0, len(rows))
        below.set_xlim(0.0, found.seconds)
        below.grid(visible=False, axis="y")
        below.set_xlabel("seconds since the first sample of the seat", color=SOFT_COLOUR)

    return drawn(WIDTH_IN, 2.6 + 0.22 * len(rows), fill)


def timeline_rows(found: Findings) -> list[tuple[str, list[Bar], str]]:
    """The rows below the curve: name, bars and colour."""
    rows = [("rest", [(rest.begin_s, rest.end_s - rest.begin_s) for rest in found.rests], REST_COLOUR)]
    for number, case in enumerate(dict.fromkeys(event.case for event in found.events)):
        bars = [(event.begin_s, event.end_s - event.begin_s) for event in found.events if event.case == case]
        rows.append((case, bars, CASE_COLOURS[number % len(CASE_COLOURS)]))
    for name in dict.fromkeys(fault.sensor for fault in found.faults):
        bars = [(fault.begin_s, fault.end_s - fault.begin_s) for fault in found.faults if fault.sensor == name]
        rows.append((f"fault: {words(name)}", bars, FAULT_COLOUR))
    return rows


def decimated(values: Floats, width_s: float, of: Any) -> tuple[Floats, Floats]:
    """At most `COLUMNS` values, each `of` its known neighbours, NaN without any, and their times."""
    size = max(1, -(-values.size // COLUMNS))
    padded = np.append(values, np.full(-values.size % size, np.nan)).reshape(-1, size)
    is_known = ~np.isnan(padded).all(axis=1)
    found = np.full(len(padded), np.nan)
    found[is_known] = of(padded[is_known], axis=1)
    return (np.arange(found.size) + 0.5) * size * width_s, np.asarray(found)


def colours_of(found: Findings) -> dict[str, str]:
    """The colour of each loading condition."""
    cases: Sequence[str] = list(dict.fromkeys(event.case for event in found.events))
    return {case: CASE_COLOURS[number % len(CASE_COLOURS)] for number, case in enumerate(cases)}
