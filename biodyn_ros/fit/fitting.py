"""Fit a subject to bags: read the events, identify, and determine uncertainty and prediction errors.

Of several recordings of one case the representative one is used for the fit (Zaman et al., 5.3); the finished fits
predict the others and the bags that are held out.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import HEAD
from biodyn_core.base.suggestions import did_you_mean
from biodyn_core.body.subject import Subject
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.effects import needs_channels
from biodyn_core.identification.fit import prediction_errors
from biodyn_core.identification.held_out import usual_residual
from biodyn_core.identification.identify import Identification, fingerprint, identify
from biodyn_core.identification.posterior import prior_of
from biodyn_core.identification.problem import Errors
from biodyn_core.identification.profiles import profile
from biodyn_core.identification.residuals import residual_checks
from biodyn_core.identification.settings import CaseSettings, FitSettings, UncertaintySettings
from biodyn_core.identification.uncertainty import uncertainty
from biodyn_core.recording.recording import representative
from biodyn_core.signals.spectrum_settings import SpectrumSettings
from biodyn_ros.base.files import check_directory, make_directory, write_text
from biodyn_ros.base.json_files import write_json
from biodyn_ros.fit.document import fit_document, fitted_subject
from biodyn_ros.fit.report import FitEvent, FitName, Report, Use, clock_warnings, reuse_warnings, warnings_of
from biodyn_ros.reading.dealing import TO_FIT, dealt, dealt_line
from biodyn_ros.reading.events import EventOptions, Prepared, check_bags, read_events
from biodyn_ros.reading.parts import Bag
from biodyn_ros.reading.recordings import RecordingOptions
from biodyn_ros.work.tasks import Work


@dataclass(frozen=True)
class FitOptions:
    """Options of reading, preparation and fitting.

    held_out: bags that are only predicted; auto_held_out: they are drawn; cases: loading conditions of bags, in place
    of those from their names; profiles: parameters with a profile likelihood, or `all`.
    """

    seed: int = 0
    held_out: tuple[Bag, ...] = ()
    auto_held_out: bool = False
    cases: Mapping[str, str] = field(default_factory=dict)
    profiles: tuple[str, ...] = ()
    reading: RecordingOptions = field(default_factory=RecordingOptions)
    spectra: SpectrumSettings = field(default_factory=SpectrumSettings)
    preparing: CaseSettings = field(default_factory=CaseSettings)
    settings: FitSettings = field(default_factory=FitSettings)
    uncertainty: UncertaintySettings = field(default_factory=UncertaintySettings)


def fit_bags(
    bags: Sequence[Bag],
    subject: Subject,
    options: FitOptions | None = None,
    work: Work | None = None,
) -> Report:
    """Fit a subject to bags; raises InputError for bags without an event to fit to."""
    o, work, begin = options or FitOptions(), work or Work(), time.monotonic()
    check_bags(bags, o.held_out, o.cases)
    check_profiles(o)
    prior_of(subject, o.settings)  # a prior that the subject cannot have must fail before the work
    reading = dataclasses.replace(o.reading, channels=needs_channels(subject.effects))
    with work.monitor("reading") as progress:
        # A bag without comparable samples must fail before the work.
        events = read_events(bags, o.held_out, EventOptions(o.cases, reading, o.spectra, o.preparing), progress)
    prepared = dealt(events.prepared, TO_FIT, o.seed) if o.auto_held_out else list(events.prepared)
    fitted, spare = choose(prepared)
    cases, held_out = [case for _, case in fitted], [case for _, case in spare]
    problem = fingerprint(cases, subject, o.seed, o.settings)
    found = identify(cases, subject, o.seed, o.settings, work.run(problem))
    cutoff_hz = (o.reading.conditioning or ConditioningSettings()).cutoff_hz
    sure = uncertainty(found.joint, cases, o.uncertainty)
    requested = [estimate for estimate in sure.estimates if {estimate.name, "all"} & set(o.profiles)]
    better, mass_matrix_percent = found.better_mass_matrix(held_out)
    return Report(
        given=subject,
        identification=found,
        events=tuple(_predicted(found, fitted, spare)),
        uncertainty=sure,
        profiles=tuple(profile(found.joint, cases, of.name, o.uncertainty) for of in requested if not of.at_bound),
        not_profiled=tuple(of.name for of in requested if of.at_bound),
        residual_checks=tuple(residual_checks(found.joint, cases, o.spectra, cutoff_hz)),
        better_mass_matrix=better,
        mass_matrix_percent=mass_matrix_percent,
        seed=o.seed,
        dealt=_dealt_line(prepared, len(fitted), o.seed) if o.auto_held_out else None,
        warnings=(
            *events.left_out,
            *warnings_of([*fitted, *spare]),
            *reuse_warnings(subject, spare),
            *clock_warnings(found),
        ),
        seconds=time.monotonic() - begin,
        usual_residual=usual_residual(found.subject, held_out),
    )


def _dealt_line(prepared: Sequence[Prepared], fitted: int, seed: int) -> str:
    line = dealt_line(prepared, seed)
    to_fit = sum(not event.held_out for event, _ in prepared)
    return line if to_fit == fitted else f"{line}; of those to fit, the representative one of each condition is fitted"


def _predicted(found: Identification, fitted: Sequence[Prepared], spare: Sequence[Prepared]) -> Iterator[FitEvent]:
    """The events with the errors of all resulting subjects, and of the fits to a case alone."""
    prepared = [*fitted, *spare]
    subjects: dict[FitName, Subject] = {"joint": found.joint.subject, "idealized": found.idealized.subject}
    if found.joint.prior:
        subjects["without_prior"] = found.without_prior.subject
    errors = [prediction_errors(subject, [case for _, case in prepared]) for subject in subjects.values()]
    for number, ((event, case), *of_event) in enumerate(zip(prepared, *errors, strict=True)):
        by_fit: dict[FitName, Errors] = dict(zip(subjects, of_event, strict=True))
        use: Use = "held out" if event.held_out else "another repetition"
        if number < len(fitted):
            use, by_fit = "fitted", {"alone": found.fits[number].errors[0], **by_fit}
        yield FitEvent(event, case, use, by_fit)


def write_fitted(report: Report, output: Path) -> None:
    """Write the subject file and its fit.json."""
    make_directory(output.parent)
    subject = fitted_subject(report).to_yaml()
    write_json(json_beside(output), fit_document(report))
    write_text(output, subject)


def parse_cases(pairs: Iterable[str]) -> dict[str, str]:
    """Read `bag=case` pairs; raises InputError naming the pair."""
    cases: dict[str, str] = {}
    for pair in pairs:
        bag, _, case = pair.rpartition("=")
        if not bag or not case:
            raise InputError(f"--case {pair}: expected BAG=CASE, such as drive_3.mcap=pothole")
        if bag in cases:
            raise InputError(f"--case {pair}: the bag is given twice")
        cases[bag] = case
    return cases


def check_output(output: Path) -> None:
    """Raise InputError, before the work, if the results cannot be written."""
    if output.suffix not in (".yaml", ".yml"):
        raise InputError(f"{output}: a subject file ends in .yaml")
    if output.is_dir():
        raise InputError(f"{output}: is a directory, give a file")
    check_directory(output.parent)


def json_beside(output: Path) -> Path:
    """The path of a subject file's fit.json: `anna.yaml` has `anna.fit.json`."""
    return output.with_name(f"{output.stem}.fit.json")


