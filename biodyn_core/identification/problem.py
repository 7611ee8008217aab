"""A recording prepared for a fit: spectra for phase 1, samples and masks for phase 2, and errors of a fit.

Zaman et al., 5.3 and 6.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.errors import InputError, UnusableRecording
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.model import WARM_UP_S
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.identification.settings import CaseSettings
from biodyn_core.recording.recording import Recording
from biodyn_core.signals.response import cross_spectra
from biodyn_core.signals.spectrum_settings import SpectrumSettings


@dataclass(frozen=True, eq=False)
class Case:
    """A prepared recording.

    seat_mps2 (n,), `sharpened`; measured_mps2 (n, 5), 0 where `compared` (n, 5) is not set, which excludes masks and
    the first 2 s; energy (5,) is the sum of squares of compared samples, 0 for an excluded segment. For phase 1, from
    the whole recording: frequency_hz (f,), transmissibility (f, 5), magnitude of the H1 estimate, and coherence (f, 5),
    both 0 for a segment without spectrum. channels (n,) by name, such as `seat.x` or `head.rate_y`, are inputs of
    effects, 0 where masked; mean_tilts are the recording's.
    """

    name: str
    case: str
    rate_hz: float
    seat_mps2: Floats
    measured_mps2: Floats
    compared: Flags
    energy: Floats
    frequency_hz: Floats
    transmissibility: Floats
    coherence: Floats
    warnings: tuple[str, ...]
    channels: Mapping[str, Floats] = field(default_factory=dict)
    mean_tilts: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    begins_ns: int = 0
    """Stamp of the first sample, for the order of events."""
    record: str = ""
    """The name of the whole record, of which gaps of the seat may leave several cases; empty: that of the case."""
    cutoff_hz: float = ConditioningSettings().cutoff_hz
    """Of the low-pass of the seat."""

    @classmethod
    def of(
        cls, recording: Recording, spectrum: SpectrumSettings | None = None, settings: CaseSettings | None = None
    ) -> Case:
        """Prepare a recording; raises UnusableRecording where there is nothing to fit to."""
        s, name = settings or CaseSettings(), recording.name
        seat = np.ascontiguousarray(recording.seat_mps2, dtype=np.float64)
        if not np.isfinite(seat).all():
            raise UnusableRecording(f"{name}: the seat has samples that are not finite; split the recording there")
        compared = np.isfinite(recording.measured_mps2)
        compared[: recording.begin] = False
        short = compared.sum(axis=0) < s.least_compared_s * recording.rate_hz
        if short.all():
            raise UnusableRecording(
                f"{name}: no segment has {s.least_compared_s:g} s to compare after the {WARM_UP_S:g} s of warm-up;"
                " record longer"
            )
        compared[:, short] = False
        measured = np.where(compared, recording.measured_mps2, 0.0)
        energy = (measured**2).sum(axis=0)
        still = ~short & (energy == 0.0)
        if still.any():
            raise UnusableRecording(f"{name}: {_named(still)[0]} does not move at all; leave its sensor out")
        grid, magnitude, coherence = _spectra(recording, ~short, spectrum)
        excluded = [
            f"{segment}: not fitted, less than {s.least_compared_s:g} s to compare" for segment in _named(short)
        ]
        return cls(
            name, recording.case, recording.rate_hz, sharpened(seat) if s.sharpen_seat else seat, measured, compared,
            energy, grid, magnitude, coherence, (*recording.warnings, *excluded), recording.named_channels(),
            recording.mean_tilts, int(recording.stamps_ns[0]), recording.record, recording.cutoff_hz,
        )  # fmt: skip

    @property
    def begin(self) -> int:
        """The first sample after the warm-up."""
        return round(WARM_UP_S * self.rate_hz)

    @property
    def seat_peak_mps2(self) -> float:
        """The largest acceleration of the seat in compared samples and the warm-up, without misread spikes."""
        used = self.compared.any(axis=1) | (np.arange(self.seat_mps2.size) < self.begin)
        return float(np.abs(self.seat_mps2[used]).max(initial=0.0))

    @property
    def fitted(self) -> tuple[str, ...]:
        """The segments that are fitted to."""
        return _named(self.energy > 0.0)

    @property
    def weight(self) -> Floats:
        """Weights (n, 5) of the squares of samples in Eq. 33: 1 / energy of the segment, or 0."""
        return np.where(self.compared, 1.0 / np.where(self.energy > 0.0, self.energy, 1.0), 0.0)


def sharpened(seat_mps2: Floats) -> Floats:
    """A seat motion (n,) whose linear interpolation has the spectrum of the true motion.

    Linear interpolation multiplies a spectrum by sinc^2: 0.6 % too small at 50 Hz and a rate of 1129 Hz, which would
    bias f_n1. One twelfth of the second difference corrects it, to 0.1 % at 100 Hz. Absolute accelerations are forces
    over masses and need no correction.
    """
    padded = np.pad(seat_mps2, 1, "edge")
    return np.asarray(seat_mps2 - np.diff(padded, 2) / 12.0)


def _named(segments: Flags) -> tuple[str, ...]:
    return tuple(name for name, flag in zip(MEASURED_SEGMENTS, segments, strict=True) if flag)


def _spectra(recording: Recording, wanted: Flags, settings: SpectrumSettings | None) -> tuple[Floats, Floats, Floats]:
    """Frequencies (f,), H1 magnitudes and coherences (f, 5), 0 where a segment has no spectrum."""
    try:
        spectra = cross_spectra([(recording.seat_mps2, recording.measured_mps2)], recording.rate_hz, settings)
    except InputError as error:
        raise UnusableRecording(f"{recording.name}: {error}") from error
    valid = wanted & (spectra.segments > 0)
    magnitude, coherence = np.abs(spectra.h1), spectra.coherence
    return spectra.frequency_hz, np.where(valid, magnitude, 0.0), np.where(valid, coherence, 0.0)


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of a prediction of one case, per measured segment (5,); NaN for an excluded segment.

    nrmse_rms_percent: rms of model - measured over measured rms; nrmse_range_percent: over the measured range.
    """

    name: str
    case: str
    nrmse_rms_percent: Floats
    nrmse_range_percent: Floats

    @property
    def mean_percent(self) -> float:
        """J of Eq. 35: the mean of nrmse_rms_percent over the measured segments; infinite for an unstable simulation.

        An unstable simulation has NaN in every segment. Infinity is larger than any error it is compared with.
        """
        known = self.nrmse_rms_percent[~np.isnan(self.nrmse_rms_percent)]
        return float(known.mean()) if known.size else math.inf

    @property
    def is_unstable(self) -> bool:
        """Whether the simulation was unstable, so that there is no error."""
        return math.isinf(self.mean_percent)


def errors(case: Case, accel_mps2: Floats) -> Errors:
    """Errors of absolute accelerations (n, 5) against a case, without warm-up and masks.

    A simulation that is unstable in the compared samples of one segment is unstable for all.
    """
    count = np.where(case.energy > 0.0, case.compared.sum(axis=0), np.nan)
    with np.errstate(over="ignore"):  # the square of an unstable simulation
        rms = np.sqrt((np.where(case.compared, accel_mps2 - case.measured_mps2, 0.0) ** 2).sum(axis=0) / count)
    if np.isnan(rms[case.energy > 0.0]).any():
        rms[:] = np.nan
    highest = np.where(case.compared, case.measured_mps2, -np.inf).max(axis=0)
    lowest = np.where(case.compared, case.measured_mps2, np.inf).min(axis=0)
    return Errors(case.name, case.case, 100.0 * rms / np.sqrt(case.energy / count), 100.0 * rms / (highest - lowest))
