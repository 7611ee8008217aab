"""Frequency response: outputs per input by Welch's method, with coherence, of records and of streams.

H1 estimates, S_yx / S_xx: noise of the output averages out, noise of the input makes them too small. A segment with a
masked sample is left out, of the input's spectrum too. `Chain` has the linear model's response.
Zaman et al., 4.1; Welch 1967; Bendat and Piersol, Random Data, 4th ed., 9.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from biodyn_core.base.arrays import Complexes, Flags, Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.signals.spectrum_settings import SpectrumSettings

Part = tuple[Floats, Floats]
"""One stretch of time: input (n,) and outputs (n, m), NaN where masked."""

CHANCE: Final = 0.05
"""Probability that unrelated signals exceed `CrossSpectra.chance_coherence`."""

APART: Final = 2
"""Lines so far apart are nearly independent with Hann's window."""

NEIGHBOURS: Final = (4.0 / 9.0, 1.0 / 36.0)
"""Squared correlation of lines one and two apart with Hann's window."""

SAME_RATE: Final = 1e-3
"""Largest relative difference of rates for pooled records: 0.05 Hz at 50 Hz."""


@dataclass(frozen=True, eq=False)
class CrossSpectra:
    """Averaged spectra of one input and m outputs over frequency_hz (f,); NaN for an output without any segment.

    input_psd, output_psd (f, m), one-sided, unit squared per Hz; cross (f, m) is S_yx, conj(X) Y; segments (m,):
    number averaged; averages (m,): equivalent number of independent ones, which is one for a single shock in a record
    of any length; bandwidth_hz: noise bandwidth of a line.
    """

    frequency_hz: Floats
    input_psd: Floats
    output_psd: Floats
    cross: Complexes
    segments: Integers
    averages: Floats
    bandwidth_hz: float

    @property
    def h1(self) -> Complexes:
        """Output per input, (f, m)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.cross / self.input_psd

    @property
    def phase_deg(self) -> Floats:
        """Phase of output against input, (f, m) degrees: degrees(arg S_yx); the paper's 4.1 has the unit inside arg."""
        return np.degrees(np.angle(self.cross))

    @property
    def coherence(self) -> Floats:
        """Share of the output's power that is linear in the input, (f, m); 1 for a single segment."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.minimum(np.abs(self.cross) ** 2 / (self.input_psd * self.output_psd), 1.0)

    @property
    def chance_coherence(self) -> Floats:
        """Coherence (m,) that unrelated signals exceed with probability CHANCE; 1 for a single segment.

        1 - CHANCE^(1 / (averages - 1)), after Goodman 1957.
        """
        freedom = np.maximum(self.averages - 1.0, 1e-9)
        return 1.0 - CHANCE ** (1.0 / freedom)

    def is_coherent(self, least_coherence: float) -> Flags:
        """Flags (f, m) of a coherence above the required least and above chance."""
        return np.nan_to_num(self.coherence) > np.maximum(self.chance_coherence, least_coherence)

    def is_linear(self, least_coherence: float) -> Flags:
        """Flags (f, m) of a simulated response, which has no noise: only what is nonlinear lowers its coherence."""
        return (np.nan_to_num(self.coherence) > least_coherence) & (self.segments > 1)

    def chance_of_mean(self, weights: Floats) -> Floats:
        """The same as chance_coherence of the mean over the lines by weights (f, m), whose sum is one.

        By a gamma distribution; coherences of unrelated signals have beta distributions, and neighbouring lines are
        related by the window (`NEIGHBOURS`).
        """
        n = np.maximum(self.averages, 1.0)
        mean, variance = 1.0 / n, (n - 1.0) / (n**2 * (n + 1.0))
        related = (weights**2).sum(axis=0)
        for apart, shared in enumerate(NEIGHBOURS, start=1):
            related = related + 2.0 * shared * (weights[apart:] * weights[:-apart]).sum(axis=0)
        spread = np.maximum(variance * related, 1e-12)
        quantile = scipy.special.gammaincinv(mean**2 / spread, 1.0 - CHANCE) * spread / mean
        return np.asarray(np.minimum(quantile, 1.0))

    @property
    def relative_error(self) -> Floats:
        """Standard error of |H1| over |H1|, and of its phase in rad, (f, m) (Bendat and Piersol, Eq. 9.90)."""
        share = self.coherence
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(np.maximum(1.0 - share, 0.0) / (2.0 * self.averages * share))


def cross_spectra(parts: Sequence[Part], rate_hz: float, settings: SpectrumSettings | None = None) -> CrossSpectra:
    """Welch's averages over all parts, of one rate.

    Raises InputError where no output has a segment without NaN, or highest_hz lies above half the rate.
    """
    meter = SpectraMeter(rate_hz, parts[0][1].shape[1], settings)
    for given, answers in parts:
        meter.push(given, answers)
        meter.part()
    return meter.spectra()


class SpectraMeter:
    """The same of a stream, in constant memory: `push` samples, `part` at a break of time.

    Any cut into blocks gives the same averages. Raises InputError as `cross_spectra`, for missing segments at the end.
    """

    def __init__(self, rate_hz: float, outputs: int, settings: SpectrumSettings | None = None) -> None:
        s = settings or SpectrumSettings()
        self.settings, self.rate_hz = s, rate_hz
        self._window = scipy.signal.get_window(s.window, round(s.segment_s * rate_hz))
        size = self._window.size
        self._step = size - int(s.overlap * size)
        frequency = np.arange(size // 2 + 1) * rate_hz / size
        if s.highest_hz >= rate_hz / 2.0:
            raise InputError(f"highest_hz is {s.highest_hz:g}, half the sampling rate is {rate_hz / 2.0:g} Hz")
        self._at = np.flatnonzero(
            (frequency >= s.lowest_hz * (1.0 - 1e-3)) & (frequency <= s.highest_hz * (1.0 + 1e-3))
        )
        if self._at.size < 2:
            raise InputError(
                f"lowest_hz {s.lowest_hz:g} to highest_hz {s.highest_hz:g} holds less than two lines of"
                f" {rate_hz / size:.3g} Hz: widen it, or lengthen segment_s"
            )
        self._frequency_hz = frequency[self._at]
        self._sums = np.zeros((3, self._at.size, outputs), dtype=np.complex128)
        self._both = np.zeros((max(self._at.size - APART, 0), outputs))
        self._segments = np.zeros(outputs, dtype=np.int64)
        self.part()

    def part(self) -> None:
        """Begin another stretch of time, which shares no segment with the one before."""
        self._rows = np.empty((0, 1 + self._segments.size))
        self._next = [0] * self._segments.size

    def push(self, given: Floats, answers: Floats) -> None:
        """Add samples of the input (n,) and the outputs (n, m), NaN where masked."""
        rows = np.column_stack([given, answers])
        self._rows = np.concatenate([self._rows, rows]) if self._rows.size else rows
        usable = np.isfinite(self._rows)
        usable[:, 1:] &= usable[:, :1]
        inputs: dict[int, Complexes] = {}
        for m in range(self._segments.size):
            starts, self._next[m] = _starts(usable[:, m + 1], self._next[m], self._window.size, self._step)
            self._segments[m] += len(starts)
            for start in starts:
                if start not in inputs:
                    inputs[start] = self._lines(0, start)
                x, y = inputs[start], self._lines(m + 1, start)
                self._sums[:, :, m] += x.conj() * x, y.conj() * y, x.conj() * y
                self._both[:, m] += _crossed(np.abs(x) ** 2, np.abs(y) ** 2)
        done = min(*self._next, self._rows.shape[0]) if self._next else self._rows.shape[0]
        self._rows, self._next = self._rows[done:].copy(), [at - done for at in self._next]

    def _lines(self, column: int, start: int) -> Complexes:
        return _lines(self._rows[start : start + self._window.size, column], self._window, self._at)

    def spectra(self) -> CrossSpectra:
        """The averages so far."""
        s, window, segments = self.settings, self._window, self._segments.copy()
        if not segments.any():
            raise InputError(f"no {s.segment_s:g} s without a mask in the record: shorten segment_s, or record longer")
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = self._sums * 2.0 / (self.rate_hz * (window**2).sum()) / segments
        return CrossSpectra(
            frequency_hz=self._frequency_hz,
            input_psd=np.ascontiguousarray(mean[0].real),
            output_psd=np.ascontiguousarray(mean[1].real),
            cross=mean[2],
            segments=segments,
            averages=self._averages(),
            bandwidth_hz=float(self.rate_hz * (window**2).sum() / window.sum() ** 2),
        )

    def _averages(self) -> Floats:
        """The equivalent number of independent segments (m,), of a seat and outputs as uneven over time as these.

        A concentration c is n sum(e s) / (sum(e) sum(s)) of the powers e and s of input and output by segment: 1 if
        even, and n if one of n segments has all. Unrelated signals then have a mean coherence of c / n.
        """
        segments = self._segments.tolist()
        independent = np.array([_independent(n, self._window, self._step) for n in segments])
        with np.errstate(invalid="ignore", divide="ignore"):
            by_line = self._segments * self._both / _crossed(self._sums[0].real, self._sums[1].real)
        known = np.isfinite(by_line)
        concentration = np.where(known, by_line, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        uneven = np.maximum(concentration - 1.0, 0.0) * _of_one_instant(self._window, self._step)
        return np.maximum(independent / (1.0 + uneven), np.minimum(independent, 1.0))


def _crossed(e: Floats, s: Floats) -> Floats:
    """Products of powers (f, ...) at lines that are `APART`, because those of one line are related by its phase."""
    return 0.5 * (e[:-APART] * s[APART:] + e[APART:] * s[:-APART])


def _starts(usable: Flags, begin: int, size: int, step: int) -> tuple[list[int], int]:
    """Starts of segments from `begin` on, in every stretch without a mask from its first sample; and the next start."""
    starts, at = [], begin
    while at < usable.size:
        seen = usable[at : at + size]
        if not seen.all():
            masked = at + int(np.argmin(seen))
            rest = usable[masked:]
            at = masked + int(np.argmax(rest)) if rest.any() else usable.size
        elif seen.size == size:
            starts.append(at)
            at += step
        else:
            break
    return starts, at


def _lines(values: Floats, window: Floats, lines: NDArray[np.intp]) -> Complexes:
    return np.asarray(np.fft.rfft((values - values.mean()) * window)[lines], dtype=np.complex128)


def _independent(segments: int, window: Floats, step: int) -> float:
    """Equivalent number of independent segments of overlapping ones (Welch 1967, for a smooth spectrum)."""
    shared = 0.0
    for j in range(1, min(segments, math.ceil(window.size / step))):
        common = window[: window.size - j * step] @ window[j * step :] / (window @ window)
        shared += 2.0 * (1.0 - j / segments) * float(common) ** 2
    return segments / (1.0 + shared)


def _of_one_instant(window: Floats, step: int) -> float:
    """The most averages that one instant seems to give, because overlapping segments share it."""
    powers = [window[first::step] ** 2 for first in range(step)]
    most = max(float(w.sum() ** 2 / (w @ w)) for w in powers if w.any())
    shared = _independent(1000, window, step) / 1000.0
    return most * shared


class Peak(NamedTuple):
    """Frequency and value of a largest magnitude."""

    frequency_hz: float
    magnitude: float


def peak(frequency_hz: Floats, magnitude: Floats, among: Flags | None = None) -> Peak | None:
    """The largest magnitude (f,) over the frequencies flagged; None without any."""
    allowed = np.isfinite(magnitude) if among is None else among & np.isfinite(magnitude)
    if not allowed.any():
        return None
    at = int(np.argmax(np.where(allowed, magnitude, -np.inf)))
    return Peak(float(frequency_hz[at]), float(magnitude[at]))


def common_rate_hz(rates_hz: Sequence[float]) -> float:
    """The common rate of records to pool; InputError where rates differ."""
    if max(rates_hz) > min(rates_hz) * (1.0 + SAME_RATE):
        listed = ", ".join(f"{rate:g}" for rate in rates_hz)
        raise InputError(f"records of {listed} Hz cannot share spectra: give records of one rate")
    return rates_hz[0]
