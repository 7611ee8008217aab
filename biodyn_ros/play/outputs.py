"""Recognises the outputs of a live node in a recording: played, they would pose as those of the running node."""

from __future__ import annotations

from typing import Final

from biodyn_ros.bag import BagReader
from biodyn_ros.bag.cdr import ACCEL_STAMPED_TYPE, STRING_TYPE
from biodyn_ros.bag.trajectories import JOINT_TRAJECTORY_TYPE
from biodyn_ros.base import topics

CLOCK: Final = "/clock"

OUTPUT_TYPES: Final = {
    **dict.fromkeys((*topics.PREDICTED.values(), *topics.MEASURED.values()), ACCEL_STAMPED_TYPE),
    **dict.fromkeys((topics.PREDICTED_BLOCK, topics.MEASURED_BLOCK), JOINT_TRAJECTORY_TYPE),
    **dict.fromkeys(topics.SCALARS, "std_msgs/msg/Float64"),
    **dict.fromkeys((topics.SNAPSHOT, topics.MARKS), STRING_TYPE),
    topics.DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}
"""The message type of every topic that the live node publishes."""


def is_output(topic: str, kind: str) -> bool:
    """Whether a topic of this name and type is an output of a live node.

    The node may have another name or a namespace: the type and the last part of the name identify the topic.
    """
    name = f"/{topic.lstrip('/')}"
    return any(
        kind == of and (name.endswith(output[1:]) if output.startswith("~") else name == output)
        for output, of in OUTPUT_TYPES.items()
    )


def recorded_outputs(reader: BagReader, clock: bool) -> list[str]:
    """The topics of the bag that are outputs of a live node; clock: with the recorded clock too."""
    return [
        topic.name
        for topic in reader.topics
        if topic.messages and (is_output(topic.name, topic.type) or (clock and f"/{topic.name.lstrip('/')}" == CLOCK))
    ]
