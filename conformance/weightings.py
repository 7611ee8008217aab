"""Frequency weightings: tone bursts at every third-octave band, compared with the analog curve and the printed table.

A burst is not exactly a single frequency: its result is divided by that of the same burst weighted by the analog curve,
and multiplied by the gain of the curve at the band.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.segments import SEAT, SENSORS
from conformance import record, twins
from conformance.recordings import data
from conformance.table import FAIL, PASS, Row, cells, number, signed

Floats = NDArray[np.float64]

RATES_HZ: Final = (250.0, 500.0, 1000.0, 1129.3, 2000.0)
TOLERANCES: Final = {250.0: 0.01, 500.0: 0.005, 1000.0: 0.001, 1129.3: 0.001, 2000.0: 0.001}
MSDV_TOLERANCE: Final = 0.005
TABLE_DB: Final = 0.25
"""The printed factors are rounded, and some deviate from the curve by 0.2 dB."""

GROUPS: Final = ((25.0, range(-3, 3)), (10.0, range(3, 9)), (4.0, range(9, 15)), (2.0, range(15, 20)))
"""Length of the bursts in seconds, and numbers of the bands: 0.5 to 1.6, 2 to 6.3, 8 to 25 and 31.5 to 80 Hz."""

SICKNESS_BANDS: Final = range(-11, -1)
SICKNESS_BURST_S: Final = 110.0
TAIL_S: Final = 3.0
AMPLITUDE_MPS2: Final = 5.0

_TABLES: Final = {
    "Wk": ("01", "vertical_acceleration_z"),
    "Wd": ("01", "translational_acceleration_xy"),
    "Wf": ("01", "motion_sickness_z"),
    "Wc": ("02", "wc"),
    "We": ("02", "rotation_acceleration_xyz"),
    "Wj": ("02", "wj"),
}
"""File and column of a weighting in the transcription of ISO 2631-1:1997, Tables 3 and 4, beside the recordings."""

_CORRECTED: Final = {("Wd", 2.0): 890.0, ("Wd", 10.0): 202.0}
"""2 Hz is a transcription error; 10 Hz (212) is a misprint of the standard, whose decibels give 202."""


def frequency(band: int) -> float:
    """The exact centre of a third-octave band, Hz."""
    return 10.0 ** (band / 10.0)


@cache
def printed(name: str) -> dict[int, float]:
    """The standard's factors of a weighting by band."""
    if name not in _TABLES:
        return {}
    number, column = _TABLES[name]
    lines = (data() / f"iso2631_tables/iso-2631-filter-{number}.csv").read_text(encoding="utf-8").splitlines()
    found = {}
    for row in csv.DictReader(lines):
        hz = float(row["frequency_hz"])
        found[round(10.0 * math.log10(hz))] = _CORRECTED.get((name, hz), float(row[column])) / 1000.0
    return found


@dataclass(frozen=True)
class Gain:
    """Measured gain of one weighting at a band and a sampling rate."""

    band: int
    rate_hz: float
    gain: float


