"""Recordings for tests of identification, their truth integrated by DOP853 from full matrices."""

from __future__ import annotations

from functools import cache

import naive
import numpy as np
from numpy.typing import NDArray
from scipy import signal

from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX
from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import MassMatrix, Subject
from biodyn_core.body.synthesis import load_case
from biodyn_core.identification.problem import Case, CaseSettings
from biodyn_core.recording.recording import Recording
from biodyn_core.signals.response import SpectrumSettings

Floats = NDArray[np.float64]

RATE_HZ = 600.0
LINES = CaseSettings(sharpen_seat=False)
"""The truth of these tests takes the seat as straight lines between samples, so nothing is to be made up for."""
SPECTRUM = SpectrumSettings(segment_s=1.0, lowest_hz=2.0)
MASS_MATRICES: tuple[MassMatrix, ...] = ("segment", "cascade")


def drawn(seed: int, mass_matrix: MassMatrix, margin: float = 0.15) -> Subject:
    """A subject drawn inside Table 1, `margin` of each range from its ends; m_scale is 1."""
    share = np.random.default_rng(seed).uniform(margin, 1.0 - margin, LOWER.size)
    theta = LOWER + (UPPER - LOWER) * share
    theta[14] = 1.0
    return Subject(f"drawn {seed}", 70.0, 1.75, mass_matrix, Parameters.from_vector(theta))


def theta_of(subject: Subject) -> Floats:
    """Its parameters (15,)."""
    return subject.parameters.vector()


def seat_motion(case: str, seconds: float, seed: int) -> Floats:
    """A low-passed vertical seat motion of a load case, (n,)."""
    motion = load_case(case, seconds, np.random.default_rng(seed), RATE_HZ).accel_mps2[:, 2]
    return low_passed(motion)


def low_passed(values: Floats) -> Floats:
    """Values (n, ...) as the recorder low-passes them."""
    return signal.sosfiltfilt(signal.butter(4, 100.0, fs=RATE_HZ, output="sos"), values, axis=0)


def recording(seat: Floats, accel: Floats, case: str = "road") -> Recording:
    """A recording of a seat (n,) and the accelerations of all (n, 6) or the measured (n, 5) segments."""
    measured = accel[:, MEASURED_SEGMENT_INDEX] if accel.shape[1] == 6 else accel
    stamps = np.rint(np.arange(seat.size) / RATE_HZ * 1e9).astype(np.int64)
    return Recording(case, case, RATE_HZ, stamps, seat, measured.copy(), ())


def ready(seat: Floats, accel: Floats, case: str = "road") -> Case:
    """The same, made ready."""
    return Case.of(recording(seat, accel, case), SPECTRUM, LINES)


@cache
def true_recordings(seconds: float = 4.0) -> dict[MassMatrix, tuple[Recording, ...]]:
    """Road, pothole and rail of `drawn(1, "segment")` and `drawn(2, "cascade")`, without noise."""
    bodies = [(theta_of(s), s.body_mass_kg, s.mass_matrix) for s in true_subjects().values()]
    cases = ("road", "pothole", "rail")
    seats = [seat_motion(case, seconds, number) for number, case in enumerate(cases)]
    each = naive.chain_responses(
        [body for body in bodies for _ in cases], np.array(seats * len(bodies)), RATE_HZ, rtol=1e-9
    )
    made = [
        recording(seat, accel, case) for seat, accel, case in zip(seats * len(bodies), each, cases * 2, strict=True)
    ]
    return {name: tuple(made[3 * number : 3 * number + 3]) for number, name in enumerate(MASS_MATRICES)}


def true_subjects() -> dict[MassMatrix, Subject]:
    """The true subject for each mass matrix."""
    return {name: drawn(number, name) for number, name in enumerate(MASS_MATRICES, 1)}


@cache
def true_cases(mass_matrix: MassMatrix) -> tuple[Case, ...]:
    """The recordings of one of them, made ready."""
    return tuple(Case.of(r, SPECTRUM, LINES) for r in true_recordings()[mass_matrix])
