"""Draw people, seat motions and sensors; separate the known data of each person from the hidden truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, signal
from world import body, ride, seats

from biodyn_core.body.subject import MassMatrix
from biodyn_core.identification.problem import Case
from biodyn_core.recording.recording import Recorder, Recording

Floats = NDArray[np.float64]

TRAINING_S: Final = 9.0
HELD_OUT_S: Final = 8.0
"""Motion in an event; rest before and after comes on top."""

LOW_PASS_HZ: Final = 100.0


@dataclass(frozen=True, eq=False)
class Person:
    """The known data: body mass, mass matrix, and for each kind of motion one case to fit and one to predict."""

    body_mass_kg: float
    mass_matrix: MassMatrix
    training: tuple[Case, ...]
    held_out: tuple[Case, ...]


@dataclass(frozen=True, eq=False)
class Truth:
    """The hidden truth: theta (15,), the origins of the seat motions, the accelerations in the held-out events.

    accel_mps2 are (n, 7), the seat and six segments, low-passed, on the grid of each held-out case.
    """

    theta: Floats
    training: tuple[str, ...]
    held_out: tuple[str, ...]
    accel_mps2: tuple[Floats, ...]


def draw(
    count: int,
    seed: int,
    kinds: tuple[seats.Case, ...] = seats.CASES,
    seconds: tuple[float, float] = (TRAINING_S, HELD_OUT_S),
    recorded: bool = True,
    report: Callable[[str], None] = lambda text: None,
) -> tuple[list[Person], list[Truth]]:
    """Draw people and simulate them; seat motions alternate between synthetic and recorded, held-out ones inversely."""
    rng = np.random.default_rng(seed)
    people = body.drawn(count, rng)
    worn = [ride.wear(rng) for _ in range(count)]
    cases: list[list[Case]] = [[] for _ in range(count)]
    origins: list[list[str]] = [[] for _ in range(count)]
    truths: list[list[Floats]] = [[] for _ in range(count)]
    for turn, length_s in enumerate(seconds):
        for number, kind in enumerate(kinds):
            report(f"{('training', 'held out')[turn]}, {kind}")
            choice = [seats.ORIGINS[(i // 2 + number + turn) % 2 if recorded else 0] for i in range(count)]
            motions = [seats.motion(kind, origin, length_s, rng) for origin in choice]
            for i, event in enumerate(ride.rides(people, worn, motions, rng)):
                recording = _recorded(event)
                cases[i].append(Case.of(recording))
                origins[i].append(event.origin)
                truths[i].append(_low_passed(event, recording) if turn else np.empty((0, 7)))
    k = len(kinds)
    known = [
        Person(float(people.body_mass_kg[i]), "cascade" if people.cascade[i] else "segment", tuple(c[:k]), tuple(c[k:]))
        for i, c in enumerate(cases)
    ]
    hidden = [Truth(people.theta[i], tuple(o[:k]), tuple(o[k:]), tuple(truths[i][k:])) for i, o in enumerate(origins)]
    return known, hidden


def _recorded(event: ride.Ride) -> Recording:
    """Process raw streams with the recorder of the package."""
    recorder = Recorder(event.case, event.case)
    for sensor, (stamps_ns, force_mps2) in event.streams.items():
        recorder.push(sensor, stamps_ns, force_mps2)
    (recording,) = recorder.finish()
    return recording


def _low_passed(event: ride.Ride, recording: Recording) -> Floats:
    """The truth (n, 7) at the recording's stamps with the same low-pass, as measured by a perfect sensor."""
    sos = signal.butter(4, LOW_PASS_HZ, fs=seats.RATE_HZ, output="sos")
    truth = signal.sosfiltfilt(sos, event.truth_mps2, axis=0)
    time_s = np.arange(len(truth)) / seats.RATE_HZ
    return np.asarray(interpolate.CubicSpline(time_s, truth)(1e-9 * recording.stamps_ns))
