"""Compare the answers with the truth and with the predictions of the true subject."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import PARAMETERS, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import prediction_errors
from biodyn_core.identification.problem import Case
from biodyn_core.identification.uncertainty import Estimate
from blind.recovery.draw import Person, Truth
from blind.recovery.identify import Answer, initial_subject

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

JOINTS: Final = (0, 1, 4, 5)
"""Joints 1, 2, 5 and 6: their natural frequencies must be identified."""


@dataclass(frozen=True, eq=False)
class MethodResult:
    """The subject of one method compared with the truth.

    log_ratio (14,): ln of found over true; error_percent (events, 5): of held-out events, over the measurement;
    unseen_percent (events, 6): over the true motion of all six segments.
    """

    log_ratio: Floats
    error_percent: Floats
    unseen_percent: Floats
    seconds: float


@dataclass(frozen=True, eq=False)
class PersonResult:
    """One person: both methods, the floor of the true subject (errors as in `MethodResult`), and our estimates.

    difference_percent (events, 6) is the difference between the predictions of our subject and of the true one.
    """

    truth: Truth
    mass_matrix: str
    ours: MethodResult
    papers: MethodResult
    floor: MethodResult
    difference_percent: Floats
    estimates: tuple[Estimate, ...]

    @property
    def ratio(self) -> Floats:
        """Our error over the floor, (events, 5)."""
        return self.ours.error_percent / self.floor.error_percent

    @property
    def papers_ratio(self) -> Floats:
        """Error of the method of the paper over the floor, (events, 5)."""
        return self.papers.error_percent / self.floor.error_percent

    @property
    def is_identifiable(self) -> bool:
        """Whether all of `JOINTS` are classified as identifiable."""
        return all(self.estimates[joint].identifiability == "identifiable" for joint in JOINTS)

    @property
    def inside(self) -> Flags:
        """Whether the intervals contain the truth, (14,)."""
        pairs = zip(self.estimates, self.truth.theta, strict=False)
        return np.array([estimate.lower <= true <= estimate.upper for estimate, true in pairs])

    @property
    def counted(self) -> Flags:
        """Whether each parameter has an interval, (14,): a parameter on a bound has none."""
        return np.array([not estimate.at_bound for estimate in self.estimates])


def largest_frequency_error(one: MethodResult) -> float:
    """Largest relative error of f_n of `JOINTS`."""
    return float(np.abs(np.expm1(one.log_ratio[list(JOINTS)])).max())


def compare(person: Person, answer: Answer, truth: Truth) -> PersonResult:
    """Compare both answers with the truth."""
    true = dataclasses.replace(initial_subject(person), parameters=Parameters.from_vector(truth.theta))
    return PersonResult(
        truth,
        person.mass_matrix,
        _result_of(answer.ours.subject, person, truth, answer.ours.seconds),
        _result_of(answer.papers.subject, person, truth, answer.papers.seconds),
        _result_of(true, person, truth, 0.0),
        np.array([_error_percent(_moved(answer.ours.subject, case), _moved(true, case)) for case in person.held_out]),
        answer.estimates,
    )


def _result_of(subject: Subject, person: Person, truth: Truth, seconds: float) -> MethodResult:
    # m_scale cancels from accelerations, so it is not identifiable.
    log_ratio = np.log(subject.parameters.vector() / truth.theta)[: len(PARAMETERS) - 1]
    measured = np.array([errors.nrmse_rms_percent for errors in prediction_errors(subject, person.held_out)])
    pairs = zip(person.held_out, truth.accel_mps2, strict=True)
    unseen = np.array([_error_percent(_moved(subject, case), accel[case.begin :, 1:]) for case, accel in pairs])
    return MethodResult(log_ratio, measured, unseen, seconds)


def _moved(subject: Subject, case: Case) -> Floats:
    """Accelerations of the six segments after the warm-up, (n, 6) m/s^2."""
    return Chain.of(subject).simulate(case.seat_mps2, case.rate_hz).accel_mps2[case.begin :]


def _error_percent(accel_mps2: Floats, reference_mps2: Floats) -> Floats:
    """Rms of the difference of (n, 6) over that of the reference, (6,)."""
    return 100.0 * np.sqrt(((accel_mps2 - reference_mps2) ** 2).sum(axis=0) / (reference_mps2**2).sum(axis=0))
