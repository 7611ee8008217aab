"""Fits of one person to few data and to many, without the prior and with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.parameters import UNFITTED, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import Fit, fit_joint, mean_percent, prediction_errors
from biodyn_core.identification.posterior import maximum_a_posteriori
from biodyn_core.identification.problem import Case
from biodyn_core.identification.uncertainty import uncertainty
from biodyn_core.population.distribution import SPREAD, theta_of
from biodyn_core.population.population import population
from blind.prior.people import Origin, Person

Floats = NDArray[np.float64]

AMPLE: Final = "road, potholes, rails: 44 s, all sensors"


@dataclass(frozen=True)
class Amount:
    """Data of a fit: events, seconds of each after the warm-up (None: all), and the sensors on the body."""

    name: str
    events: tuple[str, ...]
    seconds: float | None = None
    sensors: tuple[str, ...] = MEASURED_SEGMENTS


_EACH: Final = ("road_1", "pothole_1", "rail_1")
HEAD: Final = ("head",)
AMOUNTS: Final = (
    Amount("road: 1 s, head alone", ("road_1",), 1.0, HEAD),
    Amount("road: 3 s, head alone", ("road_1",), 3.0, HEAD),
    Amount("road: 10 s, head alone", ("road_1",), 10.0, HEAD),
    Amount("road, pothole, rail: 22 s, head alone", _EACH, None, HEAD),
    Amount("road: 1 s, all sensors", ("road_1",), 1.0),
    Amount("road: 3 s, all sensors", ("road_1",), 3.0),
    Amount("road: 10 s, all sensors", ("road_1",), 10.0),
    Amount("road at a quarter: 3 s, all sensors", ("road_2",), 3.0),
    Amount("road at a quarter: 10 s, all sensors", ("road_2",), 10.0),
    Amount("road, pothole, rail: 22 s, all sensors", _EACH),
    Amount(AMPLE, ("road_1", "road_3", "pothole_1", "pothole_2", "rail_1", "rail_2")),
)
"""From little to ample."""


@dataclass(frozen=True)
class Score:
    """One fit: error in held-out events, rms error of ln theta, 95 % intervals with the truth and all intervals."""

    error_percent: float
    parameter_error: float
    inside: int
    intervals: int


@dataclass(frozen=True)
class FitPair:
    """Both fits of a person to one amount of data.

    from_prior: parameters that are from the prior; group_percent: error of the group's mean, without any fit.
    """

    person: int
    origin: Origin
    amount: str
    without: Score
    with_prior: Score
    from_prior: int
    group_percent: float


def pairs(person: Person, amounts: Sequence[Amount] = AMOUNTS) -> Iterator[FitPair]:
    """All fits of one person."""
    given = Subject("drawn", person.body_mass_kg, 1.75, "segment", UNFITTED)
    prior = population().without_softening
    group = theta_of(prior.mean)
    group_percent = _error_percent(dataclasses.replace(given, parameters=Parameters.from_vector(group)), person)
    for amount in amounts:
        cases = [_part(person.fit[name], amount) for name in amount.events]
        alone = fit_joint(cases, given, 0)
        both = [_score(fit, cases, person) for fit in (alone, maximum_a_posteriori(alone, cases, prior))]
        (without, _), (with_prior, from_prior) = both
        yield FitPair(person.number, person.origin, amount.name, without, with_prior, from_prior, group_percent)


def _part(case: Case, amount: Amount) -> Case:
    """The begin of a case, with some of its sensors."""
    end = None if amount.seconds is None else case.begin + round(amount.seconds * case.rate_hz)
    kept = np.array([name in amount.sensors for name in MEASURED_SEGMENTS])
    compared = case.compared[:end] & kept
    measured = np.where(compared, case.measured_mps2[:end], 0.0)
    return dataclasses.replace(
        case, seat_mps2=case.seat_mps2[:end], measured_mps2=measured, compared=compared,
        energy=(measured**2).sum(axis=0), transmissibility=case.transmissibility * kept,
        coherence=case.coherence * kept, channels={name: values[:end] for name, values in case.channels.items()},
    )  # fmt: skip


def _score(fit: Fit, cases: Sequence[Case], person: Person) -> tuple[Score, int]:
    """The score of a fit, and how many parameters are from the prior."""
    estimates = [one for one in uncertainty(fit, cases).estimates if not one.at_bound]
    truth = dict(zip(fit.settings.fitted, person.theta, strict=False))
    inside = sum(bool(one.lower <= truth[one.name] <= one.upper) for one in estimates)
    away = np.log(fit.refined.theta / person.theta)[SPREAD]
    score = Score(_error_percent(fit.subject, person), float(np.sqrt(np.mean(away**2))), inside, len(estimates))
    return score, sum(one.identifiability == "from the prior" for one in estimates)


def _error_percent(subject: Subject, person: Person) -> float:
    return mean_percent(prediction_errors(subject, person.held))
