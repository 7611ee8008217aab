"""A short session as a bag: drives between rests of 5 s, made by the model."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from biodyn_core.body.subject import load_subject
from biodyn_core.body.synthesis import SeatMotion
from biodyn_core.body.synthesis_settings import SensorSettings
from biodyn_ros.base.resources import subject_file
from biodyn_ros.simulate import motion_of_cases, simulate_bag

CASES = ("road", "pothole", "rail", "road")
REST_S = 5.0


def session_bag(path: Path, seed: int = 4, cases: tuple[str, ...] = CASES, drive_s: float = 12.0) -> Path:
    """Write the bag of a session."""
    rate_hz = 4 * 1129.3
    count = round(rate_hz * REST_S)
    still = SeatMotion(rate_hz, np.zeros((count, 3)), np.zeros(count))
    drives = [motion_of_cases([case], drive_s, number) for number, case in enumerate(cases)]
    parts = [still, *(part for drive in drives for part in (drive, still))]
    motion = SeatMotion(
        rate_hz,
        np.concatenate([part.accel_mps2 for part in parts]),
        np.concatenate([part.pitch_rate_radps for part in parts]),
    )
    simulate_bag(path, load_subject(subject_file("subject_1")), motion, seed, SensorSettings())
    return path
