"""Report: a validation with its bag, its settings and its findings, for document, text and page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from biodyn_core.base.segments import SEAT
from biodyn_core.body.origin import origin_of
from biodyn_core.signals.response import Peak, peak
from biodyn_core.signals.spectrum_settings import SpectrumSettings
from biodyn_core.validation.driving_point import DrivingPoint
from biodyn_core.validation.exposures import Exposures
from biodyn_core.validation.validation import Validation
from biodyn_ros.base.wording import words
from biodyn_ros.reading.provenance import Role, without_note
from biodyn_ros.reports.intervals import DoseIntervals, dose_intervals, interval_notes
from biodyn_ros.validate.findings import Finding, findings, verdict
from biodyn_ros.validate.settings import ValidationSettings


@dataclass(frozen=True, eq=False)
class Report:
    """A validation and its settings; role is of the bag in the subject's fit, cutoff_hz of the low-pass."""

    validation: Validation
    bag: str
    role: Role | None
    spectra: SpectrumSettings
    limits: ValidationSettings
    cutoff_hz: float

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """All disagreements and undecided criteria."""
        return tuple(findings(self.validation, self.role, self.limits))

    @property
    def verdict(self) -> str:
        """The verdict of all findings."""
        return verdict(self.findings)

    @property
    def is_made_by_model(self) -> bool:
        """Whether the model made a recording."""
        return bool(self._notes_and_warnings[0])

    @property
    def warnings(self) -> list[str]:
        """Other warnings of the recordings, each once, and the suspect samples."""
        return [*self._notes_and_warnings[1], *_suspect_warning(self.validation.exposures)]

    @property
    def _notes_and_warnings(self) -> tuple[list[str], list[str]]:
        return without_note(dict.fromkeys(line for run in self.validation.runs for line in run.recording.warnings))

    def dose_intervals(self, segment: str) -> DoseIntervals:
        """The 95 % intervals of a segment's predicted weighted acceleration."""
        found = self.validation.exposures
        return dose_intervals(found.predicted[segment], found.spreads.get(segment))

    @property
    def interval_notes(self) -> list[str]:
        """What the intervals of the predictions are, or why there are none: sentences."""
        found, subject = self.validation.exposures, self.validation.subject
        return interval_notes(subject.name, origin_of(subject), found.no_interval, bool(found.masked))

    def hic_bandwidth_hz(self, name: str) -> float:
        """Bandwidth of the channel behind a HIC, by the name of its window."""
        return min(self.validation.exposures.measured_hic[name].bandwidth_hz, self.cutoff_hz)


class DrivingPeaks(NamedTuple):
    """Peaks of a driving point at frequencies of sufficient coherence: kg, no unit, no unit, N s/m."""

    apparent_mass: Peak | None
    by_body_mass: Peak | None
    by_upper_body_mass: Peak | None
    impedance: Peak | None


def driving_peaks(point: DrivingPoint, least_coherence: float) -> DrivingPeaks:
    """The peaks of a driving point."""
    coherent = point.is_coherent(least_coherence)
    curves = (
        np.abs(point.apparent_mass_kg), point.by_body_mass, point.by_upper_body_mass, np.abs(point.impedance_n_s_per_m)
    )  # fmt: skip
    return DrivingPeaks(*(peak(point.frequency_hz, values, coherent) for values in curves))


def _suspect_warning(exposures: Exposures) -> Iterator[str]:
    """The motion that no dose contains, in one line, if there is any."""
    parts = [f"{words(name)} {seconds:.3f} s" for name, seconds in exposures.suspect_s.items() if seconds > 0.0]
    if parts:
        yield f"doses and DRI leave out, after losses within strong motion, {', '.join(parts)}: they are lower bounds"


def is_lower_bound(exposures: Exposures, name: str) -> bool:
    """Whether samples of a segment, or of the seat that drives it, are missing or suspect."""
    return SEAT in exposures.masked or name in exposures.masked
