"""Run status: the state of a pipeline's model and outputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple


class Latency(NamedTuple):
    """Delay of an output beyond transport, seconds: by the filter (corrected in stamps), interpolation and waiting."""

    filter_s: float
    look_ahead_s: float
    wait_s: float


NO_LATENCY = Latency(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RunStatus:
    """State of a pipeline.

    seconds: length of the record by accepted samples. substeps: integration steps per seat sample, None until the
    seat's rate is known. divergences: samples at which the model left its range and restarted from rest.
    unpredicted_s: seconds since reset without a counted prediction. is_extrapolating: since reset the seat moved harder
    than in the recordings that the subject was fitted to, where its file states them. latency: by output; predictions
    need the seat alone, comparisons the slowest sensor, exposure nothing; empty until the seat's rate is known.
    """

    seconds: float
    cutoff_hz: float
    substeps: int | None
    divergences: int
    unpredicted_s: float
    is_extrapolating: bool
    latency: Mapping[str, Latency]