def page_beside(output: Path) -> Path:
    """The path of a subject file's page: `anna.yaml` has `anna.fit.html`."""
    return output.with_name(f"{output.stem}.fit.html")


def choose(events: Sequence[Prepared]) -> tuple[list[Prepared], list[Prepared]]:
    """The events to fit to, the representative one of each case, and those only to predict."""
    by_case: dict[str, list[Prepared]] = {}
    for each in events:
        event, _ = each
        if not event.held_out:
            by_case.setdefault(event.recording.case, []).append(each)
    fitted = [_representative(case, repetitions) for case, repetitions in by_case.items()]
    return fitted, [each for each in events if each not in fitted]


def _representative(case: str, repetitions: Sequence[Prepared]) -> Prepared:
    if len(repetitions) == 1:
        return repetitions[0]
    # A head that was measured for too short a time to be fitted must not decide, however strong that moment was.
    with_head = [each for each in repetitions if HEAD in each[1].fitted] or repetitions
    try:
        chosen = representative([event.recording for event, _ in with_head])
    except InputError as error:
        raise InputError(f"{case}: {error}; give one bag of this case, the others with --hold-out") from error
    return next(each for each in repetitions if each[0].recording is chosen)


def check_profiles(options: FitOptions) -> None:
    """Raise InputError for a profile of a parameter that is not fitted."""
    known = options.settings.fitted
    for name in options.profiles:
        if name != "all" and name not in known:
            near = did_you_mean(name, ["all", *known])
            raise InputError(f"profile: {name!r} is not a fitted parameter, known are all, {', '.join(known)}{near}")
