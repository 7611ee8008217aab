"""Refit: how far theta moves from the subject that was given, and on which recordings each of both rests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from biodyn_core.body.parameters import PARAMETERS, is_fitted
from biodyn_core.body.subject import Subject
from biodyn_core.tracing.findings import Trace
from biodyn_ros.base.json_files import finite
from biodyn_ros.base.wording import number, parameter_name, with_interval

Document = dict[str, Any]


def parameters_moved(trace: Trace) -> Document:
    """Every parameter as given, refitted, and with the effect, and both changes in percent, None from zero.

    given is None for a subject that was never fitted, with_effect where nothing was added.
    """
    subjects = (trace.given, trace.before, trace.after)
    known, intervals = is_fitted(trace.given.parameters), given_intervals(trace.given)
    columns = zip(PARAMETERS, *(subject.parameters.vector().tolist() for subject in subjects), strict=True)
    return {
        parameter.name: {
            "given": given if known else None,
            "given_interval": intervals.get(parameter.name),
            "refitted": refitted,
            "with_effect": after if trace.adds else None,
            "before": refitted,
            "after": after,
            "percent": _percent(refitted, after),
            "refit_percent": _percent(given, refitted) if known else None,
            "unit": parameter.unit,
        }
        for parameter, given, refitted, after in columns
    }


def refit_document(trace: Trace, moved: Document, hashes: Sequence[str]) -> Document | None:
    """Why the refit is where it is; None where nothing was refitted.

    hashes: of the recordings that theta was fitted to here.
    """
    if not trace.refitted:
        return None
    recordings, given = set(hashes), _given_recordings(trace.given)
    document: Document = {
        "outside_intervals": [name for name, of in moved.items() if outside(of)],
        "intervals_known": any(of["given_interval"] for of in moved.values()),
        "given_fitted": is_fitted(trace.given.parameters),
        "recordings": len(recordings),
        "given_recordings": len(given) or None,
        "shared_recordings": len(recordings & given),
        "error_percent": {"given": _mean(trace, "given"), "refitted": _mean(trace, "before")},
    }
    return document | {"text": _text(document, moved)}


def given_intervals(subject: Subject) -> dict[str, list[float]]:
    """The 95 % intervals that a subject's file has of its fit, by parameter."""
    found = subject.provenance.get("intervals")
    known = found if isinstance(found, Mapping) else {}
    return {name: [float(end) for end in ends] for name, ends in known.items() if _is_interval(ends)}


def _is_interval(ends: object) -> bool:
    return isinstance(ends, list) and len(ends) == 2 and all(isinstance(end, int | float) for end in ends)


def _given_recordings(subject: Subject) -> set[str]:
    """The hashes of the recordings that a subject's file says it was fitted to."""
    found = subject.provenance.get("fitted")
    known = found if isinstance(found, list) else []
    return {str(each["sha256"]) for each in known if isinstance(each, Mapping) and "sha256" in each}


def outside(of: Document) -> bool:
    """Whether a refitted parameter is outside the given interval; never where there is none."""
    ends = of["given_interval"]
    return ends is not None and not ends[0] <= of["refitted"] <= ends[1]


def refitted_beside(of: Document) -> str:
    """The refitted value as text, with as many digits as tell it from the nearest end of the given interval."""
    ends, value = of["given_interval"], of["refitted"]
    if ends is None:
        return number(value)
    near = min(ends, key=lambda end: abs(value - end))
    return with_interval(value, *(sorted((value, near)) if outside(of) else ends))[0]


def _percent(before: float, after: float) -> float | None:
    return 100.0 * (after - before) / before if before else None


def _mean(trace: Trace, when: str) -> float | None:
    """The mean error of a subject over the events that theta was fitted to."""
    found = [getattr(event, when) for event in trace.events if event.use == "train"]
    percents = [error.mean_percent for error in found if error is not None]
    return finite(float(np.mean(percents))) if percents else None


def _text(document: Document, moved: Document) -> str:
    here = _recordings(document["recordings"])
    if not document["given_fitted"]:
        return f"the given subject was not fitted: its parameters come from the {here} given here"
    error = document["error_percent"]
    given, refitted = (number(error[key]) for key in ("given", "refitted"))
    left = f"there the given parameters miss {given} % of the measured rms, the refitted ones {refitted} %"
    if not document["intervals_known"]:
        return f"refitted to the {here} given here; {left}; the given subject's file has no intervals to compare with"
    left_theirs = document["outside_intervals"]
    if not left_theirs:
        return f"refitted to the {here} given here, every parameter stays in the given subject's interval; {left}"
    far = max(left_theirs, key=lambda name: abs(moved[name]["refit_percent"] or 0.0))
    more = {1: "", 2: ", and 1 more leaves its own"}.get(
        len(left_theirs), f", and {len(left_theirs) - 1} more leave theirs"
    )
    value, lower, upper = with_interval(moved[far]["given"], *moved[far]["given_interval"])
    return (
        f"refitted to the {here} given here, {parameter_name(far)} goes from {value} ({lower} to {upper}) to"
        f" {refitted_beside(moved[far])}, outside its 95 % interval{more}: {_holds(document)}; {left}"
    )


def _holds(document: Document) -> str:
    """What the given intervals hold for."""
    given, shared = document["given_recordings"], document["shared_recordings"]
    if given is None:
        return "these intervals hold only for the recordings of that fit, which its file does not name"
    used = "none is" if shared == 0 else "all are" if shared == given else f"{shared} {'is' if shared == 1 else 'are'}"
    return f"these intervals hold only for the {_recordings(given)} of that fit, of which {used} used here"


def _recordings(count: int) -> str:
    return f"{count} recording{'' if count == 1 else 's'}"
