"""Coverage: whether the figures of people drawn from the population lie in the band of its mean, on the same motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
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
SEEDS: Final = (7, 8, 9, 10, 11)
"""One for each realisation of a load case: a peak is that of a few samples, so one realisation says little."""

SINE_HZ: Final = (1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0)
SINE_RMS_MPS2: Final = 1.0
SINES: Final = tuple(f"{frequency_hz:g} Hz" for frequency_hz in SINE_HZ)

Coverage = Mapping[str, Mapping[str, float]]
"""By motion (load cases, then sine vibration) and figure, percent."""


def covered(people: int) -> Coverage:
    """Share of the figures of drawn people in the 95 % interval of the population's mean.

    people: drawn for each motion; the realisations of a load case share them.
    """
    motions = {case: [_drive(case, seed) for seed in SEEDS] for case in CASES}
    motions |= {name: [_sine(frequency_hz)] for name, frequency_hz in zip(SINES, SINE_HZ, strict=True)}
    rng = np.random.default_rng(SEEDS[0])
    return {name: _covered(drives, population().at_rest.draw(rng, people)) for name, drives in motions.items()}


def averaged(coverage: Coverage, motions: Iterable[str]) -> dict[str, float]:
    """Mean over these motions, by figure."""
    rows = [coverage[motion] for motion in motions]
    return {figure: float(np.mean([row[figure] for row in rows])) for figure in rows[0]}


def person_of(theta: NDArray[np.float64]) -> Subject:
    """A subject of the population with this theta (15,)."""
    return Subject("drawn", BODY_MASS_KG, 1.75, "segment", Parameters.from_vector(theta), population().effects)


def _drive(case: str, seed: int) -> NDArray[np.float64]:
    """Vertical acceleration (n,) of one realisation of a load case."""
    return load_case(case, SECONDS, np.random.default_rng(seed), NATIVE_RATE_HZ).accel_mps2[:, 2]


def _sine(frequency_hz: float) -> NDArray[np.float64]:
    """Vertical acceleration (n,) that grows over a second to its amplitude."""
    time_s = np.arange(round(SECONDS * NATIVE_RATE_HZ)) / NATIVE_RATE_HZ
    sine = np.sin(2.0 * np.pi * frequency_hz * time_s)
    return np.sqrt(2.0) * SINE_RMS_MPS2 * np.minimum(time_s, 1.0) * sine


def _covered(drives: Sequence[NDArray[np.float64]], people: NDArray[np.float64]) -> dict[str, float]:
    """Share of people (n, 15) in the interval, percent by figure; each has one of the realisations (n,) of a motion."""
    hits = dict[str, list[bool]]()
    for number, vertical_mps2 in enumerate(drives):
        seat = _specific_force(vertical_mps2)
        predicted = _exposure(new_subject("mean", BODY_MASS_KG, 1.75), seat)
        for theta in people[number :: len(drives)]:
            for figure, inside in _inside(predicted, _exposure(person_of(theta), seat)):
                hits.setdefault(figure, []).append(inside)
    return {figure: 100.0 * float(np.mean(found)) for figure, found in hits.items()}


def _specific_force(vertical_mps2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Specific force (n, 3) of the seat: rest, then this motion."""
    vertical = np.concatenate([np.zeros(round(REST_S * NATIVE_RATE_HZ)), vertical_mps2])
    return np.column_stack([np.zeros((len(vertical), 2)), vertical + STANDARD_GRAVITY_MPS2])


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
            ("rms of a joint's force", true_force.rms_n, force.rms_n, spread.force.of_rms),
            (
                "largest compression of a joint",
                true_force.compression_n,
                force.compression_n,
                spread.force.of_compression,
            ),
            ("largest tension of a joint", true_force.tension_n, force.tension_n, spread.force.of_tension),
        ):
            if wide is not None:
                lower, upper = interval(of, wide)
                yield figure, lower <= value <= upper
