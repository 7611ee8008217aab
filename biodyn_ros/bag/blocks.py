"""Blocks: frames of the pipeline as trajectory_msgs/JointTrajectory, for the live node and for bags."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final, Generic, TypeVar

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.segments import SEAT, SEGMENTS, SENSORS
from biodyn_core.body.model import parts_of_motion
from biodyn_core.pipeline.frames import MeasuredFrames, PredictedFrames
from biodyn_ros.bag.trajectories import SEQUENCES, TrajectoryTemplate

AnyFrames = TypeVar("AnyFrames", PredictedFrames, MeasuredFrames)

LONGEST_BLOCK: Final = 256
"""Most samples of one message."""


class BlockEncoder(Generic[AnyFrames]):
    """Serialized blocks of one kind of frames; numbers: each sequence of a message (n, names) of some frames."""

    def __init__(self, template: TrajectoryTemplate, numbers: Callable[[AnyFrames], dict[str, Floats]]) -> None:
        self._template, self._numbers = template, numbers

    def blocks(self, frames: AnyFrames, longest: int = LONGEST_BLOCK) -> Iterator[tuple[int, bytes]]:
        """The last stamp, ns, and the message of each block, without instants at which no acceleration is known."""
        unknown = np.isnan(frames.accel_mps2).all(axis=1)
        if unknown.any():
            frames = type(frames)(*(column[~unknown] for column in frames))
        for begin in range(0, frames.stamps_ns.size, longest):
            part = type(frames)(*(column[begin : begin + longest] for column in frames))
            yield int(part.stamps_ns[-1]), self._template.fill(part.stamps_ns, self._numbers(part))

    def times_ns(self, message: bytes) -> Integers:
        """The stamps (n,) of a message."""
        return self._template.times_ns(message)


def predicted_blocks(are_forces_known: bool) -> BlockEncoder[PredictedFrames]:
    """Predictions: displacement and velocity relative to the seat, absolute acceleration, force in the joint below.

    Without known forces, as under `cascade`, the effort stays empty.
    """
    sequences = SEQUENCES if are_forces_known else tuple(name for name in SEQUENCES if name != "effort")
    return BlockEncoder(TrajectoryTemplate(SEAT, SEGMENTS, sequences), _predicted_numbers)


def measured_blocks() -> BlockEncoder[MeasuredFrames]:
    """Measurements: the vertical acceleration of each sensor, NaN where it has none."""
    return BlockEncoder(TrajectoryTemplate(SEAT, SENSORS, ["accelerations"]), _measured_numbers)


def _predicted_numbers(frames: PredictedFrames) -> dict[str, Floats]:
    displacement_m, velocity_mps, force_n = parts_of_motion(frames.motion)
    return {
        "positions": displacement_m, "velocities": velocity_mps, "accelerations": frames.accel_mps2, "effort": force_n
    }  # fmt: skip


def _measured_numbers(frames: MeasuredFrames) -> dict[str, Floats]:
    return {"accelerations": frames.accel_mps2}
