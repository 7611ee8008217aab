"""Fitting: one person is fitted once on the events that were found, once on events cut by hand from the list."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from world import body, ride
from world.effects import bags
from world.seats import RATE_HZ
from world.session import Planted, SessionMotion, session

from biodyn_core.body.parameters import UNFITTED, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import prediction_errors
from biodyn_core.identification.problem import Case
from biodyn_ros.base.progress import silent
from biodyn_ros.events.finding import find_events
from biodyn_ros.fit.document import fitted_subject
from biodyn_ros.fit.fitting import FitOptions, fit_bags
from biodyn_ros.reading.events_file import load_events, write_events
from biodyn_ros.reading.parts import BagPart
from biodyn_ros.reading.recordings import read_recordings
from biodyn_ros.subject.uses import used_events
from biodyn_ros.work.tasks import Work

BEGIN_NS: Final = 1_700_000_000 * 10**9
LEAD_S, TAIL_S = 3.0, 2.0
"""A person cuts so much before and after a shock."""

LEAST_ROAD_S: Final = 15.0
LONGEST_ROAD_S: Final = 30.0
PER_CASE: Final = 8
PIECE_S: Final = 60.0


@dataclass(frozen=True)
class FitScore:
    """Mean errors, percent of the rms, in events of another drive: fitted on found events, by hand, and of the truth.

    theta_percent: the largest difference of a natural frequency or damping ratio from the truth, of both fits.
    """

    found_percent: float
    by_hand_percent: float
    true_percent: float
    found_theta_percent: float
    by_hand_theta_percent: float

    @property
    def ratio(self) -> float:
        """The error after the fit on found events over that by hand."""
        return self.found_percent / self.by_hand_percent


def scores_of(people: int, minutes: float, seed: int, report: Callable[[str], None]) -> list[FitScore]:
    """Simulate people in sessions, fit each twice, and predict an independent drive."""
    rng = np.random.default_rng(seed)
    persons = dataclasses.replace(body.drawn(people, rng), cascade=np.zeros(people, dtype=np.bool_))
    worn = [{name: dataclasses.replace(imu, drift=0.0) for name, imu in ride.wear(rng).items()} for _ in range(people)]
    with tempfile.TemporaryDirectory(prefix="biodyn-") as folder:
        drives = {}
        for name, length in (("session", minutes), ("other", 0.3 * minutes)):
            report(f"{name}: {people} people are moved for {length:g} minutes or more")
            drives[name] = _written(Path(folder), name, persons, worn, length, rng)
        found = []
        for k in range(people):
            report(f"person {k + 1} of {people} is fitted")
            given = Subject(f"person_{k}", float(persons.body_mass_kg[k]), 1.75, "segment", UNFITTED)
            found.append(_score(given, persons.theta[k], *drives["session"][k], *drives["other"][k]))
        return found


def by_hand(bag: Path, planted: Sequence[Planted]) -> list[BagPart]:
    """Events that a person cuts with the list: shocks with lead and tail, and long pieces of road, none overlapping."""
    parts: list[BagPart] = []
    for one in planted:
        if one.kind == "road" and one.end_s - one.begin_s >= LEAST_ROAD_S:
            begin_s, end_s = one.begin_s + LEAD_S, min(one.end_s - LEAD_S, one.begin_s + LEAD_S + LONGEST_ROAD_S)
        elif one.peak_g >= 0.8:
            begin_s, end_s = one.begin_s - LEAD_S, one.end_s + TAIL_S
        else:
            continue
        if not parts or begin_s >= parts[-1].end_s:
            name = f"{one.kind}_{len(parts):02d}"
            parts.append(BagPart(bag, round(begin_s, 2), round(end_s, 2), one.kind, name=name))
    return parts


def _written(
    folder: Path, name: str, persons: body.People, worn: Sequence[dict[str, object]], minutes: float,
    rng: np.random.Generator,
) -> list[tuple[Path, SessionMotion]]:  # fmt: skip
    """One session for each person, all of one length, as bags with one clock."""
    motions = [session(minutes, rng) for _ in range(len(persons))]
    count = min(len(motion.accel_mps2) for motion in motions)
    seats = [motion.accel_mps2[:count] for motion in motions]
    answers = body.accelerations(persons, RATE_HZ, np.column_stack([seat[:, 2] for seat in seats]), piece_s=PIECE_S)
    found = []
    for k, (seat, answer, imus) in enumerate(zip(seats, answers, worn, strict=True)):
        up, streams = np.column_stack([seat[:, 2], answer]), {}
        for sensor, imu in imus.items():
            truth = np.column_stack([seat[:, :2], up[:, ride.SENSORS.index(sensor)]])
            stamps, force = imu.stream(truth, RATE_HZ, rng)  # type: ignore[attr-defined]
            gyro = 0.003 * rng.standard_normal(3) + 0.002 * rng.standard_normal(force.shape)
            streams[sensor] = stamps, force, gyro
        bag = folder / f"{name}_{k}.mcap"
        bags.write(bag, streams, BEGIN_NS)
        end_s = count / RATE_HZ
        planted = tuple(one for one in motions[k].planted if one.end_s < end_s - 1.0)
        found.append((bag, SessionMotion(seat, planted)))
    return found


def _score(
    given: Subject, theta: np.ndarray, bag: Path, motion: SessionMotion, other: Path, other_motion: SessionMotion
) -> FitScore:
    events = bag.with_suffix(".events.yaml")
    write_events([find_events(bag)], events)
    fits = [_fitted(given, parts) for parts in (load_events(events), by_hand(bag, motion.planted))]
    true = dataclasses.replace(given, parameters=Parameters.from_vector(theta))
    cases = [Case.of(recording) for part in by_hand(other, other_motion.planted) for recording in read_recordings(part)]
    errors = [
        float(np.mean([one.mean_percent for one in prediction_errors(subject, cases)])) for subject in (*fits, true)
    ]
    away = [float(np.abs(fit.parameters.vector()[:12] / theta[:12] - 1.0).max() * 100.0) for fit in fits]
    return FitScore(*errors, *away)


def _fitted(given: Subject, parts: Sequence[BagPart]) -> Subject:
    used = used_events(parts, PER_CASE, seed=0)
    report = fit_bags(used.fit, given, FitOptions(held_out=used.held_out), Work(monitor=silent))
    return fitted_subject(report)
