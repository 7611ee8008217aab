"""Blocks as trajectory_msgs/JointTrajectory, read by the real ROS 2."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from streams import in_turn, noisy_streams, predicted_frames, run
from trajectory_msgs.msg import JointTrajectory

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import N_SENSORS, SEGMENTS, SENSORS
from biodyn_core.body.model import parts_of_motion
from biodyn_core.pipeline.frames import MeasuredFrames, PredictedFrames
from biodyn_ros.bag.blocks import LONGEST_BLOCK, measured_blocks, predicted_blocks
from biodyn_ros.bag.trajectories import SEQUENCES, TrajectoryTemplate

EPOCH_NS = 1_700_000_000_999_999_000


def times_ns(message: JointTrajectory) -> list[int]:
    begin_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    return [begin_ns + p.time_from_start.sec * 10**9 + p.time_from_start.nanosec for p in message.points]


@given(
    frame_id=st.text("abcdefgh", max_size=9),
    names=st.lists(st.text("xyzü_", min_size=1, max_size=7), min_size=1, max_size=7, unique=True),
    given_sequences=st.sets(st.sampled_from(SEQUENCES), min_size=1),
    counts=st.lists(st.integers(1, 9), min_size=1, max_size=4),
)
def test_ros_reads_what_was_written(
    frame_id: str, names: list[str], given_sequences: set[str], counts: list[int]
) -> None:
    """For any alignment of the points; a template is used again for blocks of other lengths."""
    template = TrajectoryTemplate(frame_id, names, given_sequences)
    rng = np.random.default_rng(len(names))
    for count in counts:
        stamps_ns = EPOCH_NS + np.arange(count) * 885_503
        values = {name: rng.standard_normal((count, len(names))) for name in given_sequences}
        written = template.fill(stamps_ns, values)
        message = deserialize_message(written, JointTrajectory)
        assert (message.header.frame_id, list(message.joint_names)) == (frame_id, names)
        assert times_ns(message) == template.times_ns(written).tolist() == stamps_ns.tolist()
        for index, point in enumerate(message.points):
            for name in SEQUENCES:
                assert list(getattr(point, name)) == (values[name][index].tolist() if name in values else [])


def test_stamps_that_jump_back_and_negative_ones_are_kept() -> None:
    template, stamps_ns = TrajectoryTemplate("seat", SEGMENTS, ["effort"]), np.array([5, -7, 3_000_000_001])
    written = template.fill(stamps_ns, {"effort": np.zeros((3, 6))})
    assert times_ns(deserialize_message(written, JointTrajectory)) == stamps_ns.tolist()


def test_a_stamp_outside_ros_is_refused() -> None:
    with pytest.raises(InputError, match="does not fit a ROS stamp"):
        TrajectoryTemplate("seat", SEGMENTS, ["effort"]).fill(np.array([2**62]), {"effort": np.zeros((1, 6))})


def test_a_block_has_the_frames_of_the_pipeline() -> None:
    frames = run(noisy_streams(), in_turn(noisy_streams()))
    predicted = PredictedFrames(frames.predicted_ns, frames.predicted, frames.motion)
    messages = [deserialize_message(one, JointTrajectory) for _, one in predicted_blocks(True).blocks(predicted)]
    assert {tuple(one.joint_names) for one in messages} == {SEGMENTS}
    assert max(len(one.points) for one in messages) == LONGEST_BLOCK
    points = [point for one in messages for point in one.points]
    displacement_m, velocity_mps, force_n = parts_of_motion(frames.motion)
    for name, expected in zip(SEQUENCES, (displacement_m, velocity_mps, frames.predicted, force_n), strict=True):
        np.testing.assert_array_equal([getattr(point, name) for point in points], expected)
    assert [stamp for one in messages for stamp in times_ns(one)] == frames.predicted_ns.tolist()


def test_without_forces_the_effort_is_empty_and_lost_instants_are_left_out() -> None:
    accel = np.ones((4, 6))
    accel[1] = np.nan
    ((last_ns, written),) = predicted_blocks(False).blocks(predicted_frames(np.arange(4), accel))
    message = deserialize_message(written, JointTrajectory)
    assert last_ns == 3 and times_ns(message) == [0, 2, 3]
    assert all(len(point.effort) == 0 and len(point.positions) == 6 for point in message.points)
    assert not list(predicted_blocks(True).blocks(predicted_frames(np.arange(1), np.full((1, 6), np.nan))))


def test_a_sensor_without_a_value_is_nan_in_a_measured_block() -> None:
    accel = np.ones((2, N_SENSORS))
    accel[0, 3] = np.nan
    ((_, written),) = measured_blocks().blocks(MeasuredFrames(np.arange(2), accel, accel[:, 1:]))
    message = deserialize_message(written, JointTrajectory)
    assert tuple(message.joint_names) == SENSORS and not message.points[0].effort
    np.testing.assert_array_equal([point.accelerations for point in message.points], accel)
