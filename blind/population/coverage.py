"""Coverage: whether the figures of people drawn from the population lie in the band of its mean, on the same drive."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.segments import SEAT, STANDARD_GRAVITY_MPS2
from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.body.synthesis import load_case
from biodyn_core.body.synthesis_settings import CASES, NATIVE_RATE_HZ
from biodyn_core.exposure.figure_spread import interval
from biodyn_core.pipeline.exposure import Exposure
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.population.population import new_subject, population
from blind.population.deriving import BODY_MASS_KG

SECONDS: Final = 20.0
REST_S: Final = 2.0
SEED: Final = 7


def covered(people: int) -> dict[str, float]:
    """Share of the figures of drawn people in the 95 % interval of the population's mean, percent by figure."""
    hits: dict[str, list[bool]] = {}
    rng = np.random.default_rng(SEED)
    for case in CASES:
        seat = _seat(case)
        predicted = _exposure(new_subject("mean", BODY_MASS_KG, 1.75), seat)
        for theta in population().at_rest.draw(rng, people):
            person = person_of(theta)
            for figure, inside in _inside(predicted, _exposure(person, seat)):
                hits.setdefault(figure, []).append(inside)
    return {figure: 100.0 * float(np.mean(found)) for figure, found in hits.items()}


def person_of(theta: NDArray[np.float64]) -> Subject:
    """A subject of the population with this theta (15,)."""
    return Subject("drawn", BODY_MASS_KG, 1.75, "segment", Parameters.from_vector(theta), population().effects)


def _seat(case: str) -> NDArray[np.float64]:
    """Specific force (n, 3) of the seat: rest, then a load case."""
    motion = load_case(case, SECONDS, np.random.default_rng(SEED), NATIVE_RATE_HZ).accel_mps2.copy()
    motion[:, :2] = 0.0
    whole = np.concatenate([np.zeros((round(REST_S * NATIVE_RATE_HZ), 3)), motion])
    return whole + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])


def _exposure(subject: Subject, seat: NDArray[np.float64]) -> Exposure:
    pipeline = Pipeline(subject)
    stamps_ns = np.round(1e9 * np.arange(1, len(seat) + 1) / NATIVE_RATE_HZ).astype(np.int64)
    pipeline.push(SEAT, stamps_ns, seat)
    pipeline.finish()
    return pipeline.exposure()


def _inside(predicted: Exposure, true: Exposure) -> Iterator[tuple[str, bool]]:
    """Each figure, and whether the true one is in the interval of the predicted one."""
    for name, spread in predicted.spreads.items():
        dose, truth = predicted.predicted[name], true.predicted[name]
        force, true_force = predicted.joint_forces[name], true.joint_forces[name]
        for figure, value, of, wide in (
            ("aw of a segment", truth.aw_mps2, dose.aw_mps2, spread.accel.of_means),
            ("VDV of a segment", truth.vdv_mps175, dose.vdv_mps175, spread.accel.of_vdv),
            ("weighted peak of a segment", truth.peak_mps2, dose.peak_mps2, spread.accel.of_peaks),
            ("rms of a joint's force", true_force.rms_n, force.rms_n, spread.force.of_means),
            ("largest compression", true_force.compression_n, force.compression_n, spread.force.of_peaks),
        ):
            if wide is not None:
                lower, upper = interval(of, wide)
                yield figure, lower <= value <= upper