@dataclass(frozen=True)
class GainTable:
    """A section with a line per band and a column per rate, with one or two comparisons in each cell."""

    title: str
    words: str
    name: str
    gains: tuple[Gain, ...]
    tolerances: dict[float, float]

    def _against_curve(self, gain: Gain) -> Row:
        what = f"{self.title}, {frequency(gain.band):.4g} Hz at {gain.rate_hz:g} Hz, curve"
        return Row(what, gain.gain, float(twins.curve(self.name, frequency(gain.band))), self.tolerances[gain.rate_hz])

    def _against_print(self, gain: Gain) -> Row | None:
        if gain.band not in printed(self.name):
            return None
        what = f"{self.title}, {frequency(gain.band):.4g} Hz at {gain.rate_hz:g} Hz, printed"
        value, reference = _decibels(gain.gain), _decibels(printed(self.name)[gain.band])
        return Row(what, value, reference, TABLE_DB, "dB", absolute=True)

    def rows(self) -> Sequence[Row]:
        """All comparisons of the section."""
        both = [row for gain in self.gains for row in (self._against_curve(gain), self._against_print(gain))]
        return [row for row in both if row is not None]

    def lines(self) -> list[str]:
        """The section as Markdown."""
        rates = list(self.tolerances)
        head = ["Hz", "curve", "printed", *(f"{rate:g} Hz" for rate in rates)]
        lines = [f"### {self.title}", "", self.words, "", cells(*head), cells(*["---:"] * len(head))]
        for band in sorted({gain.band for gain in self.gains}):
            there = printed(self.name).get(band)
            known = [f"{frequency(band):.4g}", number(1000.0 * float(twins.curve(self.name, frequency(band))))]
            found = {gain.rate_hz: gain for gain in self.gains if gain.band == band}
            known.append("-" if there is None else f"{1000.0 * there:g}")
            lines.append(cells(*known, *(self._cell(found[rate]) for rate in rates)))
        return [*lines, *self._feet(rates), ""]

    def _cell(self, gain: Gain) -> str:
        rows = [self._against_curve(gain), self._against_print(gain)]
        return number(1000.0 * gain.gain) + ("" if all(row is None or row.passes for row in rows) else f" {FAIL}")

    def _feet(self, rates: list[float]) -> Iterator[str]:
        """The largest deviations of every rate, with their tolerances."""
        curve = {rate: [self._against_curve(gain) for gain in self.gains if gain.rate_hz == rate] for rate in rates}
        yield cells("deviation from the curve", "", "", *(_worst(rows) for rows in curve.values()))
        yield cells("tolerance", "", "", *(f"{100.0 * tolerance:g} %" for tolerance in self.tolerances.values()))
        table = {rate: [self._against_print(gain) for gain in self.gains if gain.rate_hz == rate] for rate in rates}
        known = {rate: [row for row in rows if row is not None] for rate, rows in table.items()}
        if any(known.values()):
            yield cells("deviation from the print", "", "", *(_worst(rows) for rows in known.values()))
            yield cells("tolerance", "", "", *[f"{TABLE_DB:g} dB"] * len(rates))
        passes = [all(row.passes for row in [*curve[rate], *known[rate]]) for rate in rates]
        yield cells("", "", "", *(PASS if ok else FAIL for ok in passes))


def _worst(rows: list[Row]) -> str:
    row = max(rows, key=lambda r: abs(r.off))
    if row.absolute:
        return f"{signed(row.off, row.tolerance)} dB"
    return f"{signed(100.0 * row.off, 100.0 * row.tolerance)} %"


def _decibels(gain: float) -> float:
    return 20.0 * math.log10(gain)


# --- records ---------------------------------------------------------------------------------------------------------


def burst(band: int, time_s: Floats, length_s: float) -> Floats:
    """A sine with an envelope of sin^2 over the length."""
    since = np.clip(time_s - record.BEGIN_S, 0.0, length_s)
    return AMPLITUDE_MPS2 * np.sin(np.pi * since / length_s) ** 2 * np.sin(2.0 * np.pi * frequency(band) * since)


def vertical_gains(rate_hz: float, length_s: float, bands: range) -> dict[str, list[Gain]]:
    """Gains of every weighting except Wf: one band per sensor, its vertical with all weightings."""
    time = record.instants(rate_hz, record.BEGIN_S + length_s + TAIL_S)
    up = {sensor: burst(band, time, length_s) for sensor, band in zip(SENSORS, bands, strict=False)}
    streams = {sensor: record.stream(sensor, time, motion) for sensor, motion in up.items()}
    found = record.replayed(streams, also_weighted="Wd Wc We Wj Wb").document
    by_name = {"Wk": found["sensors"], **found["also_weighted"]}
    return {
        name: [
            _gain(name, band, time, rate_hz, up[sensor], doses[sensor]["aw_mps2"])
            for sensor, band in zip(SENSORS, bands, strict=False)
        ]
        for name, doses in by_name.items()
    }


