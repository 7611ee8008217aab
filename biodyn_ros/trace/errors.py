"""Mean errors of a trace by the use of its events, percent."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.identification.problem import Errors
from biodyn_core.tracing.findings import Trace
from biodyn_ros.base.json_files import finite
from biodyn_ros.fit.document import by_segment

MeanErrors = Mapping[str, float | None]
"""The error of each measured segment and of `all`, None where unknown."""

When = Literal["before", "after"]
WHEN: Final[tuple[When, ...]] = ("before", "after")

USES: Final = {"train": "train", "choose": "choose", "held_out": "held out"}
"""The uses of events with their titles."""


def errors_by_use(trace: Trace, when: When) -> dict[str, MeanErrors]:
    """Mean errors over the events of each use; `train` and `held_out` are present even without an event."""
    found = {use: [getattr(event, when) for event in trace.events if event.use == use] for use in USES}
    return {use: mean_errors(errors) for use, errors in found.items() if errors or use != "choose"}


def is_known(trace: Trace, use: str) -> bool:
    """Whether there is an error of this use."""
    return any(value is not None for when in WHEN for value in errors_by_use(trace, when).get(use, {}).values())


def mean_errors(errors: Sequence[Errors]) -> MeanErrors:
    """The mean of each segment over the events that have it, and the mean of the events' own means.

    Nothing is known if the simulation of an event was unstable: a mean of the others would look better than it is.
    """
    by_event = np.array([error.nrmse_rms_percent for error in errors]).reshape(-1, len(MEASURED_SEGMENTS))
    if any(error.is_unstable for error in errors):
        by_event = np.full_like(by_event, np.nan)
    return by_segment(np.array([_mean(column) for column in by_event.T])) | {
        "all": finite(_mean(np.array([_mean(row) for row in by_event])))
    }


def known(value: float | None) -> float | None:
    """The value, or None if it is not finite."""
    return None if value is None else finite(value)


def _mean(values: Floats) -> float:
    """The mean of the finite values, NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan
