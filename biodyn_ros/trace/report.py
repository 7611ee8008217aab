"""Report: a trace with the facts of its recordings, for its document, text and page."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.tracing.findings import Trace
from biodyn_ros.trace.refit import Refit


@dataclass(frozen=True, eq=False)
class Report:
    """A trace, its refit (None if nothing was fitted), how bags were dealt (None if by name), and warnings."""

    trace: Trace
    refit: Refit | None = None
    dealt: str | None = None
    warnings: tuple[str, ...] = ()
