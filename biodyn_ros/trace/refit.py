"""Refit: the change of theta from the given subject, and the recordings of both fits."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from biodyn_core.body.parameters import PARAMETERS, is_fitted
from biodyn_core.body.subject import EDITED, Subject
from biodyn_core.identification.problem import Errors
from biodyn_core.tracing.findings import Trace
from biodyn_ros.base.wording import counted, number, parameter_name, with_interval
from biodyn_ros.reading.provenance import Source, origins_of
from biodyn_ros.trace.errors import mean_errors


@dataclass(frozen=True)
class ParameterChange:
    """One parameter: given (None if unfitted) with its 95 % interval, refitted, and of the subject in the end."""

    name: str
    unit: str
    given: float | None
    interval: tuple[float, float] | None
    refitted: float
    after: float

    @property
    def refit_percent(self) -> float | None:
        """The change by the refit, percent; None from zero or without a given value."""
        return None if self.given is None else _percent(self.given, self.refitted)

    @property
    def percent(self) -> float | None:
        """The change by the added effect, percent; None from zero."""
        return _percent(self.refitted, self.after)

    @property
    def is_outside(self) -> bool:
        """Whether the refitted value is outside the given interval; False without one."""
        return self.interval is not None and not self.interval[0] <= self.refitted <= self.interval[1]

    @property
    def given_text(self) -> str:
        """The given value as text, with its interval if there is one."""
        if self.given is None or self.interval is None:
            return number(self.given)
        value, lower, upper = with_interval(self.given, *self.interval)
        return f"{value} ({lower} to {upper})"

    @property
    def refitted_text(self) -> str:
        """The refitted value as text, with enough digits to differ from the nearest end of the given interval."""
        if self.interval is None:
            return number(self.refitted)
        near = min(self.interval, key=lambda end: abs(self.refitted - end))
        ends = sorted((self.refitted, near)) if self.is_outside else self.interval
        return with_interval(self.refitted, *ends)[0]


@dataclass(frozen=True)
class Refit:
    """The refit of theta: its parameters, the recordings of both fits, and the errors in the events for fitting.

    shared_recordings: how many of the given ones have time in common with one used here.
    unstable: the number of the events for fitting in which the given subject diverges, so that it has no mean error.
    """

    changes: tuple[ParameterChange, ...]
    is_given_fitted: bool
    recordings: int
    given_recordings: int | None
    shared_recordings: int
    events: int
    unstable: int
    given_percent: float | None
    refitted_percent: float | None

    @property
    def outside(self) -> list[ParameterChange]:
        """The parameters outside their given intervals."""
        return [change for change in self.changes if change.is_outside]

    @property
    def has_intervals(self) -> bool:
        """Whether the given subject has intervals."""
        return any(change.interval for change in self.changes)

    @property
    def text(self) -> str:
        """The refit in one sentence, without a full stop."""
        here = counted(self.recordings, "recording")
        if not self.is_given_fitted:
            return f"the given subject was not fitted: its parameters come from the {here} given here"
        error = self._errors
        if not self.has_intervals:
            return (
                f"refitted to the {here} given here; {error}; the given subject's file has no intervals to compare with"
            )
        if not self.outside:
            return f"refitted to the {here} given here, every parameter stays in the given subject's interval; {error}"
        far = max(self.outside, key=lambda change: abs(change.refit_percent or 0.0))
        others = len(self.outside) - 1
        more = f", and {others} more {'leaves its own' if others == 1 else 'leave theirs'}" if others else ""
        return (
            f"refitted to the {here} given here, {parameter_name(far.name)} goes from {far.given_text} to"
            f" {far.refitted_text}, outside its 95 % interval{more}: {self._validity}; {error}"
        )

    @property
    def _errors(self) -> str:
        """The errors with the given and with the refitted parameters."""
        refitted = number(self.refitted_percent)
        if self.unstable:
            return (
                f"there the model diverges in {self.unstable} of {counted(self.events, 'event')} with the given"
                f" parameters, and the error is {refitted} % of the measured rms with the refitted ones"
            )
        return (
            f"there the error is {number(self.given_percent)} % of the measured rms with the given parameters,"
            f" {refitted} % with the refitted ones"
        )

    @property
    def _validity(self) -> str:
        """The recordings that the given intervals are valid for."""
        given, shared = self.given_recordings, self.shared_recordings
        if given is None:
            return "these intervals hold only for the recordings of that fit, which its file does not name"
        if given == 1:
            used = "which is" if shared else "which is not"
        else:
            some = f"{shared} {'is' if shared == 1 else 'are'}"
            used = f"of which {'none is' if shared == 0 else 'all are' if shared == given else some}"
        return f"these intervals hold only for the {counted(given, 'recording')} of that fit, {used} used here"


def parameter_changes(trace: Trace) -> tuple[ParameterChange, ...]:
    """Every parameter as given, refitted, and of the subject in the end, also of the effects of the given subject."""
    subjects = (trace.given, trace.before, trace.after)
    known, intervals = is_fitted(trace.given.parameters), given_intervals(trace.given)
    columns = zip(PARAMETERS, *(subject.parameters.vector().tolist() for subject in subjects), strict=True)
    return tuple(
        ParameterChange(of.name, of.unit, given if known else None, intervals.get(of.name), refitted, after)
        for of, given, refitted, after in columns
    ) + tuple(_effect_changes(trace))


def _effect_changes(trace: Trace) -> Iterator[ParameterChange]:
    """The parameters of the effects that the given subject has; added effects come after them."""
    count = len(trace.given.effects)
    subjects = (trace.given.effects, trace.before.effects[:count], trace.after.effects[:count])
    for given, refitted, after in zip(*subjects, strict=True):
        for of in given.effect.parameters:
            name = f"{given.effect.name} {of.name}[{given.site}]"
            old, new, last = (one.values[of.name] for one in (given, refitted, after))
            yield ParameterChange(name, of.unit, old, None, new, last)


def refit_of(trace: Trace, sources: Collection[Source]) -> Refit | None:
    """The refit of a trace; None if nothing was fitted. sources: the recordings for fitting."""
    if not trace.refitted:
        return None
    recordings, given = set(sources), {source for _, source in origins_of(trace.given, "fitted")}
    events = [event for event in trace.events if event.use == "train"]
    by_given = [event.given for event in events if event.given is not None]
    return Refit(
        changes=parameter_changes(trace),
        is_given_fitted=is_fitted(trace.given.parameters),
        recordings=len(recordings),
        given_recordings=len(given) or None,
        shared_recordings=sum(any(known.overlaps(one) for one in recordings) for known in given),
        events=len(events),
        unstable=sum(error.is_unstable for error in by_given),
        given_percent=_mean(by_given),
        refitted_percent=_mean([event.before for event in events]),
    )


def given_intervals(subject: Subject) -> dict[str, tuple[float, float]]:
    """The 95 % intervals in a subject's file, by parameter; none of a model that was changed by hand."""
    found = None if subject.provenance.get(EDITED) else subject.provenance.get("intervals")
    known = found if isinstance(found, Mapping) else {}
    return {name: (float(ends[0]), float(ends[1])) for name, ends in known.items() if _is_interval(ends)}


def _is_interval(ends: object) -> bool:
    return isinstance(ends, list) and len(ends) == 2 and all(isinstance(end, int | float) for end in ends)


def _percent(before: float, after: float) -> float | None:
    return 100.0 * (after - before) / before if before else None


def _mean(errors: Sequence[Errors]) -> float | None:
    """The mean error over events, percent; None without an event, or if the model diverges in one."""
    return None if any(error.is_unstable for error in errors) else mean_errors(errors)["all"]
