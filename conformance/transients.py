"""Transients: steps, shocks, tone bursts and decays from rest, compared with analog responses in closed form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from biodyn_core.base.segments import SEAT, SENSORS
from conformance import record, twins
from conformance.table import Row, RowTable
from conformance.twins import Mode

TOLERANCES: Final = {500.0: 0.005, 1129.3: 0.001}
"""Tolerance of all results by sampling rate, as for the weightings."""

SECONDS: Final = 8.0

MOTIONS: Final[dict[str, Callable[[float], list[Mode]]]] = {
    "step of 2 m/s²": lambda begin_s: twins.step(2.0, begin_s),
    "half-sine shock, 30 m/s², 20 ms": lambda begin_s: twins.tone(30.0, 25.0, 0.5, begin_s),
    "half-sine shock, 30 m/s², 100 ms": lambda begin_s: twins.tone(30.0, 5.0, 0.5, begin_s),
    "one cycle of 12 Hz, 10 m/s²": lambda begin_s: twins.tone(10.0, 12.0, 1.0, begin_s),
    "eight cycles of 4 Hz, 10 m/s²": lambda begin_s: twins.tone(10.0, 4.0, 8.0, begin_s),
    "12 Hz from 20 m/s², decaying with 90 ms": lambda begin_s: twins.decay(20.0, 12.0, 0.09, begin_s),
}
"""One for the vertical of each sensor."""

HORIZONTAL: Final = {"x": "step of 2 m/s²", "y": "half-sine shock, 30 m/s², 100 ms"}

NAMES: Final = {
    "aw_mps2": "aw", "vdv_mps175": "VDV", "mtvv_mps2": "MTVV", "mtvv_linear_mps2": "MTVV, linear",
    "mtvv_exponential_mps2": "MTVV, exponential", "peak_mps2": "peak",
}  # fmt: skip
UNITS: Final = {name: "m/s¹·⁷⁵" if name == "vdv_mps175" else "m/s²" for name in NAMES}


class _Span:
    """The sample times of a record, the start of its motions, and the start and end of counting."""

    def __init__(self, rate_hz: float) -> None:
        self.time_s = record.instants(rate_hz, SECONDS)
        # A jump is midway between two samples, because samples do not determine it better.
        self.motion_s = (np.ceil(1.2 * rate_hz) + 0.5) / rate_hz
        # A sample represents half a period on either side of it.
        self.begin_s = float(self.time_s[record.first_counted(self.time_s)]) - 0.5 / rate_hz
        self.end_s = float(self.time_s[-1]) + 0.5 / rate_hz

    def rows(self, name: str, what: str, doses: dict[str, float], names: Sequence[str], tolerance: float) -> list[Row]:
        """A motion's results with a weighting, and the analog ones."""
        analog = twins.figures(name, MOTIONS[what](self.motion_s), self.begin_s, self.end_s)
        return [Row(f"{name} {NAMES[f]}, {what}", doses[f], getattr(analog, f), tolerance, UNITS[f]) for f in names]


def vertical(rate_hz: float, also: Sequence[str]) -> dict[str, list[Row]]:
    """All results with Wk, and VDV with further weightings."""
    span = _Span(rate_hz)
    streams = {
        sensor: record.stream(sensor, span.time_s, twins.motion(modes(span.motion_s), span.time_s))
        for sensor, modes in zip(SENSORS, MOTIONS.values(), strict=True)
    }
    found = record.replayed(streams, also_weighted=" ".join(also)).document
    rows: dict[str, list[Row]] = {"Wk": []}
    for sensor, what in zip(SENSORS, MOTIONS, strict=True):
        rows["Wk"] += span.rows("Wk", what, found["sensors"][sensor], list(UNITS), TOLERANCES[rate_hz])
    for name in also:
        rows[name] = []
        for sensor, what in zip(SENSORS, MOTIONS, strict=True):
            doses = found["also_weighted"][name][sensor]
            rows[name] += span.rows(name, what, doses, ["vdv_mps175"], TOLERANCES[rate_hz])
    return rows


def horizontal(rate_hz: float) -> list[Row]:
    """The seat's horizontal axes with Wd."""
    span = _Span(rate_hz)
    x, y = (twins.motion(MOTIONS[what](span.motion_s), span.time_s) for what in HORIZONTAL.values())
    found = record.replayed({SEAT: record.stream(SEAT, span.time_s, np.zeros_like(x), x, y)}).document["seat"]
    rows = []
    for axis, what in HORIZONTAL.items():
        doses = {"aw_mps2": found["aw_weighted_mps2"][axis], "vdv_mps175": found["vdv_weighted_mps175"][axis]}
        rows += span.rows("Wd", what, doses, list(doses), TOLERANCES[rate_hz])
    return rows


ALSO: Final = ("Wc", "We", "Wj", "Wb")


def sections() -> list[RowTable]:
    """All sections; about ten seconds."""
    tables = []
    for rate_hz, tolerance in TOLERANCES.items():
        found = vertical(rate_hz, ALSO)
        words = f"""\
Motions from rest, sampled at {rate_hz:g} Hz; jumps lie midway between two samples. Reference: the response of the
analog curve in closed form, by partial fractions. Tolerance: the {100.0 * tolerance:g} % of the weighting at this
rate."""
        rows = [*found["Wk"], *horizontal(rate_hz), *(row for name in ALSO for row in found[name])]
        tables.append(RowTable(f"Transients at {rate_hz:g} Hz", words, tuple(rows)))
    return tables
