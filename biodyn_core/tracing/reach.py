"""Reach: how far and how fast joints and segments of a subject move in its events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.model import predict
from biodyn_core.body.subject import Subject
from biodyn_core.effects import Effect
from biodyn_core.identification.problem import Case


@dataclass(frozen=True, eq=False)
class Reach:
    """Medians over the events, (6,) each: the largest stretch m and rate m/s of each joint, and its rms rate.

    displacement_m: the largest displacement of each segment relative to the seat.
    """

    stretch_m: Floats
    rate_mps: Floats
    rms_rate_mps: Floats
    displacement_m: Floats

    @classmethod
    def of(cls, subject: Subject, cases: Sequence[Case]) -> Reach:
        """Simulate the events; the warm-up does not count."""
        found = []
        for case in cases:
            response = predict(subject, case.seat_mps2, case.rate_hz, case.channels)
            stretch, rate = response.stretch_m[case.begin :], response.stretch_rate_mps[case.begin :]
            largest = [np.abs(each).max(axis=0) for each in (stretch, rate, response.displacement_m[case.begin :])]
            found.append((largest[0], largest[1], np.sqrt((rate**2).mean(axis=0)), largest[2]))
        return cls(*(np.median(each, axis=0) for each in zip(*found, strict=True)))

    def at(self, effect: Effect, site: str) -> float:
        """The length, m, on which an effect depends at a site: of a joint its stretch; nan outside the chain."""
        if effect.place not in ("joint", "segment") or site not in SEGMENTS:
            return float("nan")
        lengths = self.stretch_m if effect.place == "joint" else self.displacement_m
        return float(lengths[SEGMENTS.index(site)])