def horizontal_gains(rate_hz: float, length_s: float, bands: range) -> list[Gain]:
    """Gains of Wd by the seat's two horizontal axes, a band on each."""
    time = record.instants(rate_hz, record.BEGIN_S + length_s + TAIL_S)
    gains = []
    for first in bands[::2]:
        motion = {axis: burst(band, time, length_s) for axis, band in zip("xy", (first, first + 1), strict=True)}
        rest = np.zeros(time.size)
        found = record.replayed({SEAT: record.stream(SEAT, time, rest, motion["x"], motion["y"])}).document
        for axis, band in zip("xy", (first, first + 1), strict=True):
            if band in bands:
                aw = found["seat"]["aw_weighted_mps2"][axis]
                gains.append(_gain("Wd", band, time, rate_hz, motion[axis], aw))
    return gains


def sickness_gain(rate_hz: float, band: int) -> Gain:
    """Gain of Wf by the seat's motion sickness dose."""
    time = record.instants(rate_hz, record.BEGIN_S + SICKNESS_BURST_S + TAIL_S)
    up = burst(band, time, SICKNESS_BURST_S)
    found = record.replayed({SEAT: record.stream(SEAT, time, up)}).document
    counted_s = (time.size - record.first_counted(time)) / rate_hz
    return _gain("Wf", band, time, rate_hz, up, found["seat"]["msdv_mps15"] / math.sqrt(counted_s))


def _gain(name: str, band: int, time_s: Floats, rate_hz: float, motion: Floats, aw_mps2: float) -> Gain:
    analog = twins.weighted(name, motion, rate_hz)[record.first_counted(time_s) :]
    wanted = math.sqrt(float((analog**2).mean()))
    return Gain(band, rate_hz, aw_mps2 / wanted * float(twins.curve(name, frequency(band))))


# --- sections --------------------------------------------------------------------------------------------------------

INTRO: Final = f"""\
Tone bursts from rest at every third-octave band, one sensor for each band, whole record. The gain (times 1000) is that
of the curve at the exact centre 10^(n/10) of the band, times the ratio of the measured figure to that of the same burst
after the analog curve. Tolerances of the curve: 0.1 % at 1129.3 Hz and 0.5 % at 500 Hz are the requirements, and the
0.1 % applies to the rates around it; {100.0 * TOLERANCES[250.0]:g} % at 250 Hz, the lowest accepted rate, where 80 Hz
is two thirds of the Nyquist frequency; {100.0 * MSDV_TOLERANCE:g} % for the motion sickness dose. Tolerance of the
printed factors of ISO 2631-1, Tables 3 and 4: {TABLE_DB:g} dB, because they are rounded and lie up to 0.2 dB off the
formula; Wb is in neither table."""


def sections() -> list[GainTable]:
    """All sections; about half a minute."""
    found: dict[str, list[Gain]] = {}
    horizontal: list[Gain] = []
    for rate_hz in RATES_HZ:
        for length_s, bands in GROUPS:
            for name, gains in vertical_gains(rate_hz, length_s, bands).items():
                found.setdefault(name, []).extend(gains)
            horizontal += horizontal_gains(rate_hz, length_s, bands)
    sickness = tuple(sickness_gain(rate_hz, band) for rate_hz in RATES_HZ for band in SICKNESS_BANDS)
    vertical = [
        GainTable(f"{name}, vertical", _words(name), name, tuple(gains), TOLERANCES) for name, gains in found.items()
    ]
    plane = "From `seat.aw_weighted_mps2` x and y."
    dose = f"From `seat.msdv_mps15`, bursts of {SICKNESS_BURST_S:g} s."
    return [
        *vertical,
        GainTable("Wd, horizontal", plane, "Wd", tuple(horizontal), TOLERANCES),
        GainTable("Wf, motion sickness", dose, "Wf", sickness, dict.fromkeys(RATES_HZ, MSDV_TOLERANCE)),
    ]


def _words(name: str) -> str:
    return "From `sensors.*.aw_mps2`." if name == "Wk" else f"From `also_weighted.{name}.*.aw_mps2`."
