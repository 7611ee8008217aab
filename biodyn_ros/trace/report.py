"""Report: a trace with the facts of its recordings, for its document, text and page."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.tracing.findings import Trace
from biodyn_ros.reading.events import Prepared
from biodyn_ros.trace.refit import Refit


@dataclass(frozen=True, eq=False)
class Report:
    """A trace and its events; refit is None if nothing was fitted, dealt (how bags were dealt) if they were by name."""

    trace: Trace
    events: tuple[Prepared, ...] = ()
    refit: Refit | None = None
    dealt: str | None = None
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
