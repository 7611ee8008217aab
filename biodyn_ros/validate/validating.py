"""Validate: compare a bag with the model's forward prediction, as validate.json and a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from biodyn_core.body.model import SeatForce
from biodyn_core.body.subject import Subject
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.effects import needs_channels
from biodyn_core.recording.recording import Recording
from biodyn_core.signals.spectrum_settings import SpectrumSettings
from biodyn_core.validation import validation
from biodyn_ros.base.files import make_directory, remove
from biodyn_ros.base.json_files import write_json
from biodyn_ros.base.progress import OnProgress, ignore_progress
from biodyn_ros.reading.parts import Bag
from biodyn_ros.reading.provenance import Role, role_of, source_of
from biodyn_ros.reading.recordings import RecordingOptions, read_recordings
from biodyn_ros.validate.document import validation_document
from biodyn_ros.validate.report import Report
from biodyn_ros.validate.settings import ValidationSettings

PAGE: Final = "validate.html"


@dataclass(frozen=True)
class ValidateOptions:
    """Options for reading an event, its case, and settings of spectra, limits and force."""

    case: str | None = None
    reading: RecordingOptions = field(default_factory=RecordingOptions)
    spectra: SpectrumSettings = field(default_factory=SpectrumSettings)
    limits: ValidationSettings = field(default_factory=ValidationSettings)
    seat_force: SeatForce = "inertia"
    as_printed: bool = False


def validate(
    bag: Bag,
    subject: Subject,
    options: ValidateOptions | None = None,
    progress: OnProgress = ignore_progress,
) -> Report:
    """Predict a bag's event from its seat alone and compare; raises InputError as `read_recordings`."""
    options = options or ValidateOptions()
    reading = replace(options.reading, channels=needs_channels(subject.effects))
    recordings = read_recordings(bag, options.case, reading, progress)
    return validate_recordings(recordings, subject, options, str(bag), role_of(subject, source_of(bag)))


def write_validated(validated: Report, directory: Path, report: bool = True) -> None:
    """Write validate.json and validate.html; without a report, the page of an earlier run is removed."""
    make_directory(directory)
    write_json(directory / "validate.json", validation_document(validated))
    if report:
        from biodyn_ros.reports.pages import write_drawn  # an extra of its own
        from biodyn_ros.validate.page import validation_page

        write_drawn(directory / PAGE, lambda: validation_page(validated))
    else:
        remove(directory / PAGE)


def validate_recordings(
    recordings: Sequence[Recording],
    subject: Subject,
    options: ValidateOptions | None = None,
    bag: str = "",
    role: Role | None = None,
) -> Report:
    """Validate on recordings, the runs of one event; role is of the bag in the subject's fit."""
    o = options or ValidateOptions()
    found = validation.validate(recordings, subject, o.limits.least_coherence, o.spectra, o.seat_force, o.as_printed)
    cutoff_hz = (o.reading.conditioning or ConditioningSettings()).cutoff_hz
    return Report(found, bag or recordings[0].name, role, o.spectra, o.limits, cutoff_hz)
