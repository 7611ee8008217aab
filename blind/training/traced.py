"""The evidence of a simulated body: its first round of a trace, and the ratio of its hidden effects."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from world.effects.sitting import Sitting

from biodyn_core.base.errors import InputError
from biodyn_core.base.parallel import serial_map
from biodyn_core.body.parameters import Parameters
from biodyn_core.tracing import data_checks
from biodyn_core.tracing.evidence import Evidence
from biodyn_core.tracing.joint_refit import jointly_refitted
from biodyn_core.tracing.rounds import Search, search
from biodyn_core.tracing.settings import TraceSettings
from biodyn_core.tracing.trace import refitted
from blind.tracing.outcome import Cause
from blind.tracing.records import Record, record
from blind.tracing.score import ratio
from blind.tracing.true_law import with_true_law

SEED = 0
"""Of a trace."""


@dataclass(frozen=True)
class TracedBody:
    """The ratio of the hidden effects, None without; the evidence, and that with the true law in the catalogue."""

    ratio: float | None
    evidence: Evidence | None
    with_true_law: Evidence | None = None


def traced(one: Sitting, cause: Cause | None) -> TracedBody | None:
    """The evidence of a sitting; cause: the hidden effect if it is one of the catalogue; None if nothing can be fitted.

    The refit without the effects, for the ratio as in the blind study, starts from the true theta.
    """
    s, hidden = TraceSettings(), record(one)
    try:
        found = searched(hidden, s)
        if found is None:
            return None
        diagnostics = found.diagnostics(s)
        if not one.effects:
            return TracedBody(None, found.evidence(s, diagnostics))
        without = record(one, with_effects=False)
        true = dataclasses.replace(hidden.subject, parameters=Parameters.from_vector(one.theta))
        plain = jointly_refitted(true, without.train)
    except InputError:
        return None
    bent = None if cause is None else with_true_law(found, cause, plain, without.cases)
    # Both have the same residual, so the same diagnostics.
    return TracedBody(
        ratio(found.nuisance.subject, hidden.cases, plain, without.cases),
        found.evidence(s, diagnostics),
        None if bent is None else bent.evidence(s, diagnostics),
    )


def searched(one: Record, settings: TraceSettings) -> Search | None:
    """The first round of a trace; None without events for it; raises InputError if the record cannot be fitted."""
    train, choose, _ = data_checks.usable(one.train, one.held_out, settings.floor)
    if not train or not choose:
        return None
    before = refitted(train, one.subject, settings, SEED, {}, serial_map)
    return search(before, train, choose, settings, SEED, lambda stage, share: None)
