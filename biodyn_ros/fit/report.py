"""Report: a fit with its events, uncertainty and prediction errors, for document, text and page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.base.wording import counted
from biodyn_core.body.subject import MassMatrix, Subject
from biodyn_core.body.usual_residual import UsualResidual
from biodyn_core.identification.fit import Fit
from biodyn_core.identification.identify import Identification
from biodyn_core.identification.objectives import LARGEST_DELAY_S
from biodyn_core.identification.phase1 import Search
from biodyn_core.identification.phase2 import Refined
from biodyn_core.identification.problem import Case, Errors
from biodyn_core.identification.profiles import Profile
from biodyn_core.identification.residuals import ResidualCheck
from biodyn_core.identification.settings import Refiner
from biodyn_core.identification.uncertainty import Uncertainty
from biodyn_ros.reading.events import BagEvent, Prepared
from biodyn_ros.reading.provenance import MADE_BY_MODEL, origins_of, without_note

FitName = Literal["alone", "joint", "idealized", "without_prior"]
"""The fit to a case alone, the joint fit, the fusion of all fits to a case alone, the joint fit without its prior."""

Use = Literal["fitted", "held out", "another repetition"]


@dataclass(frozen=True, eq=False)
class FitEvent:
    """One event with its prediction errors by fit; only fitted events have `alone`, only fits with a prior the last."""

    bag: BagEvent
    case: Case
    use: Use
    errors: Mapping[FitName, Errors]

    @property
    def seconds(self) -> float:
        """The duration of the event."""
        return self.case.seat_mps2.size / self.case.rate_hz

    @property
    def seat_rms_mps2(self) -> float:
        """The rms of the seat's acceleration."""
        return float(np.sqrt(np.mean(self.case.seat_mps2**2)))


@dataclass(frozen=True, eq=False)
class Report:
    """The fit of a subject to events.

    given: the subject before the fit; events: those fitted to, in the order of the identification's cases, then those
    only predicted. better_mass_matrix: the one that predicts better, None where neither does; mass_matrix_percent: the
    mean error of both. not_profiled: parameters on a bound whose profile was requested. dealt: how held-out events were
    drawn, None if they were named. usual_residual: of the result in the events only predicted, by segment.
    """

    given: Subject
    identification: Identification
    events: tuple[FitEvent, ...]
    uncertainty: Uncertainty
    profiles: tuple[Profile, ...]
    not_profiled: tuple[str, ...]
    residual_checks: tuple[ResidualCheck, ...]
    better_mass_matrix: MassMatrix | None
    mass_matrix_percent: Mapping[MassMatrix, float]
    seed: int
    warnings: tuple[str, ...]
    seconds: float
    dealt: str | None = None
    usual_residual: Mapping[str, UsualResidual] = field(default_factory=dict)

    @property
    def joint(self) -> Fit:
        """The joint fit."""
        return self.identification.joint

    @property
    def distance(self) -> float | None:
        """Mahalanobis distance of the joint fit from the mean of its prior, None without one."""
        fit = self.joint
        return fit.prior and fit.prior.prior.distance(fit.refined.theta)

    @property
    def result(self) -> FitName:
        """The fit that the resulting subject is of."""
        return self.identification.settings.result

    @property
    def fitted(self) -> list[FitEvent]:
        """The events fitted to."""
        return [event for event in self.events if event.use == "fitted"]

    @property
    def held_out(self) -> list[FitEvent]:
        """The events only predicted."""
        return [event for event in self.events if event.use != "fitted"]

    @property
    def searches(self) -> list[tuple[str, Search]]:
        """Phase 1 under the subject's own mass matrix: one search for each case, or one for all."""
        found = self.identification
        own = found.searches[: len(found.searches) // 2]
        names = [case.case for case in found.cases] if len(own) == len(found.cases) else ["all"]
        return list(zip(names, own, strict=True))

    @property
    def refiners(self) -> dict[Refiner, Refined]:
        """Both refiners on Eq. 33 as printed, with the regularization of the settings, from one start."""
        return {run.refiner: run.refined for run in self.identification.refiners}

    @property
    def penalties(self) -> Counter[str]:
        """Objectives that were not finite, by cause."""
        return sum((part.penalties for part in self.identification.parts), Counter())


def warnings_of(events: Sequence[Prepared]) -> list[str]:
    """Warnings on the events with their bags, each once; recordings made by the model share one line."""
    made, rest = without_note(dict.fromkeys(f"{event.bag}: {line}" for event, case in events for line in case.warnings))
    return [f"{len(made)} of {counted(len(events), 'recording')}: {MADE_BY_MODEL}", *rest] if made else rest


def clock_warnings(found: Identification) -> Iterator[str]:
    """Warnings on sensors whose delay the joint fit estimates too large to be removed to first order."""
    for case, delays in zip(found.cases, found.joint.clock_delays_s, strict=False):  # empty where clocks are trusted
        half_s = 0.5 * (len(case.measured_mps2) - case.begin) / case.rate_hz
        for name, (delay_s, growth) in zip(MEASURED_SEGMENTS, delays.tolist(), strict=True):
            if abs(delay_s) + abs(growth) * half_s > LARGEST_DELAY_S:
                late = f"{1e3 * abs(delay_s):.1f} ms {'late' if delay_s > 0.0 else 'early'}"
                yield (
                    f"{case.name}: {name} fits best with a clock that is {late} and drifts by {1e6 * growth:.0f} ppm;"
                    f" above {1e3 * LARGEST_DELAY_S:g} ms parameters are wrong, and the size too: check stamps and"
                    " mountings, of its neighbours too"
                )


def reuse_warnings(given: Subject, held_out: Sequence[Prepared]) -> list[str]:
    """Warnings on held-out bags to which an effect of the given subject was fitted."""
    known = [source for _, source in origins_of(given, "fitted")] if given.effects else []
    bags = dict.fromkeys(event.bag for event, _ in held_out if any(event.source.overlaps(one) for one in known))
    return [f"{bag}: held out, but an effect of the given subject was fitted to it" for bag in bags]
